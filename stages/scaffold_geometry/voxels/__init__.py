"""Regular grids: samples, voxel images, iso-surfaces and offsets."""
