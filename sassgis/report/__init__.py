"""The report: figures, tables and pages."""

from sassgis.model.current_folder import not_found

with not_found("matplotlibrc"):
    import matplotlib as matplotlib
