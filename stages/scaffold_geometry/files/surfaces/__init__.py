"""Surfaces as users' programs write them, one module a format; `reading` opens a file by its suffix."""
