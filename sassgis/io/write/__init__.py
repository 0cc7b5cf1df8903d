"""Writers: rasters, GeoPackages, tables, manifest; results appear whole or not at all."""
