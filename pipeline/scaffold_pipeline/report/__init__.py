"""What a run leaves for people and other tools: its files, its record and one page."""
