"""From a raster of classes to zones: generalised, then drawn as a valid coverage."""
