"""Volume meshes: files that hold them, their cells and their boundary; plain numpy, so apart from the kernels."""
