"""Say before a campaign which effects of which strength it would show.

Rocks are released in the configured model with one effect, seen by an observer with usual errors,
and put in the place of observations. An effect would be named if most of such campaigns name it by
their fingerprints against the configured model. What calibration takes away of an effect, and what
the gains of causes add, is left out: both take a calibration of each campaign.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy import stats

from sassgis.errors import InputError
from sassgis.gap.causes import trees_cause
from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import CausePart, ParameterDraws
from sassgis.gap.constants import (
    LEAST_PLANNED_M,
    NAMED_POWER,
    PLANNED_ROCKS,
    PLANNED_STATIONS,
    POWER_CAMPAIGNS,
    POWER_NUMBER,
    REPLICATES,
    STRENGTH_SHARES,
)
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.forward.campaign_case import with_campaign
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import (
    all_rocks,
    configured_model,
    move,
    with_stations_at,
)
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.observations.case import Case, Errors, case_of
from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.tables import Rocks
from sassgis.gap.residuals.residual_table import fingerprint_residuals
from sassgis.gap.residuals.rock_residuals import holm_adjusted
from sassgis.gap.residuals.stop_residuals import FreeRun, free_run
from sassgis.gap.verdict.verdict import CauseWeights, Thresholds, decide, fingerprints
from sassgis.gap.words import effect_name
from sassgis.settings.languages import Language, Phrase, in_language, phrase, translated
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import short
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.prepare import plan, prepare_lines

_RECORDED = frozenset({"passages", "deposits", "impacts", "trajectories"})
#: What is recorded besides the rocks: each set of tables has those before it.
TABLE_SETS: tuple[frozenset[str], ...] = tuple(
    frozenset({"rocks", "stations", "passages", *added})
    for added in ((), ("deposits",), ("deposits", "impacts"), _RECORDED)
)


@dataclass(frozen=True, slots=True)
class Strength:
    """The parameter that makes an effect weak or strong; others are usual or in the middle."""

    label: str  # of the parameter, in words
    drawn: str  # as the draws of the cause call it
    reported: str  # as its model reports it
    ends: tuple[float, float] = (0.0, 1.0)  # shares of its range: weakest and strongest
    fixed: Mapping[str, float] = field(default_factory=dict)  # other draws: form, parts left out

    def part(self, case: Case, cause: str, share: float) -> CausePart:
        """Return the cause in a strength from 0 to 1."""
        low, high = self.ends
        drawn = {**self.fixed, self.drawn: low + share * (high - low)}
        return CAUSES[cause].draw(case, ParameterDraws(None, drawn))


_USUAL_EFFICIENCY = trees_cause.FIT.ranges["efficiency"].share(1.0)
_FALLING, _UPPER_HALF = (1.0, 0.0), (0.5, 1.0)


def _first_form(cause: str, label: str, name: str, *ends: float, **fixed: float) -> Strength:
    """Return the strength of an effect with forms: the first one is usual."""
    others = {f"{cause}.form": 0.0, **fixed}
    return Strength(label, f"{cause}.{name}", name, ends or (0.0, 1.0), others)  # type: ignore[arg-type]


#: Of each cause, by the ranges of its fit.
STRENGTHS: Mapping[str, Strength] = {
    "measurement_error": Strength(
        "scale of speeds", "seen.log_scale", "scale", _UPPER_HALF,
        {"seen.scale": 0.0, "seen.clock": 1.0, "seen.turns": 1.0, "seen.place": 1.0},
    ),
    "release_error": Strength(
        "start farther down, m", "release.ahead_m", "ahead_m", _UPPER_HALF,
        {"release.ahead": 0.0, "release.faster": 1.0, "release.aside": 1.0},
    ),
    "air_drag": _first_form("air_drag", "C_d", "drag_coefficient"),
    "trees": Strength(
        "stems per hectare", "stand.stems", "stems_per_ha",
        fixed={"trees.form": 0.0, "trees.efficiency": _USUAL_EFFICIENCY},
    ),
    "fragmentation": _first_form("fragmentation", "breaking from, J/kg", "energy_jkg", *_FALLING),
    "entrainment": _first_form("entrainment", "blocks per impact", "number"),
    "lateral_deflection": _first_form("lateral_deflection", "angle, °", "angle_deg"),
    "soft_ground": _first_form(
        "soft_ground", "speed that halves the rebound, m/s", "reference_speed_mps", *_FALLING
    ),
    "roughness": _first_form("roughness", "obstacles, m", "obstacle_m"),
    "rock_shape": _first_form("rock_shape", "strength", "strength"),
}  # fmt: skip


def planned_case(run: MapRun, rocks: int, seed: int, file: Path) -> Case:
    """Return a case of rocks that nobody has observed yet: one release, three stations.

    Sizes are drawn from the first block scenario and known, as if they had been measured. All start
    at the release point in the middle of those with a fall line. Stations cross that line at 40, 60
    and 80 % of the way to the middle of the stops.
    """
    starts = plan(run).starts
    traces = trace(run.grid, fall_line_surface(run.grid, run.terrain), starts, run.terrain)
    good = np.flatnonzero(prepare_lines(run, traces).good)
    if not good.size:
        raise InputError(
            "no fall line can be traced from the release points", file=file, field="release",
            found=f"{len(starts)} points", expected="release areas on a slope",
        )  # fmt: skip
    x, y = starts.x[good], starts.y[good]
    middle = int(np.hypot(x - np.median(x), y - np.median(y)).argmin())
    names = [f"R{k + 1}" for k in range(rocks)]
    places = {"x": np.full(rocks, x[middle]), "y": np.full(rocks, y[middle])}
    case = case_of(run, Observations(Rocks.of(rock_id=names, **places)), file)
    lines = rock_lines_of(case)
    own = move(
        case, lines, all_rocks(case, lines), configured_model(case), seed=seed, count=1
    ).rocks
    stop = float(np.median(own["runout_m"]))
    if stop < LEAST_PLANNED_M:
        raise InputError(
            "half of the simulated blocks stop next to the release: no campaign can be planned",
            file=file, field="release", found=f"{stop:.1f} m", expected=f"{LEAST_PLANNED_M:g} m",
        )  # fmt: skip
    known = Rocks.of(
        rock_id=names, **places, mass_kg=own["mass_kg"], density_kgm3=own["density_kgm3"],
        **{f"semi_axis_{c}_m": own[f"{c}_m"] for c in "abc"},
    )  # fmt: skip
    case = case_of(run, Observations(known), file)
    return with_stations_at(case, stop * np.array(PLANNED_STATIONS))


def first_rocks(case: Case, n: int) -> Case:
    """Return a planned case with only its first rocks."""
    fewer = case.observations.rocks.take(np.arange(n))
    return replace(
        case, observations=replace(case.observations, rocks=fewer), line=case.line[:n],
        blocks=case.blocks[:n], start=case.start[:n], mass_kg=case.mass_kg[:n],
        radius_m=case.radius_m[:n],
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class UsualRocks:
    """Rocks of a planned campaign without an effect."""

    case: Case  # with one campaign of the configured model in the place of observations
    run: FreeRun  # their replicates


def usual_rocks(planned: Case, n: int, seed: int) -> UsualRocks:
    """Release the first rocks of a planned case in the configured model."""
    case = first_rocks(planned, n)
    base = configured_model(case)
    (made,) = campaigns(
        case, rock_lines_of(case), base, count=1, seed=seed, number=POWER_NUMBER,
        tables=_RECORDED, everywhere=True,
    )  # fmt: skip
    case = with_campaign(case, made)
    return UsualRocks(case, free_run(case, base, seed, REPLICATES))


@dataclass(frozen=True, slots=True)
class PlannedCampaign:
    """A campaign before it is made, and by what an effect is named in it."""

    usual: Mapping[int, UsualRocks]  # by their number
    families: tuple[str, ...]  # that may be named
    weights: CauseWeights
    thresholds: Thresholds
    seed: int

    def named(self, prints: Sequence[Fingerprint], tables: frozenset[str]) -> str:
        """Return the answer that the fingerprints in some tables give by themselves."""
        seen = in_tables(prints, tables)
        shares = self.weights.shares(seen, {}, self.families, True)
        return decide(seen, {}, shares, True, None, self.thresholds, False)[0]


def in_tables(prints: Sequence[Fingerprint], tables: frozenset[str]) -> tuple[Fingerprint, ...]:
    """Return the fingerprints that remain if only some tables were recorded."""
    needed = {own.name: {*own.tables} for cause in CAUSES.values() for own in cause.statistics}
    seen = [one for one in prints if one.observable and needed[one.statistic] <= tables]
    p = holm_adjusted(stats.norm.sf([one.z for one in seen])) if seen else np.empty(0)
    return tuple(replace(one, p_adjusted=own) for one, own in zip(seen, p.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """Campaigns of some rocks with a cause of one strength."""

    cause: str
    strength: str  # one of STRENGTH_SHARES
    rocks: int

    @property
    def count(self) -> int:
        """Blocks that are released, at most."""
        return POWER_CAMPAIGNS * self.rocks


@dataclass(frozen=True, slots=True)
class Power:
    """Whether four of five campaigns name a cause, for each of TABLE_SETS."""

    trial: PlannedTrial
    value: float  # of the parameter that makes it weak or strong
    named: tuple[bool, ...]


def power_of(planned: PlannedCampaign, trial: PlannedTrial) -> Power:
    """Make campaigns with a cause, until it is clear which tables name it often enough."""
    usual = planned.usual[trial.rocks]
    strength, share = STRENGTHS[trial.cause], STRENGTH_SHARES[trial.strength]
    part = strength.part(usual.case, trial.cause, share)
    samples = campaigns(
        usual.case, replace(usual.run.rock_lines, observer=Errors()), part.change(usual.run.model),
        count=POWER_CAMPAIGNS, seed=planned.seed, number=POWER_NUMBER + 1, tables=_RECORDED,
        everywhere=True,
    )  # fmt: skip
    enough = math.ceil(NAMED_POWER * POWER_CAMPAIGNS)
    times = np.zeros(len(TABLE_SETS), np.int64)
    for left, sample in zip(range(len(samples), 0, -1), samples, strict=True):
        if ((times >= enough) | (times + left < enough)).all():
            break
        case = with_campaign(usual.case, sample)
        prints = fingerprints(case, fingerprint_residuals(case, usual.run))
        times += [planned.named(prints, tables) == trial.cause for tables in TABLE_SETS]
    value = float(part.parameters[strength.reported])
    return Power(trial, value, tuple((times >= enough).tolist()))


Run = Callable[
    [Callable[[PlannedCampaign, PlannedTrial], Power], Sequence[PlannedTrial]], Iterable[Power]
]


def powers_of(causes: Sequence[str], run: Run) -> list[Power]:
    """Find what campaigns name, from many rocks and strong effects to few and weak ones.

    Weaker effects and fewer rocks are skipped where a stronger effect or more rocks failed.
    """
    due = [PlannedTrial(name, _ORDER[-1], max(PLANNED_ROCKS)) for name in causes]
    found: dict[PlannedTrial, Power] = {}
    while due:
        made = list(run(power_of, due))
        found |= {one.trial: one for one in made}
        after = (trial for one in made if any(one.named) for trial in _harder(one.trial))
        due = [trial for trial in dict.fromkeys(after) if trial not in found]
    return list(found.values())


_ORDER = tuple(STRENGTH_SHARES)
_WEAKER = dict(itertools.pairwise(_ORDER[::-1]))
_FEWER = dict(itertools.pairwise(PLANNED_ROCKS[::-1]))


def _harder(trial: PlannedTrial) -> Iterator[PlannedTrial]:
    """Yield trials of a weaker effect, and of fewer rocks."""
    if trial.strength in _WEAKER:
        yield replace(trial, strength=_WEAKER[trial.strength])
    if trial.rocks in _FEWER:
        yield replace(trial, rocks=_FEWER[trial.rocks])


@dataclass(frozen=True, slots=True)
class CampaignPower:
    """What campaigns at a site would name."""

    causes: tuple[str, ...]  # in the order of the diagnosis
    powers: tuple[Power, ...]  # what was tried
    stations_m: tuple[float, ...]  # chainages of the stations
    x: float  # release point (m)
    y: float
    language: Language = "en"  # in which it is printed

    def least(self, cause: str, tables: int, rocks: int) -> Power | None:
        """Return the weakest effect that is named; None if none is. ``tables``: of TABLE_SETS."""
        named = [
            own for own in self.powers
            if (own.trial.cause, own.trial.rocks) == (cause, rocks) and own.named[tables]
        ]  # fmt: skip
        return min(named, key=lambda own: _ORDER.index(own.trial.strength), default=None)

    def lines(self) -> list[str]:
        """Return a short table in words: a line for each cause, a column for each table."""
        with in_language(self.language):
            return self._lines()

    def _lines(self) -> list[str]:
        head = ["", *map(translated, _COLUMNS)]
        rows = [[translated(_label(name)), *self._cells(name)] for name in self.causes]
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        numbers = [f"{n}" for n in PLANNED_ROCKS]
        before = phrase(
            "Weakest effect that would be named with {} rocks (simulated; – : not named)",
            " / ".join(numbers),
        )
        after = phrase(
            "Rocks released at {}, {}; stations at {} m along the fall line. Each effect is "
            "named in 4 of 5 simulated campaigns with usual errors of measurement. A calibration "
            "may hide weak effects.",
            f"{self.x:.0f}", f"{self.y:.0f}", ", ".join(f"{s:.0f}" for s in self.stations_m),
        )  # fmt: skip
        table = [
            "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
            for row in (head, *rows)
        ]
        return [translated(before), *table, translated(after)]

    def _cells(self, cause: str) -> list[str]:
        found = []
        for k in range(len(TABLE_SETS)):
            least = [self.least(cause, k, rocks) for rocks in PLANNED_ROCKS]
            found.append(" / ".join("–" if own is None else short(own.value) for own in least))
        return found


_COLUMNS = ("stations and passages", "+ stops with masses", "+ impacts", "+ paths in time")


def _label(cause: str) -> Phrase:
    """Return a cause with the parameter by which it is weak or strong."""
    return phrase("{} ({})", effect_name(cause), phrase(STRENGTHS[cause].label))
