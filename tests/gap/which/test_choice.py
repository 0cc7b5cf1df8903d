"""Campaigns, features, calibration and the choice between causes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.simulated_slope import TABLE, observed

from sassgis.engine.effects.trees import Trees as Forest
from sassgis.gap.inference import distances as scores
from sassgis.gap.ladder.calibration import distances, folds_of, refine, run_refined, shrinkage_of
from sassgis.gap.observations.campaign import LOOSE, PIECE, main_blocks, observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import (
    ForestStand,
    HypothesisModel,
    LateralWalk,
    MeasurementError,
    ReleaseError,
)
from sassgis.gap.replicas.model_json import model_as_json, model_from_json
from sassgis.gap.replicas.rock_lines import dips_at, heights_at_chainage, rock_lines_of
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
    Ensemble,
    Tried,
    ensemble_of,
    problem_of,
    rock_scores,
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

ORDER = {name: i for i, name in enumerate(FAMILIES)}


@pytest.fixture(scope="module")
def problem() -> CalibrationProblem:
    return problem_of(observed(24, 3), 5)


@pytest.fixture(scope="module")
def made(problem: CalibrationProblem) -> tuple[Base, list[Tried]]:
    return base_of(problem, 20)


@pytest.fixture(scope="module")
def ensemble(problem: CalibrationProblem, made: tuple[Base, list[Tried]]) -> Ensemble:
    tasks = tasks_of(("lateral_deflection", "air_drag", "fragmentation"), 10)
    return ensemble_of(
        problem,
        [*made[1], *(try_task(problem, task, ORDER) for task in tasks)],
    )


def plain(problem: CalibrationProblem, **changes: object) -> HypothesisModel:
    return HypothesisModel(TABLE, EffectSettings(), **changes)  # type: ignore[arg-type]


def test_what_the_base_model_shows_is_what_it_made(problem: CalibrationProblem) -> None:
    """The field is the engine itself: its own campaigns look like it, station by station."""
    samples = campaigns(
        problem.case,
        problem.rock_lines,
        plain(problem),
        count=30,
        seed=2,
    )
    seen = rock_quantities(problem.case, observed_campaign(problem.case))
    made = [rock_quantities(problem.case, sample) for sample in samples]
    for name in ("stop:runout", "S0:speed", "S1:rotation", "hit:kept", "S0:height"):
        means = np.array([np.nanmean(one[name]) for one in made])
        assert abs(np.nanmean(seen[name]) - means.mean()) < 4.5 * means.std(), name


def test_campaigns_are_the_same_however_they_are_asked_for(
    problem: CalibrationProblem,
) -> None:
    one = campaigns(
        problem.case,
        problem.rock_lines,
        plain(problem),
        count=2,
        seed=2,
        number=7,
    )
    again = campaigns(
        problem.case,
        problem.rock_lines,
        plain(problem),
        count=2,
        seed=2,
        number=7,
    )
    other = campaigns(
        problem.case,
        problem.rock_lines,
        plain(problem),
        count=2,
        seed=2,
        number=8,
    )
    assert one[0].deposits is not None and again[0].deposits is not None
    np.testing.assert_array_equal(one[0].deposits.s, again[0].deposits.s)
    assert other[0].deposits is not None
    assert not np.array_equal(one[0].deposits.s, other[0].deposits.s)


def test_scatter_aside_grows_as_a_random_walk(problem: CalibrationProblem) -> None:
    walk = LateralWalk(angle_deg=10.0, hop_m=8.0)
    rows = [
        s.deposits
        for s in campaigns(
            problem.case,
            problem.rock_lines,
            plain(problem, lateral_walk=walk),
            count=60,
            seed=2,
        )
    ]
    s = np.concatenate([r.s for r in rows if r is not None])
    aside = np.concatenate([r.lateral_m for r in rows if r is not None])
    expected = np.sqrt(np.tan(np.radians(10.0)) ** 2 * 8.0 * s + 0.25**2)
    assert np.std(aside / expected) == pytest.approx(1.0, abs=0.08)
    assert abs(np.mean(aside / expected)) < 0.1


def test_measurement_scales_what_is_read(problem: CalibrationProblem) -> None:
    def speed(measurement: MeasurementError) -> float:
        model = plain(problem, measurement=measurement)
        rows = campaigns(problem.case, problem.rock_lines, model, count=10, seed=2)
        return float(
            np.mean(np.concatenate([r.passages.speed_mps for r in rows if r.passages is not None]))
        )

    assert speed(MeasurementError(scale=1.2)) == pytest.approx(
        1.2 * speed(MeasurementError()), rel=1e-9
    )


def test_release_moves_the_start(problem: CalibrationProblem) -> None:
    shifted = plain(problem, release=ReleaseError(shift_m=5.0))
    rows = campaigns(problem.case, problem.rock_lines, shifted, count=10, seed=2)
    aside = np.concatenate([r.deposits.lateral_m for r in rows if r.deposits is not None])
    assert np.mean(aside) == pytest.approx(5.0, abs=0.2)


def test_a_stand_takes_energy_only_where_it_stands(problem: CalibrationProblem) -> None:
    model = replace(
        plain(problem, stand=ForestStand(46.0, 79.0, 4000.0, 50.0)),
        effects=EffectSettings(Forest()),
    )
    with_trees = campaigns(problem.case, problem.rock_lines, model, count=20, seed=2)
    without = campaigns(
        problem.case,
        problem.rock_lines,
        plain(problem),
        count=20,
        seed=2,
    )

    def speed(rows: list, station: int) -> float:  # type: ignore[type-arg]
        return float(
            np.mean(
                np.concatenate([r.passages.speed_mps[r.passages.station == station] for r in rows])
            )
        )

    assert speed(with_trees, 0) == pytest.approx(speed(without, 0), rel=0.02)
    assert speed(with_trees, 1) < 0.5 * speed(without, 1)


def test_pieces_and_loose_blocks_keep_to_their_campaign(
    problem: CalibrationProblem,
) -> None:
    for family, kind in (("fragmentation", PIECE), ("entrainment", LOOSE)):
        parameter_draws = {"break.energy": 0.1, "set_off.number": 0.9}
        made = draw(
            problem.case,
            (family,),
            ParameterDraws(np.random.default_rng(1), parameter_draws),
        )
        for sample in campaigns(problem.case, problem.rock_lines, made.model, count=3, seed=2):
            rows = sample.deposits
            assert rows is not None
            assert (rows.kind == kind).any()
            assert rows.rock.max() < sample.n_rocks
            assert ((rows.rock == -1) == (rows.kind == LOOSE)).all()
            main = main_blocks(rows, sample.n_rocks)
            assert (rows.rock[main[main >= 0]] == np.flatnonzero(main >= 0)).all()


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


def test_scores_are_those_of_the_room_of_scores() -> None:
    rng = np.random.default_rng(5)
    seen, replicas = rng.normal(size=(12, 4)), rng.normal(size=(5, 12, 4))
    ensembles = replicas.transpose(1, 0, 2)
    expected = scores.energy_scores(ensembles, seen, scale=np.ones(4))
    np.testing.assert_allclose(rock_scores(seen, replicas), expected, rtol=1e-12)
    found = distances(seen, replicas, replicas + 1.0)
    pool = replicas.reshape(-1, 4)
    expected_distance = scores.energy_distance(seen, pool, scale=np.ones(4), unbiased=True)
    assert found.base == pytest.approx(expected_distance, abs=1e-12)
    assert found.effect > found.base


def test_shrinkage_is_one_where_the_effect_explains_all_and_withheld_without_a_gap() -> None:
    rng = np.random.default_rng(6)
    seen = rng.normal(size=(200, 3))
    far, near = rng.normal(2.0, 1.0, size=(8, 200, 3)), rng.normal(size=(8, 200, 3))
    assert distances(seen, far, near).shrinkage == pytest.approx(1.0, abs=0.05)
    assert distances(seen, near, near).shrinkage is None


def test_profiles_are_read_where_they_are(problem: CalibrationProblem) -> None:
    bare = problem.rock_lines.unforested
    for i in (0, 5):
        s, z = bare.vertices(i)
        at = np.linspace(s[0] + 0.5, s[-1] - 0.5, 40)
        which = np.full(at.size, i)
        np.testing.assert_allclose(heights_at_chainage(bare, which, at), np.interp(at, s, z))
        ahead = np.interp(at + 1e-6, s, z) - np.interp(at, s, z)
        np.testing.assert_allclose(np.tan(dips_at(bare, which, at)), ahead / 1e-6, atol=1e-4)


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


def test_refinement_betters_the_score(problem: CalibrationProblem, ensemble: Ensemble) -> None:
    before = ensemble.scores[ensemble.of(NONE)].mean(axis=1).min()
    refined = refine(
        problem, ensemble, (NONE,), lambda tasks: [run_refined(problem, t) for t in tasks],
        rounds=2, draws=8,
    )  # fmt: skip
    best = refined.scores[refined.of(NONE)].mean(axis=1)
    assert best.min() <= before
    assert len(refined.of(NONE)) == len(ensemble.of(NONE)) + 16


def test_without_a_gap_no_shrinkage_is_stated(
    problem: CalibrationProblem, ensemble: Ensemble
) -> None:
    part = folds_of(problem.case.n_rocks, 1)
    assert np.bincount(part).min() >= problem.case.n_rocks // 5
    found = shrinkage_of(problem, ensemble, NONE, part, draws=0, seed=1)
    assert found.value is None and found.note


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


def test_impacts_alone_can_be_told_apart_but_not_scored() -> None:
    alone = problem_of(observed(12, 1, tables=("impacts",)), 1)
    _, base = base_of(alone, 8)
    tried = [try_task(alone, task, ORDER) for task in tasks_of(("air_drag",), 3)]
    ensemble = ensemble_of(alone, [*base, *tried])
    assert ensemble.scores.shape == (11, 12)
    found = shrinkage_of(alone, ensemble, "air_drag", folds_of(12, 1), draws=5, seed=1)
    assert found.value is None and "no distance" in found.note


def test_numbers_of_a_campaign_exist_for_few_rocks() -> None:
    case = observed(6, 1, tables=("passages", "deposits"))
    told, _ = summary(case, observed_campaign(case), covariates_of(case))
    assert told and not any(name.startswith("hit") for name in told)
    assert rock_lines_of(case).keys.size == 6
