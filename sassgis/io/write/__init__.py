"""Files of results. What writes raises OutputError where the disk is full or not writable."""
