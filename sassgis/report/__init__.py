"""The report: figures, tables and pages."""

from sassgis.settings.process import not_found

with not_found("matplotlibrc"):
    import matplotlib as matplotlib
