"""From a plan to artifacts, files and a record: results are stored by what they come from."""
