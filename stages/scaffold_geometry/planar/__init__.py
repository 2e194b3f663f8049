"""Regions of a plane, from which plates are made."""
