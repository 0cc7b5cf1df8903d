"""What a user must know before trusting a result: one list for every command.

``validate`` gives what the inputs show, ``run`` what the simulation adds to it, ``zone`` and
``batch`` what the rules of the zoning add.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.grid import IntArray
from sassgis.hazard.preset_labels import preset_unverified
from sassgis.hazard.zoning.applied_edits import AppliedEdit, shares_text
from sassgis.settings.effects import EffectSettings
from sassgis.settings.ground import GroundClass, Trust
from sassgis.settings.hazard_rules import BlockBudget, HazardPreset
from sassgis.settings.labels import STOP_TEXT, short
from sassgis.settings.languages import phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.profiles import LineEnd, ReleasePoints
from sassgis.settings.results import StopReason
from sassgis.simulation.accumulators import Progress, line_ends
from sassgis.simulation.along_profile import ProfileResult
from sassgis.terrain.release import points_by_size

_LINE_ENDS = (
    (LineEnd.LEFT_DEM, "{} of {} fall lines reach the edge of the terrain model."),
    (LineEnd.NODATA, "{} of {} fall lines run into nodata."),
    (LineEnd.MAX_LENGTH, "{} of {} fall lines are cut at terrain.max_line_length_m."),
    (LineEnd.CLOSED_LOOP, "{} of {} fall lines close upon themselves."),
)
_TRUST_WARNINGS: tuple[tuple[Trust, str], ...] = (
    ("estimate", "Ground classes that are estimates, with their share of the ground: {}."),
    ("fitted", "Ground classes fitted to field sites, with their share of the ground: {}."),
)
#: Points and size of a release area differ by more than this factor, and by so many points.
_UNEVEN, _FEW_POINTS = 2.0, 2
_STOPS = (
    (
        StopReason.LEFT_PROFILE,
        "{} % of the blocks still moved at the end of their fall line or at the edge of the "
        "terrain model, and are lost from the map.",
    ),
    (
        StopReason.STEP_LIMIT,
        "{} % of the blocks were given up: at engine.max_events contacts, or below the ground.",
    ),
    (
        StopReason.NEVER_STARTED,
        "{} % of the blocks never started: the slope at their release point is below the "
        "friction there. They are not part of the denominator of reach probability and "
        "frequencies, which are those of blocks that start (give blocks an initial speed if they "
        "should).",
    ),
)


def ground_shares(run: MapRun, cells: IntArray) -> list[tuple[GroundClass, float]]:
    """Ground classes of flat cells with their share; of all known cells where none are given."""
    known = np.isfinite(run.grid.values)
    of_cells = run.ground.ravel()[cells] if cells.size else run.ground[known]
    used, counts = np.unique(of_cells, return_counts=True)
    return [(run.table.classes[k], n / of_cells.size) for k, n in zip(used, counts, strict=True)]


def ground_words(used: Iterable[tuple[GroundClass, float]]) -> str:
    """Classes with their share: "rock 12 %, debris 30 %"."""
    return ", ".join(f"{c.name} {100 * share:.0f} %" for c, share in used)


def ground_warnings(used: Sequence[tuple[GroundClass, float]]) -> list[str]:
    """How far the values of the classes that occur may be trusted; each with its share."""
    out: list[str] = []
    for trust, text in _TRUST_WARNINGS:
        if names := ground_words((c, share) for c, share in used if c.trust == trust):
            out.append(phrase(text, names))
    assumed = [f"{c.name} {c.d_star_m:g} m" for c, _ in used if c.trust == "paper" and c.d_star_m]
    if assumed:
        text = "Diameter of blocks on the ground from the table, to be measured on the site: {}."
        out.append(phrase(text, ", ".join(assumed)))
    return out


def path_warnings(path: str) -> list[str]:
    """What paths of this kind leave out."""
    if path == "followed":
        return []
    return [
        "All blocks of a release point keep to one fall line: maps and zones are too narrow where "
        'blocks spread laterally. terrain.path = "followed" gives each block a path of its own.'
    ]


def release_warnings(run: MapRun, points: ReleasePoints) -> list[str]:
    """Release areas whose points do not go with their size, or are far apart."""
    spacing, n = run.release.spacing_m, len(run.areas)
    counts, length = np.bincount(points.area, minlength=n), np.zeros(n)
    if points.sides is not None:
        np.maximum.at(length, points.area, np.hypot(*points.sides[:, 0].T))
    asked = [points_by_size(area.geometry, spacing) for area in run.areas]
    uneven = [
        f"{area.name} ({has}, {short(wants)})"
        for area, has, wants in zip(run.areas, counts.tolist(), asked, strict=True)
        if abs(has - wants) >= _FEW_POINTS and max(has / wants, wants / max(has, 1)) > _UNEVEN
    ]
    narrow = [
        f"{run.areas[i].name} ({length[i]:.0f} m)"
        for i in np.flatnonzero(length > _UNEVEN * spacing)
    ]
    out: list[str] = []
    if uneven:
        text = (
            "Release areas with far more or fewer release points than their size asks for at "
            "release.spacing_m (points, asked for): {}. Their parts do not count evenly; a smaller "
            "spacing does better."
        )
        out.append(phrase(text, ", ".join(uneven)))
    if narrow:
        text = (
            "Release areas so narrow that a release point represents more than twice "
            "release.spacing_m of their length: {}. A smaller spacing gives more points."
        )
        out.append(phrase(text, ", ".join(narrow)))
    return out


def idle_areas(areas: Iterable[str]) -> list[str]:
    """That no block starts in some release areas; nothing without any."""
    text = (
        "No block starts in these release areas, as no release point has a height and a descent; "
        "their onset frequency is in no map: {}."
    )
    names = ", ".join(areas)
    return [phrase(text, names)] if names else []


def simulation_warnings(run: MapRun, progress: Progress) -> list[str]:
    """What happened to blocks and lines, and what the inputs leave open."""
    total = max(int(progress.reasons.sum()), 1)
    started = max(total - int(progress.reasons[StopReason.NEVER_STARTED]), 1)
    out: list[str] = []
    ends = line_ends(progress)
    for end, what in _LINE_ENDS:
        if ends[end] and not run.followed:
            out.append(phrase(what, ends[end], sum(ends.values())))
    for reason, what in _STOPS:
        n = int(progress.reasons[reason])
        if n:
            # Shares, as some blocks count for several.
            of = total if reason == StopReason.NEVER_STARTED else started
            out.append(phrase(what, short(100.0 * n / of)))
    if progress.lost:
        text = (
            "{} blocks were not simulated: their fall lines end where they begin (release points "
            "on nodata or at the edge of the terrain model). They are not part of the denominator "
            "of the reach probability."
        )
        out.append(phrase(text, progress.lost))
    sources = {area for area, _ in progress.sources}
    out += idle_areas(area.name for i, area in enumerate(run.areas) if i not in sources)
    idle = [
        line.name
        for i, (line, _) in enumerate(run.control_lines)
        if progress.control_lines.arrivals(i) == 0
    ]
    if idle:
        out.append(phrase("No block reaches: {}.", ", ".join(idle)))
    return [
        *out,
        *ground_warnings(ground_shares(run, progress.sums.cells)),
        *path_warnings(run.terrain.path),
    ]


def rule_warnings(preset: HazardPreset, frequencies: Mapping[tuple[str, str], float]) -> list[str]:
    """What the rules of a zoning leave open, with blocks per year by area and scenario."""
    out = preset_unverified(preset)
    idle = [f"{area} / {scenario}" for (area, scenario), n in frequencies.items() if n == 0.0]
    if idle:
        out.append(phrase("Onset frequency 0, so without any hazard: {}.", ", ".join(idle)))
    return out


def sample_words(changed_share: float) -> str:
    """What another sample would change: one sentence for command, report and sheets."""
    text = "Another sample of as many blocks would change the level on {} % of the zoned area."
    return phrase(text, f"{100 * changed_share:.1f}")


def edge_words(run: MapRun, progress: Progress, open_m: float) -> str:
    """That blocks were lost at the edge of the terrain model: one sentence; empty without any.

    ``open_m`` is the length over which zones go on there (m).
    """
    # On fall lines blocks are lost at the ends of these, too.
    if not run.followed or not progress.lost_share:
        return ""
    lost = short(100.0 * progress.lost_share)
    if open_m <= 0.0:
        return phrase("{} % of the blocks left the terrain model; no zone ends at its edge.", lost)
    text = (
        "{} % of the blocks left the terrain model; over {} m zones go on beyond its edge, where "
        "nothing was computed."
    )
    return phrase(text, lost, f"{open_m:.0f}")


def zone_warnings(changed_share: float, budget: BlockBudget | None) -> list[str]:
    """What a zoning has not settled within its budget."""
    if budget is None or changed_share <= budget.changed_share:
        return []
    text = (
        "{} Wanted: {} % (hazard.changed_share_max); hazard.blocks_max or hazard.minutes_max was "
        "spent before."
    )
    return [phrase(text, sample_words(changed_share), f"{100 * budget.changed_share:g}")]


def edit_lines(applied: Sequence[AppliedEdit]) -> list[str]:
    """That zones were edited by hand, in one sentence; nothing without edits."""
    if not applied:
        return []
    authors = ", ".join(dict.fromkeys(a.edit.author for a in applied))
    if len(applied) == 1:
        text = "Hazard zones edited by hand at one place ({}); intensities and risk as computed."
        return [phrase(text, authors)]
    text = "Hazard zones edited by hand at {} places ({}); intensities and risk are as computed."
    return [phrase(text, len(applied), authors)]


def edit_warnings(applied: Sequence[AppliedEdit]) -> list[str]:
    """Edits below which another level is computed than when they were made."""
    return [
        phrase(
            "Below an edit ({}) the computed level has changed on {} % of its area: then {}; "
            "now {}.",
            a.edit.words,
            f"{100 * a.changed:.0f}",
            shares_text(a.then),
            shares_text(a.now),
        )
        for a in applied
        if a.has_changed
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
