"""What `docs/plugins.md` shows: a stage, a field, a measure and a file format of a third party, a module each."""
