"""Figures: arrays in, a matplotlib Figure out; nothing is written until ``save``."""

from sassgis.report.figures.energy_figure import energy_profile_figure
from sassgis.report.figures.gap_figures import (
    gap_distributions_figure,
    gap_hypotheses_figure,
    gap_ladder_figure,
    gap_map_figure,
    gap_where_figure,
)
from sassgis.report.figures.hazard_curve import hazard_curve_figure
from sassgis.report.figures.hazard_maps import (
    change_figure,
    confidence_figure,
    intensity_figure,
    map_change_figure,
)
from sassgis.report.figures.histograms import runout_counts_figure, runout_figure, station_figure
from sassgis.report.figures.map_figure import map_figure
from sassgis.report.figures.map_marks import MapMarks
from sassgis.report.figures.profile_figure import ProfilePanel, profile_figure
from sassgis.report.figures.risk_figure import risk_figure
from sassgis.report.figures.style import save, to_png

__all__ = [
    "MapMarks",
    "ProfilePanel",
    "change_figure",
    "confidence_figure",
    "energy_profile_figure",
    "gap_distributions_figure",
    "gap_hypotheses_figure",
    "gap_ladder_figure",
    "gap_map_figure",
    "gap_where_figure",
    "hazard_curve_figure",
    "intensity_figure",
    "map_change_figure",
    "map_figure",
    "profile_figure",
    "risk_figure",
    "runout_counts_figure",
    "runout_figure",
    "save",
    "station_figure",
    "to_png",
]
