"""Files of volume meshes: a module for each format that is read."""
