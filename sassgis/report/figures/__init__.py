"""Figures: arrays in, a matplotlib Figure out; nothing is written until ``save``."""

from sassgis.report.figures.distributions import energy_profile_figure as energy_profile_figure
from sassgis.report.figures.distributions import runout_figure as runout_figure
from sassgis.report.figures.distributions import station_figure as station_figure
from sassgis.report.figures.hazard_figures import PLACES_SHOWN as PLACES_SHOWN
from sassgis.report.figures.hazard_figures import blocks_figure as blocks_figure
from sassgis.report.figures.hazard_figures import change_figure as change_figure
from sassgis.report.figures.hazard_figures import confidence_figure as confidence_figure
from sassgis.report.figures.hazard_figures import hazard_curve_figure as hazard_curve_figure
from sassgis.report.figures.hazard_figures import intensity_figure as intensity_figure
from sassgis.report.figures.hazard_figures import map_change_figure as map_change_figure
from sassgis.report.figures.hazard_figures import protection_figure as protection_figure
from sassgis.report.figures.hazard_figures import risk_figure as risk_figure
from sassgis.report.figures.map_figure import map_figure as map_figure
from sassgis.report.figures.map_marks import MapMarks as MapMarks
from sassgis.report.figures.profile_figure import ProfilePanel as ProfilePanel
from sassgis.report.figures.profile_figure import profile_figure as profile_figure
from sassgis.report.figures.style import save as save
from sassgis.report.figures.style import to_png as to_png
