"""Types shared by every stage: frozen data, no files, no algorithms."""
