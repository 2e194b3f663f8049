"""Files of a solid: one module for each format, which writes it and reads it back, and the checks of a file."""
