"""Readers of surface files, one module for each format; `reading` selects one by the suffix."""
