"""What the pipelines of the field cases share: folders, tables of observations, splits, scores."""
