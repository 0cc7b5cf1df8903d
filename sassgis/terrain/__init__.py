"""From heights and release areas to flattened profiles: array geometry, no files."""
