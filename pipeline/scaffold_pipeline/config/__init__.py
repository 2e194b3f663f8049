"""Reading of configs: from YAML to a checked plan, every fault with file, line and column."""
