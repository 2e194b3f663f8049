"""File formats: surfaces, solids, volume meshes and points."""
