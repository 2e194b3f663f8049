"""The engine of scaffold-pipeline: artifacts, the stage contract, configuration, plan, runner and record."""

__version__ = "0.1.0"
