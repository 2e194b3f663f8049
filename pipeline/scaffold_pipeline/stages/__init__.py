"""What a stage is, where the installed ones are found, and what they say of themselves."""
