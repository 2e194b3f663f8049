"""Scalar fields whose level sets are scaffolds, on voxels and at points, and their certificate."""
