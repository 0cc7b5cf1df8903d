"""Figures and report of a run along one profile."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from sassgis.hazard.along_profile import STRETCH_M, ProfileResult
from sassgis.model.labels import file_stems
from sassgis.model.results import StopReason
from sassgis.report import figures
from sassgis.report.map_report import (
    control_line_tables,
    save_figure,
    station_figures,
    stopping_reasons,
)
from sassgis.report.page import Cell, ReportContext, ReportFigure
from sassgis.report.run_summary import profile_lines

_QUANTITIES: tuple[tuple[Literal["energy", "speed", "height"], str], ...] = (
    ("energy", "Energy"),
    ("speed", "Speed"),
    ("height", "Passing height"),
)


def profile_panel(result: ProfileResult, title: str = "") -> figures.ProfilePanel:
    """The slope with trajectories, control lines and stops, for one or several panels."""
    p = result.profile
    ended = np.concatenate([result.rocks, result.pieces])
    return figures.ProfilePanel(
        s=p.s,
        z=p.z,
        trajectories=list(result.paths),
        ground=p.ground.astype(np.int64),
        ground_names=p.table.names,
        control_lines=[(g, c, float(np.interp(c, p.s, p.z))) for g, c in p.control_lines],
        stops=ended["runout_m"][
            (ended["rock"] < result.drawn) & (ended["reason"] != StopReason.BROKEN)
        ],
        title=title or p.name,
    )


def profile_report(
    result: ProfileResult,
    warnings: Sequence[str],
    effects: Sequence[str],
    byline: tuple[str, ...],
    provenance: tuple[tuple[str, Cell], ...],
    folder: Path,
) -> ReportContext:
    """Draw the figures of a profile into ``folder`` and put the report together.

    Parameters
    ----------
    result : ProfileResult
    warnings : sequence of str
    effects : sequence of str
        Names of those that are switched on.
    byline : tuple of str
        Who made it, when, with which program.
    provenance : tuple of (name, value)
    folder : Path
    """
    p = result.profile
    spawned = int(result.pieces.size)
    reasons = np.bincount(result.rocks["reason"], minlength=len(StopReason))
    return ReportContext(
        title=p.name,
        subtitle="Rockfall along one profile with the SASS model (Bozzolo and Pamini, 1986)",
        what_was_run=(
            ("Profile", f"{p.s.size} vertices, {p.s[-1] - p.s[0]:.0f} m long, "
             f"{p.z.max() - p.z.min():.0f} m of relief"),
            ("Start", f"chainage {p.start[0]:g} to {p.start[1]:g} m"),
            ("Simulated blocks", int(result.rocks.size)),
            ("Fragments and entrained blocks", spawned),
            ("Effects beyond the model of 1986", ", ".join(effects) or "none"),
        ),
        byline=byline,
        summary=profile_lines(result),
        warnings=tuple(warnings),
        key_results=stopping_reasons(reasons),
        figures=tuple(
            ReportFigure(title, caption, save_figure(folder, name, figure))
            for name, title, caption, figure in _figures(result)
        ),
        tables=tuple(control_line_tables(result.control_lines)),
        provenance=provenance,
    )  # fmt: skip


def _figures(result: ProfileResult) -> list[tuple[str, str, str, Figure]]:
    """Name, title, caption and figure, in the order of the report."""
    p = result.profile
    out = [
        (
            "profile",
            "Trajectories",
            "Paths of the centres of the blocks; chainage in plan.",
            figures.profile_comparison_figure([profile_panel(result)]),
        )
    ]
    for quantity, words in _QUANTITIES:
        figure = figures.energy_profile_figure(
            result.stretches,
            result.along[quantity],
            p.s,
            p.z,
            quantity=quantity,
            control_lines=list(p.control_lines),
        )
        caption = f"Quantiles of the blocks that reach each stretch of {STRETCH_M:g} m."
        out.append((f"{quantity}_along", f"{words} along the profile", caption, figure))
    ended = np.concatenate([result.rocks, result.pieces])
    more = ", fragments and entrained blocks too" if result.pieces.size else ""
    out.append(
        (
            "runout",
            "Run-out",
            f"Chainage at which blocks stop, by stopping reason{more}.",
            figures.runout_figure(ended["runout_m"], ended["reason"].astype(np.int64)),
        )
    )
    drawn = station_figures(result.control_lines, result.rocks.size)
    for (name, figure), stem in zip(drawn, file_stems([n for n, _ in drawn]), strict=True):
        out.append((f"station_{stem}", f"At {name}", "First downhill passage.", figure))
    return out
