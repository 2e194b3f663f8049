"""Formulas on arrays and scalars, shared by stages; `_jit` alone names a compiler and its flags."""
