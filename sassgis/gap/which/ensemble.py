"""The ensemble of a diagnosis: campaigns of every hypothesis, scored against the observed rocks.

Each campaign releases all observed rocks once with one set of parameters. What it shows is kept as
one row per rock, from which it is scored against the rock that was observed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.inference.folds import folds_of
from sassgis.gap.observations.campaign import Campaign, errors_of, observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.replicas.rock_lines import RockLines, rock_lines_of
from sassgis.gap.which.features import rock_quantities
from sassgis.gap.which.hypotheses import NONE, Draw, draw
from sassgis.model.grid import FloatArray, IntArray

#: Campaigns of each draw: two, so that the scatter of one model is known rock by rock.
COUNT = 2
#: Number of no fit: draws in which no observed rock had a say.
BLIND = -1
#: A quantity that fewer rocks than this have is not scored.
_FEWEST = 5


@dataclass(frozen=True, slots=True)
class Scale:
    """How quantities of a rock become a row whose distances count.

    Attributes
    ----------
    names : tuple of str
        Quantities, as ``features.rock_quantities`` names them.
    centre, scale : float64, shape (k,)
    n_rocks : int
        Rows where nothing is scored at all.
    """

    names: tuple[str, ...]
    centre: FloatArray
    scale: FloatArray
    n_rocks: int = 0

    def rows(self, quantities: Mapping[str, FloatArray]) -> FloatArray:
        """Rows per rock, shape (n_rocks, 2 k): standardised values, and flags of absence.

        A rock that never reached a station has no speed there, which the flag states.
        """
        if not self.names:
            return np.zeros((self.n_rocks, 0))
        values = np.column_stack([_scored(name, quantities[name]) for name in self.names])
        z = (values - self.centre) / self.scale
        absent = ~np.isfinite(z)
        rows: FloatArray = np.hstack([np.where(absent, 0.0, z), absent.astype(float)])
        return rows


@dataclass(frozen=True, slots=True)
class Tried:
    """One draw and the campaigns made of it.

    Attributes
    ----------
    draw : Draw
    rows : float32, shape (count, n_rocks, 2 k)
        Rows per rock on the scale of the observed.
    fit : int
        For which fit it was drawn: the part of the rocks that had no say in it. BLIND: for all.
    number : int
        Of its campaigns; the same number gives the same ones again.
    """

    draw: Draw
    rows: NDArray[np.float32]
    fit: int = BLIND
    number: int = 0


@dataclass(frozen=True, slots=True)
class CalibrationProblem:
    """A case made ready for many campaigns.

    Attributes
    ----------
    case : Case
    rock_lines : RockLines
    scale : Scale
    observed : Campaign
    rows : float64, shape (n_rocks, 2 k)
        Of the observed rocks.
    seed : int
    part : int64, shape (n_rocks,)
        Part of the cross-validation that each rock belongs to.
    unseen : bool, shape (n_rocks, 2 k)
        Stops of rocks of which no block is known to lie anywhere: not found, or not told from
        others. They count as not measured, in replicas too.
    """

    case: Case
    rock_lines: RockLines
    scale: Scale
    observed: Campaign
    rows: FloatArray
    seed: int
    part: IntArray
    unseen: NDArray[np.bool_]

    @property
    def n_parts(self) -> int:
        """Parts of the cross-validation; also the number of the fit that leaves no rock out."""
        return int(self.part.max()) + 1

    def rocks_of(self, fit: int) -> IntArray:
        """Rocks that have a say in a fit: all but those of the part of its number."""
        return np.flatnonzero(self.part != fit)


def problem_of(case: Case, seed: int, scale: Scale | None = None) -> CalibrationProblem:
    """Prepare a case; ``scale`` is that of other rocks of the same slope."""
    observed = observed_campaign(case)
    quantities = rock_quantities(case, observed)
    scale = scale_of(case, quantities) if scale is None else scale
    unseen = np.zeros((case.n_rocks, 2 * len(scale.names)), np.bool_)
    if "stop:blocks" in quantities:
        of_stops = np.array([name.startswith("stop:") for name in (*scale.names, *scale.names)])
        unseen = (quantities["stop:blocks"] == 0.0)[:, None] & of_stops
    return CalibrationProblem(
        case,
        rock_lines_of(case),
        scale,
        observed,
        scale.rows(quantities),
        seed,
        folds_of(case.n_rocks, seed, case.group),
        unseen,
    )


def scale_of(case: Case, quantities: Mapping[str, FloatArray]) -> Scale:
    """Quantities to be scored, with the scatter of the observed as their unit."""
    errors = errors_of(case)
    floors = {
        "runout": 2.0 * errors.position_m,
        "aside": 2.0 * errors.position_m,
        "speed": errors.speed_rel,
        "rotation": 0.1,
        "height": 2.0 * errors.height_m,
        "blocks": 0.3,
    }
    names, centre, scale = [], [], []
    for name, values in quantities.items():
        place, _, what = name.partition(":")
        if what not in floors or not (place == "stop" or place.startswith("S")):
            continue
        known = _scored(name, values)
        known = known[np.isfinite(known)]
        if known.size < _FEWEST:
            continue
        names.append(name)
        centre.append(float(known.mean()))
        scale.append(max(float(known.std(ddof=1)), floors[what]))
    return Scale(tuple(names), np.array(centre), np.array(scale), case.n_rocks)


def _scored(name: str, values: FloatArray) -> FloatArray:
    """Numbers of blocks count by their logarithm."""
    return np.log(np.maximum(values, 0.5)) if name.endswith(":blocks") else values


def try_draw(
    problem: CalibrationProblem, made: Draw, number: int, *, fit: int = BLIND, count: int = COUNT
) -> Tried:
    """Make ``count`` campaigns of one draw; ``number`` distinguishes them."""
    return Tried(made, model_rows(problem, made.model, number, count), fit, number)


def model_rows(
    problem: CalibrationProblem, model: HypothesisModel, number: int, count: int
) -> NDArray[np.float32]:
    """Rows per rock of ``count`` campaigns of a model, shape (count, n_rocks, 2 k)."""
    samples = campaigns(
        problem.case, problem.rock_lines, model,
        count=count, seed=problem.seed, number=number, impacts=False,
    )  # fmt: skip
    return np.stack([rows_of(problem, sample) for sample in samples]).astype(np.float32)


def rows_of(problem: CalibrationProblem, sample: Campaign) -> FloatArray:
    """Rows per rock of another campaign of the same rocks."""
    rows = problem.scale.rows(rock_quantities(problem.case, sample))
    return np.where(problem.unseen, problem.rows, rows)


def tasks_of(effects: Iterable[str], draws: int) -> list[tuple[str, int]]:
    """What an ensemble is made of besides the base: effect and number of each draw."""
    return [(effect, i) for effect in effects for i in range(draws)]


def first_draw(
    problem: CalibrationProblem, task: tuple[str, int], order: Mapping[str, int]
) -> tuple[Draw, int]:
    """One draw of an effect (joined by "+" for several) from its ranges, and its number.

    The draw depends on the seed, the effect and its number alone, never on what else is tried.
    """
    effect, i = task
    families = () if effect == NONE else tuple(effect.split("+"))
    code = [order[name] + 1 for name in families]
    rng = np.random.default_rng([problem.seed, 11, i, *code])
    number = 1 + i + 4096 * (sum(c * 16**k for k, c in enumerate(code)))
    return draw(problem.case, families, ParameterDraws(rng)), number


def try_task(problem: CalibrationProblem, task: tuple[str, int], order: Mapping[str, int]) -> Tried:
    """The campaigns of ``first_draw``."""
    made, number = first_draw(problem, task, order)
    return try_draw(problem, made, number)


@dataclass(frozen=True, slots=True)
class Ensemble:
    """All that was tried.

    Attributes
    ----------
    tried : tuple of Tried
    effect : str, shape (n_draws,)
    fit : int64, shape (n_draws,)
    scores : float64, shape (n_draws, n_rocks)
        Energy score of each observed rock.
    """

    tried: tuple[Tried, ...]
    effect: NDArray[np.str_]
    fit: IntArray
    scores: FloatArray

    def of(self, effect: str, fit: int | None = None) -> IntArray:
        """Numbers of the draws of an effect; with ``fit`` the blind ones and those of this fit."""
        own = self.effect == effect
        if fit is not None:
            own &= (self.fit == BLIND) | (self.fit == fit)
        return np.flatnonzero(own)

    def with_more(self, problem: CalibrationProblem, more: Sequence[Tried]) -> Ensemble:
        """The ensemble with further draws."""
        return ensemble_of(problem, [*self.tried, *more])


def ensemble_of(problem: CalibrationProblem, tried: Sequence[Tried]) -> Ensemble:
    """Score what was tried."""
    return Ensemble(
        tuple(tried),
        np.array([t.draw.effect for t in tried], np.str_),
        np.array([t.fit for t in tried], np.int64),
        np.stack([rock_scores(problem.rows, t.rows) for t in tried]),
    )


def rock_scores(observed: FloatArray, replicas: NDArray[np.floating]) -> FloatArray:
    """Energy score of each rock against its replicas, without bias by their number.

    Gneiting and Raftery (2007), equation 22; fair as Ferro (2014) has it.

    Parameters
    ----------
    observed : float64, shape (n_rocks, p)
    replicas : float, shape (m, n_rocks, p)
        m of two or more.

    Returns
    -------
    float64, shape (n_rocks,)
    """
    members = np.asarray(replicas, np.float64)
    m = members.shape[0]
    near = np.sqrt(((members - observed) ** 2).sum(axis=2)).mean(axis=0)
    apart = np.zeros(observed.shape[0])
    for i in range(m):
        for j in range(i + 1, m):
            apart += np.sqrt(((members[i] - members[j]) ** 2).sum(axis=1))
    scores: FloatArray = near - apart / (m * (m - 1)) if m > 1 else near
    return scores
