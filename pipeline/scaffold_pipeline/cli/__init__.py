"""The command `scaffold-pipeline`: it turns arguments into calls and decides nothing else."""
