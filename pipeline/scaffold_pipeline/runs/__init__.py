"""Run a plan: artifacts, files and a record; results are stored under a hash of their inputs."""
