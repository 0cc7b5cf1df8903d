"""Styles and projects for QGIS, written without QGIS."""
