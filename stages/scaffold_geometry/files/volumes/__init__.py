"""Files of volume meshes: one module per format."""
