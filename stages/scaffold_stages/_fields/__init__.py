"""What the field stages share: sampling on voxels, fields of meshes with their certificate, dense interpolation."""
