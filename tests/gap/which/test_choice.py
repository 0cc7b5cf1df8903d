"""Draws of hypotheses, and the choice between causes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.trees import Trees as Forest
from sassgis.gap.calibration.problem import CalibrationProblem, scale_of
from sassgis.gap.causes.all_causes import FAMILIES, STATISTICS
from sassgis.gap.causes.ground_classes import reaches_between
from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.diagnosis import Fingerprint, GapFinding
from sassgis.gap.observations.campaign import observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.features import rock_quantities
from sassgis.gap.replicas.hypothesis_model import (
    LateralWalk,
)
from sassgis.gap.replicas.model_json import model_as_json, model_from_json
from sassgis.gap.which.hypotheses import NONE, draw, families_to_try
from sassgis.gap.which.verdict import (
    CONTACT_LAW,
    Thresholds,
    adequate,
    confusion_set,
    decide,
    group_of,
)
from sassgis.io.read.gap_thresholds import cause_weights_of, read_thresholds
from sassgis.model.effects import EffectSettings


@pytest.mark.parametrize("family", [None, *FAMILIES])
def test_the_same_parameter_draws_make_the_same_draw(
    problem: CalibrationProblem, family: str | None
) -> None:
    families = () if family is None else (family,)
    made = draw(problem.case, families, ParameterDraws(np.random.default_rng(8)))
    again = draw(
        problem.case, families, ParameterDraws(np.random.default_rng(9), made.parameter_draws)
    )
    assert again == made
    assert model_from_json(json.loads(json.dumps(model_as_json(made.model)))) == made.model


def test_effects_that_are_on_already_are_not_tried(problem: CalibrationProblem) -> None:
    with_trees = replace(problem.case, effects=EffectSettings(Forest()))
    assert "trees" not in families_to_try(with_trees)
    assert len(families_to_try(problem.case)) == len(FAMILIES)


def without_columns(case: Case, table: str, *columns: str) -> Case:
    rows = getattr(case.observations, table)
    blind = {name: np.full(len(rows), np.nan) for name in columns}
    return replace(case, observations=replace(case.observations, **{table: replace(rows, **blind)}))


def test_not_measured_stays_not_measured(problem: CalibrationProblem) -> None:
    """As against absent: such a rock was at the station, and no score counts what it lacks."""
    whole = rock_quantities(problem.case, problem.observed)
    blind = without_columns(problem.case, "passages", "rotation_hz")
    seen = rock_quantities(blind, observed_campaign(blind))
    assert np.isfinite(whole["S0:rotation"]).any() and "S0:rotation" in problem.scale.names
    assert np.isnan(seen["S0:rotation"]).all()
    np.testing.assert_array_equal(seen["S0:passed"], whole["S0:passed"])
    np.testing.assert_array_equal(seen["S0:speed"], whole["S0:speed"])
    expected = [name for name in problem.scale.names if not name.endswith(":rotation")]
    assert list(scale_of(blind, seen).names) == expected


def test_deflection_that_is_configured_stays(problem: CalibrationProblem) -> None:
    on = replace(problem.case, effects=EffectSettings(LateralDeflection()))
    base = draw(on, (), ParameterDraws(np.random.default_rng(1)))
    assert base.model.lateral_walk == LateralWalk(angle_deg=10.0, hop_m=10.0)
    assert "lateral_deflection" not in families_to_try(on)


def test_reaches_between_chainages(problem: CalibrationProblem) -> None:
    case = problem.case
    assert reaches_between(case, -5.0, 1e9) == case.reaches
    assert reaches_between(case, 0.0, 1.0) == case.reaches[:1]


def printed(effect: str, z: float, p: float = 0.001) -> Fingerprint:
    return Fingerprint(effect, f"what shows {effect}", 1.0, z, p, True, 30)


def gap(size: float, p: float = 0.001) -> GapFinding:
    """A gap of 30 rocks whose scatter is 1."""
    half = 1.96 / 30**0.5
    return GapFinding(
        "S1", "flight", "speed_mps", size, "m/s", (size - half, size + half), p, p, 30, size, 0.0,
        "free run", 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


def shares(**p: float) -> dict[str, float]:
    """Probabilities, the rest shared by all other families and "none" at most."""
    rest = (1.0 - sum(p.values())) / (len(FAMILIES) + 1 - len(p))
    own = {name: p.get(name, rest) for name in (*FAMILIES, NONE)}
    return dict(sorted(own.items(), key=lambda item: -item[1]))


FROZEN = Thresholds(named=0.6, grouped=0.7)


def answer(prints: list[Fingerprint], p: dict[str, float], gaps: list[GapFinding],
           most: float | None = None) -> tuple[str, str]:  # fmt: skip
    law = any(f.effect == CONTACT_LAW for f in prints)
    return decide(prints, p, gaps, most, FROZEN, law)[:2]


def test_none_is_answered_only_where_the_base_is_adequate() -> None:
    nothing = shares(none=0.9)
    assert answer([], nothing, [gap(0.2)]) == (NONE, "")
    assert answer([], nothing, [gap(0.8, 0.2)]) == (NONE, "")
    assert answer([], nothing, [gap(0.8)]) == ("unknown", "")
    law = [printed(CONTACT_LAW, 6.0)]
    assert answer(law, nothing, [gap(0.8)]) == (CONTACT_LAW, "contact")
    assert answer(law, nothing, [gap(0.2)]) == (NONE, "")
    assert adequate([gap(0.2)]) and not adequate([gap(-0.8)])


def test_a_family_is_named_where_it_is_probable_and_could_be_seen() -> None:
    trees = shares(trees=0.8)
    assert answer([printed("trees", 5.0)], trees, [gap(1.0)], 0.5) == ("trees", "along the way")
    # Neither where its fingerprint cannot be seen, nor where it certainly closes none of the gap.
    assert answer([printed("air_drag", 5.0)], trees, [gap(1.0)])[0] == "unknown"
    assert answer([printed("trees", 5.0)], trees, [gap(1.0)], -0.1) == ("unknown", "")
    two = shares(trees=0.45, air_drag=0.4)
    assert answer([printed("trees", 5.0)], two, [gap(1.0)]) == ("unknown", "along the way")


def test_a_second_cause_is_named_if_it_is_none_of_the_consequences_of_the_first() -> None:
    first = printed("fragmentation", 9.0)
    start, side = printed("release_error", 8.0), printed("lateral_deflection", 11.0)
    p = shares(fragmentation=0.9, release_error=0.06, lateral_deflection=0.03)
    assert answer([first, start], p, [gap(1.0)]) == ("fragmentation+release_error", "extra blocks")
    assert answer([first, side], p, [gap(1.0)]) == ("fragmentation", "extra blocks")
    assert answer([first, printed("release_error", 5.0)], p, [gap(1.0)])[0] == "fragmentation"
    # Nor where another cause is as probable as the second.
    p = shares(fragmentation=0.9, release_error=0.03)
    assert answer([first, start], p, [gap(1.0)]) == ("fragmentation", "extra blocks")
    assert group_of("trees") == "along the way" and group_of("unknown") == ""


def test_the_confusion_set_holds_the_answer_and_what_is_probable() -> None:
    p = shares(trees=0.7, air_drag=0.2)
    assert confusion_set("trees", p, 0.85) == ("trees", "air_drag")
    assert confusion_set("unknown", p, 0.6) == ("unknown", "trees")


def test_the_frozen_weights_follow_the_fingerprints() -> None:
    weights = cause_weights_of(read_thresholds())
    assert set(weights.causes) == {*FAMILIES, NONE} and set(weights.statistics) == set(STATISTICS)
    nothing = [Fingerprint(e, s, 0.0, 0.0, 1.0, True, 30) for s, e in STATISTICS.items()]
    base = weights.shares(nothing, FAMILIES)
    assert sum(base.values()) == pytest.approx(1.0)
    for effect in FAMILIES:
        sure = [replace(f, z=8.0) if f.effect == effect else f for f in nothing]
        found = weights.shares(sure, FAMILIES)
        assert found[effect] > base[effect]
        # What is not tried is not named.
        assert effect not in weights.shares(sure, [n for n in FAMILIES if n != effect])


def test_what_is_unlike_every_site_is_told() -> None:
    weights = cause_weights_of(read_thresholds())
    fitted = zip(weights.statistics[: weights.usual.size], weights.usual, strict=True)
    usual = [Fingerprint(STATISTICS[s], s, 0.0, 4.0 * v, 1.0, True, 30) for s, v in fitted]
    assert weights.is_typical(usual) and weights.is_typical([])
    assert not weights.is_typical([replace(f, z=8.0) for f in usual])
