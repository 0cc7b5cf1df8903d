"""Which cause: campaigns of every contender teach a classifier, which is then asked of the field.

Approximate Bayesian choice between models by supervised classification (Pudlo et al. 2016,
Bioinformatics 32): the campaigns are draws from each contender, the classifier learns the
probability of each contender given what a campaign shows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from sklearn.linear_model import LogisticRegression

from sassgis.core.grid import FloatArray, IntArray
from sassgis.gap.contenders import NONE
from sassgis.gap.library import Bench, Library

#: Numbers beyond this many units count by their logarithm: what is far off is far off.
_FAR = 3.0
_FOLDS = 4


@dataclass(frozen=True, slots=True)
class Thresholds:
    """What was chosen on worlds of development and is frozen for all that is reported.

    Attributes
    ----------
    discrepancy : mapping of kind of number to float
        How far models that differ only in how they are computed lie apart in each kind of number,
        in units of its scatter among campaigns of the base model.
    discrepancy_else : float
        For kinds that are not listed.
    penalty : float
        Strength of the classifier's penalty.
    null_quantile : float
        An effect is named only where the evidence against the base exceeds this quantile of what
        campaigns of the base show.
    null_margin : float
        And by how much at least (logarithm of odds).
    least_confidence : float
        Below, the answer is "unknown".
    least_shrinkage : float
        Where the upper limit of its shrinkage is below, the effect does not explain the gap:
        "unknown".
    sharpness : float
        Power to which probabilities are raised, so that a confidence is how often it is right.
    confusion_mass : float
        Probability that a confusion set holds.
    pair_gain : float
        Gain of score by which a pair must beat the single effect, in standard errors.
    """

    discrepancy: Mapping[str, float] = field(default_factory=dict)
    discrepancy_else: float = 1.0
    penalty: float = 0.02
    null_quantile: float = 0.975
    null_margin: float = 0.0
    least_confidence: float = 0.35
    least_shrinkage: float = 0.0
    sharpness: float = 1.0
    confusion_mass: float = 0.95
    pair_gain: float = 3.0


def kind_of(feature: str) -> str:
    """Kind of a number: its name without station, leg or ground."""
    name = re.sub(r"\bS\d+:", "S:", feature)
    name = re.sub(r"^leg\d+:", "leg:", name)
    name = re.sub(r"^hit\d+:", "hit_leg:", name)
    return re.sub(r"^hit@[^:]*:", "hit_ground:", name)


@dataclass(frozen=True, slots=True)
class Problem:
    """Campaigns as a matrix in units in which they are compared.

    Attributes
    ----------
    names : tuple of str
        Numbers that the observed campaign has too.
    x : float64, shape (n, p)
    label : str, shape (n,)
    group : int64, shape (n,)
        Draw of each campaign: those of one draw stay together.
    observed : float64, shape (p,)
    """

    names: tuple[str, ...]
    x: FloatArray
    label: np.ndarray[tuple[int], np.dtype[np.str_]]
    group: IntArray
    observed: FloatArray


def problem_of(
    bench: Bench,
    library: Library,
    thresholds: Thresholds,
    keep: Sequence[str] | None = None,
) -> Problem:
    """Put campaigns and observation on one scale.

    The unit of each number is its scatter among campaigns of the base model and the discrepancy of
    its kind together; the same discrepancy is added to the campaigns as noise.

    Parameters
    ----------
    bench : Bench
    library : Library
    thresholds : Thresholds
    keep : sequence of str, optional
        Prefixes of the numbers to use; default: all.
    """
    names = [
        name
        for name, value in bench.features.items()
        if np.isfinite(value) and (keep is None or name.startswith(tuple(keep)))
    ]
    rows, label, group = [], [], []
    for i, tried in enumerate(library.tried):
        for features in tried.features:
            rows.append([features.get(name, np.nan) for name in names])
            label.append(tried.draw.effect)
            group.append(i)
    x = np.array(rows, np.float64)
    observed = np.array([bench.features[name] for name in names])
    labels = np.array(label, np.str_)
    x, observed, used = _in_units(x, observed, labels, names, thresholds, bench.seed)
    return Problem(tuple(names[k] for k in used), x, labels, np.array(group, np.int64), observed)


def _in_units(
    x: FloatArray,
    observed: FloatArray,
    labels: np.ndarray[tuple[int], np.dtype[np.str_]],
    names: Sequence[str],
    thresholds: Thresholds,
    seed: int,
) -> tuple[FloatArray, FloatArray, IntArray]:
    known = np.isfinite(x)
    used = np.flatnonzero(known.mean(axis=0) > 0.6)
    x, observed, known = x[:, used], observed[used], known[:, used]
    base = labels == NONE
    middle = np.array(
        [
            np.median(c[k & base] if (k & base).any() else c[k])
            for c, k in zip(x.T, known.T, strict=True)
        ]
    )
    x = np.where(known, x, middle) - middle
    own = x[base].std(axis=0)
    # A number that never varies in the base model, such as one of pieces, gets a unit from all.
    own = np.maximum(own, 0.1 * x.std(axis=0))
    varies = own > 1e-9
    used, x, own = used[varies], x[:, varies] / own[varies], own[varies]
    seen = (observed[varies] - middle[varies]) / own
    off = np.array(
        [
            thresholds.discrepancy.get(kind_of(names[k]), thresholds.discrepancy_else)
            for k in used.tolist()
        ]
    )
    unit = np.sqrt(1.0 + off**2)
    noise = np.random.default_rng([seed, 61]).standard_normal(x.shape) * off
    return _bounded((x + noise) / unit), _bounded(seen / unit), used


def _bounded(z: FloatArray) -> FloatArray:
    size = np.abs(z)
    bounded: FloatArray = np.sign(z) * np.where(
        size < _FAR, size, _FAR + np.log1p(np.maximum(size - _FAR, 0.0))
    )
    return bounded


@dataclass(frozen=True, slots=True)
class Odds:
    """What the classifier says.

    Attributes
    ----------
    effects : tuple of str
    probability : float64, shape (n_effects,)
        Of the observed campaign.
    held_out : float64, shape (n, n_effects)
        Of every campaign, by a classifier that has not seen its draw.
    label : str, shape (n,)
    evidence : float
        Logarithm of the odds against the base model.
    evidence_of_base : float64
        The same of held-out campaigns of the base model.
    """

    effects: tuple[str, ...]
    probability: FloatArray
    held_out: FloatArray
    label: np.ndarray[tuple[int], np.dtype[np.str_]]
    evidence: float
    evidence_of_base: FloatArray


def odds_of(problem: Problem, thresholds: Thresholds, seed: int) -> Odds:
    """Teach the classifier and ask it."""
    classes = tuple(sorted(set(problem.label.tolist())))
    held_out = held_out_odds(problem, thresholds, seed)
    model = _taught(problem.x, problem.label, thresholds)
    probability = _sharpened(model.predict_proba(problem.observed[None])[0], thresholds)
    none = classes.index(NONE)

    def evidence(p: FloatArray) -> FloatArray:
        own = np.clip(p[..., none], 1e-9, 1.0 - 1e-9)
        logs: FloatArray = np.log((1.0 - own) / own)
        return logs

    return Odds(
        classes,
        probability,
        held_out,
        problem.label,
        float(evidence(probability)),
        evidence(held_out[problem.label == NONE]),
    )


def held_out_odds(problem: Problem, thresholds: Thresholds, seed: int) -> FloatArray:
    """Probabilities of every campaign by classifiers that have not seen its draw."""
    draws = np.unique(problem.group)
    part = np.random.default_rng([seed, 71]).permutation(draws.size) % _FOLDS
    own = part[np.searchsorted(draws, problem.group)]
    classes = np.unique(problem.label)
    found = np.zeros((problem.label.size, classes.size))
    for p in range(_FOLDS):
        out = own == p
        model = _taught(problem.x[~out], problem.label[~out], thresholds)
        at = np.searchsorted(classes, model.classes_)
        found[np.ix_(out, at)] = model.predict_proba(problem.x[out])
    return _sharpened(found, thresholds)


def _taught(
    x: FloatArray, label: np.ndarray[tuple[int], np.dtype[np.str_]], thresholds: Thresholds
) -> LogisticRegression:
    model = LogisticRegression(
        C=thresholds.penalty, max_iter=300, tol=1e-3, class_weight="balanced"
    )
    return model.fit(x, label)


def _sharpened(p: FloatArray, thresholds: Thresholds) -> FloatArray:
    raised = np.clip(p, 1e-12, 1.0) ** thresholds.sharpness
    sharp: FloatArray = raised / raised.sum(axis=-1, keepdims=True)
    return sharp


def confused_with(odds: Odds, effect: str, least: float = 0.1) -> dict[str, float]:
    """What campaigns of an effect are taken for, by mean held-out probability."""
    mine = odds.label == effect
    mean = odds.held_out[mine].mean(axis=0)
    order = np.argsort(-mean)
    return {
        odds.effects[k]: float(mean[k])
        for k in order.tolist()
        if mean[k] >= least and odds.effects[k] != effect
    }
