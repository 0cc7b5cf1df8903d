"""What the diagnosis can name: one file for each cause, and one row in the registry."""
