"""Features, signatures, classifier and the choice between causes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.simulated_slope import ORDER, observed

from sassgis.engine.effects.trees import Trees as Forest
from sassgis.gap.observations.campaign import observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import (
    LateralWalk,
)
from sassgis.gap.replicas.model_json import model_as_json, model_from_json
from sassgis.gap.replicas.rock_lines import rock_lines_of
from sassgis.gap.which.classifier import (
    DESIGNS,
    Classifier,
    TreeEnsemble,
    cautious,
    designs_of,
    no_idea,
)
from sassgis.gap.which.ensemble import (
    CalibrationProblem,
    Tried,
    problem_of,
    scale_of,
    tasks_of,
    try_task,
)
from sassgis.gap.which.families import FAMILIES
from sassgis.gap.which.features import correlations, covariates_of, rock_quantities, summary
from sassgis.gap.which.hypotheses import NONE, ParameterDraws, draw, families_to_try
from sassgis.gap.which.signature import (
    Base,
    base_of,
    features_of,
    kind_and_place,
    observed_signature,
    reference_of,
    signature_of,
)
from sassgis.gap.which.verdict import (
    Thresholds,
    best_cause,
    confusion_set,
    decide,
    measure_next,
    pair_of,
    reaches_between,
)
from sassgis.io.read.gap_thresholds import read_classifier, write_classifiers
from sassgis.model.effects import EffectSettings
from sassgis.model.errors import InputError
from sassgis.model.settings import LateralDeflection


def test_correlations_are_those_of_numpy() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(40, 3)), rng.normal(size=(40, 2))
    y[:, 0] += x[:, 1]
    y[rng.random(y.shape) < 0.2] = np.nan
    for i in range(2):
        for j in range(3):
            known = np.isfinite(y[:, i])
            r = np.corrcoef(y[known, i], x[known, j])[0, 1]
            expected = np.arctanh(r) * np.sqrt(known.sum() - 3)
            assert correlations(y, x)[i, j] == pytest.approx(expected, abs=1e-9)


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


def test_kinds_of_numbers_do_not_know_places() -> None:
    assert kind_and_place("S12:speed|mean") == ("S:speed|mean", 12)
    assert kind_and_place("hit3:kept|all_sd") == ("hit_leg:kept|all_sd", 3)
    assert kind_and_place("leg2:speed_change~S1:speed") == ("leg:speed_change~S:speed", 2)
    assert kind_and_place("hit@meadow:kept~size", ("meadow",)) == ("hit_soft:kept~size", 0)
    assert kind_and_place("hit@rock:kept~size", ("meadow",)) == ("hit_hard:kept~size", 0)


def test_the_order_of_draws_changes_nothing(problem: CalibrationProblem) -> None:
    tasks = tasks_of(("air_drag",), 3)
    forth = {t: try_task(problem, t, ORDER) for t in tasks}
    back = {t: try_task(problem, t, ORDER) for t in reversed(tasks)}
    for task in tasks:
        np.testing.assert_array_equal(forth[task].rows, back[task].rows)
        assert forth[task].draw == back[task].draw


def test_the_signature_of_the_base_is_none(
    problem: CalibrationProblem, made: tuple[Base, list[Tried]]
) -> None:
    """The field is the base model: no more of its signature is far off than chance makes."""
    values = np.array(list(observed_signature(made[0]).values()))
    assert values.size > 400
    assert np.mean(np.abs(values) > 3.0) < 0.03
    assert np.median(np.abs(values)) < 1.0


def test_calibration_takes_out_what_the_ground_explains() -> None:
    rng = np.random.default_rng(3)
    moved = np.repeat(rng.normal(size=(60, 2)), 2, axis=0)
    slope = rng.normal(size=(30, 2))
    x = moved @ slope.T + 0.8 * rng.normal(size=(120, 30))
    names = [f"n{k}" for k in range(30)]
    reference = reference_of(names, x, moved, ())
    other_ground = dict(zip(names, slope @ np.array([1.2, -0.8]), strict=True))
    effect = dict(zip(names, 2.0 * rng.choice([-1.0, 1.0], 30), strict=True))

    def left(numbers: dict[str, float]) -> float:
        told = signature_of(reference, numbers)
        return float(np.mean([abs(v) for name, v in told.items() if name.startswith("r|")]))

    assert left(other_ground) < 0.8
    assert left(effect) > 2.0
    assert set(signature_of(reference, {"n3": 1.0, "n4": np.nan})) == {"p|n3", "r|n3"}


def test_an_effect_shows_where_it_acts(
    problem: CalibrationProblem, made: tuple[Base, list[Tried]]
) -> None:
    base = made[0]
    reference = reference_of(base.names, base.x, base.moved, base.soft)

    def seen(family: str, **parameter_draws: float) -> dict[str, float]:
        one = draw(
            problem.case,
            (family,),
            ParameterDraws(np.random.default_rng(1), parameter_draws),
        )
        sample = campaigns(problem.case, problem.rock_lines, one.model, count=1, seed=2, number=3)[
            0
        ]
        return signature_of(reference, features_of(base, sample))

    assert seen("fragmentation", **{"break.energy": 0.1})["p|stop:more_blocks"] > 4.0
    assert seen("entrainment", **{"set_off.number": 0.9})["p|loose:number"] > 4.0
    kicks = {"lateral.form": 0.1, "lateral.angle": 0.9, "lateral.hop": 0.9}
    assert seen("lateral_deflection", **kicks)["r|step_hit:turn|sd"] > 4.0
    slow = {"air.coefficient": 0.95}
    assert seen("air_drag", **slow)["r|step_fly:loss|mean"] > 3.0


def test_numbers_that_are_missing_are_not_told(
    problem: CalibrationProblem, made: tuple[Base, list[Tried]]
) -> None:
    few = replace(
        problem.case,
        observations=replace(
            problem.case.observations,
            impacts=problem.case.observations.impacts.take(
                np.zeros(len(problem.case.observations.impacts), bool)
            ),
        ),
    )
    assert designs_of(problem.case) == ("everything", "both", "stations", "stops")
    assert designs_of(few) == ("both", "stations", "stops")
    base, _ = base_of(problem_of(few, 1), 6)
    assert not any("hit" in name for name in observed_signature(base))
    assert not any("S" in name for name in observed_signature(base, "stops"))


def without_columns(case: Case, table: str, *columns: str) -> Case:
    rows = getattr(case.observations, table)
    blind = {name: np.full(len(rows), np.nan) for name in columns}
    return replace(case, observations=replace(case.observations, **{table: replace(rows, **blind)}))


@pytest.mark.parametrize(
    ("table", "columns"),
    [
        ("impacts", ("omega_in_radps", "omega_out_radps")),
        ("passages", ("rotation_hz", "height_m")),
    ],
)
def test_columns_that_were_not_measured_make_no_effect(
    problem: CalibrationProblem, table: str, columns: tuple[str, ...]
) -> None:
    """The field is the base model; without some columns it still is."""
    blind = without_columns(problem.case, table, *columns)
    base, _ = base_of(problem_of(blind, 5), 20)
    values = np.array(list(observed_signature(base).values()))
    assert values.size > 200
    assert np.mean(np.abs(values) > 3.0) < 0.03


def test_not_measured_stays_not_measured(problem: CalibrationProblem) -> None:
    """As against absent: such a rock was at the station, and no score counts what it lacks."""
    whole = rock_quantities(problem.case, problem.observed)
    blind = without_columns(problem.case, "passages", "rotation_hz")
    seen = rock_quantities(blind, observed_campaign(blind))
    assert np.isfinite(whole["S0:rotation"]).any() and "S0:rotation" in problem.scale.names
    assert np.isnan(seen["S0:rotation"]).all() and np.isnan(seen["S0:spin_ratio"]).all()
    np.testing.assert_array_equal(seen["S0:passed"], whole["S0:passed"])
    np.testing.assert_array_equal(seen["S0:speed"], whole["S0:speed"])
    expected = [name for name in problem.scale.names if not name.endswith(":rotation")]
    assert list(scale_of(blind, seen).names) == expected
    base, _ = base_of(problem_of(blind, 5), 6)
    assert not any("rotation" in name for name in observed_signature(base))


def test_too_little_is_no_idea(problem: CalibrationProblem) -> None:
    classifier = read_classifier("stations")
    assert classifier.seen({}) == 0.0
    base, _ = base_of(problem, 6)
    assert classifier.seen(observed_signature(base, "stations")) > 0.3
    nothing = no_idea((NONE, *FAMILIES, "unknown", "pair"))
    assert decide(nothing, None, Thresholds(0.4, 0.45))[0] == "unknown"


def test_deflection_that_is_configured_stays(problem: CalibrationProblem) -> None:
    on = replace(problem.case, effects=EffectSettings(LateralDeflection()))
    base = draw(on, (), ParameterDraws(np.random.default_rng(1)))
    assert base.model.lateral_walk == LateralWalk(angle_deg=10.0, hop_m=10.0)
    assert "lateral_deflection" not in families_to_try(on)


def small_classifier() -> Classifier:
    """Two trees of one question each."""
    trees = TreeEnsemble(
        np.array([0, 3]),
        np.array([0, 0, 0, 1, 0, 0]),
        np.array([0.5, 0, 0, -0.5, 0, 0], np.float32),
        np.array([1, 1, 2, 4, 4, 5]),
        np.array([2, 1, 2, 5, 4, 5]),
        np.array(
            [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 1], [0.4, 0.6, 0]], np.float32
        ),
    )
    return Classifier(
        ("a", "b"),
        (NONE, "trees", "unknown"),
        np.array([1.0, 0.0], np.float32),
        np.array([2.0, 1.0], np.float32),
        trees,
        1.0,
        np.ones(3),
        1.0,
    )


def test_trees_are_asked_from_the_root() -> None:
    classifier = small_classifier()
    # (3 - 1) / 2 is above 0.5, 0 above -0.5.
    found = classifier.probabilities({"a": 3.0})
    assert list(found) == ["trees", NONE, "unknown"]
    assert found["trees"] == pytest.approx((0.8 + 1e-3) / (1.0 + 3e-3))
    assert sum(found.values()) == pytest.approx(1.0)
    # A number that is missing counts as usual: left, and right.
    assert classifier.probabilities({})[NONE] == pytest.approx(0.7, abs=0.01)
    assert classifier.probabilities({"a": 3.0}, excluded=("trees",))[NONE] > 0.98


def test_classifiers_are_read_as_they_were_written(tmp_path: Path) -> None:
    file = tmp_path / "classifiers.npz"
    write_classifiers(file, dict.fromkeys(DESIGNS, small_classifier()))
    read = read_classifier("both", file)
    for signature in ({"a": 3.0}, {"b": -2.0}, {}):
        expected = small_classifier().probabilities(signature)
        found = read.probabilities(signature)
        assert found == pytest.approx(expected, abs=0.01)
    assert read.confidence_calibration == 1.0
    with pytest.raises(InputError, match="cannot be read"):
        read_classifier("walls", file)
    with pytest.raises(InputError, match="cannot be read"):
        read_classifier("both", tmp_path / "none.npz")


def test_confidence_calibration_lowers_confidence() -> None:
    p = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(cautious(p, 0.0), p, atol=1e-12)
    lowered = cautious(p, 2.0)
    assert (np.diff(lowered) > 0.0).all()
    assert lowered[0] == 0.0 and lowered[-1] == pytest.approx(1.0)
    assert (lowered[1:-1] < p[1:-1]).all()
    odds = 0.6 / 0.4 * np.exp(2.0)
    assert cautious(odds / (1.0 + odds), 2.0) == pytest.approx(0.6)


def test_decisions() -> None:
    thresholds = Thresholds(none_share=0.4, least_confidence=0.45, confusion_mass=0.9)
    clear = {"trees": 0.85, "air_drag": 0.08, NONE: 0.05, "unknown": 0.02}
    assert decide(clear, 0.7, thresholds)[:2] == ("trees", 0.85)
    assert decide(clear, -0.05, thresholds)[0] == "unknown"
    assert decide(clear, None, thresholds)[0] == "trees"
    chance = {"trees": 0.55, NONE: 0.42, "unknown": 0.03}
    assert decide(chance, 0.7, thresholds)[:2] == (NONE, 0.42)
    torn = {"trees": 0.4, "air_drag": 0.33, "roughness": 0.25, NONE: 0.02}
    assert decide(torn, 0.7, thresholds)[0] == "unknown"
    assert confusion_set("trees", torn, thresholds) == ("trees", "air_drag", "roughness")
    strange = {"unknown": 0.6, "trees": 0.3, NONE: 0.1}
    assert decide(strange, 0.7, thresholds)[:2] == ("unknown", 0.6)
    two = {"pair": 0.6, "trees": 0.2, "air_drag": 0.15, NONE: 0.05}
    assert best_cause(two) == pair_of(two) == "air_drag+trees"
    assert decide(two, 0.7, thresholds)[:2] == ("air_drag+trees", 0.6)
    assert confusion_set("air_drag+trees", two, thresholds) == ("air_drag", "trees", NONE)


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


def test_numbers_of_a_campaign_exist_for_few_rocks() -> None:
    case = observed(6, 1, tables=("passages", "deposits"))
    told, _ = summary(case, observed_campaign(case), covariates_of(case))
    assert told and not any(name.startswith("hit") for name in told)
    assert rock_lines_of(case).keys.size == 6
