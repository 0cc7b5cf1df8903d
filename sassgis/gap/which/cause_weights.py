"""How likely each cause is: by the z of its fingerprints, and by what it closes of the gap.

The fingerprints need no synthetic site. What they weigh against each other does: where stems stand,
stops are early as well. The weights (``data/gap_thresholds.json``) of a logistic regression were
fitted on sites of several laws of motion; each law was judged by weights that never saw it
(docs/studies/gap_weights.md). What a cause closes on rocks left out multiplies the odds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, softmax

from sassgis.gap.causes.all_causes import CAUSES, FAMILIES, STATISTICS
from sassgis.gap.diagnosis import Fingerprint
from sassgis.model.grid import FloatArray

#: What z counts for: against a cause up to the first, for it up to the second; its unit.
_LEAST, _MOST, _UNIT = -2.0, 8.0, 4.0
#: Share of a gap (standard deviation) that a cause closes, or opens, which does not act: its
#: parameters take up some of whatever the base lacks. No data set it; a site without an effect
#: keeps a third of its distance, and any cause may close that.
_FREEDOM = 1.0 / 3.0
#: No gain multiplies or divides odds by more.
_MOST_RATIO = 100.0


@dataclass(frozen=True, slots=True)
class CauseWeights:
    """Weights of fingerprints for causes.

    Attributes
    ----------
    causes : tuple of str
        Families, and "none": the base model, whatever the law of the contact.
    statistics : tuple of str
        Fingerprints, by their names.
    weights : float64, shape (n_causes, n_statistics)
    offset : float64, shape (n_causes,)
    sharpness : float
        Factor on the sum of the weights that makes the shares calibrated on laws that were left
        out.
    usual, spread : float64, shape (n_frozen,)
        Mean and standard deviation of what the fingerprints count on the sites, of those that the
        weights were fitted to: the first ones.
    farthest : float
        Distance from the usual that one site of a hundred exceeds.
    """

    causes: tuple[str, ...]
    statistics: tuple[str, ...]
    weights: FloatArray
    offset: FloatArray
    sharpness: float
    usual: FloatArray
    spread: FloatArray
    farthest: float

    def is_typical(self, prints: Sequence[Fingerprint]) -> bool:
        """Whether fingerprints are no farther from the usual than those of the sites."""
        z = z_of(prints, self.statistics[: self.usual.size])
        return distance(z, self.usual, self.spread) <= self.farthest

    def shares(self, prints: Sequence[Fingerprint], tried: Sequence[str]) -> dict[str, float]:
        """Probability of every cause that may be named and of "none", most likely first.

        Parameters
        ----------
        tried : sequence of str
            Families that may be named.
        """
        own = [i for i, name in enumerate(self.causes) if name == "none" or name in tried]
        logits = self.offset + self.weights @ counts_of(z_of(prints, self.statistics))
        p = softmax(self.sharpness * logits[own])
        return {self.causes[own[k]]: float(p[k]) for k in np.argsort(-p, kind="stable").tolist()}


def gain_ratio(gain: float, error: float, gap: float) -> float:
    """How many times likelier a gain is if the cause acts than if it does not.

    A cause that acts closes any share of the gap with the same chance; one that does not closes
    nothing in the mean. Both are seen with the error of the gain. Where next to no gap is left
    there is nothing to close, and the gain says nothing: the ratio is near 1.

    Parameters
    ----------
    gain, error : float
        What is closed of the distance on rocks left out, and its standard error.
    gap : float
        Distance without the cause, beyond what chance leaves.
    """
    if not (gap > 0.0 and error > 0.0 and math.isfinite(gain)):
        return 1.0
    # More than all of it is all of it, and chance.
    gain = min(gain, gap)
    acts = float(ndtr(gain / error) - ndtr((gain - gap) / error)) / gap
    sd = math.hypot(error, _FREEDOM * gap)
    none = math.exp(-0.5 * (gain / sd) ** 2) / (sd * math.sqrt(2.0 * math.pi))
    return min(max(acts / none, 1.0 / _MOST_RATIO), _MOST_RATIO)


def with_gains(shares: Mapping[str, float], ratios: Mapping[str, float]) -> dict[str, float]:
    """Probabilities by fingerprints and gains, most likely first; no ratio counts as 1."""
    odds = {name: p * ratios.get(name, 1.0) for name, p in shares.items()}
    total = sum(odds.values())
    return {n: odds[n] / total for n in sorted(odds, key=lambda n: -odds[n])}


def z_of(prints: Sequence[Fingerprint], statistics: Sequence[str]) -> FloatArray:
    """Z of each fingerprint; NaN where it cannot be seen."""
    z = {one.statistic: one.z for one in prints if one.observable}
    return np.array([z.get(name, np.nan) for name in statistics])


def distance(z: FloatArray, usual: FloatArray, spread: FloatArray) -> float:
    """Root mean square of the distances from the usual, in spreads, of the fingerprints seen."""
    seen = np.isfinite(z)
    if not seen.any():
        return 0.0
    return float(np.sqrt(np.mean(((counts_of(z) - usual)[seen] / spread[seen]) ** 2)))


def counts_of(z: FloatArray) -> FloatArray:
    """Z as it counts, limited on both sides; NaN counts nothing."""
    counts: FloatArray = np.nan_to_num(np.clip(z, _LEAST, _MOST)) / _UNIT
    return counts


def weights_of(content: Mapping[str, object]) -> CauseWeights:
    """Weights from the content of their file: of each cause, those that are not zero by name.

    A cause or a fingerprint that is not in the file weighs what it does before any site.

    Raises
    ------
    KeyError, TypeError, ValueError
        If it is none of weights.
    """
    rows: dict[str, dict[str, float]] = content["weights"]  # type: ignore[assignment]
    statistics: tuple[str, ...] = tuple(content["statistics"])  # type: ignore[arg-type]
    offset: dict[str, float] = content["offset"]  # type: ignore[assignment]
    usual: dict[str, float] = content["usual"]  # type: ignore[assignment]
    spread: dict[str, float] = content["spread"]  # type: ignore[assignment]
    found = {(e, s): float(own.get(s, 0.0)) for e, own in rows.items() for s in statistics}
    first = {(e, own.name): own.weight for e in FAMILIES for own in CAUSES[e].statistics}
    names = tuple(dict.fromkeys((*rows, *FAMILIES)))
    every = tuple(dict.fromkeys((*statistics, *STATISTICS)))
    return CauseWeights(
        names,
        every,
        np.array([[found.get((e, s), first.get((e, s), 0.0)) for s in every] for e in names]),
        np.array([float(offset.get(e, 0.0)) for e in names]),
        float(content["sharpness"]),  # type: ignore[arg-type]
        np.array([float(usual[name]) for name in statistics]),
        np.array([float(spread[name]) for name in statistics]),
        float(content["farthest"]),  # type: ignore[arg-type]
    )
