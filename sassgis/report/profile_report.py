"""Figures and report of a run along one profile."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sassgis.report import figures
from sassgis.report.map_report import control_line_tables, station_figures, stopping_reasons
from sassgis.report.page import Cell, ReportContext, ReportFigure
from sassgis.report.pictures import picture
from sassgis.report.run_summary import profile_lines
from sassgis.settings.languages import phrase
from sassgis.settings.results import StopReason
from sassgis.simulation.along_profile import STRETCH_M, ProfileResult


def profile_panel(result: ProfileResult, title: str = "") -> figures.ProfilePanel:
    """Return the slope with trajectories, control lines and stops, for one or several panels."""
    p = result.profile
    ended = np.concatenate([result.rocks, result.pieces])
    drawn = (ended["rock"] < result.drawn) & (ended["reason"] != StopReason.BROKEN)
    return figures.ProfilePanel(
        s=p.s,
        z=p.z,
        trajectories=list(result.paths),
        ground=p.ground.astype(np.int64),
        ground_names=p.table.names,
        control_lines=[(g, c, float(np.interp(c, p.s, p.z))) for g, c in p.control_lines],
        stops=ended["runout_m"][drawn],
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
    """Draw the figures of a profile into ``folder`` and put the report together."""
    p = result.profile
    length, relief = p.s[-1] - p.s[0], p.z.max() - p.z.min()
    text = "{} vertices, {} m long, {} m of relief"
    return ReportContext(
        title=p.name,
        subtitle="Rockfall along one profile with the SASS model (Bozzolo and Pamini, 1986)",
        what_was_run=(
            ("Profile", phrase(text, p.s.size, f"{length:.0f}", f"{relief:.0f}")),
            ("Start", phrase("chainage {} to {} m", *(f"{s:g}" for s in p.start))),
            ("Simulated blocks", int(result.rocks.size)),
            ("Fragments and entrained blocks", int(result.pieces.size)),
            ("Effects beyond the model of 1986", ", ".join(effects) or "none"),
        ),
        byline=byline,
        summary=profile_lines(result),
        warnings=tuple(warnings),
        key_results=stopping_reasons(
            np.bincount(result.rocks["reason"], minlength=len(StopReason))
        ),
        figures=tuple(_pictures(result, folder)),
        tables=tuple(control_line_tables(result.control_lines)),
        provenance=provenance,
    )


def _pictures(result: ProfileResult, folder: Path) -> list[ReportFigure]:
    p = result.profile
    caption = "Paths of the centres of the blocks; chainage in plan."
    figure = figures.profile_figure([profile_panel(result)])
    out = [picture(folder, "profile", "Trajectories", caption, figure)]
    caption = phrase("Quantiles of the blocks that reach each stretch of {} m.", f"{STRETCH_M:g}")
    for quantity, title in (
        ("energy", "Energy along the profile"),
        ("speed", "Speed along the profile"),
        ("height", "Passing height along the profile"),
    ):
        figure = figures.energy_profile_figure(
            result.stretches, result.along[quantity], p.s, p.z, quantity=quantity,
            control_lines=list(p.control_lines),
        )  # fmt: skip
        out.append(picture(folder, f"{quantity}_along", title, caption, figure))
    ended = np.concatenate([result.rocks, result.pieces])
    caption = "Chainage at which blocks stop, by reason."
    if result.pieces.size:
        caption = "Chainage at which blocks, fragments and entrained blocks stop, by reason."
    last = np.ceil(np.ptp(ended["runout_m"])) + 1.0
    edges = np.floor(ended["runout_m"].min()) + np.arange(last + 1.0)
    counts = {
        r: np.histogram(ended["runout_m"][ended["reason"] == r], edges)[0] for r in StopReason
    }
    figure = figures.runout_figure(edges, counts)
    out.append(picture(folder, "runout", "Run-out", caption, figure))
    caption = "First downhill passage."
    return out + station_figures(result.control_lines, result.rocks.size, folder, caption, {})
