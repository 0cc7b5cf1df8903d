"""Figures for a report: saved beside it, and what is seen in them in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sassgis.hazard.along_profile import LinePaths
from sassgis.model.grid import Grid
from sassgis.model.noted_files import noted
from sassgis.model.results import RasterLayer
from sassgis.model.styles import class_labels
from sassgis.report.figures.map_figure import class_numbers, shown_values
from sassgis.report.figures.style import to_png
from sassgis.report.page import Cell, ReportFigure, sensible


def picture(
    folder: Path, name: str, title: str, caption: str, figure: Figure, alt: str = ""
) -> ReportFigure:
    """Save a figure as ``<name>.png``, and give it as the report shows it."""
    png = to_png(figure)
    folder.mkdir(parents=True, exist_ok=True)
    noted(folder / f"{name}.png").write_bytes(png)
    return ReportFigure(title, caption, png, alt)


def map_alt(grid: Grid, layer: RasterLayer) -> str:
    """Classes of the first band with their areas, the highest first, and the largest value."""
    band = layer.bands[0]
    values = shown_values(band)
    if layer.classes:
        ordered = sorted(layer.classes, key=lambda entry: -entry.value)
        areas = [(c.label, int((values == c.value).sum())) for c in ordered]
    else:
        number = class_numbers(values, layer.breaks) if layer.breaks else np.zeros_like(values)
        labels = class_labels(layer.breaks, band.unit) if layer.breaks else ["any value"]
        areas = [(label, int((number == k).sum())) for k, label in enumerate(labels)][::-1]
    cell = grid.cell_size**2
    parts = ", ".join(f"{label} on {sensible(round(n * cell))} m²" for label, n in areas if n)
    text = f"Map over shaded relief, {layer.title}: {parts or 'no values'}."
    if not layer.classes and np.isfinite(values).any():
        text += f" Largest value {sensible(float(np.nanmax(values)))}."
    return text


def path_alt(shown: LinePaths) -> str:
    """A profile with paths of blocks."""
    end = float(shown.stops.max())
    low = float(np.interp(end, shown.s, shown.z))
    names = ", ".join(line.name for line, chainage in shown.control_lines if chainage <= end)
    crossed = f" It crosses {names}." if names else ""
    return (
        f"Vertical section from {shown.z[0]:.0f} m down to {low:.0f} m over {end:.0f} m in plan, "
        f"with the path of {len(shown.paths)} of the blocks.{crossed}"
    )


def station_alt(row: Mapping[str, object]) -> str:
    """Histograms at a station or barrier; ``row`` of control_line_rows."""

    def shown(key: str) -> str:
        value: Cell = row[key]  # type: ignore[assignment]
        return sensible(value)

    return (
        f"Histograms of speed, rotation and passing height of {shown('rocks')} blocks: 95 % of "
        f"them below {shown('speed_mps_q95')} m/s, {shown('rotation_hz_q95')} Hz and "
        f"{shown('height_m_q95')} m."
    )
