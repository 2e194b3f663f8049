"""The command scaffold-pipeline: arguments to calls; it decides nothing."""
