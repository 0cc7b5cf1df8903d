"""What is told first: how far the configured model is off, what to set, what follows."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sassgis.gap.diagnosis import Advice, ConfiguredGap, Consequence, GroundSetting, Rung
from sassgis.gap.inference.intervals import bootstrap_interval
from sassgis.gap.ladder.calibration import FRESH
from sassgis.gap.observations.campaign import main_blocks
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, LateralWalk, MeasurementError
from sassgis.gap.which.ensemble import BLIND, CalibrationProblem, Ensemble, Scale
from sassgis.gap.which.hypotheses import GROUND_WIDTHS, Draw, at_physical_limit
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.settings import LateralDeflection

#: Number of the campaigns of the configured model.
CONFIGURED_NUMBER = 3990
#: A parameter is identified if its interval is narrower than this share of the range.
_NARROWER = 0.7
#: A limit is met where this share of the good draws lies in the outermost part of the range.
_AT_LIMIT, _OUTERMOST = 0.25, 0.05
#: Correlations from here on are stated as trade-offs, that many of them.
_CORRELATED, _TRADE_OFFS = 0.6, 3
#: Fewest good draws from which limits and correlations are read.
_FEWEST = 10


def configured_model(case: Case) -> HypothesisModel:
    """The model as it is configured."""
    lateral = case.effects.get(LateralDeflection)
    return HypothesisModel(
        case.table, case.effects.without(LateralDeflection), lateral_walk=LateralWalk.of(lateral)
    )


def values_of(scale: Scale, rows: FloatArray, column: int) -> FloatArray:
    """A quantity in its own unit from rows of rocks; NaN where a rock has none."""
    found = rows[..., column] * scale.scale[column] + scale.centre[column]
    if scale.names[column].partition(":")[2] in ("speed", "blocks"):
        found = np.exp(found)
    values: FloatArray = np.where(rows[..., column + len(scale.names)] < 0.5, found, np.nan)
    return values


def configured_gap(problem: CalibrationProblem, configured: FloatArray) -> ConfiguredGap | None:
    """How far the configured model is off: median run-out, or speed at the furthest station.

    Parameters
    ----------
    problem : CalibrationProblem
    configured : float64, shape (m, n_rocks, p)
        Rows of rocks in the configured model.
    """
    names = problem.scale.names
    stations = sorted(int(n[1 : n.index(":")]) for n in names if n.endswith(":speed"))
    if "stop:runout" in names:
        place, column, quantity, unit = "stop", names.index("stop:runout"), "runout_m", "m"
    elif stations:
        place = problem.case.station_names[stations[-1]]
        column = names.index(f"S{stations[-1]}:speed")
        quantity, unit = "speed_mps", "m/s"
    else:
        return None
    seen = values_of(problem.scale, problem.rows, column)
    made = values_of(problem.scale, configured, column)
    known = np.flatnonzero(np.isfinite(seen) & np.isfinite(made).any(axis=0))
    if known.size < 3:
        return None
    seen, made = seen[known], made[:, known]

    def gap(rows: IntArray) -> float:
        return float(np.median(seen[rows]) - np.nanmedian(made[:, rows]))

    found = bootstrap_interval(
        gap,
        problem.case.group[known],
        draws=999,
        rng=np.random.default_rng([problem.seed, 57]),
        method="percentile",
    )
    return ConfiguredGap(
        place, quantity, unit, float(np.median(seen)), float(np.nanmedian(made)), found.value,
        (found.low, found.high),
    )  # fmt: skip


def good_draws(problem: CalibrationProblem, ensemble: Ensemble, effect: str) -> IntArray:
    """Draws of an effect that the rocks do not tell from the best one.

    Those whose mean excess of score over that of the best is below 1.64 of its standard errors,
    over groups of rocks.
    """
    own = ensemble.of(effect)
    scores = np.nan_to_num(ensemble.scores[own])
    best = int(np.argmin(scores.mean(axis=1)))
    unit = np.unique(problem.case.group, return_inverse=True)[1]
    n = int(unit.max()) + 1
    excess = np.zeros((own.size, n))
    np.add.at(excess.T, unit, (scores - scores[best]).T)
    error = excess.std(axis=1, ddof=1) * np.sqrt(n) if n > 1 else np.full(own.size, np.inf)
    good: IntArray = own[excess.sum(axis=1) <= 1.64 * error]
    return good


def _labels(draw: Draw) -> list[str]:
    """Parameters of ground classes of a draw, as class.parameter."""
    return [k for k in draw.parameters if k.rpartition(".")[2] in GROUND_WIDTHS and "." in k]


def settings_of(
    problem: CalibrationProblem, ensemble: Ensemble, effect: str, chosen: Draw
) -> tuple[tuple[GroundSetting, ...], tuple[tuple[str, str, float], ...]]:
    """Ground of the model that is handed over, with intervals, and pairs that move together."""
    labels = _labels(chosen)
    draws = ensemble.of(effect)
    values = np.array(
        [[ensemble.tried[i].draw.parameters[k] for k in labels] for i in draws.tolist()]
    )
    good = values[np.isin(draws, good_draws(problem, ensemble, effect))]
    blind = values[ensemble.fit[draws] == BLIND]
    low, high = np.quantile(good, [0.025, 0.975], axis=0)
    least, most = np.quantile(blind, [0.025, 0.975], axis=0)
    before = {c.name: c for c in problem.case.table.classes}
    found = []
    for k, label in enumerate(labels):
        ground, _, name = label.rpartition(".")
        value = chosen.parameters[label]
        found.append(
            GroundSetting(
                ground,
                name,
                float(getattr(before[ground], name)),
                value,
                # What is handed over lies within, also where it was told by fresh campaigns.
                (min(float(low[k]), value), max(float(high[k]), value)),
                bool(high[k] - low[k] < _NARROWER * (most[k] - least[k])),
            )
        )
    pairs: list[tuple[str, str, float]] = []
    moving = np.flatnonzero(good.std(axis=0) > 0.0)
    if len(good) >= _FEWEST and moving.size > 1:
        r = np.corrcoef(good[:, moving].T)
        pairs = [
            (labels[moving[i]], labels[moving[j]], float(r[i, j]))
            for i, j in itertools.combinations(range(moving.size), 2)
            if abs(r[i, j]) >= _CORRELATED
        ]
    pairs.sort(key=lambda p: -abs(p[2]))
    return tuple(found), tuple(pairs[:_TRADE_OFFS])


def classes_at_limit(problem: CalibrationProblem, ensemble: Ensemble, effect: str) -> list[str]:
    """Ground classes whose calibration runs into the limits of its range."""
    good = good_draws(problem, ensemble, effect)
    if good.size < _FEWEST:
        return []
    found = []
    for label in _labels(ensemble.tried[int(good[0])].draw):
        shares = np.array([ensemble.tried[i].draw.parameter_draws[label] for i in good.tolist()])
        low, high = np.quantile(shares, [0.025, 0.975])
        ground, _, name = label.rpartition(".")
        for end, near in ((0.0, shares < _OUTERMOST), (1.0, shares > 1.0 - _OUTERMOST)):
            meets = high - low < _NARROWER and near.mean() > _AT_LIMIT
            if meets and not at_physical_limit(problem.case, ground, name, end):
                found.append(ground)
    return list(dict.fromkeys(found))


def consequences_of(
    problem: CalibrationProblem, before: HypothesisModel, after: HypothesisModel
) -> tuple[Consequence, ...]:
    """Run-out and energy of the observed rocks in two models, without errors of measurement."""
    found = [_reached(problem, model) for model in (before, after)]
    return tuple(
        Consequence(*key, value, found[1][key])
        for key, value in found[0].items()
        if key in found[1]
    )


def _reached(
    problem: CalibrationProblem, model: HypothesisModel
) -> dict[tuple[str, str, str], float]:
    """Medians and 90 % quantiles of run-out, and of the energy at the furthest station."""
    case = problem.case
    samples = campaigns(
        case,
        problem.rock_lines,
        HypothesisModel(
            model.table, model.effects, model.stand, model.lateral_walk, model.release,
            MeasurementError(),
        ),
        count=FRESH,
        seed=problem.seed,
        number=CONFIGURED_NUMBER,
        impacts=False,
    )  # fmt: skip
    found: dict[tuple[str, str, str], FloatArray] = {}
    stops = [s.deposits for s in samples if s.deposits is not None]
    if stops:
        main = [main_blocks(rows, case.n_rocks) for rows in stops]
        ends = [rows.s[own[own >= 0]] for rows, own in zip(stops, main, strict=True)]
        found["stop", "runout_m", "m"] = np.concatenate(ends)
    passed = [s.passages for s in samples if s.passages is not None]
    if passed and case.station_names:
        last = len(case.station_names) - 1
        energy = [
            0.5e-3 * (rows.mass_kg * rows.speed_mps**2)[rows.station == last] for rows in passed
        ]
        found[case.station_names[last], "energy_kj", "kJ"] = np.concatenate(energy)
    out = {}
    for (place, quantity, unit), values in found.items():
        known = values[np.isfinite(values)]
        for name, level in (("median", 0.5), ("90 %", 0.9)):
            if known.size:
                out[place, f"{quantity} ({name})", unit] = float(np.quantile(known, level))
    return out


# ---------------------------------------------------------------------------------------------
# In words


def first_sentence(advice: Advice, ladder: Sequence[Rung], effect: str) -> str:
    """How far the configured model is off and on which side, what to set, and what that does.

    Parameters
    ----------
    advice : Advice
    ladder : sequence of Rung
    effect : str
        Effect that is handed over with the ground; "" for none.
    """
    gap = advice.configured
    if gap is None:
        return "Neither stops nor speeds were observed: how far the model is off cannot be stated."
    said = [_off_by(gap)]
    if advice.wrong_ground:
        names = " and ".join(advice.wrong_ground)
        said.append(
            f"The ground class {names} is wrong: no values in its usual range fit."
            if len(advice.wrong_ground) == 1
            else f"The ground classes {names} are wrong: no values in their usual ranges fit."
        )
    if gap.significant or advice.wrong_ground:
        said += _what_to_set(advice, effect)
        told = {r.rung: r for r in ladder}
        best = told.get(effect or "ground")
        if best is not None and best.share is not None and best.ci95 is not None:
            low, high = (100.0 * v for v in best.ci95)
            said.append(
                f"On rocks that had no say in the values, this closes {100.0 * best.share:.0f} % "
                f"of the gap (95 %: {low:.0f} to {high:.0f} %)."
            )
    return " ".join(said)


def _off_by(gap: ConfiguredGap) -> str:
    low, high = sorted(abs(v) for v in gap.ci95)
    where = "median run-out" if gap.quantity == "runout_m" else f"median speed at {gap.place}"
    if not gap.significant:
        return (
            f"As configured, the model is not distinguished from the rocks in {where}: observed "
            f"less predicted {_number(gap.gap)} {gap.unit} (95 %: {_number(gap.ci95[0])} to "
            f"{_number(gap.ci95[1])} {gap.unit})."
        )
    if gap.quantity == "runout_m":
        word = "short" if gap.gap > 0.0 else "long"
    else:
        word = "too slow" if gap.gap > 0.0 else "too fast"
    side = "unsafe" if gap.gap > 0.0 else "safe"
    return (
        f"As configured, the model is {_number(abs(gap.gap))} {gap.unit} {word} ({where}; 95 %: "
        f"{_number(low)} to {_number(high)} {gap.unit}), on the {side} side."
    )


def _what_to_set(advice: Advice, effect: str) -> list[str]:
    told = [s for s in advice.settings if s.identified and s.value != s.before]
    by_class: dict[str, list[str]] = {}
    for s in told:
        by_class.setdefault(s.ground, []).append(
            f"{s.parameter} {_number(s.value)} ({_number(s.ci95[0])} to {_number(s.ci95[1])})"
        )
    added = f" with {effect.replace('_', ' ').replace('+', ' and ')}" if effect else ""
    if not by_class:
        return [
            f"Set the ground as in model/ground_classes.csv{added}; these data identify none of "
            "its parameters alone."
        ]
    said = [f"Set {name}: {', '.join(values)}{added}." for name, values in by_class.items()]
    if advice.trade_offs:
        one, other, _ = advice.trade_offs[0]
        said.append(f"{one} and {other} move together: change one only with the other.")
    return said


def _number(value: float) -> str:
    """Two digits for large numbers, as many decimals as a setting needs for small ones."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"
