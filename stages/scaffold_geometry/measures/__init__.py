"""Measures of a solid, one module each, with source, unit and error."""
