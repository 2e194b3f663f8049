"""The stages that come with scaffold-pipeline: one module, one stage, one name in YAML."""
