"""The layers of a result: what each map, vector layer and table of a GeoPackage holds."""
