"""Say what observations support, and what to measure next.

For the latter, two calibrated models are released again, and seen where they differ most. Both fit
what was observed, each with several draws of its parameters. What they would show elsewhere, or by
quantities that were not measured, is simulated with the stated errors. A difference counts if the
draws of one model do not differ as much; the number of rocks that would distinguish the models is
then that of a test of one mean (level 5 %, power 80 %).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.constants import (
    DETECTABLE,
    LEAST_DIFFERENCE,
    NEAR_STATION,
    SEPARATION_CAMPAIGNS,
    SEPARATION_DRAWS,
    SEPARATION_NUMBER,
    SEPARATION_ROCKS,
    SURE_DIFFERENCE,
    TRIED_STATIONS,
)
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import HypothesisModel, with_stations_at
from sassgis.gap.forward.rock_lines import RockLines, control_lines_of
from sassgis.gap.observations.case import WHOLE, Campaign, Case, ImpactRows, observed_campaign
from sassgis.gap.observations.observed import Observations, rock_masses_kg
from sassgis.gap.residuals.rock_residuals import mean_of_draws, per_rock
from sassgis.gap.words import effect_name
from sassgis.grid import FloatArray
from sassgis.settings.languages import Phrase, all_of, joined, phrase


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that the observations hold."""

    name: str
    table: str
    rocks: int  # on how many of them; unattributed blocks are not counted
    values: int


@dataclass(frozen=True, slots=True)
class Identifiable:
    """Quantities that observations support, and those that they do not."""

    rocks: int
    unattributed: int  # blocks and passages that belong to none of the rocks
    quantities: tuple[Quantity, ...]
    #: Sentences: the missing data, and what they would identify.
    not_identifiable: tuple[str, ...]
    not_testable: str = ""  # causes that leave nothing in the given tables

    def has(self, name: str, table: str | None = None) -> bool:
        """Return whether a quantity is there, in one table or in any."""
        return any(q.name == name and table in (None, q.table) for q in self.quantities)


def what_is_identifiable(observations: Observations) -> Identifiable:
    """Find the quantities that the data support, and those that they do not identify."""
    quantities = []
    unattributed = 0
    for table, data in observations.tables.items():
        for name, columns in data.quantities.items():
            known = np.all([np.isfinite(data.numbers[c]) for c in columns], axis=0)
            if known.any():
                owner = observations.rock_of(table)[known]
                rocks = int(np.unique(owner[owner >= 0]).size)
                quantities.append(Quantity(name, table, rocks, int(known.sum())))
        if data.may_be_loose:
            unattributed += int((observations.rock_of(table) < 0).sum())
    found = Identifiable(len(observations.rock_names), unattributed, tuple(quantities), ())
    lacks = (
        *_missing_of_releases(observations, found),
        *_missing_at_stations(observations, found),
        *_missing_on_the_path(found),
        *_missing_of_rocks(observations),
    )
    unseen = [n for n, lacking in _tables_lacking(observations, CAUSES).items() if all(lacking)]
    text = "Not testable with these tables, however many rocks: {}."
    return replace(
        found, not_identifiable=lacks, not_testable=not_testable(observations, unseen, text)
    )


def _missing_of_releases(observations: Observations, found: Identifiable) -> Iterable[str]:
    rocks = observations.rocks
    yield _sample_size(found.rocks)
    if not len(rocks):
        yield ("No table of rocks: entrainment cannot be separated from fragmentation.")
    if not {"x", "y"} <= rocks.present:
        yield (
            "No release points: rocks have no individual fall line. An error of the release "
            "cannot be separated from one of the motion."
        )
    if not found.has("release_speed_mps"):
        yield "No release speeds: a wrong initial speed shows only farther down the slope."


def _missing_at_stations(observations: Observations, found: Identifiable) -> Iterable[str]:
    if not len(observations.stations) or not found.has("speed_mps", "passages"):
        yield (
            "No speeds at stations: the slope cannot be divided into reaches. The start of a gap "
            "between release and stop is unknown."
        )
    elif len(observations.stations) == 1:
        yield "One station: a gap can only be located above or below it."
    if found.has("speed_mps", "passages") and not found.has("rotation_hz", "passages"):
        yield "No rotation at stations: spin and the energy in it are not compared."
    if found.has("speed_mps", "passages") and not found.has("height_m"):
        yield "No heights at stations: flying and rolling passages cannot be separated."


def _missing_on_the_path(found: Identifiable) -> Iterable[str]:
    if not found.has("energy_kept"):
        yield (
            "No velocities before and after impacts: energy lost in impacts, in flight and in "
            "rolling cannot be separated directly. Only trends down the slope separate soft "
            "ground, roughness and trees."
        )
    elif not found.has("spin_out_radps"):
        yield "No spin before and after impacts: slip at the contact cannot be detected."
    if not found.has("runout_m"):
        yield "No deposits: run-out, its spread and stopping are not compared."
    elif not (found.has("block_mass_kg") or found.has("block_volume_m3")):
        yield "No sizes of deposited blocks: fragments cannot be added up to their rock."
    if not (found.has("lateral_m") or found.has("turn_deg") or found.has("path_m")):
        yield "No lateral positions: lateral deflection cannot be detected."
    if not found.has("flight_fit"):
        yield (
            "No trajectories in time: air drag and a wrong time base or scale of the measurement "
            "cannot be detected in flight."
        )


#: Keys of ``metadata`` that state an error of measurement, by what was measured.
_ERRORS = {
    "positions": "position_error_m",
    "speeds": "speed_error_rel",
    "rotations": "rotation_error_rel",
    "heights": "height_error_m",
}


def _missing_of_rocks(observations: Observations) -> Iterable[str]:
    rocks = observations.rocks
    masses = rock_masses_kg(observations)
    known = masses[np.isfinite(masses)]
    if known.size < 3:
        yield "Fewer than three rocks with a mass: effects that go with mass are not identifiable."
    elif float(np.std(np.log(known))) < 0.1:
        yield phrase(
            "All rocks have about the same mass ({} kg): effects that go with mass are not "
            "identifiable.",
            f"{np.median(known):.3g}",
        )
    if not {"semi_axis_a_m", "semi_axis_b_m", "semi_axis_c_m"} <= rocks.present:
        yield "No semi-axes of the rocks: an effect of rock shape is not identifiable."
    missing = [
        what for what, key in _ERRORS.items() if math.isnan(getattr(observations.metadata, key))
    ]
    if missing:
        whose = phrase("")
        if len(missing) < len(_ERRORS):
            whose = phrase(" of {}", all_of(missing))
        yield phrase(
            "Measurement errors{} are not stated. Assumed values separate the noise of the "
            "measurement from the scatter of the rocks.",
            whose,
        )


def _sample_size(rocks: int) -> str:
    if rocks == 0:
        return "No rocks: a comparison rock by rock is impossible."
    if rocks == 1:
        return "One rock: its scatter is unknown, and no gap can be distinguished from chance."
    return phrase(
        "With {} rocks, a gap remains undetected below {} standard deviations (means) or {} "
        "percentage points (shares near one half); power 80 %, level 5 %, one comparison.",
        rocks,
        f"{DETECTABLE / math.sqrt(rocks):.2f}",
        f"{100.0 * min(1.0, DETECTABLE * 0.5 / math.sqrt(rocks)):.0f}",
    )


@dataclass(frozen=True, slots=True)
class Separation:
    """A measurement that distinguishes two causes."""

    one: str
    other: str
    what: str  # what is measured, in words; empty if nothing that was tried distinguishes them
    rocks: int  # that it takes

    @property
    def sentence(self) -> str:
        """For the reader."""
        pair = effect_name(self.one), effect_name(self.other)
        if not self.what:
            return phrase(
                "No measurement of speeds, rotations, heights, impacts or stops would separate {} "
                "from {} (simulated).",
                *pair,
            )
        return phrase(
            "To separate {} from {}, measure {} of about {} rocks (simulated).",
            *pair, phrase(self.what), self.rocks,
        )  # fmt: skip


def separations(
    case: Case, rock_lines: RockLines, models: Mapping[str, Sequence[HypothesisModel]], seed: int
) -> tuple[Separation, ...]:
    """Say what would best distinguish the first of some calibrated models from the others."""
    causes = list(models)
    if len(causes) < 2:
        return ()
    places = new_places(case, rock_lines)
    seen = {name: _shown(case, rock_lines, models[name], places, seed) for name in causes}
    first, there = causes[0], recorded_rocks(case)
    return tuple(
        best_measurement(first, name, seen[first], seen[name], there) for name in causes[1:]
    )


def recorded_rocks(case: Case) -> dict[str, int]:
    """Return rocks of which impacts and stops were recorded, by what they show in words."""
    # Stations that are tried are new ones.
    seen = replace(observed_campaign(case), passages=None)
    return {what: int(np.isfinite(v).sum()) for what, v in _quantities(seen, ())}


def _tables_lacking(
    observations: Observations, causes: Iterable[str]
) -> dict[str, list[frozenset[str]]]:
    """Return the tables that lack for each fingerprint of causes that have one, by cause."""
    return {
        name: [
            frozenset(table for table in own.tables if not len(observations.tables[table]))
            for own in CAUSES[name].statistics
        ]
        for name in causes
        if name in CAUSES and CAUSES[name].statistics
    }


def _recording(lacking: Mapping[str, Sequence[frozenset[str]]]) -> list[tuple[list[str], Phrase]]:
    """Return tables to record, what shows most causes first, with the names of these causes."""
    left, recorded = dict(lacking), frozenset[str]()
    found = []
    while left:
        shown: dict[frozenset[str], list[str]] = {}
        for name, fingerprints in left.items():
            for more in dict.fromkeys(own - recorded for own in fingerprints if own - recorded):
                shown.setdefault(more, []).append(name)
        if not shown:
            break
        more = max(shown, key=lambda own: (len(shown[own]), -len(own)))
        # What a part of these tables shows, they show as well.
        names = [n for own, names in shown.items() if own <= more for n in names]
        names = [name for name in left if name in names]
        found.append((sorted(more), joined(", ", map(effect_name, names))))
        recorded |= more
        left = {name: own for name, own in left.items() if name not in names}
    return found


def not_testable(
    observations: Observations,
    causes: Iterable[str],
    text: str = "Not testable with these data: {}.",
) -> str:
    """Return causes that the data cannot show, in a line: what would show most of them first."""
    lacking = _tables_lacking(observations, causes)
    # Of these every table is there.
    rest = [name for name, own in lacking.items() if not any(own)]
    rows = _recording({name: own for name, own in lacking.items() if name not in rest})
    said = [phrase("{} (record {})", names, all_of(tables)) for tables, names in rows]
    if rest:
        said.append(phrase("{} (record more rocks)", joined(", ", map(effect_name, rest))))
    return phrase(text, joined("; ", said)) if said else ""


def tables_to_add(case: Case, causes: Sequence[str]) -> tuple[str, ...]:
    """Return what to record so that causes have more fingerprints; what shows most comes first."""
    found = _recording(_tables_lacking(case.observations, causes))
    said = [phrase("{} ({})", all_of(tables), names) for tables, names in found]
    if not said:
        return ()
    return (phrase("Recording these tables would separate causes: {}.", joined("; ", said)),)


def new_places(case: Case, rock_lines: RockLines) -> FloatArray:
    """Return chainages of stations at which nothing was measured yet (m)."""
    stops = case.projected["deposits"].s if "deposits" in case.projected else np.empty(0)
    known = stops[np.isfinite(stops)]
    # Lines of followed paths have no end but that of the trace.
    ends = case.traces.s[case.traces.offset[case.line + 1] - 1]
    length = float(np.median(np.minimum(rock_lines.end, ends)))
    way = float(np.median(known)) if known.size else 0.7 * length
    used = case.station_names and len(case.observations.passages)
    there = np.nanmedian(case.station_s, axis=0) if used else np.empty(0)
    places = [p * way for p in TRIED_STATIONS]
    return np.array([s for s in places if not (np.abs(there - s) < NEAR_STATION * way).any()])


def _shown(
    case: Case,
    rock_lines: RockLines,
    models: Sequence[HypothesisModel],
    places: FloatArray,
    seed: int,
) -> dict[str, FloatArray]:
    """Simulate what rocks show in campaigns, by words, shape (DRAWS, _CAMPAIGNS, n_rocks)."""
    there = with_stations_at(case, places)
    names = [phrase("{} along the fall line", name) for name in there.station_names]
    lines = replace(rock_lines, control_lines=control_lines_of(there))
    chosen = [models[k % len(models)] for k in range(SEPARATION_DRAWS)]
    made = [
        sample
        for k, model in enumerate(chosen)
        for sample in campaigns(
            there, lines, model,
            count=SEPARATION_CAMPAIGNS, seed=seed, number=SEPARATION_NUMBER + k, everywhere=True,
        )
    ]  # fmt: skip
    rows = [dict(_quantities(sample, names)) for sample in made]
    shape = SEPARATION_DRAWS, SEPARATION_CAMPAIGNS, case.n_rocks
    return {what: np.stack([row[what] for row in rows]).reshape(shape) for what in rows[0]}


def _quantities(sample: Campaign, places: Sequence[str]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the quantities of each rock of one campaign, shape (n_rocks,); NaN where nothing."""
    n = sample.n_rocks
    passed, lying, hit = sample.passages, sample.deposits, sample.impacts
    if passed is not None:
        for k, place in enumerate(places):
            rock = np.where((passed.station == k) & (passed.kind == WHOLE), passed.rock, -1)
            yield phrase("the speed at {}", place), per_rock(passed.speed_mps, rock, n)
            yield phrase("the rotation at {}", place), per_rock(passed.rotation_hz, rock, n)
            yield phrase("the passing height at {}", place), per_rock(passed.height_m, rock, n)
            yield phrase("where rocks pass {}", place), per_rock(np.abs(passed.lateral_m), rock, n)
    if lying is not None:
        whole = np.where(lying.kind == WHOLE, lying.rock, -1)
        yield "where rocks stop along the fall line", per_rock(lying.s, whole, n)
        yield (
            "lateral distance of stops from the fall line",
            per_rock(np.abs(lying.lateral_m), whole, n),
        )
        # A rock without blocks to its name has none but itself.
        more = np.bincount(lying.rock[(lying.rock >= 0) & (lying.kind != WHOLE)], minlength=n)
        yield "the number of fragments of each rock", more.astype(np.float64)
    if hit is not None:
        yield from _impacts(hit, n)


def _impacts(hit: ImpactRows, n: int) -> Iterator[tuple[str, FloatArray]]:
    with np.errstate(invalid="ignore", divide="ignore"):
        kept = np.clip(hit.vn_out / np.abs(hit.vn_in), 0.0, 3.0)
        slip = np.clip(hit.vt_out / hit.vt_in, 0.0, 3.0)
    off = np.abs(kept - np.nanmedian(kept)) if kept.size else kept
    yield "the rebound at impacts", per_rock(kept, hit.rock, n)
    yield "the scatter of the rebound at impacts", per_rock(off, hit.rock, n)
    yield "the tangential speed before and after impacts", per_rock(slip, hit.rock, n)
    yield "the spin after impacts", per_rock(hit.spin_out, hit.rock, n)
    yield "the turn of the path at impacts", per_rock(np.abs(hit.turn_deg), hit.rock, n)


def best_measurement(
    one: str,
    other: str,
    first: Mapping[str, FloatArray],
    second: Mapping[str, FloatArray],
    recorded: Mapping[str, int],
) -> Separation:
    """Return what differs most and is not recorded, counted on other campaigns than chose it."""
    half, sure = SEPARATION_CAMPAIGNS // 2, 0.0
    size = {w: _difference(first[w][:, :half], second[w][:, :half]) for w in first}
    new = [w for w in size if _rocks(size[w]) > recorded.get(w, 0)]
    if new:
        best = max(new, key=lambda w: abs(size[w]))
        sure = _difference(first[best][:, half:], second[best][:, half:])
        sure *= math.copysign(1.0, size[best])
    if sure < LEAST_DIFFERENCE:
        return Separation(one, other, "", 0)
    return Separation(one, other, best, max(math.ceil(_rocks(sure)), SEPARATION_ROCKS))


def _rocks(difference: float) -> float:
    """Return rocks that a difference takes, in standard deviations of one."""
    return (DETECTABLE / difference) ** 2 if difference else math.inf


def _difference(one: FloatArray, other: FloatArray) -> float:
    """Return the mean difference of a rock in two models over its scatter; 0 if draws differ so."""
    seen = float(min(np.isfinite(one).mean(), np.isfinite(other).mean()))
    # Of each rock in each draw, shape (DRAWS, n_rocks).
    means = [mean_of_draws(np.moveaxis(v, 1, -1), least=1) for v in (one, other)]
    apart = mean_of_draws(means[0].T, least=1) - mean_of_draws(means[1].T, least=1)
    both = np.isfinite(apart)
    if both.sum() < SEPARATION_ROCKS:
        return 0.0
    delta = float(apart[both].mean())
    common = math.hypot(*(float(_of_draws(m[:, both]).std(ddof=1)) for m in means))
    if abs(delta) < SURE_DIFFERENCE * common:
        return 0.0
    off = [(v - m[:, None, :])[..., both].ravel() for v, m in zip((one, other), means, strict=True)]
    n = one.shape[1]
    scatter = math.sqrt(float(np.nanmean(np.concatenate(off) ** 2)) * n / max(n - 1, 1))
    return delta / scatter * math.sqrt(seen) if scatter > 0.0 else 0.0


def _of_draws(means: FloatArray) -> FloatArray:
    """Return the mean of each draw over the rocks that all draws have, shape (DRAWS,)."""
    whole = np.isfinite(means).all(axis=0)
    return means[:, whole].mean(axis=1) if whole.any() else np.zeros(len(means))
