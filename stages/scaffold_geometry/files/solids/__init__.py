"""Files of a solid: a module for each format that writes it and reads it back, and what a file is checked for."""
