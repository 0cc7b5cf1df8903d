"""Hazard zones as INTERLIS 2 transfer files, and their validation."""
