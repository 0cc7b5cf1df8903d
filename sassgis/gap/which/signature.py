"""The signature of a campaign: how it differs from the base model, in numbers that name no place.

Each number of a campaign is taken twice: as it lies among campaigns of the base model whose ground
is drawn anew each time, and as what is left of it after the ground has been calibrated on all
numbers together (linear in the parameters, Gaussian). Numbers of the same kind at several
stations, reaches or kinds of ground become their mean and their change down the slope, so that
signatures of any two cases can be compared.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.observations.campaign import Campaign, as_seen
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.which.ensemble import COUNT, CalibrationProblem, Tried
from sassgis.gap.which.features import summary
from sassgis.gap.which.hypotheses import Draw, ParameterDraws, draw
from sassgis.gap.which.step_features import Steps, step_features, steps_of
from sassgis.model.grid import FloatArray

#: Numbers beyond this many units count by their logarithm: what is far off is far off.
_FAR = 3.0
#: Least unit of any number: below, differences are of rounding.
_LEAST_UNIT = 0.02
#: Models that differ only in how they are computed lie this far apart (units, per number), and so
#: many numbers say the same thing that each counts by this share only.
_DISCREPANCY, _SHARE = 3.0, 0.25
#: Penalty of the regression of numbers on parameters, and how far a parameter is moved at most
#: (standard deviations of its range).
_PENALTY, _FURTHEST = 10.0, 2.0
#: Share of the base campaigns that must have a number.
_KNOWN = 0.6
_PLACES = (
    (re.compile(r"^S(\d+):"), "S:"),
    (re.compile(r"^leg(\d+):"), "leg:"),
    (re.compile(r"^hit(\d+):"), "hit_leg:"),
)


@dataclass(frozen=True, slots=True)
class Reference:
    """What campaigns of the base model look like, and how they go with the ground's parameters.

    Attributes
    ----------
    soft : tuple of str
        Names of the softer ground classes.
    names : tuple of str
        Numbers that most base campaigns have.
    centre, spread : float64, shape (p,)
        Mean, and standard deviation over all base campaigns.
    response : float64, shape (p, k)
        Change of each number with each parameter of the ground (standard deviations of its range).
    unit : float64, shape (p,)
        Scatter that the parameters do not explain.
    """

    soft: tuple[str, ...]
    names: tuple[str, ...]
    centre: FloatArray
    spread: FloatArray
    response: FloatArray
    unit: FloatArray


@dataclass(frozen=True, slots=True)
class Base:
    """A case, and campaigns of its rocks in the base model.

    Attributes
    ----------
    problem : CalibrationProblem
    steps : Steps
    names : tuple of str
        Numbers that any of the campaigns has.
    x : float64, shape (n, p)
        Those numbers, campaigns of one draw next to each other; NaN where one is not had.
    moved : float64, shape (n, k)
        Parameters of the ground in each (standard deviations of their ranges).
    """

    problem: CalibrationProblem
    steps: Steps
    names: tuple[str, ...]
    x: FloatArray
    moved: FloatArray

    @property
    def soft(self) -> tuple[str, ...]:
        """Names of the softer ground classes."""
        names = self.problem.case.table.names
        return tuple(names[k] for k in sorted(self.steps.soft))


#: Draws of the base model; not a choice of the user, since the units of signatures hang on it.
BASE_DRAWS = 80


def base_of(problem: CalibrationProblem, draws: int = BASE_DRAWS) -> tuple[Base, list[Tried]]:
    """Release the rocks in the base model, its ground drawn anew ``draws`` times.

    Returns
    -------
    Base
    list of Tried
        The same campaigns for an ensemble.
    """
    made: list[Draw] = []
    samples: list[Campaign] = []
    for i in range(draws):
        one = draw(
            problem.case,
            (),
            ParameterDraws(np.random.default_rng([problem.seed, 11, i])),
        )
        made.append(one)
        samples += [
            as_seen(sample, problem.observed)
            for sample in campaigns(
                problem.case,
                problem.rock_lines,
                one.model,
                count=COUNT,
                seed=problem.seed,
                number=1 + i,
            )
        ]
    summaries = [summary(problem.case, sample, problem.given) for sample in samples]
    quantities = [q for _, q in summaries]
    steps = steps_of(problem.case, problem.given, samples, quantities)
    features = [
        f | step_features(problem.case, problem.given, steps, sample, q)
        for sample, (f, q) in zip(samples, summaries, strict=True)
    ]
    rows = [problem.scale.rows(q) for q in quantities]
    tried = [
        Tried(one, np.stack(rows[COUNT * i : COUNT * (i + 1)]).astype(np.float32))
        for i, one in enumerate(made)
    ]
    names = tuple(sorted(set().union(*features)))
    x = np.array([[f.get(name, np.nan) for name in names] for f in features])
    parameter_draws = np.array(
        [[v for name, v in one.parameter_draws.items() if "." in name] for one in made]
    )
    # Uniform from 0 to 1, in standard deviations.
    moved = np.repeat((parameter_draws - 0.5) * np.sqrt(12.0), COUNT, axis=0)
    return Base(problem, steps, names, x, moved), tried


def reference_of(
    names: Sequence[str], x: FloatArray, moved: FloatArray, soft: tuple[str, ...]
) -> Reference:
    """Learn how numbers of base campaigns scatter, and how they go with the ground.

    Parameters
    ----------
    names : sequence of str, length p
    x : float64, shape (n, p)
        Numbers of campaigns, those of one draw next to each other; NaN where one is not had.
    moved : float64, shape (n, k)
        Parameters of each draw (standard deviations of their ranges).
    soft : tuple of str
        Names of the softer ground classes.
    """
    kept = np.flatnonzero(np.isfinite(x).mean(axis=0) > _KNOWN)
    x = x[:, kept]
    x = np.where(np.isfinite(x), x, np.nanmedian(x, axis=0))
    centre = np.asarray(x.mean(axis=0), np.float64)
    x = x - centre
    spread: FloatArray = np.maximum(x.std(axis=0), _LEAST_UNIT).astype(np.float64)
    products = moved.T @ moved + _PENALTY * np.eye(moved.shape[1])
    response = np.asarray(np.linalg.solve(products, moved.T @ x).T, np.float64)
    apart = x.reshape(-1, COUNT, x.shape[1])
    within = np.sqrt(apart.var(axis=1, ddof=1).mean(axis=0))
    unexplained = np.sqrt(((x - moved @ response.T) ** 2).mean(axis=0))
    unit = np.asarray(np.maximum(np.maximum(unexplained, within), _LEAST_UNIT), np.float64)
    return Reference(
        soft,
        tuple(names[k] for k in kept.tolist()),
        centre,
        spread,
        response,
        unit,
    )


def features_of(base: Base, sample: Campaign) -> dict[str, float]:
    """All numbers of a campaign of the case."""
    problem = base.problem
    found, quantities = summary(problem.case, sample, problem.given)
    return found | step_features(problem.case, problem.given, base.steps, sample, quantities)


def observed_signature(base: Base, design: str = "everything") -> dict[str, float]:
    """Signature of the observed campaign, of the numbers that can be had in a design."""
    seen = features_of(base, base.problem.observed)
    return signature_of(reference_in(base, design), seen)


def reference_in(base: Base, design: str) -> Reference:
    """Reference of the numbers that can be had in a design."""
    kept = [k for k, name in enumerate(base.names) if _known_in(name, design)]
    names = [base.names[k] for k in kept]
    return reference_of(names, base.x[:, kept], base.moved, base.soft)


def _known_in(name: str, design: str) -> bool:
    of_impacts = name.startswith(("hit", "step_")) or ":step_" in name
    of_stops = name.startswith(("stop:", "loose:", "pieces:"))
    if design == "everything":
        return True
    if design == "both":
        return not of_impacts
    if design == "stops":
        return of_stops and "~S" not in name
    return not of_impacts and not of_stops and "stop:" not in name and ":end" not in name


def signature_of(reference: Reference, features: Mapping[str, float]) -> dict[str, float]:
    """Signature of a campaign.

    Parameters
    ----------
    reference : Reference
    features : mapping
        As ``features_of`` returns them; those that the campaign lacks are left out.

    Returns
    -------
    dict of name to float
        "p|..." among base campaigns, "r|..." after calibration; "/d" is half the change from the
        upper to the lower places.
    """
    seen = np.array([features.get(name, np.nan) for name in reference.names])
    known = np.isfinite(seen)
    names = [name for name, k in zip(reference.names, known.tolist(), strict=True) if k]
    off = (seen - reference.centre)[known]
    unit, response = reference.unit[known], reference.response[known]
    left = off - response @ _calibrated(off, unit, response)
    among = _without_places(names, _bounded(off / reference.spread[known]), reference.soft)
    after = _without_places(names, _bounded(left / unit), reference.soft)
    return {f"p|{k}": v for k, v in among.items()} | {f"r|{k}": v for k, v in after.items()}


def _calibrated(off: FloatArray, unit: FloatArray, response: FloatArray) -> FloatArray:
    """Parameters of the ground that bring the numbers nearest, in standard deviations."""
    slope = response / (unit * _DISCREPANCY)[:, None]
    wanted = _bounded(off / unit) / _DISCREPANCY
    products = _SHARE * slope.T @ slope + np.eye(slope.shape[1])
    found: FloatArray = np.clip(
        np.linalg.solve(products, _SHARE * slope.T @ wanted), -_FURTHEST, _FURTHEST
    )
    return found


def _bounded(z: FloatArray) -> FloatArray:
    size = np.abs(z)
    bounded: FloatArray = np.sign(z) * np.where(
        size < _FAR, size, _FAR + np.log1p(np.maximum(size - _FAR, 0.0))
    )
    return bounded


def _without_places(
    names: Sequence[str], values: FloatArray, soft: Sequence[str]
) -> dict[str, float]:
    found: dict[str, list[tuple[int, float]]] = defaultdict(list)
    for name, value in zip(names, values.tolist(), strict=True):
        kind, place = kind_and_place(name, soft)
        found[kind].append((place, value))
    out: dict[str, float] = {}
    for kind, rows in found.items():
        rows.sort()
        ordered = np.array([value for _, value in rows])
        out[kind] = float(ordered.mean())
        half = len(rows) // 2
        if rows[0][0] != rows[-1][0]:
            change = ordered[-half:].mean() - ordered[:half].mean()
            out[f"{kind}/d"] = float(0.5 * change)
    return out


def kind_and_place(name: str, soft: Sequence[str] = ()) -> tuple[str, int]:
    """A number's name without station, reach or ground class, and which of them it was.

    Ground classes become "hit_soft:" and "hit_hard:", all at one place.
    """
    if name.startswith("hit@"):
        ground, _, rest = name[4:].partition(":")
        return f"{'hit_soft' if ground in soft else 'hit_hard'}:{rest}", 0
    for pattern, stands_for in _PLACES:
        match = pattern.match(name)
        if match:
            kind = re.sub(r"S\d+:", "S:", pattern.sub(stands_for, name))
            return kind, int(match.group(1))
    return name, 0
