"""Whole jobs: what the command line and the pipelines call.

What reads settings and files raises ``ConfigError`` or ``InputError``, with the file, the field,
what was found and what is expected. What writes raises ``OutputError`` if a result is there
already, or the disk is full or not writable. What simulates raises ``Interrupted`` if the user
stops it; what was computed is kept.
"""
