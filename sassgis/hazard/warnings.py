"""Warnings that a user must know before trusting a result: one list for every command.

``validate`` gives what the inputs show, ``run`` what the simulation adds to it, ``zone`` and
``batch`` what the rules of the zoning add.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from scipy import ndimage

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.grid import Grid, IntArray
from sassgis.hazard.levels import preset_unverified
from sassgis.hazard.sampling_error import LevelChances
from sassgis.hazard.zoning.applied_edits import AppliedEdit, shares_text
from sassgis.hazard.zoning.coverage import cell_polygons
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundClass, Trust
from sassgis.settings.hazard_rules import BlockBudget, HazardPreset
from sassgis.settings.languages import Phrase, counted, joined, like_phrase, phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import (
    STOP_TEXT,
    LineEnd,
    ReleasePoints,
    SetUp,
    StopReason,
    ground_name,
    short,
    thousands,
)
from sassgis.simulation.accumulators import Progress, line_ends
from sassgis.simulation.path_sample import ProfileResult
from sassgis.terrain.release import points_by_size

#: Warnings by the end of one fall line, and of several.
_LINE_ENDS = (
    (
        LineEnd.LEFT_DEM,
        "{} of {} fall lines reaches the edge of the terrain model. Extend it where blocks may go "
        "farther.",
        "{} of {} fall lines reach the edge of the terrain model. Extend it where blocks may go "
        "farther.",
    ),
    (
        LineEnd.NODATA,
        "{} of {} fall lines runs into cells without height. Fill these cells.",
        "{} of {} fall lines run into cells without height. Fill these cells.",
    ),
    (
        LineEnd.MAX_LENGTH,
        "{} of {} fall lines ends at terrain.max_line_length_m. Raise it if blocks may come so "
        "far.",
        "{} of {} fall lines end at terrain.max_line_length_m. Raise it if blocks may come so far.",
    ),
    (
        LineEnd.CLOSED_LOOP,
        "{} of {} fall lines forms a closed loop. Check the terrain there for pits.",
        "{} of {} fall lines form closed loops. Check the terrain there for pits.",
    ),
)
#: What the share of a ground class is stated of.
REACHED = "share of the ground that blocks reach"
_TRUST_WARNINGS: tuple[tuple[Trust, str], ...] = (
    ("estimate", "Estimated ground classes ({}): {}."),
    ("fitted", "Ground classes fitted to field sites ({}): {}."),
)
#: Points and size of a release area differ by more than this factor, and by so many points.
_UNEVEN, _FEW_POINTS = 2.0, 2
#: Warnings by the stopping reason of one block, and of several.
_STOPS = (
    (
        StopReason.LEFT_PROFILE,
        "{} left the terrain model or its fall line while still moving. The map ends where it "
        "left. Extend the terrain model.",
        "{} left the terrain model or their fall line while still moving. The map ends where "
        "they left. Extend the terrain model.",
    ),
    (
        StopReason.STEP_LIMIT,
        "{} was aborted: it reached engine.max_events contacts or sank below the ground.",
        "{} were aborted: they reached engine.max_events contacts or sank below the ground. If "
        "they are many, raise engine.max_events.",
    ),
    (
        StopReason.NEVER_STARTED,
        "{} never started: at its release point the slope is too gentle for the friction. Reach "
        "probability and frequencies do not count it. Give the blocks an initial speed.",
        "{} never started: at their release points the slope is too gentle for the friction. "
        "Reach probability and frequencies do not count them. Give the blocks an initial speed.",
    ),
)
#: Below this share of all blocks their number is stated in place of the share.
_FEW = 1e-3
_GAPS_NAMED = 5  # gaps in the terrain whose place is stated, the largest


def _set_up(text: str, *parts: object) -> SetUp:
    plain = phrase(text, *parts)
    return like_phrase(SetUp(plain), plain)


def _some_blocks(n: int, total: int) -> Phrase:
    """State blocks of all blocks: their share, or how many they are if these are few."""
    if n >= _FEW * total:
        return phrase("{} % of the blocks", short(100.0 * n / total))
    all_blocks = thousands(total)
    if total >= 1_000_000:
        all_blocks = phrase("{} million", f"{total / 1e6:.2g}")
    return counted(n, "{} block of {}", "{} of {} blocks", n, all_blocks)


def ground_shares(run: MapRun, cells: IntArray) -> list[tuple[GroundClass, float]]:
    """Return ground classes of flat cells with their share; of all known cells without any."""
    known = np.isfinite(run.grid.values)
    of_cells = run.ground.ravel()[cells] if cells.size else run.ground[known]
    used, counts = np.unique(of_cells, return_counts=True)
    return [(run.table.classes[k], n / of_cells.size) for k, n in zip(used, counts, strict=True)]


def ground_words(used: Iterable[tuple[GroundClass, float]]) -> str:
    """Return classes with their share: "rock 12 %, debris 30 %"."""
    classes = (phrase("{} {} %", ground_name(c.name), f"{100 * share:.0f}") for c, share in used)
    return joined(", ", classes)


def ground_warnings(
    used: Sequence[tuple[GroundClass, float]], share_of: str = REACHED
) -> list[str]:
    """Warn how far the values of the classes that occur may be trusted, each with its share.

    ``share_of`` says of what the shares are.
    """
    out: list[str] = []
    for trust, text in _TRUST_WARNINGS:
        if names := ground_words((c, share) for c, share in used if c.trust == trust):
            out.append(_set_up(text, phrase(share_of), names))
    assumed = [f"{c.name} {c.d_star_m:g} m" for c, _ in used if c.trust == "paper" and c.d_star_m]
    if assumed:
        text = (
            "Diameter of blocks lying on the ground, from the class table: {}. Measure it on the "
            "site."
        )
        out.append(_set_up(text, ", ".join(assumed)))
    return out


def path_warnings(path: str) -> list[str]:
    """Warn of the limits of paths of this kind."""
    if path == "followed":
        return []
    return [
        "All blocks of a release point stay on one fall line. Maps and zones are too narrow where "
        'blocks spread laterally. Use terrain.path = "followed" to give each block its path.'
    ]


def release_warnings(run: MapRun, points: ReleasePoints) -> list[str]:
    """Warn of release areas whose points do not match their size, or are far apart."""
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
            "Release areas with too many or too few release points for their size (points, "
            "needed): {}. Their parts do not count evenly. Reduce release.spacing_m."
        )
        out.append(phrase(text, ", ".join(uneven)))
    if narrow:
        text = (
            "Too few release points in narrow release areas (largest length for one point): {}. "
            "Reduce release.spacing_m."
        )
        out.append(phrase(text, ", ".join(narrow)))
    return out


def idle_areas(areas: Iterable[str]) -> list[str]:
    """Warn that no block starts in some release areas; nothing without any."""
    text = (
        "No block starts in these release areas, because no release point lies on a slope with "
        "known heights: {}. The maps lack their onset frequency. Check these areas."
    )
    names = ", ".join(areas)
    return [phrase(text, names)] if names else []


def simulation_warnings(run: MapRun, progress: Progress) -> list[str]:
    """Warn of lost blocks and lines, and of uncertain inputs."""
    total = max(int(progress.reasons.sum()), 1)
    started = max(total - int(progress.reasons[StopReason.NEVER_STARTED]), 1)
    out: list[str] = []
    ends = line_ends(progress)
    for end, one, several in _LINE_ENDS:
        if ends[end] and not run.followed:
            out.append(counted(ends[end], one, several, ends[end], sum(ends.values())))
    for reason, one, several in _STOPS:
        if n := int(progress.reasons[reason]):
            of = total if reason == StopReason.NEVER_STARTED else started
            # A share is one of several blocks.
            named = n if n < _FEW * of else of
            out.append(counted(named, one, several, _some_blocks(n, of)))
    arrivals = [
        (line, progress.control_lines.arrivals(i)) for i, (line, _) in enumerate(run.control_lines)
    ]
    if progress.lost:
        text = (
            "Blocks not simulated, because their release points lie on cells without height or "
            "at the edge of the terrain model: {}. The reach probability does not count them. "
            "Extend the terrain model."
        )
        out.append(phrase(text, progress.lost))
    sources = {area for area, _ in progress.sources}
    out += idle_areas(area.name for i, area in enumerate(run.areas) if i not in sources)
    idle = [line.name for line, n in arrivals if not n]
    if idle:
        out.append(_set_up("No block reaches: {}.", ", ".join(idle)))
    return [
        *out,
        *ground_warnings(ground_shares(run, progress.sums.cells)),
        *path_warnings(run.terrain.path),
    ]


def rule_warnings(preset: HazardPreset, frequencies: Mapping[tuple[str, str], float]) -> list[str]:
    """Warn of unverified rules and of sources with a frequency (blocks per year) of zero."""
    out: list[str] = [_set_up(text) for text in preset_unverified(preset)]
    idle = [f"{area} / {scenario}" for (area, scenario), n in frequencies.items() if n == 0.0]
    if idle:
        out.append(phrase("Onset frequency 0: {}. These sources add no hazard.", ", ".join(idle)))
    return out


def sample_words(chances: LevelChances, preset: HazardPreset) -> str:
    """State the change with another random seed, in one sentence for command, report and sheets."""
    shares = zip(preset.levels, chances.changed_by_level.tolist(), strict=True)
    levels = [
        phrase("{} {} %", phrase(level.label), f"{100 * share:.1f}")
        for level, share in shares if not math.isnan(share)
    ][::-1]  # fmt: skip
    text = (
        "With another random seed, {} % of the zoned area changes level, including {} % that is "
        "newly zoned; by level: {}."
    )
    whole, new = (f"{100 * s:.1f}" for s in (chances.changed_share, chances.newly_zoned_share))
    return phrase(text, whole, new, joined(", ", levels))


def edge_words(run: MapRun, progress: Progress, open_limit: Iterable[Any]) -> str:
    """State that blocks were lost at the edge of the terrain or in gaps of it; empty without any.

    ``open_limit`` are the lines where zones end there (shapely).
    """
    # On fall lines blocks are lost at the ends of these, too.
    if not run.followed or not progress.lost_share:
        return ""
    limit = shapely.union_all(list(open_limit))
    gaps, length = ([], []) if limit.is_empty else _open_gaps(run.grid, limit)
    open_m = limit.length - sum(length)
    lost = short(100.0 * progress.lost_share)
    said: Phrase = phrase(
        "{} % of the blocks left the terrain model. No zone ends at its edge.", lost
    )
    if open_m >= 0.5:
        text = (
            "{} % of the blocks left the terrain model. Along {} m of its edge zones continue "
            "beyond it, where nothing was computed. Extend the terrain model."
        )
        said = phrase(text, lost, f"{open_m:.0f}")
    if not gaps:
        return said
    one = "Zones end at a gap in the terrain model. Fill the gap at E, N {}."
    several = "Zones end at gaps in the terrain model. Fill the gaps at E, N {}."
    within = [gap.representative_point() for gap in gaps[:_GAPS_NAMED]]
    places = "; ".join(f"{at.x:.0f}, {at.y:.0f}" for at in within)
    parts = [said, counted(len(gaps), one, several, places)]
    if len(gaps) > _GAPS_NAMED:
        parts.append(phrase("Smaller gaps that are not listed: {}.", len(gaps) - _GAPS_NAMED))
    return joined(" ", parts)


def _open_gaps(grid: Grid, limit: Any) -> tuple[list[Any], list[float]]:
    """Return gaps inside the terrain at which zones end, and the length of limit at each (m).

    The largest gap is first.
    """
    known = np.isfinite(grid.values)
    gaps = cell_polygons(ndimage.binary_fill_holes(known) & ~known, grid)
    # Sides of cells, whose coordinates may differ by rounding.
    around = shapely.buffer(gaps, 0.1 * grid.cell_size)
    length = shapely.length(shapely.intersection(around, limit))
    open_ = np.flatnonzero(length > 0.5 * grid.cell_size)
    open_ = open_[np.argsort(-shapely.area(gaps[open_]), kind="stable")]
    return list(gaps[open_]), length[open_].tolist()


def zone_warnings(
    chances: LevelChances, preset: HazardPreset, budget: BlockBudget | None, reused: bool = False
) -> list[str]:
    """Warn of a zoning that stopped before its levels were certain enough.

    ``reused``: its blocks are as many as those of an earlier result.
    """
    if budget is None or chances.target_share <= budget.changed_share:
        return []
    text = (
        "{} The run stopped at hazard.blocks_max or hazard.minutes_max, before it reached the "
        "limit of {} % for this area and for the mean of the levels (hazard.changed_share_max). "
        "Raise blocks_max or minutes_max."
    )
    if reused:
        text = (
            "{} With the blocks of the reused result, this is above the limit of {} % for this "
            "area or for the mean of the levels (hazard.changed_share_max). Run the final design "
            "without --reuse."
        )
    return [phrase(text, sample_words(chances, preset), f"{100 * budget.changed_share:g}")]


def edit_lines(applied: Sequence[AppliedEdit]) -> list[str]:
    """State in one sentence that zones were edited by hand; nothing without edits."""
    if not applied:
        return []
    authors = ", ".join(dict.fromkeys(a.edit.author for a in applied))
    one = "Hazard zones edited by hand at {} place ({}). Intensities and risk are as computed."
    more = "Hazard zones edited by hand at {} places ({}). Intensities and risk are as computed."
    return [counted(len(applied), one, more, len(applied), authors)]


def assessed_warnings(zones: Iterable[Any], assessed: Sequence[Any]) -> list[str]:
    """Warn of zones beyond the polygons of what was assessed completely, if there are any."""
    zoned = shapely.union_all(list(zones))
    beyond = zoned.difference(shapely.union_all(list(assessed))).area if assessed else 0.0
    if beyond < 1.0:
        return []
    text = (
        "{} m² of the zones ({} %) lie outside the area of hazard.assessed. The layers of the "
        "federal model are cut there; hazard_zones are not."
    )
    return [phrase(text, thousands(round(beyond)), short(100.0 * beyond / zoned.area))]


def edit_warnings(applied: Sequence[AppliedEdit]) -> list[str]:
    """Return edits below which another level is computed than when they were made."""
    return [
        phrase(
            "Since an edit by hand ({}), the computed level has changed on {} % of its area. "
            "Before: {}. Now: {}. Review the edit.",
            a.edit.words,
            f"{100 * a.changed:.0f}",
            shares_text(a.then),
            shares_text(a.now),
        )
        for a in applied
        if a.has_changed
    ]


def profile_warnings(result: ProfileResult, effects: EffectSettings) -> list[str]:
    """Warn of lost blocks of a profile."""
    out: list[str] = []
    if effects.get(LateralDeflection) is not None:
        out.append("A profile has no width. [effects.lateral_deflection] has no effect here.")
    for reason, *_ in _STOPS:
        n = int((result.rocks["reason"] == reason).sum())
        if n:
            text = phrase(STOP_TEXT[reason])
            out.append(phrase("{} of {} blocks: {}.", n, result.rocks.size, text))
    return out
