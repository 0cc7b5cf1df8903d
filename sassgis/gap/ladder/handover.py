"""What is told first: how far the configured model is off, what to set, what follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sassgis.gap.calibration.problem import CalibrationProblem, Scale
from sassgis.gap.diagnosis import (
    Advice,
    ConfiguredGap,
    Consequence,
    GroundSetting,
    Range,
    Rung,
)
from sassgis.gap.inference.intervals import bootstrap_interval
from sassgis.gap.ladder.hypothesis_fit import FRESH, FittedHypothesis
from sassgis.gap.observations.campaign import main_blocks
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.features import rock_quantities
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, MeasurementError
from sassgis.gap.which.hypotheses import at_physical_limit
from sassgis.gap.words import effect_name
from sassgis.model.grid import FloatArray, IntArray

_COMPARED = frozenset({"passages", "deposits"})
#: Number of the campaigns of the configured model.
CONFIGURED_NUMBER = 3990


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


def settings_of(
    case: Case, fit: FittedHypothesis, intervals: Mapping[str, Range]
) -> tuple[GroundSetting, ...]:
    """Ground of a model that is handed over, with intervals."""
    if fit.found is None:
        return ()
    before = {c.name: c for c in case.table.classes}
    identified = {f.parameter.label for f in fit.found.fitted if f.identified}
    return tuple(
        GroundSetting(
            ground,
            name,
            float(getattr(before[ground], name)),
            value,
            intervals[label],
            label in identified,
        )
        for label, value in fit.handed_over.draw.parameters.items()
        for ground, _, name in (label.rpartition("."),)
        if ground in before
    )


def classes_at_limit(case: Case, fit: FittedHypothesis) -> list[str]:
    """Ground classes whose calibration runs into the limits of its range."""
    found = [
        f.parameter.class_name
        for f in (() if fit.found is None else fit.found.fitted)
        if f.limit
        and f.parameter.class_name in case.table.names
        and not at_physical_limit(case, f.parameter.class_name, f.parameter.name, f.limit)
    ]
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
        tables=_COMPARED,
    )  # fmt: skip
    found: dict[tuple[str, str, str], FloatArray] = {}
    stops = [s.deposits for s in samples if s.deposits is not None]
    if stops:
        main = [main_blocks(rows, case.n_rocks) for rows in stops]
        # Of rocks whose stop is known in nature as well.
        seen = np.isfinite(rock_quantities(case, problem.observed)["stop:runout"])
        ends = [rows.s[own[seen & (own >= 0)]] for rows, own in zip(stops, main, strict=True)]
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


def first_sentence(advice: Advice, ladder: Sequence[Rung], answer: str) -> str:
    """How far the configured model is off and on which side, what to set, and what that does.

    Parameters
    ----------
    advice : Advice
    ladder : sequence of Rung
    answer : str
        Of the verdict.
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
    named = answer not in ("none", "unknown")
    if not (gap.significant or advice.wrong_ground or named):
        return " ".join(said)
    # A share whose interval holds zero may be chance.
    closed = {
        r.rung: _closed(r)
        for r in ladder
        if r.share is not None and (r.ci95 is None or r.ci95[0] > 0.0)
    }
    if named:
        what = " and ".join(effect_name(e) for e in answer.split("+"))
        share = closed.get(answer, "")
        alone = closed.get("ground", "")
        said.append(
            f"Run model/config.toml, which has {what}"
            + (
                f": on rocks left out of the calibration, it closes {share} of the gap"
                if share
                else ""
            )
            + (f", calibrated ground alone {alone}." if share and alone else ".")
        )
        return " ".join(said)
    said += _what_to_set(advice)
    share = closed.get("ground", "")
    said.append(
        f"On rocks left out of the calibration, this closes {share} of the gap."
        if share
        else "Whether these values hold for rocks left out of the calibration is not certain."
    )
    return " ".join(said)


def _closed(rung: Rung) -> str:
    span = ""
    if rung.ci95 is not None:
        low, high = (f"{100.0 * v:.0f}".replace("-", "\u2212") for v in rung.ci95)
        span = f" (95 %: {low} to {high} %)"
    return f"{100.0 * (rung.share or 0.0):.0f} %{span}"


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


def _what_to_set(advice: Advice) -> list[str]:
    by_class: dict[str, list[str]] = {}
    for s in advice.settings:
        if s.identified and s.value != s.before:
            by_class.setdefault(s.ground, []).append(
                f"{s.parameter} {_number(s.value)} ({_number(s.ci95[0])} to {_number(s.ci95[1])})"
            )
    if not by_class:
        return [
            "Set the ground as in model/ground_classes.csv; these data identify none of its "
            "parameters alone."
        ]
    known = {f"{s.ground}.{s.parameter}" for s in advice.settings if s.identified}
    said = [f"Set {name}: {', '.join(values)}." for name, values in by_class.items()]
    said += [
        f"{one} and {other} make up for each other: change one only with the other."
        for one, other, _ in advice.trade_offs
        if {one, other} <= known
    ][:1]
    return said


def _number(value: float) -> str:
    """Two digits for large numbers, as many decimals as a setting needs for small ones."""
    text = f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"
    return text.replace("-", "\u2212")
