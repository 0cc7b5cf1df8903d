"""Recommendation: where and how far the configured model is off, why, what to set."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.constants import GAP_ROCKS, GAP_SAMPLES, GROUND_WIDTHS, RELEVANT_GAPS
from sassgis.gap.diagnosis import Advice, GroundSetting, ModelGap, Range, Rung, Verdict
from sassgis.gap.fit.distances import bootstrap_rows, quantiles_of
from sassgis.gap.fit.hypothesis_fit import NONE, FittedHypothesis
from sassgis.gap.fit.site_data import Scale, SiteData
from sassgis.gap.observations.case import Case
from sassgis.gap.verdict.model_comparison import CONFIGURED, GROUND
from sassgis.gap.words import (
    LISTED,
    MOST_SURE,
    closed_percent,
    effect_name,
    effect_phrase,
    file_has,
    number_text,
    quantity_name,
    range_text,
)
from sassgis.grid import BoolArray, FloatArray, IntArray
from sassgis.settings.languages import Phrase, all_of, capital, counted, joined, named, phrase


def values_of(scale: Scale, rows: FloatArray, column: int) -> FloatArray:
    """Return a quantity in its unit from rows of rocks; NaN where a rock has none."""
    found = rows[..., column] * scale.scale[column] + scale.centre[column]
    if scale.names[column].partition(":")[2] in ("speed", "blocks"):
        found = np.exp(found)
    return np.where(rows[..., column + len(scale.names)] < 0.5, found, np.nan)


def model_gaps(
    problem: SiteData,
    rows: FloatArray,
    left: float = 0.0,
    *,
    observed_scale: float = 1.0,
    model_scale: float = 1.0,
) -> tuple[ModelGap, ...]:
    """Compute how far a model is off: run-out, energy or else speed, arrivals at stations.

    ``rows``: of rocks in the model, shape (m, n_rocks, p); ``left``: share of the rocks that leave
    the terrain in it, and may come farther; scales: speeds over the true ones, of the
    observations and of the rows.
    """
    names, scale = problem.scale.names, problem.scale
    mass = problem.case.mass_kg
    found: list[ModelGap] = []
    for column, name in enumerate(names):
        place, _, what = name.partition(":")
        if what not in ("runout", "speed"):
            continue
        seen, made = (values_of(scale, own, column) for own in (problem.rows, rows))
        quantity, unit = "runout_m", "m"
        if what == "speed":
            place = problem.case.station_names[int(place[1:])]
            quantity, unit = "speed_mps", "m/s"
            seen, made = seen / observed_scale, made / model_scale
            found.append(_arrivals(problem, place, column, np.isfinite(seen), np.isfinite(made)))
            if np.isfinite(mass[np.isfinite(seen)]).all():
                seen, made = 0.5e-3 * mass * seen**2, 0.5e-3 * mass * made**2
                quantity, unit = "energy_kj", "kJ"
        known = np.flatnonzero(np.isfinite(seen) & np.isfinite(made).any(axis=0))
        if known.size < GAP_ROCKS:
            continue
        rng = np.random.default_rng([problem.seed, 57, column])
        compared = _compared(seen[known], made[:, known], problem.unit[known], rng)
        least = RELEVANT_GAPS[quantity]
        for statistic in compared if what == "runout" else ("median", "90 %"):
            observed, predicted, (low, high) = compared[statistic]
            side = "unsafe" if low > 0.0 else "safe" if high < 0.0 else ""
            if what == "runout" and side == "unsafe" and _reaches_beyond(statistic, compared, left):
                side = ""
            limit = least * (compared["90 %"][0] if statistic == "width" else observed)
            found.append(
                ModelGap(
                    place=place, quantity=quantity, statistic=statistic, unit=unit,
                    observed=observed, predicted=predicted, gap=observed - predicted,
                    ci95=(low, high), limit=abs(limit), rocks=known.size, side=side,
                )
            )  # fmt: skip
    case = problem.case
    down = {case.station_names[k]: place for place, k in enumerate(case.station_order.tolist())}
    # Run-out first, then stations down the slope, arrivals last.
    return tuple(sorted(found, key=lambda g: (g.quantity == "arrived", down.get(g.place, -1))))


def _arrivals(
    problem: SiteData, place: str, column: int, seen: BoolArray, made: BoolArray
) -> ModelGap:
    """Compute the surplus of rocks seen at a station over the model's (%); fewer say nothing."""
    more = 100.0 * (seen - made.mean(axis=0))
    rng = np.random.default_rng([problem.seed, 58, column])
    low, high = _interval(lambda rows: more[rows].mean(), problem.unit, rng).tolist()
    # Where all rocks were seen, samples of them are all alike: the model has scatter all the same.
    half = 196.0 * math.sqrt(float(made.var(axis=0, ddof=1).sum())) / seen.size
    low, high = min(low, float(more.mean()) - half), max(high, float(more.mean()) + half)
    return ModelGap(
        place=place, quantity="arrived", statistic="mean", unit="%",
        observed=100.0 * float(seen.mean()), predicted=100.0 * float(made.mean()),
        gap=float(more.mean()), ci95=(low, high), limit=100.0 * RELEVANT_GAPS["arrived"],
        rocks=seen.size, side="unsafe" if low > 0.0 else "",
    )  # fmt: skip


def _reaches_beyond(
    statistic: str, compared: Mapping[str, tuple[float, float, Range]], left: float
) -> bool:
    """Return whether a run-out is unknown (rocks left the terrain), or too narrow but farther."""
    if statistic == "width" and compared["90 %"][2][1] < 0.0:
        return True
    return left > (0.5 if statistic == "median" else 0.1)


def _compared(
    seen: FloatArray, made: FloatArray, group: IntArray, rng: np.random.Generator
) -> dict[str, tuple[float, float, Range]]:
    """Compare observed and predicted median, 90 % quantile and width, with intervals."""

    def statistics(values: FloatArray) -> FloatArray:
        low, middle, high = quantiles_of(values[np.isfinite(values)], (0.1, 0.5, 0.9))
        return np.array([middle, high, high - low])

    observed, predicted = statistics(seen), statistics(made)
    drawn = _interval(lambda rows: statistics(seen[rows]) - statistics(made[:, rows]), group, rng)
    each = zip(observed.tolist(), predicted.tolist(), map(tuple, drawn.T.tolist()), strict=True)
    return dict(zip(("median", "90 %", "width"), each, strict=True))


def _interval(
    statistic: Callable[[IntArray], Any], group: IntArray, rng: np.random.Generator
) -> FloatArray:
    """Return 95 % limits of a statistic of rows, groups drawn anew, (2, ...); NaN of one group."""
    if np.unique(group).size == 1:
        return np.full((2, *np.shape(statistic(np.arange(group.size)))), np.nan)
    samples = [statistic(rows) for rows in bootstrap_rows(group, GAP_SAMPLES, rng)]
    return np.asarray(np.quantile(samples, (0.025, 0.975), axis=0))


def worst_of(gaps: Sequence[ModelGap]) -> ModelGap | None:
    """Return the most certain relevant gap, unsafe before safe; else the first."""

    def sureness(gap: ModelGap) -> float:
        return abs(gap.gap) / max(gap.ci95[1] - gap.ci95[0], 1e-9)

    for side in ("unsafe", "safe"):
        own = [gap for gap in gaps if gap.counts and gap.side == side]
        if own:
            return max(own, key=sureness)
    return next(iter(gaps), None)


def shortfall(gaps: Sequence[ModelGap]) -> ModelGap | None:
    """Return the most certain gap by which a model falls far short; None if it does not."""
    return worst_of([gap for gap in gaps if gap.far_short])


def settings_of(
    case: Case, fit: FittedHypothesis, intervals: Mapping[str, Range]
) -> tuple[GroundSetting, ...]:
    """Return the ground of a model that is handed over, with intervals."""
    before, found = {c.name: c for c in case.table.classes}, []
    for label, value in fit.handed_over.draw.parameters.items():
        ground, _, name = label.rpartition(".")
        if ground in before:
            configured, identified = float(getattr(before[ground], name)), label in fit.identified
            found.append(
                GroundSetting(ground, name, configured, value, intervals[label], identified)
            )
    return tuple(found)


def wrong_ground(case: Case, intervals: Mapping[str, Range]) -> tuple[str, ...]:
    """Return classes of which a parameter of the base with a free contact is certainly unusual."""
    found = []
    for label, (low, high) in intervals.items():
        ground, _, name = label.rpartition(".")
        if ground in case.met and name in GROUND_WIDTHS:
            value = float(getattr(case.table.classes[case.table.index(ground)], name))
            width = GROUND_WIDTHS[name] * case.ground_range
            if low > value + width or high < value - width:
                found.append(ground)
    return tuple(dict.fromkeys(found))


# ---------------------------------------------------------------------------------------------
# In words


def first_sentence(advice: Advice, ladder: Sequence[Rung], verdict: Verdict) -> Phrase:
    """State where the configured model errs, why, how far, to which side, and what to set."""
    gap = advice.configured
    because = [_cause(verdict, advice), *([] if advice.short else _shrinks(advice, ladder))]
    clauses = [text for text in because if text]
    if gap is None:
        text = "No stops and no speeds were observed. The error of the model is unknown."
        return joined(" ", (phrase(text), *(phrase("{}.", capital(own)) for own in clauses)))
    if gap.counts:
        said = [capital(phrase("{}.", joined("; ", (_off_by(gap, advice.compared), *clauses))))]
    else:
        said = [_no_difference(gap, advice), *(phrase("{}.", capital(own)) for own in clauses)]
    mentioned = [gap]
    far = _far_safe(advice.compared)
    if far is not None and gap.side == "unsafe":
        said.append(phrase("Also: {}.", _off_by(far, advice.compared)))
        mentioned.append(far)
    if advice.wrong_ground:
        names = all_of(map(named, advice.wrong_ground))
        one = "No usual values of the ground class {} fit."
        more = "No usual values of the ground classes {} fit."
        said.append(counted(len(advice.wrong_ground), one, more, names))
    said += _to_run(advice, ladder)
    if advice.short is None:
        said += _remains(advice, mentioned, verdict)
    return joined(" ", said)


def _cause(verdict: Verdict, advice: Advice) -> Phrase:
    """Return the cause that is named, else the most probable ones; empty where none is missing."""
    if verdict.named:
        text = "most likely because of {} ({} %)"
        if not {*verdict.effect.split("+")} <= {*advice.recommended.split("+")}:
            # An effect that does not certainly close the gap does not explain it.
            text = "the observations show {} ({} %)"
        return phrase(text, effect_phrase(verdict.effect), f"{100.0 * verdict.confidence:.0f}")
    if verdict.effect == NONE or not verdict.ranked:
        return phrase("")
    first, *others = (
        phrase("{} ({} %)", effect_name(name), f"{100.0 * min(p, MOST_SURE):.0f}")
        for name, p in verdict.ranked.items()
        if p >= LISTED
    )
    if not others:
        return phrase("no cause is certain: most likely {}", first)
    return phrase("no cause is certain: most likely {}, then {}", first, others[0])


def _shrinks(advice: Advice, ladder: Sequence[Rung]) -> list[Phrase]:
    """Return what the recommended model closes of the gap; nothing where that may be chance."""
    closed = _shares(ladder)
    share = closed.get(advice.recommended)
    if share is None:
        return []
    said = phrase(
        "with {} the gap over all quantities shrinks by {} on held-out rocks",
        file_has(advice.recommended),
        share,
    )
    if advice.recommended == GROUND or GROUND not in closed:
        return [said]
    return [phrase("{}, with calibrated ground by {}", said, closed[GROUND])]


def _remains(advice: Advice, mentioned: Sequence[ModelGap], verdict: Verdict) -> list[Phrase]:
    """Return the gaps that the recommended model leaves, except those stated already."""
    unsafe = worst_of([own for own in advice.left if own.counts and own.side == "unsafe"])
    both = (unsafe, _far_safe(advice.left))
    left = [_off_by(own, advice.left) for own in both if own not in (None, *mentioned) and own]
    if left:
        texts = ("After calibration: {}.", "Also: {}.")
        return [phrase(text, own) for text, own in zip(texts, left, strict=False)]
    # Of calibration that suffices the verdict states it.
    changed = advice.recommended != CONFIGURED and bool(advice.left)
    if changed and verdict.effect != NONE and not any(own.counts for own in advice.left):
        return [phrase("After calibration no relevant difference remains.")]
    return []


def _far_safe(gaps: Sequence[ModelGap]) -> ModelGap | None:
    """Return the most certain gap that is far on the safe side."""
    return worst_of([own for own in gaps if own.side == "safe" and own.is_far])


def _shares(ladder: Sequence[Rung]) -> dict[str, Phrase]:
    """Return the closed share of the gap by model, if its interval is above zero."""
    return {
        r.rung: _closed(r)
        for r in ladder
        if r.share is not None and (r.ci95 is None or r.ci95[0] > 0.0)
    }


def _to_run(advice: Advice, ladder: Sequence[Rung]) -> list[Phrase]:
    """State the recommendation, and why no further model is recommended."""
    why = [phrase("{}.", capital(advice.why))] if advice.why else []
    if advice.recommended == CONFIGURED:
        if advice.short is not None:
            return [phrase("No tested model is recommended."), *why]
        return [phrase("Keep the configured ground."), *why]
    name = file_has(advice.recommended)
    if advice.short is not None:
        said = phrase(
            "No tested model is recommended. The nearest one is {} (model/config.toml); with it, "
            "{}.",
            name,
            _off_by(advice.short, advice.left),
        )
        share = _shares(ladder).get(advice.recommended)
        on_rocks = phrase("On held-out rocks, it closes {} of the gap over all quantities.", share)
        return [said, *([on_rocks] if share else []), *why]
    if advice.recommended == GROUND:
        return [*_what_to_set(advice), *why]
    apart = [n for n in advice.recommended.split("+") if n in CAUSES and CAUSES[n].of_data]
    if apart:
        text = "{} concerns the data, so the file does not contain it."
        why = [phrase(text, capital(effect_name("+".join(apart)))), *why]
    return [phrase("Run model/config.toml (with {}).", name), *why]


def _closed(rung: Rung) -> Phrase:
    share = f"{closed_percent(rung.share or 0.0):.0f}"
    if rung.ci95 is None:
        return phrase("{} %", share)
    low, high = (f"{closed_percent(v):.0f}".replace("-", "\u2212") for v in rung.ci95)
    return phrase("{} % (95 %: {} to {} %)", share, low, high)


#: Words for gaps on the unsafe side and on the safe side, after the place.
_OFF: Mapping[str, tuple[str, ...]] = {
    "width": (
        "{} simulated stops scatter {} % too little",
        "{} simulated stops scatter {} % too much",
    ),
    "runout_m": (
        "{} simulated blocks stop {} % too early",
        "{} simulated blocks stop {} % too far",
    ),
    "energy_kj": (
        "{} simulated energies are {} % too low",
        "{} simulated energies are {} % too high",
    ),
    "speed_mps": (
        "{} simulated blocks are {} % too slow",
        "{} simulated blocks are {} % too fast",
    ),
    "arrived": ("{} {} % of all simulated blocks stop too early",),
}


def _off_by(gap: ModelGap, gaps: Sequence[ModelGap]) -> Phrase:
    """Return place, relative size and side of a gap among others, its size and interval."""
    low, high = sorted(abs(v) for v in gap.ci95)
    kind = "width" if gap.statistic == "width" else gap.quantity
    size, unit = abs(gap.gap), gap.unit
    percent = size if kind == "arrived" else 100.0 * size / max(abs(gap.observed), 1e-9)
    off = phrase(_OFF[kind][gap.side == "safe"], _place(gap, gaps), f"{percent:.0f}")
    if kind == "arrived":
        size_of = phrase("95 % interval {} %", range_text(low, high))
    else:
        what = phrase("10 % to 90 % quantile")
        if kind != "width":
            what = phrase("median" if gap.statistic == "median" else "90 % quantile")
        if gap.place != "stop":
            what = phrase("{} at {}", what, gap.place)
        size_of = phrase(
            "{} differs by {} {}, 95 % interval {} {}",
            what, number_text(size), unit, range_text(low, high), unit,
        )  # fmt: skip
    if gap.side == "safe":
        return phrase("{}, on the safe side ({})", off, size_of)
    return phrase("{}, on the unsafe side ({})", off, size_of)


def _place(gap: ModelGap, gaps: Sequence[ModelGap]) -> Phrase:
    """Return where a gap lies: at the stations around it that are off alike, one after another."""
    if gap.place == "stop":
        return phrase("in the run-out")
    if gap.quantity == "arrived":
        return phrase("before {}", gap.place)
    along = [g for g in gaps if (g.quantity, g.statistic) == (gap.quantity, gap.statistic)]
    alike = [g == gap or (g.counts and g.side == gap.side) for g in along]
    first = last = along.index(gap)
    while first > 0 and alike[first - 1]:
        first -= 1
    while last + 1 < len(along) and alike[last + 1]:
        last += 1
    if first == last:
        return phrase("at {}", gap.place)
    ends = along[first].place, along[last].place
    # Nothing above the uppermost station says where the gap begins.
    return phrase("from {} to {}" if first else "at {} already, and down to {},", *ends)


def _no_difference(gap: ModelGap, advice: Advice) -> Phrase:
    """State that the configured model is not significantly off."""
    compared = dict.fromkeys(
        phrase("median, 90 % and width of run-out")
        if g.quantity == "runout_m"
        else quantity_name(g.quantity)
        if g.quantity == "arrived"
        else phrase("median and 90 % {} at stations", quantity_name(g.quantity))
        for g in advice.compared
    )
    return phrase(
        "Configured model: no significant difference from {} rocks in {}. Observed minus "
        "predicted ({} {}): {} {} (95 %: {} {}).",
        gap.rocks, all_of(compared), phrase(gap.statistic), quantity_name(gap.quantity),
        number_text(gap.gap), gap.unit, range_text(*gap.ci95), gap.unit,
    )  # fmt: skip


def _what_to_set(advice: Advice) -> list[Phrase]:
    by_class: dict[str, list[Phrase]] = {}
    for s in advice.settings:
        if s.identified and s.value != s.before:
            by_class.setdefault(s.ground, []).append(
                phrase("{} {} ({})", s.parameter, number_text(s.value), range_text(*s.ci95))
            )
    if not by_class:
        return [
            phrase(
                "Set the ground as in model/ground_classes.csv. These data do not identify its "
                "parameters one by one."
            )
        ]
    known = {f"{s.ground}.{s.parameter}" for s in advice.settings if s.identified}
    said = [phrase("Set {}: {}.", name, joined(", ", values)) for name, values in by_class.items()]
    said += [
        phrase("{} and {} compensate each other. Change them together.", one, other)
        for one, other, _ in advice.trade_offs
        if {one, other} <= known
    ][:1]
    return said
