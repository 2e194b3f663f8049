"""Provenance of runs: verification, comparison of two runs, and RO-Crates."""
