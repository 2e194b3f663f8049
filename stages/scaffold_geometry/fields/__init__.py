"""Scalar fields whose level sets are scaffolds, on voxels and at points, and the certificate of a field."""
