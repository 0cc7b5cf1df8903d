"""What to measure next: two calibrated models are released again, and seen where they differ most.

Both fit what was observed, each with several draws of its parameters. What they would show
elsewhere, or by quantities that were not measured, is simulated with the stated errors. A
difference counts if the draws of one model do not differ as much; the number of rocks that would
tell the models apart is then that of a test of one mean (level 5 %, power 80 %).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.observations.campaign import WHOLE, Campaign, ImpactRows, observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.replicas.released_rocks import with_stations_at
from sassgis.gap.replicas.rock_lines import RockLines, control_lines_of
from sassgis.gap.residuals.residuals import mean_of_draws, per_rock
from sassgis.gap.words import effect_name
from sassgis.model.grid import FloatArray
from sassgis.model.languages import all_of, joined, phrase

#: Stations that are tried, as shares of the way to the middle of the stops; the nearest that an
#: existing one may lie (the same share).
_PLACES, _NEAR = (0.2, 0.4, 0.6, 0.8), 0.08
#: Draws of each model, and campaigns of each draw: half of them choose the measurement, the others
#: count.
DRAWS, _CAMPAIGNS = 4, 4
#: Campaigns have numbers from this on, so that they are no others.
_NUMBER = 900
#: Standard normal deviates of level and power, together.
_SURE = 1.96 + 0.84
#: Difference, in standard deviations of one rock, and in those of the draws of both models, below
#: which nothing is recommended.
_LEAST_DIFFERENCE, _LEAST_SURE = 0.2, 2.0
_LEAST_ROCKS = 5


@dataclass(frozen=True, slots=True)
class Separation:
    """A measurement that tells two causes apart."""

    one: str
    other: str
    what: str  # what is measured, in words; empty if nothing that was tried tells them apart
    rocks: int  # that it takes

    @property
    def sentence(self) -> str:
        """For the reader."""
        pair = effect_name(self.one), effect_name(self.other)
        if not self.what:
            return phrase(
                "Neither speeds, rotations, heights and impacts nor stops would tell {} from {} "
                "(simulated).",
                *pair,
            )
        return phrase(
            "To tell {} from {}: {}, of about {} rocks (simulated).",
            *pair, phrase(self.what), self.rocks,
        )  # fmt: skip


def separations(
    case: Case, rock_lines: RockLines, models: Mapping[str, Sequence[HypothesisModel]], seed: int
) -> tuple[Separation, ...]:
    """What would best distinguish the first of several calibrated models from each of the others.

    ``models``: draws that fit alike; the cause that is to be distinguished first.
    """
    causes = list(models)
    if len(causes) < 2:
        return ()
    places = _places(case, rock_lines)
    seen = {name: _shown(case, rock_lines, models[name], places, seed) for name in causes}
    first, there = causes[0], _recorded(case)
    return tuple(_best(first, name, seen[first], seen[name], there) for name in causes[1:])


def _recorded(case: Case) -> dict[str, int]:
    """Rocks of which impacts and stops were recorded, by what they show in words."""
    # Stations that are tried are new ones.
    seen = replace(observed_campaign(case), passages=None)
    return {what: int(np.isfinite(v).sum()) for what, v in _quantities(seen, ())}


def tables_to_add(case: Case, causes: Sequence[str]) -> tuple[str, ...]:
    """Tables of observations that lack, and the causes that have a fingerprint in them."""
    tables = case.observations.tables
    shown: dict[tuple[str, ...], list[str]] = {}
    for cause in (CAUSES[name] for name in causes if name in CAUSES):
        needed = {
            tuple(name for name in own.tables if not len(tables[name])): None
            for own in cause.statistics
        }
        needed.pop((), None)
        for lacks in needed:
            # With fewer tables there is a fingerprint already.
            if not any({*fewer} < {*lacks} for fewer in needed):
                shown.setdefault(lacks, []).append(cause.words[0])
    return tuple(
        phrase(
            "Not recorded yet, with fingerprints of {}: {}.",
            joined(", ", map(phrase, names)),
            all_of(lacks),
        )
        for lacks, names in shown.items()
    )


def _places(case: Case, rock_lines: RockLines) -> FloatArray:
    """Chainages of stations at which nothing was measured yet (m)."""
    stops = case.projected["deposits"].s if "deposits" in case.projected else np.empty(0)
    known = stops[np.isfinite(stops)]
    # Lines of followed paths have no end but that of the trace.
    ends = case.traces.s[case.traces.offset[case.line + 1] - 1]
    length = float(np.median(np.minimum(rock_lines.end, ends)))
    way = float(np.median(known)) if known.size else 0.7 * length
    used = case.station_names and len(case.observations.passages)
    there = np.nanmedian(case.station_s, axis=0) if used else np.empty(0)
    places = [p * way for p in _PLACES]
    return np.array([s for s in places if not (np.abs(there - s) < _NEAR * way).any()])


def _shown(
    case: Case,
    rock_lines: RockLines,
    models: Sequence[HypothesisModel],
    places: FloatArray,
    seed: int,
) -> dict[str, FloatArray]:
    """What every rock shows in every campaign, by words, shape (DRAWS, _CAMPAIGNS, n_rocks)."""
    there = with_stations_at(case, places)
    names = [phrase("{} along the fall line", name) for name in there.station_names]
    lines = replace(rock_lines, control_lines=control_lines_of(there))
    chosen = [models[k % len(models)] for k in range(DRAWS)]
    made = [
        sample
        for k, model in enumerate(chosen)
        for sample in campaigns(
            there, lines, model,
            count=_CAMPAIGNS, seed=seed, number=_NUMBER + k, everywhere=True,
        )
    ]  # fmt: skip
    rows = [dict(_quantities(sample, names)) for sample in made]
    shape = DRAWS, _CAMPAIGNS, case.n_rocks
    return {what: np.stack([row[what] for row in rows]).reshape(shape) for what in rows[0]}


def _quantities(sample: Campaign, places: Sequence[str]) -> Iterator[tuple[str, FloatArray]]:
    """What each rock of one campaign shows, shape (n_rocks,); NaN where nothing."""
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
        yield "where rocks stop beside the fall line", per_rock(np.abs(lying.lateral_m), whole, n)
        # A rock without blocks of its own has none besides itself.
        more = np.bincount(lying.rock[(lying.rock >= 0) & (lying.kind != WHOLE)], minlength=n)
        yield "the number of pieces of each rock", more.astype(np.float64)
    if hit is not None:
        yield from _impacts(hit, n)


def _impacts(hit: ImpactRows, n: int) -> Iterator[tuple[str, FloatArray]]:
    with np.errstate(invalid="ignore", divide="ignore"):
        kept = np.clip(hit.vn_out / np.abs(hit.vn_in), 0.0, 3.0)
        slip = np.clip(hit.vt_out / hit.vt_in, 0.0, 3.0)
    off = np.abs(kept - np.nanmedian(kept)) if kept.size else kept
    yield "the rebound at impacts", per_rock(kept, hit.rock, n)
    yield "the scatter of the rebound at impacts", per_rock(off, hit.rock, n)
    yield "the speed along the ground before and after impacts", per_rock(slip, hit.rock, n)
    yield "the spin after impacts", per_rock(hit.spin_out, hit.rock, n)
    yield "the turn of the path at impacts", per_rock(np.abs(hit.turn_deg), hit.rock, n)


def _best(
    one: str,
    other: str,
    first: Mapping[str, FloatArray],
    second: Mapping[str, FloatArray],
    recorded: Mapping[str, int],
) -> Separation:
    """The measurement with the largest difference, counted on campaigns that did not choose it.

    What was recorded of so many rocks already has not told them apart.
    """
    half, sure = _CAMPAIGNS // 2, 0.0
    size = {w: _difference(first[w][:, :half], second[w][:, :half]) for w in first}
    new = [w for w in size if _rocks(size[w]) > recorded.get(w, 0)]
    if new:
        best = max(new, key=lambda w: abs(size[w]))
        sure = _difference(first[best][:, half:], second[best][:, half:])
        sure *= math.copysign(1.0, size[best])
    if sure < _LEAST_DIFFERENCE:
        return Separation(one, other, "", 0)
    return Separation(one, other, best, max(math.ceil(_rocks(sure)), _LEAST_ROCKS))


def _rocks(difference: float) -> float:
    """Rocks that a difference takes, in standard deviations of one."""
    return (_SURE / difference) ** 2 if difference else math.inf


def _difference(one: FloatArray, other: FloatArray) -> float:
    """Mean difference of a rock in two models over its scatter; less where few rocks show it.

    0 where the draws of the models differ by as much: more rocks do not help then.
    """
    seen = float(min(np.isfinite(one).mean(), np.isfinite(other).mean()))
    # Of each rock in each draw, shape (DRAWS, n_rocks).
    means = [mean_of_draws(np.moveaxis(v, 1, -1), least=1) for v in (one, other)]
    apart = mean_of_draws(means[0].T, least=1) - mean_of_draws(means[1].T, least=1)
    both = np.isfinite(apart)
    if both.sum() < _LEAST_ROCKS:
        return 0.0
    delta = float(apart[both].mean())
    common = math.hypot(*(float(_of_draws(m[:, both]).std(ddof=1)) for m in means))
    if abs(delta) < _LEAST_SURE * common:
        return 0.0
    off = [(v - m[:, None, :])[..., both].ravel() for v, m in zip((one, other), means, strict=True)]
    n = one.shape[1]
    scatter = math.sqrt(float(np.nanmean(np.concatenate(off) ** 2)) * n / max(n - 1, 1))
    return delta / scatter * math.sqrt(seen) if scatter > 0.0 else 0.0


def _of_draws(means: FloatArray) -> FloatArray:
    """Mean of each draw over the rocks that all draws have, shape (DRAWS,)."""
    whole = np.isfinite(means).all(axis=0)
    return means[:, whole].mean(axis=1) if whole.any() else np.zeros(len(means))
