"""Child processes, their memory and their threads."""
