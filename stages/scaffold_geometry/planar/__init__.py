"""Regions of a plane: what plates are made of."""
