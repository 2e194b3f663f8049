"""The Python interface: the functions of `import scaffold_pipeline as sp` besides artifacts and stages."""
