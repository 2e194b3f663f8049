"""The results that a run writes: its files, its record and one page."""
