"""Triangle meshes: topology, shells, nesting, booleans, intersections, and in a folder of its own repair."""
