"""Readers: configuration, terrain, vectors, ground, forest, objects, observations.

What reads raises InputError (ConfigError) where a file or a value cannot be used:
one line with the file, the key, what was found and what was expected.
May import: sassgis.gap, sassgis.studies and below.
"""
