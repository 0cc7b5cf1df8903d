"""The classifier: what causes signatures speak for, learned on synthetic sites of known cause.

An ensemble of extremely randomised trees (Geurts, Ernst and Wehenkel 2006, Machine Learning 63)
for each design of a campaign, grown by ``docs/studies/gap_learning.py`` and frozen in a file. Here
the trees are only asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.observations.case import Case
from sassgis.model.grid import FloatArray, IntArray

#: Causes besides the families and NONE: an effect that is no family, and two families at once.
UNKNOWN, PAIR = "unknown", "pair"
DESIGNS = ("everything", "both", "stations", "stops")
#: Confidence from which on an answer is meant to be right nine times in ten.
SURE = 0.6
#: Share of its numbers below which a classifier is not used, and impacts too few to count.
LEAST_SEEN, FEWEST_IMPACTS = 0.3, 8
_FLOOR = 1e-3


@dataclass(frozen=True, slots=True)
class TreeEnsemble:
    """Binary trees in one table of nodes; a leaf is its own child.

    Attributes
    ----------
    root : int64, shape (n_trees,)
    number : int64, shape (n_nodes,)
        Column that a node asks for.
    limit : float32, shape (n_nodes,)
        Up to it the left branch is taken.
    left, right : int64, shape (n_nodes,)
    share : float32, shape (n_nodes, n_causes)
        Shares of the causes in the leaves; 0 elsewhere.
    """

    root: IntArray
    number: IntArray
    limit: NDArray[np.float32]
    left: IntArray
    right: IntArray
    share: NDArray[np.float32]

    def shares(self, x: NDArray[np.float32]) -> FloatArray:
        """Mean shares of the causes over the trees, shape (n_causes,), of one row of numbers."""
        at = self.root
        while True:
            below = np.where(x[self.number[at]] <= self.limit[at], self.left[at], self.right[at])
            if np.array_equal(below, at):
                break
            at = below
        mean: FloatArray = self.share[at].mean(axis=0).astype(np.float64)
        return mean


@dataclass(frozen=True, slots=True)
class Classifier:
    """What was learned for one design.

    Attributes
    ----------
    names : tuple of str
        Numbers of a signature that are looked at.
    causes : tuple of str
        NONE, families, UNKNOWN and PAIR.
    centre, scale : float32, shape (p,)
        A number that a signature lacks counts as its centre.
    trees : TreeEnsemble
    power : float
        Power to which shares are raised, and
    weight : float64, shape (n_causes,)
        what they are multiplied by, so that a probability is how often the cause is right.
    confidence_calibration : float
        By how much the logarithm of the odds must exceed that of SURE for a confidence of SURE.
    """

    names: tuple[str, ...]
    causes: tuple[str, ...]
    centre: NDArray[np.float32]
    scale: NDArray[np.float32]
    trees: TreeEnsemble
    power: float
    weight: FloatArray
    confidence_calibration: float = 0.0

    def standardised(self, signature: Mapping[str, float]) -> NDArray[np.float32]:
        """A signature as a row of numbers, shape (p,)."""
        values = np.array([signature.get(name, np.nan) for name in self.names], np.float32)
        return standardised(values, self.centre, self.scale)

    def seen(self, signature: Mapping[str, float]) -> float:
        """Share of the numbers looked at that a signature has."""
        return sum(name in signature for name in self.names) / len(self.names)

    def probabilities(
        self, signature: Mapping[str, float], excluded: Sequence[str] = ()
    ) -> dict[str, float]:
        """Probability of each cause, most probable first.

        Parameters
        ----------
        signature : mapping
            As ``signature.signature_of`` returns it.
        excluded : sequence of str
            Families that cannot be the cause, such as those that the model has already.
        """
        shares = calibrated(
            self.trees.shares(self.standardised(signature)), self.power, self.weight
        )
        kept = np.array([cause not in excluded for cause in self.causes])
        shares = np.where(kept, shares, 0.0)
        shares /= shares.sum()
        order = np.argsort(-shares, kind="stable")
        return {self.causes[k]: float(shares[k]) for k in order.tolist() if kept[k]}


def standardised(
    values: NDArray[np.float32], centre: NDArray[np.float32], scale: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Numbers as trees are asked for them, shape (..., p); a missing one is at its centre."""
    rows = np.where(np.isfinite(values), (values - centre) / scale, 0.0)
    return np.asarray(rows, np.float32)


def calibrated(shares: FloatArray, power: float, weight: FloatArray) -> FloatArray:
    """Shares of trees as probabilities, along the last axis."""
    raised = (shares + _FLOOR) ** power * weight
    out: FloatArray = raised / raised.sum(axis=-1, keepdims=True)
    return out


def cautious(probability: FloatArray | float, confidence_calibration: float) -> FloatArray:
    """Confidence that is stated for a probability.

    It is SURE where the logarithm of the odds exceeds that of SURE by
    ``confidence_calibration``, and straight
    below and above.

    Parameters
    ----------
    probability : float64
        0 to 1.
    confidence_calibration : float
        0: the confidence is the probability.
    """
    p = np.asarray(probability, np.float64)
    enough = 1.0 / (1.0 + (1.0 - SURE) / SURE * np.exp(-confidence_calibration))
    above = SURE + (1.0 - SURE) * (p - enough) / (1.0 - enough)
    out: FloatArray = np.where(p < enough, SURE * p / enough, above)
    return out


def designs_of(case: Case) -> tuple[str, ...]:
    """Designs by which a campaign may be classified, by the observed tables, best first."""
    seen = case.observations
    stations = len(seen.passages) > 0 and bool(case.station_names)
    stops = len(seen.deposits) > 0
    impacts = seen.rock_of("impacts")[~seen.is_piece("impacts")] if len(seen.impacts) else ()
    there = {
        "everything": int(np.sum(np.asarray(impacts) >= 0)) >= FEWEST_IMPACTS,
        "both": stations and stops,
        "stations": stations,
        "stops": stops,
    }
    return tuple(design for design in DESIGNS if there[design])


def no_idea(causes: Sequence[str]) -> dict[str, float]:
    """Probabilities where nothing speaks for anything."""
    return dict.fromkeys(causes, 1.0 / len(causes))
