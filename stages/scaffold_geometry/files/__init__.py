"""Files that are read and written: surfaces, points, and in rooms of their own solids and volume meshes."""
