"""How likely each cause is: by its fingerprints, and by what it closes of the gap.

Every cause is weighed alike: a few numbers say what its surest fingerprint counts, of those that no
contact can leave and of the others, and what its gain counts. They were fitted on sites of several
generators (``data/gap_thresholds.json``); each was judged by numbers that never saw it
(docs/studies/gap_weights.md). What a contact could leave, and a gain, may come from a law of the
contact that the base lacks: alone they make no cause more likely than none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import PRINTED
from sassgis.gap.diagnosis import CauseGain, Fingerprint
from sassgis.gap.which.hypotheses import NONE
from sassgis.gap.which.verdict import UNKNOWN
from sassgis.model.grid import FloatArray

#: Up to what z and the sureness of a gain count, and their unit. Below zero they count nothing:
#: many statistics are below their null where their cause is weak.
_MOST, _UNIT = 8.0, 4.0
#: Evidence for a cause, in the order of the weights.
FEATURES = ("clear", "usual", "gain", "share")


@dataclass(frozen=True, slots=True)
class CauseWeights:
    """What evidence counts."""

    weights: FloatArray  # shape (4,); of FEATURES
    offset: float  # by which no cause is more likely than "none" before any evidence
    #: Logarithm of the odds of an effect that these data cannot show, or that is not known, for
    #: each of the families that they cannot show and one more.
    unseen: float
    #: What a gap that the base leaves counts for such an effect, if it is significant and large.
    unsound: float
    farthest: float  # excess of the base that one site of a hundred exceeds (``CauseGain``)

    def logits(self, evidence: FloatArray, hidden: int, sound: bool) -> FloatArray:
        """Log odds against "none" of an effect that is not seen, and of each cause, shape (n + 1,).

        Parameters
        ----------
        evidence : float64, shape (n, 4)
            FEATURES of each cause.
        hidden : int
            Families that these data cannot show.
        sound : bool
            Whether the base leaves no gap that is significant and large.
        """
        other = self.unseen + math.log(hidden + 1) + self.unsound * (not sound)
        rows = evidence.reshape(-1, len(FEATURES))
        own = rows @ self.weights - self.offset
        return np.append(other, np.where(rows[:, 0] < _count(PRINTED), np.minimum(own, 0.0), own))

    def shares(
        self,
        prints: Sequence[Fingerprint],
        gains: Mapping[str, CauseGain],
        tried: Sequence[str],
        hidden: int = 0,
        sound: bool = True,
    ) -> dict[str, float]:
        """Probability of every cause that may be named, of "none" and of "unknown".

        Parameters
        ----------
        gains : mapping
            Those that could speak for their causes.
        tried : sequence of str
            Families that may be named.
        hidden, sound
            As for ``logits``.

        Returns
        -------
        dict
            Most likely first. "unknown": an effect that these data cannot show, or no known one.
        """
        evidence = np.array([evidence_of(name, prints, gains) for name in tried])
        p = softmax(np.append(0.0, self.logits(evidence, hidden, sound)))
        names = (NONE, UNKNOWN, *tried)
        return {names[k]: float(p[k]) for k in np.argsort(-p, kind="stable").tolist()}


def evidence_of(
    cause: str, prints: Sequence[Fingerprint], gains: Mapping[str, CauseGain]
) -> FloatArray:
    """FEATURES of a cause, shape (4,); what cannot be seen counts nothing.

    ``gains``: those that could speak for their causes.
    """
    clear = {own.name for own in CAUSES[cause].statistics if own.clear}
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
    return float(np.clip(z, 0.0, _MOST)) / _UNIT


def weights_of(content: Mapping[str, float]) -> CauseWeights:
    """Weights from the content of their file.

    Raises
    ------
    KeyError, TypeError, ValueError
        If it is none of weights.
    """
    return CauseWeights(
        np.array([float(content[name]) for name in FEATURES]),
        *(float(content[name]) for name in ("offset", "unseen", "unsound", "farthest")),
    )
