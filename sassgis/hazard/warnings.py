"""What a user must know before trusting a result: one list for every command.

``validate`` gives what the inputs show, ``run`` what the simulation adds to it, ``zone`` and
``batch`` what the rules of the zoning add.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.hazard.along_profile import ProfileResult
from sassgis.hazard.preset_labels import preset_unverified
from sassgis.hazard.progress import Progress, line_ends
from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundClass
from sassgis.model.hazard import HazardPreset
from sassgis.model.labels import STOP_TEXT
from sassgis.model.languages import phrase
from sassgis.model.map_run import MapRun
from sassgis.model.profiles import LineEnd
from sassgis.model.results import StopReason

_LINE_ENDS = (
    (LineEnd.LEFT_DEM, "reach the edge of the terrain model"),
    (LineEnd.NODATA, "run into nodata"),
    (LineEnd.MAX_LENGTH, "are cut at terrain.max_line_length_m"),
    (LineEnd.CLOSED_LOOP, "close upon themselves"),
)
_STOPS = (
    (
        StopReason.LEFT_PROFILE,
        "{} of {} blocks ({} %) still moved at the end of their fall line or at the edge of the "
        "terrain model, and are lost from the map.",
    ),
    (
        StopReason.STEP_LIMIT,
        "{} of {} blocks ({} %) were given up: at engine.max_events contacts, or below the ground.",
    ),
    (
        StopReason.NEVER_STARTED,
        "{} of {} blocks ({} %) never started: the slope at their release point is below the "
        "friction there. They are not part of the denominator of reach probability and "
        "frequencies, which are those of blocks that start (give blocks an initial speed if they "
        "should).",
    ),
)


def ground_warnings(used: Sequence[GroundClass]) -> list[str]:
    """Which of the classes that occur have values that were not read in their source."""
    names = [c.name for c in used if not c.verified]
    text = "Ground classes with values that are not from the paper (unverified): {}."
    return [phrase(text, ", ".join(names))] if names else []


def path_warnings(path: str) -> list[str]:
    """What paths of this kind leave out."""
    if path == "followed":
        return []
    return [
        "All blocks of a release point keep to one fall line: maps and zones are too narrow where "
        'blocks spread laterally. terrain.path = "followed" gives each block a path of its own.'
    ]


def simulation_warnings(run: MapRun, progress: Progress) -> list[str]:
    """What happened to blocks and lines, and what the inputs leave open."""
    total = max(int(progress.reasons.sum()), 1)
    out: list[str] = []
    ends = line_ends(progress)
    for end, what in _LINE_ENDS:
        if ends[end] and not run.followed:
            out.append(f"{ends[end]} of {sum(ends.values())} fall lines {what}.")
    for reason, what in _STOPS:
        n = int(progress.reasons[reason])
        if n:
            out.append(phrase(what, n, total, f"{100 * n / total:.2g}"))
    if progress.lost:
        out.append(
            f"{progress.lost} blocks were not simulated: their fall lines end where they begin "
            "(release points on nodata or at the edge of the terrain model). They are not part of "
            "the denominator of the reach probability."
        )
    idle = [
        line.name
        for i, (line, _) in enumerate(run.control_lines)
        if progress.control_lines.arrivals(i) == 0
    ]
    if idle:
        out.append(phrase("No block reaches: {}.", ", ".join(idle)))
    used = np.unique(run.ground[np.isfinite(run.grid.values)])
    classes = [run.table.classes[i] for i in used]
    return [
        *out,
        *ground_warnings(classes),
        *path_warnings(run.terrain.path),
    ]


def rule_warnings(preset: HazardPreset, frequencies: Mapping[tuple[str, str], float]) -> list[str]:
    """What the rules of a zoning leave open.

    Parameters
    ----------
    frequencies : mapping of (area, scenario) to float
        Blocks per year.
    """
    out = preset_unverified(preset)
    idle = [f"{area} / {scenario}" for (area, scenario), n in frequencies.items() if n == 0.0]
    if idle:
        out.append("Onset frequency 0, so without any hazard: " + ", ".join(idle) + ".")
    return out


def zone_warnings(changed_share: float, limit: float | None, repetitions_max: int) -> list[str]:
    """What a zoning has not settled; ``limit`` is the largest share that is wanted."""
    if limit is None or changed_share <= limit:
        return []
    return [
        f"Another sample of blocks would change the level on {100 * changed_share:.1f} % of the "
        f"zoned area, after {repetitions_max} repetitions (hazard.repetitions_max; wanted: "
        f"{100 * limit:g} %, hazard.changed_share_max)."
    ]


def profile_warnings(result: ProfileResult, effects: EffectSettings) -> list[str]:
    """What happened to the blocks of a profile."""
    out: list[str] = []
    if effects.get(LateralDeflection) is not None:
        out.append("A profile has no width: [effects.lateral_deflection] does nothing here.")
    for reason, _ in _STOPS:
        n = int((result.rocks["reason"] == reason).sum())
        if n:
            text = phrase(STOP_TEXT[reason])
            out.append(phrase("{} of {} blocks: {}.", n, result.rocks.size, text))
    return out
