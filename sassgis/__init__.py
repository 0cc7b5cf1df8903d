"""sassgis: rockfall hazard zoning with the SASS model of Bozzolo and Pamini (1986)."""

__version__ = "0.1.0"
