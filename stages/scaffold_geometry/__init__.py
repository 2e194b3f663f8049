"""Geometry on arrays, by subject: what stages and plug-ins compute with."""
