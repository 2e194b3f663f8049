"""What is measured on a solid: each measure a module, its source, unit and error beside it."""
