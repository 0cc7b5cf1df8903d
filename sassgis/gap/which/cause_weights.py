"""How likely each cause is: by its fingerprints, and by what it closes of the gap.

Every cause is weighed alike: a few numbers say what its surest fingerprint counts, of those that no
contact can leave and of the others, and what its gain counts. They were fitted on sites of several
generators (``data/gap_thresholds.json``); each was judged by numbers that never saw it
(docs/studies/gap_weights.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import CLEAR
from sassgis.gap.diagnosis import CauseGain, Fingerprint
from sassgis.model.grid import FloatArray

#: What z and the sureness of a gain count for: against a cause up to the first, for it up to the
#: second; the unit of both.
_LEAST, _MOST, _UNIT = -2.0, 8.0, 4.0
#: Evidence for a cause, in the order of the weights.
FEATURES = ("clear", "usual", "gain", "share")


@dataclass(frozen=True, slots=True)
class CauseWeights:
    """What evidence counts.

    Attributes
    ----------
    weights : float64, shape (4,)
        Of FEATURES.
    offset : float
        By which no cause is more likely than "none" before any evidence.
    farthest : float
        Excess of the base that one site of a hundred exceeds (``diagnosis.CauseGain``).
    """

    weights: FloatArray
    offset: float
    farthest: float

    def shares(
        self, prints: Sequence[Fingerprint], gains: Mapping[str, CauseGain], tried: Sequence[str]
    ) -> dict[str, float]:
        """Probability of every cause that may be named and of "none", most likely first.

        Parameters
        ----------
        tried : sequence of str
            Families that may be named.
        """
        evidence = [evidence_of(name, prints, gains) for name in tried]
        logits = np.array([0.0, *(own @ self.weights - self.offset for own in evidence)])
        p = softmax(logits)
        names = ("none", *tried)
        return {names[k]: float(p[k]) for k in np.argsort(-p, kind="stable").tolist()}


def evidence_of(
    cause: str, prints: Sequence[Fingerprint], gains: Mapping[str, CauseGain]
) -> FloatArray:
    """FEATURES of a cause, shape (4,); what cannot be seen counts nothing."""
    clear = {own.name for own in CAUSES[cause].statistics if own.weight >= CLEAR}
    own = {f.statistic: f.z for f in prints if f.effect == cause and f.observable}
    best = [
        max((_count(z) for name, z in own.items() if (name in clear) is kind), default=0.0)
        for kind in (True, False)
    ]
    gain = gains.get(cause)
    if gain is None or not CAUSES[cause].closes:
        return np.array([*best, 0.0, 0.0])
    return np.array([*best, _count(gain.sureness), gain.share])


def _count(z: float) -> float:
    return float(np.clip(z, _LEAST, _MOST)) / _UNIT


def weights_of(content: Mapping[str, float]) -> CauseWeights:
    """Weights from the content of their file.

    Raises
    ------
    KeyError, TypeError, ValueError
        If it is none of weights.
    """
    return CauseWeights(
        np.array([float(content[name]) for name in FEATURES]),
        float(content["offset"]),
        float(content["farthest"]),
    )
