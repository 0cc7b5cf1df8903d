"""Figures of hazard zones, hazard curves and risk."""

from __future__ import annotations

from pathlib import Path

from sassgis.core.results import RasterLayer
from sassgis.io.config import Config
from sassgis.io.report import ReportFigure
from sassgis.workflow.assessment import Assessment, Rules
from sassgis.workflow.run import Simulation


def zone_figures(
    config: Config,
    rules: Rules,
    found: Assessment,
    done: Simulation,
    maps: tuple[RasterLayer, ...],
    folder: Path,
) -> tuple[ReportFigure, ...]:
    """Draw the figures of a zoning into a folder."""
    return ()
