"""Triangle meshes: topology, shells, nesting, booleans, intersections, and in a room of its own repair."""
