"""The layers of a result: their values, names, columns and styles."""
