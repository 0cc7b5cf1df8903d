"""Draws of hypotheses, and the choice between causes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import ORDER

from sassgis.engine.effects.trees import Trees as Forest
from sassgis.gap.diagnosis import Fingerprint, GapFinding
from sassgis.gap.observations.campaign import observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import (
    LateralWalk,
)
from sassgis.gap.replicas.model_json import model_as_json, model_from_json
from sassgis.gap.which.ensemble import (
    CalibrationProblem,
    scale_of,
    tasks_of,
    try_task,
)
from sassgis.gap.which.families import FAMILIES
from sassgis.gap.which.features import rock_quantities
from sassgis.gap.which.hypotheses import NONE, ParameterDraws, draw, families_to_try
from sassgis.gap.which.verdict import (
    CONTACT_LAW,
    Thresholds,
    adequate,
    causes_of,
    confusion_set,
    decide,
    group_of,
    measure_next,
    reaches_between,
    shares_of,
)
from sassgis.model.effects import EffectSettings
from sassgis.model.settings import LateralDeflection


@pytest.mark.parametrize("family", [None, *FAMILIES])
def test_the_same_parameter_draws_make_the_same_draw(
    problem: CalibrationProblem, family: str | None
) -> None:
    families = () if family is None else (family,)
    made = draw(problem.case, families, ParameterDraws(np.random.default_rng(8)))
    again = draw(
        problem.case,
        families,
        ParameterDraws(np.random.default_rng(9), made.parameter_draws),
    )
    assert again == made
    assert model_from_json(json.loads(json.dumps(model_as_json(made.model)))) == made.model


def test_effects_that_are_on_already_are_not_tried(problem: CalibrationProblem) -> None:
    with_trees = replace(problem.case, effects=EffectSettings(Forest()))
    assert "trees" not in families_to_try(with_trees)
    assert len(families_to_try(problem.case)) == len(FAMILIES)


def test_the_order_of_draws_changes_nothing(problem: CalibrationProblem) -> None:
    tasks = tasks_of(("air_drag",), 3)
    forth = {t: try_task(problem, t, ORDER) for t in tasks}
    back = {t: try_task(problem, t, ORDER) for t in reversed(tasks)}
    for task in tasks:
        np.testing.assert_array_equal(forth[task].rows, back[task].rows)
        assert forth[task].draw == back[task].draw


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


def test_reaches_and_measurements(problem: CalibrationProblem) -> None:
    case = problem.case
    assert reaches_between(case, -5.0, 1e9) == case.reaches
    assert reaches_between(case, 0.0, 1.0) == case.reaches[:1]
    assert measure_next(case, ("trees",)) == ()
    bare = replace(
        case, observations=replace(case.observations, impacts=case.observations.impacts.take(
            np.zeros(len(case.observations.impacts), bool)
        )),
    )  # fmt: skip
    said = measure_next(bare, ("soft_ground", "roughness"))
    assert said and any("before and after impacts" in line for line in said)


def printed(effect: str, z: float, p: float = 0.001) -> Fingerprint:
    return Fingerprint(effect, "what was looked at", 1.0, z, p, True, 30)


def gap(size: float, p: float = 0.001) -> GapFinding:
    """A gap of 30 rocks whose scatter is 1."""
    half = 1.96 / 30**0.5
    return GapFinding(
        "S1", "flight", "speed_mps", size, "m/s", (size - half, size + half), p, p, 30, size, 0.0,
        "free run", 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


def test_none_is_answered_only_where_the_base_is_adequate() -> None:
    frozen = Thresholds()
    weak = [printed("trees", 2.0, 0.3)]
    assert decide(weak, [gap(0.2)], None, frozen, FAMILIES)[0] == NONE
    assert decide(weak, [gap(0.8, 0.2)], None, frozen, FAMILIES)[0] == NONE
    effect, reason = decide(weak, [gap(0.8)], None, frozen, FAMILIES)
    assert effect == "unknown" and "cannot answer which" in reason
    assert adequate([gap(0.2)]) and not adequate([gap(-0.8)])


def test_a_cause_is_named_by_its_fingerprint_and_not_by_what_follows_from_it() -> None:
    frozen = Thresholds()
    trees = [printed("trees", 5.0), printed("lateral_deflection", 9.0), printed(CONTACT_LAW, 7.0)]
    assert causes_of(trees, frozen, FAMILIES) == ["trees"]
    assert decide(trees, [gap(1.0)], 0.5, frozen, FAMILIES)[0] == "trees"
    # Neither what was not tried, nor what certainly closes none of the gap.
    assert decide(trees[:1], [gap(1.0)], 0.5, frozen, ("air_drag",))[0] == "unknown"
    assert decide(trees, [gap(1.0)], -0.1, frozen, FAMILIES)[0] == "unknown"
    assert group_of("trees") == "along the way" and group_of("unknown") == ""
    two = [printed("fragmentation", 8.0), printed("release_error", 9.0)]
    assert decide(two, [gap(1.0)], 0.5, frozen, FAMILIES)[0] == "fragmentation+release_error"


def test_a_shift_of_the_contact_is_no_effect_at_the_contact() -> None:
    frozen = Thresholds()
    law = [printed(CONTACT_LAW, 9.0), printed("roughness", 4.0), printed("soft_ground", 6.0)]
    assert decide(law, [gap(1.0)], 0.5, frozen, FAMILIES)[0] == CONTACT_LAW
    held = confusion_set(CONTACT_LAW, law, FAMILIES, frozen)
    assert held[:1] == (CONTACT_LAW,) and {"roughness", "soft_ground"} <= set(held)
    shape = [printed(CONTACT_LAW, 5.0), printed("rock_shape", 4.5)]
    assert decide(shape, [gap(1.0)], 0.5, frozen, FAMILIES)[0] == "rock_shape"


def test_weights_follow_the_fingerprints() -> None:
    found = shares_of([printed("trees", 6.0), printed("air_drag", 1.0)], FAMILIES)
    assert sum(found.values()) == pytest.approx(1.0)
    assert next(iter(found)) == "trees"
    assert found["trees"] / found["air_drag"] == pytest.approx(np.exp(5.0))
