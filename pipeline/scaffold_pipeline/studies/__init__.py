"""Studies: a config with varied parameters, its points, their workers, one table and one page."""
