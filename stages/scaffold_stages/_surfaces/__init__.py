"""Repair of surfaces on arrays: mending, filling, rebuilding, and how far that moves them."""
