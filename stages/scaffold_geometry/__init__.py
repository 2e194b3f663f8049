"""Geometry on arrays, by subject, for stages and plug-ins."""
