"""Whole jobs: what the command line and the pipelines call."""
