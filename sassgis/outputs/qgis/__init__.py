"""The QGIS project of a result: layers, legend, map sheets."""
