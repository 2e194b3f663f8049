"""One config over all that a study varies: points, workers, one table, one page."""
