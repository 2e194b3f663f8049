"""The plug-in of `docs/plugins.md`: a stage, a field, a measure and a file format of a third party, one module each."""
