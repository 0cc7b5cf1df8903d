"""Shared by the pipelines of the field cases: folders, observations, splits, scores."""
