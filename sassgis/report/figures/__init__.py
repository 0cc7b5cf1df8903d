"""Figures: arrays in, a matplotlib Figure out; nothing is written until ``save``."""

from sassgis.report.figures.energy_figure import energy_profile_figure
from sassgis.report.figures.gap_figures import (
    gap_distributions_figure,
    gap_hypotheses_figure,
    gap_ladder_figure,
    gap_where_figure,
)
from sassgis.report.figures.gap_map_figures import gap_map_figure, map_change_figure
from sassgis.report.figures.hazard_curve import hazard_curve_figure
from sassgis.report.figures.hazard_map_figures import (
    change_figure,
    confidence_figure,
    intensity_figure,
)
from sassgis.report.figures.histograms import runout_counts_figure, runout_figure, station_figure
from sassgis.report.figures.map_figure import map_figure
from sassgis.report.figures.profile_figure import (
    ProfilePanel,
    profile_comparison_figure,
    profile_figure,
)
from sassgis.report.figures.restitution import fig9_figure
from sassgis.report.figures.risk_figure import risk_figure
from sassgis.report.figures.runout_gap import runout_gap_figure
from sassgis.report.figures.study import convergence_figure
from sassgis.report.figures.style import save, to_png

__all__ = [
    "ProfilePanel",
    "change_figure",
    "confidence_figure",
    "convergence_figure",
    "energy_profile_figure",
    "fig9_figure",
    "gap_distributions_figure",
    "gap_hypotheses_figure",
    "gap_ladder_figure",
    "gap_map_figure",
    "gap_where_figure",
    "hazard_curve_figure",
    "intensity_figure",
    "map_change_figure",
    "map_figure",
    "profile_comparison_figure",
    "profile_figure",
    "risk_figure",
    "runout_counts_figure",
    "runout_figure",
    "runout_gap_figure",
    "save",
    "station_figure",
    "to_png",
]
