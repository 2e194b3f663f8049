"""The front door in Python: what `import scaffold_pipeline as sp` offers beside artifacts and stages."""
