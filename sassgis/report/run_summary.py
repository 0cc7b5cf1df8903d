"""The answer of a run in a few lines: run-out, angles, exposed objects, stations, zones, risk."""

from __future__ import annotations

import numpy as np

from sassgis.grid import IntArray
from sassgis.hazard.assess import Assessment
from sassgis.hazard.reach_angles import ReachAngles
from sassgis.hazard.risk import total_rows
from sassgis.hazard.warnings import sample_words
from sassgis.report.page import ReportTable, sensible
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import StopReason
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.along_profile import ProfileResult

Lines = tuple[tuple[str, str], ...]


def runout_words(counts: IntArray, text: str) -> str:
    """Put the run-out of blocks, counted in bins of 1 m, into a text; empty for none."""
    if not counts.sum():
        return ""
    below = np.cumsum(counts)
    median, most = (int(np.searchsorted(below, share * below[-1])) + 1 for share in (0.5, 0.95))
    longest = int(np.flatnonzero(counts)[-1]) + 1
    return phrase(text, sensible(median), sensible(most), sensible(longest))


def run_lines(progress: Progress, angles: ReachAngles) -> Lines:
    """State run-out of started blocks, and the angles under which their stops are seen."""
    text = "median {} m, 95 % of the blocks within {} m, longest {} m (along the path, in plan)"
    words = runout_words(progress.started_runout, text)
    lines = [("Run-out", words)] if words else []
    for name, values, text in (
        (
            "Reach angle",
            angles.reach_deg,
            "99 % of the blocks above {}, 95 % above {}, median {}, seen from the release point",
        ),
        (
            "Shadow angle",
            angles.shadow_deg,
            "99 % of the blocks above {}, 95 % above {}, median {}, seen from the foot of the "
            "cliff",
        ),
    ):
        if np.isfinite(values).any():
            # The smallest of all is that of some block that has hardly moved.
            low = np.quantile(values[np.isfinite(values)], (0.01, 0.05, 0.5))
            lines.append((name, phrase(text, *(f"{angle:.1f}°" for angle in low))))
    return tuple(lines)


def profile_lines(result: ProfileResult) -> Lines:
    """State where the blocks of a profile stop, and what passes its stations and barriers."""
    # Of released blocks that started; one that a barrier stops has not come beyond it.
    started = result.rocks["reason"] != StopReason.NEVER_STARTED
    bins = np.maximum(np.ceil(result.rocks["runout_m"][started]) - 1.0, 0.0).astype(np.int64)
    text = "median {} m, 95 % of the blocks within {} m, longest {} m (chainage)"
    words = runout_words(np.bincount(bins), text)
    lines = [("Run-out", words)] if words else []
    for k, (line, _) in enumerate(result.profile.control_lines):
        energy = result.control_lines.distribution(k, "energy_kj")
        of = (energy.count, result.rocks.size + result.pieces.size)
        arrive = phrase("{} of {} blocks arrive", *of)
        if energy.count:
            (most,) = energy.quantile(0.95)
            text = "{} of {} blocks arrive; energy: 95 % of them below {} kJ"
            arrive = phrase(text, *of, sensible(most))
        lines.append((line.described, arrive))
    return tuple(lines)


def object_lines(exposed: ReportTable) -> Lines:
    """State how many of all exposed objects blocks reach, and which with the most energy."""
    if not exposed.rows:
        return ()
    reached = [row for row in exposed.rows if row[-2] is not None or row[-1] is not None]
    words = phrase("blocks reach {} of {}", len(reached), len(exposed.rows))
    if reached and reached[0][-2] is not None:
        (what, unit), of = exposed.columns[-2], (len(reached), len(exposed.rows))
        text = "blocks reach {} of {}; most at {}: {} {} {}"
        words = phrase(text, *of, reached[0][0], phrase(what), reached[0][-2], unit)
    return (("Energy at exposed objects", words),)


def zone_lines(
    levels: ReportTable, found: Assessment, edge: str, confidence: float, currency: str
) -> Lines:
    """State the area of the zones by level, how sure they are, and the risk of all objects."""
    areas = [phrase("{} {} m²", phrase(str(row[0])), sensible(row[2])) for row in levels.rows]
    hazard = found.hazard
    text = "{} The hatched cells ({} % of the zoned area) hold {} % of these changes."
    shares = (f"{100 * share:.3g}" for share in (hazard.uncertain_share, confidence))
    sample = phrase(text, sample_words(hazard.changed_share), *shares)
    lines: list[tuple[str, str]] = [
        ("Hazard zones", joined("; ", areas)), ("Sampling error", sample)
    ]  # fmt: skip
    if edge:
        lines.append(("Edge of the terrain model", edge))
    if hazard.edits:
        changed = sum(a.has_changed for a in hazard.edits)
        text = "places: {}; computed level changed since below: {}"
        lines.append(("Edited by hand", phrase(text, len(hazard.edits), changed)))
    if found.risk is not None:
        total = total_rows(found.risk)[-1]
        text = "loss {} {}/year; deaths {} per year; largest individual risk {} per year"
        loss, deaths = (sensible(total[f"{name}_per_year"]) for name in ("loss", "deaths"))
        largest = sensible(total["individual_risk_largest_per_year"])
        risk = phrase(text, loss, currency, deaths, largest)
        lines.append(("Risk of all exposed objects", risk))
    return tuple(lines)
