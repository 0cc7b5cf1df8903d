"""The answer of a run in a few lines: run-out, angles, exposed objects, stations, zones, risk."""

from __future__ import annotations

import numpy as np

from sassgis.hazard.along_profile import ProfileResult
from sassgis.hazard.assess import Assessment
from sassgis.hazard.progress import Progress
from sassgis.hazard.reach_angles import ReachAngles
from sassgis.hazard.risk import risk_totals
from sassgis.model.grid import FloatArray, IntArray
from sassgis.report.page import ReportTable, sensible

Lines = tuple[tuple[str, str], ...]


def runout_quantile_m(counts: IntArray, share: float) -> int:
    """Run-out that a share of the blocks does not exceed (m): upper limit of its bin of 1 m."""
    below = np.cumsum(counts)
    return int(np.searchsorted(below, share * below[-1])) + 1


def runout_words(counts: IntArray) -> str:
    """Run-out of blocks that were counted in bins of 1 m; empty for none."""
    if not counts.sum():
        return ""
    median, most = (runout_quantile_m(counts, share) for share in (0.5, 0.95))
    longest = int(np.flatnonzero(counts)[-1]) + 1
    return (
        f"median {sensible(median)} m, 95 % of the blocks within {sensible(most)} m, longest "
        f"{sensible(longest)} m"
    )


def run_lines(progress: Progress, angles: ReachAngles) -> Lines:
    """Run-out of all blocks, and the angles under which their stops are seen."""
    words = runout_words(progress.runout.sum(axis=0))
    lines = [("Run-out", f"{words} (along the path, in plan)")] if words else []
    for name, values, start in (
        ("Reach angle", angles.reach_deg, "release point"),
        ("Shadow angle", angles.shadow_deg, "foot of the cliff"),
    ):
        if np.isfinite(values).any():
            lines.append((name, f"{_angle_text(values)}, seen from the {start}"))
    return tuple(lines)


def profile_lines(result: ProfileResult) -> Lines:
    """Where the blocks of a profile stop, and what passes its stations and meets its barriers."""
    stops = np.concatenate([result.rocks["runout_m"], result.pieces["runout_m"]])
    words = runout_words(np.bincount(np.maximum(stops, 0.0).astype(np.int64)))
    lines = [("Run-out", f"{words} (chainage)")] if words else []
    for k, (line, _) in enumerate(result.profile.control_lines):
        energy = result.control_lines.distribution(k, "energy_kj")
        text = f"{energy.count} of {result.rocks.size} blocks arrive"
        if energy.count:
            (most,) = energy.quantile(0.95)
            text += f"; energy: 95 % of them below {sensible(most)} kJ"
        name = line.name
        if line.kind != "station":
            name += f" ({line.kind}, {line.height_m:g} m)"
        lines.append((name, text))
    return tuple(lines)


def _angle_text(values: FloatArray) -> str:
    known = values[np.isfinite(values)]
    # The smallest of all is that of some block that has hardly moved.
    low, lower, median = np.quantile(known, (0.01, 0.05, 0.5))
    return f"99 % of the blocks above {low:.1f}°, 95 % above {lower:.1f}°, median {median:.1f}°"


def object_lines(exposed: ReportTable) -> Lines:
    """How many exposed objects blocks reach, and the one with the largest energy."""
    if not exposed.rows:
        return ()
    reached = [row for row in exposed.rows if not np.isnan(_number(row[-4]))]
    text = f"blocks reach {len(reached)} of {len(exposed.rows)}"
    if reached:
        first = reached[0]
        text += (
            f"; most at {first[0]}: 95 % of the blocks below {sensible(first[-4])} kJ, largest "
            f"{sensible(first[-3])} kJ"
        )
    return (("Energy at exposed objects", text),)


def _number(cell: object) -> float:
    return float(cell) if isinstance(cell, int | float) else float("nan")


def zone_lines(levels: ReportTable, found: Assessment, currency: str) -> Lines:
    """Area of the zones by level, and the risk of all objects."""
    areas = "; ".join(f"{row[0]} {sensible(row[2])} m²" for row in levels.rows)
    lines = [("Hazard zones", areas)]
    if found.risk is not None:
        (total,) = (t for t in risk_totals(found.risk) if t.scope == "all")
        text = (
            f"loss {sensible(total.values['loss'])} {currency}/year; deaths "
            f"{sensible(total.values['deaths'])} per year; largest individual risk "
            f"{sensible(total.individual_risk)} per year"
        )
        lines.append(("Risk of all exposed objects", text))
    return tuple(lines)
