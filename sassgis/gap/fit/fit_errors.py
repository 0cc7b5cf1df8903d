"""Errors of a calibrated model, and checks of calibrated values."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.causes.cause import HARD
from sassgis.gap.constants import COMPARED_QUANTILES, ERROR_SAMPLES, FAR_DEVIATIONS
from sassgis.gap.fit.distances import (
    Interval,
    bootstrap_interval,
    energy_scores,
    mean_interval,
    quantiles_of,
)
from sassgis.gap.fit.parameters import Fitted
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.residuals.rock_residuals import mean_of_draws
from sassgis.grid import FloatArray
from sassgis.settings.languages import phrase


@dataclass(frozen=True, slots=True)
class QuantityErrors:
    """Observed and simulated rocks in one quantity."""

    name: str  # "run-out", "lateral offset", or a quantity at a station
    unit: str
    rocks: int
    observed: tuple[float, ...]  # quantiles at SHARES
    quantiles: Mapping[str, tuple[float, ...]]  # simulated "before", "after" and "left out"
    crps: Mapping[str, float]  # continuous ranked probability score, mean over the rocks (unit)
    #: Simulated over observed median, less 1 (of the lateral offset: of its 10 to 90 % width);
    #: intervals by drawing the observed rocks anew.
    median_error: Mapping[str, Interval]
    gain: Interval  # CRPS before less that of rocks left out


@dataclass(frozen=True, slots=True)
class TableScore:
    """Scores of one table of observations in the calibration."""

    table: str
    rocks: int  # with anything in it that is scored
    score: Mapping[str, float]  # energy score, mean over these: "before", "after", "left out"
    gain: Interval  # score before less that of rocks left out, as a share of the score before


def table_scores(
    site: SiteData, models: Mapping[str, Mapping[str, FloatArray]]
) -> tuple[TableScore, ...]:
    """Return scores by table of the models before, after, left out, shape (n_rocks,) each."""
    found = []
    for table in models["before"]:
        own = {name: np.nan_to_num(scores[table]) for name, scores in models.items()}
        known = own["before"] != 0.0
        gain = paired_gain(site.per_unit(own["before"]), site.per_unit(own["left out"]))
        means = {name: float(v[known].mean()) if known.any() else 0.0 for name, v in own.items()}
        found.append(TableScore(table, int(known.sum()), means, gain))
    return tuple(found)


def paired_gain(before: FloatArray, left_out: FloatArray) -> Interval:
    """Return the mean paired difference over the mean before; units without scores do not count."""
    known = (before != 0.0) | (left_out != 0.0)
    whole = float(before[known].mean()) if known.any() else float("nan")
    return mean_interval((before - left_out)[known] / whole)


#: Name and unit of the compared quantities.
QUANTITIES = {
    "runout": ("run-out", "m"),
    "aside": ("lateral offset", "m"),
    "speed": ("speed", "m/s"),
    "rotation": ("rotation", "1/s"),
    "height": ("passing height", "m"),
    "blocks": ("stopped blocks", ""),
    "contacts": ("number of contacts", ""),
    "fastest_second": ("greatest speed over a second", "m/s"),
    "between_contacts": ("time between contacts", "s"),
    "hop_length_90": ("length of hops, 90 %", "m"),
    "hop_height_90": ("height of hops, 90 %", "m"),
    "rim_ratio": ("ratio of surface speed to speed", ""),
    "along": ("ratio of the tangential speed after impacts to the speed before", ""),
    "normal": ("ratio of the normal speed after impacts to the speed before", ""),
    "turning": ("ratio of the surface speed after impacts to the speed before", ""),
    "energy": ("ratio of the energy after impacts to that before", ""),
}


def quantity_errors(
    site: SiteData, models: Mapping[str, Mapping[str, FloatArray]], seed: int
) -> tuple[QuantityErrors, ...]:
    """Return errors of replicas before, after and left out: by quantity, (count, n_rocks) each."""
    found = []
    for name in site.quantities:
        place, _, what = name.partition(":")
        title, unit = QUANTITIES[what]
        if place.startswith("S"):
            station = site.case.station_names[int(place[1:])]
            title = phrase("{} at {}", phrase(title), station)
        # Speeds are scored by their logarithm.
        natural = np.exp if what == "speed" else np.asarray
        seen = natural(site.quantities[name])
        made = {k: natural(v[name]) for k, v in models.items()}
        rng = np.random.default_rng([seed, 61])
        found.append(_errors(title, unit, what == "aside", seen, made, rng))
    return tuple(found)


def _errors(
    title: str,
    unit: str,
    width: bool,
    seen: FloatArray,
    made: Mapping[str, FloatArray],
    rng: np.random.Generator,
) -> QuantityErrors:
    rocks = np.flatnonzero(np.isfinite(seen))
    own, drawn = seen[rocks], {k: v[:, rocks] for k, v in made.items()}
    # NaN where fewer than two of the replicas of a rock have the quantity.
    scores = {k: energy_scores(own[:, None], v[:, :, None]) for k, v in drawn.items()}
    finite = {k: v[np.isfinite(v)] for k, v in drawn.items()}

    def centre(values: FloatArray) -> float:
        low, middle, high = quantiles_of(values, COMPARED_QUANTILES)
        return float(high - low if width else middle)

    inverse = bootstrap_interval(
        lambda i: 1.0 / max(centre(own[i]), 1e-9),
        np.arange(own.size), draws=ERROR_SAMPLES, rng=rng, method="percentile",
    )  # fmt: skip

    def error(simulated: float) -> Interval:
        limits = (inverse.value, inverse.low, inverse.high)
        return Interval(*(simulated * one - 1.0 for one in limits))

    def quantiles(values: FloatArray) -> tuple[float, ...]:
        return tuple(quantiles_of(values, COMPARED_QUANTILES).tolist())

    gain = scores["before"] - scores["left out"]
    return QuantityErrors(
        name=title, unit=unit, rocks=rocks.size, observed=quantiles(own),
        quantiles={k: quantiles(v) for k, v in finite.items()},
        crps={k: float(mean_of_draws(v, least=1)) for k, v in scores.items()},
        median_error={k: error(centre(v)) for k, v in finite.items()},
        gain=mean_interval(gain[np.isfinite(gain)]),
    )  # fmt: skip


#: Built-in classes from hard to soft: ground on which nothing yields, loose blocks, soil.
HARDNESS = (HARD, ("talus", "debris"), ("overgrown_slope", "forest_soil", "soft_meadow"))
#: Harder ground has at least as much (1) or at most as much (-1) of these; the message if not.
_ORDER = {
    "restitution": (1, "{} is harder than {} but has less restitution ({}, {})"),
    "mu_0": (-1, "{} is harder than {} but has more rolling friction ({}, {})"),
}
#: Values at a limit of the search.
_AT_LIMIT = {
    "low": "{} is at the low limit of the search ({}). The model may lack an effect.",
    "high": "{} is at the high limit of the search ({}). The model may lack an effect.",
}


@dataclass(frozen=True, slots=True)
class CalibrationFinding:
    """Something about calibrated values that speaks against them, or for a fault elsewhere."""

    kind: str  # "limit", "order", "far" or "gain"
    parameters: tuple[str, ...]  # labels
    text: str


def findings_of(
    fitted: Sequence[Fitted], gains: Mapping[str, Interval]
) -> tuple[CalibrationFinding, ...]:
    """Return values at a limit, against the order of the ground, far off; gains by chance."""
    text = "{}: {}; the gain may be chance."
    small = [
        CalibrationFinding("gain", (), phrase(text, site, gain_text(gain)))
        for site, gain in gains.items()
        if not gain.low > 0.0
    ]
    limits = [
        CalibrationFinding(
            "limit", (f.parameter.label,),
            phrase(_AT_LIMIT[f.limit], f.parameter.label, f"{f.value:.3g}"),
        )
        for f in fitted
        if f.limit
    ]  # fmt: skip
    return (*limits, *_against_order(fitted), *_far(fitted), *small)


def gain_text(gain: Interval) -> str:
    """Return a gain of score in words."""
    ends = (gain.value, gain.low, gain.high)
    text = "on held-out rocks the fitted classes improve the score by {} % ({} to {})"
    return phrase(text, *(f"{100.0 * v:.1f}".replace("-", "−") for v in ends))


def _against_order(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    rank = {name: k for k, names in enumerate(HARDNESS) for name in names}
    found = []
    for one, other in itertools.permutations(fitted, 2):
        names = one.parameter.class_name, other.parameter.class_name
        same = one.parameter.name == other.parameter.name
        if not same or one.parameter.name not in _ORDER or not set(names) <= set(rank):
            continue
        sign, text = _ORDER[one.parameter.name]
        if rank[names[0]] >= rank[names[1]] or sign * (one.value - other.value) >= 0.0:
            continue
        before = sign * (one.parameter.configured - other.parameter.configured) < 0.0
        said = phrase(text, *names, f"{one.value:.3g}", f"{other.value:.3g}")
        said = phrase(
            "{}, as in the configuration." if before else "{}, unlike in the configuration.", said
        )
        labels = one.parameter.label, other.parameter.label
        found.append(CalibrationFinding("order", labels, said))
    return found


def _far(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    found = []
    text = (
        "{} {} lies {} standard deviations (between sites) from the configured {}. Check the "
        "ground class on the site."
    )
    for f in fitted:
        apart = abs(f.share - f.parameter.start) / f.parameter.sd
        if apart > FAR_DEVIATIONS:
            label, configured = f.parameter.label, f"{f.parameter.configured:.3g}"
            said = phrase(text, label, f"{f.value:.3g}", f"{apart:.1f}", configured)
            found.append(CalibrationFinding("far", (label,), said))
    return found
