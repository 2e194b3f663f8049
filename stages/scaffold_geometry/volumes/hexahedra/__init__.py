"""Hexahedra in a closed shape: a grid of cubes, and a fit to its surface."""
