"""Writers: rasters, GeoPackage, tables, manifest, QGIS project, the Swiss data model.

In: results. Out: files in a working folder that is published whole.
May import: sassgis.inputs and below, not sassgis.report.
"""
