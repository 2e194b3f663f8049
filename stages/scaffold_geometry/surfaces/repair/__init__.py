"""Repair of surfaces: merge, fill holes, split, resolve intersections, rebuild, and how far that moves them."""
