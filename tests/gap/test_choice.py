"""Campaigns, features, calibration and the choice between causes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from simulated_slope import TABLE, observed

from sassgis.core.effects import EffectSettings, Trees
from sassgis.gap import scores
from sassgis.gap.choose import Odds, Thresholds, confused_with, kind_of, odds_of, problem_of
from sassgis.gap.contenders import NONE, Dials, draw, families_to_try
from sassgis.gap.families import FAMILIES
from sassgis.gap.features import _z_table, covariates_of, rock_quantities, summary
from sassgis.gap.fit import distances, folds_of, refine, run_refined, shrinkage_of
from sassgis.gap.library import (
    Bench,
    Library,
    bench_of,
    library_of,
    rock_scores,
    tasks_of,
    try_task,
)
from sassgis.gap.model_json import model_as_json, model_from_json
from sassgis.gap.replicas import (
    Aside,
    Measurement,
    Model,
    Release,
    Stand,
    campaigns,
    dips_at,
    heights_at_chainage,
    ways_of,
)
from sassgis.gap.sample import LOOSE, PIECE, main_blocks, observed_sample
from sassgis.gap.verdict import Evidence, confusion_set, decide, legs_between, measure_next

ORDER = {name: i for i, name in enumerate(FAMILIES)}


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_of(observed(24, 3), 5)


@pytest.fixture(scope="module")
def library(bench: Bench) -> Library:
    tasks = tasks_of(("lateral_deflection", "air_drag", "fragmentation"), 10)
    return library_of(bench, [try_task(bench, task, ORDER) for task in tasks])


def plain(bench: Bench, **changes: object) -> Model:
    return Model(TABLE, EffectSettings(), **changes)  # type: ignore[arg-type]


def test_what_the_base_model_shows_is_what_it_made(bench: Bench) -> None:
    """The field is the engine itself: its own campaigns look like it, station by station."""
    samples = campaigns(bench.case, bench.ways, plain(bench), count=30, seed=2)
    seen = rock_quantities(bench.case, observed_sample(bench.case))
    made = [rock_quantities(bench.case, sample) for sample in samples]
    for name in ("stop:runout", "S0:speed", "S1:rotation", "hit:kept", "S0:height"):
        means = np.array([np.nanmean(one[name]) for one in made])
        assert abs(np.nanmean(seen[name]) - means.mean()) < 4.5 * means.std(), name


def test_campaigns_are_the_same_however_they_are_asked_for(bench: Bench) -> None:
    one = campaigns(bench.case, bench.ways, plain(bench), count=2, seed=2, number=7)
    again = campaigns(bench.case, bench.ways, plain(bench), count=2, seed=2, number=7)
    other = campaigns(bench.case, bench.ways, plain(bench), count=2, seed=2, number=8)
    assert one[0].deposits is not None and again[0].deposits is not None
    np.testing.assert_array_equal(one[0].deposits.s, again[0].deposits.s)
    assert other[0].deposits is not None
    assert not np.array_equal(one[0].deposits.s, other[0].deposits.s)


def test_scatter_aside_grows_as_a_random_walk(bench: Bench) -> None:
    walk = Aside(angle_deg=10.0, hop_m=8.0)
    rows = [
        s.deposits
        for s in campaigns(bench.case, bench.ways, plain(bench, aside=walk), count=60, seed=2)
    ]
    s = np.concatenate([r.s for r in rows if r is not None])
    aside = np.concatenate([r.aside_m for r in rows if r is not None])
    expected = np.sqrt(np.tan(np.radians(10.0)) ** 2 * 8.0 * s + 0.25**2)
    assert np.std(aside / expected) == pytest.approx(1.0, abs=0.08)
    assert abs(np.mean(aside / expected)) < 0.1


def test_measurement_scales_what_is_read(bench: Bench) -> None:
    def speed(measurement: Measurement) -> float:
        model = plain(bench, measurement=measurement)
        rows = campaigns(bench.case, bench.ways, model, count=10, seed=2)
        return float(
            np.mean(np.concatenate([r.passages.speed_mps for r in rows if r.passages is not None]))
        )

    assert speed(Measurement(scale=1.2)) == pytest.approx(1.2 * speed(Measurement()), rel=1e-9)


def test_release_moves_the_start(bench: Bench) -> None:
    shifted = plain(bench, release=Release(shift_m=5.0))
    rows = campaigns(bench.case, bench.ways, shifted, count=10, seed=2)
    aside = np.concatenate([r.deposits.aside_m for r in rows if r.deposits is not None])
    assert np.mean(aside) == pytest.approx(5.0, abs=0.2)


def test_a_stand_takes_energy_only_where_it_stands(bench: Bench) -> None:
    model = replace(
        plain(bench, stand=Stand(46.0, 79.0, 4000.0, 50.0)), effects=EffectSettings(trees=Trees())
    )
    with_trees = campaigns(bench.case, bench.ways, model, count=20, seed=2)
    without = campaigns(bench.case, bench.ways, plain(bench), count=20, seed=2)

    def speed(rows: list, station: int) -> float:  # type: ignore[type-arg]
        return float(
            np.mean(
                np.concatenate([r.passages.speed_mps[r.passages.station == station] for r in rows])
            )
        )

    assert speed(with_trees, 0) == pytest.approx(speed(without, 0), rel=0.02)
    assert speed(with_trees, 1) < 0.5 * speed(without, 1)


def test_pieces_and_loose_blocks_keep_to_their_campaign(bench: Bench) -> None:
    for family, kind in (("fragmentation", PIECE), ("entrainment", LOOSE)):
        dials = {"break.energy": 0.1, "set_off.number": 0.9}
        made = draw(bench.case, (family,), Dials(np.random.default_rng(1), dials))
        for sample in campaigns(bench.case, bench.ways, made.model, count=3, seed=2):
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
            assert _z_table(y, x)[i, j] == pytest.approx(expected, abs=1e-9)


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


def test_profiles_are_read_where_they_are(bench: Bench) -> None:
    bare = bench.ways.bare
    for i in (0, 5):
        s, z = bare.vertices(i)
        at = np.linspace(s[0] + 0.5, s[-1] - 0.5, 40)
        which = np.full(at.size, i)
        np.testing.assert_allclose(heights_at_chainage(bare, which, at), np.interp(at, s, z))
        ahead = np.interp(at + 1e-6, s, z) - np.interp(at, s, z)
        np.testing.assert_allclose(np.tan(dips_at(bare, which, at)), ahead / 1e-6, atol=1e-4)


@pytest.mark.parametrize("family", [None, *FAMILIES])
def test_the_same_dials_make_the_same_draw(bench: Bench, family: str | None) -> None:
    families = () if family is None else (family,)
    made = draw(bench.case, families, Dials(np.random.default_rng(8)))
    again = draw(bench.case, families, Dials(np.random.default_rng(9), made.dials))
    assert again == made
    assert model_from_json(json.loads(json.dumps(model_as_json(made.model)))) == made.model


def test_effects_that_are_on_already_are_not_tried(bench: Bench) -> None:
    with_trees = replace(bench.case, effects=EffectSettings(trees=Trees()))
    assert "trees" not in families_to_try(with_trees)
    assert len(families_to_try(bench.case)) == len(FAMILIES)


def test_kinds_of_numbers_do_not_know_places() -> None:
    assert kind_of("S12:speed|mean") == kind_of("S0:speed|mean")
    assert kind_of("hit@talus:kept~size") == kind_of("hit@rock:kept~size")
    assert kind_of("hit3:kept|all_sd") != kind_of("hit:kept|all_sd")
    assert kind_of("leg2:speed_change~S1:speed") == "leg:speed_change~S:speed"


def test_the_order_of_draws_changes_nothing(bench: Bench) -> None:
    tasks = tasks_of(("air_drag",), 3)
    forth = {t: try_task(bench, t, ORDER) for t in tasks}
    back = {t: try_task(bench, t, ORDER) for t in reversed(tasks)}
    for task in tasks:
        np.testing.assert_array_equal(forth[task].rows, back[task].rows)
        assert forth[task].draw == back[task].draw


def test_a_campaign_of_an_effect_is_told_from_the_base(bench: Bench, library: Library) -> None:
    thresholds = Thresholds()
    problem = problem_of(bench, library, thresholds)
    odds = odds_of(problem, thresholds, 1)
    np.testing.assert_allclose(odds.probability.sum(), 1.0)
    np.testing.assert_allclose(odds.held_out.sum(axis=1), 1.0)
    # The field is the base model: nothing speaks against it beyond chance.
    assert odds.evidence < np.quantile(odds.evidence_of_base, 0.995)
    broken = odds.label == "fragmentation"
    own = odds.held_out[broken][:, odds.effects.index("fragmentation")]
    assert own.mean() > 2.0 * odds.held_out[~broken][:, odds.effects.index("fragmentation")].mean()
    assert "fragmentation" not in confused_with(odds, "fragmentation")


def test_refinement_betters_the_score(bench: Bench, library: Library) -> None:
    before = library.scores[library.of(NONE)].mean(axis=1).min()
    refined = refine(
        bench, library, (NONE,), lambda tasks: [run_refined(bench, t) for t in tasks],
        rounds=2, draws=8,
    )  # fmt: skip
    best = refined.scores[refined.of(NONE)].mean(axis=1)
    assert best.min() <= before
    assert len(refined.of(NONE)) == len(library.of(NONE)) + 16


def test_without_a_gap_no_shrinkage_is_stated(bench: Bench, library: Library) -> None:
    part = folds_of(bench.case.n_rocks, 1)
    assert np.bincount(part).min() >= bench.case.n_rocks // 5
    found = shrinkage_of(bench, library, NONE, part, draws=0, seed=1)
    assert found.value is None and found.note


def some_odds(**shares: float) -> Odds:
    names = tuple(sorted({NONE, "trees", "air_drag", "roughness"}))
    p = np.array([shares.get(n, 0.0) for n in names])
    none = p[names.index(NONE)]
    evidence = float(np.log((1.0 - none) / none))
    return Odds(
        names,
        p,
        np.zeros((0, len(names))),
        np.empty(0, np.str_),
        evidence,
        np.linspace(-4.0, 2.0, 101),
    )


def test_decisions() -> None:
    thresholds = Thresholds(null_quantile=0.95, least_confidence=0.5, least_shrinkage=0.0)
    clear = some_odds(none=0.02, trees=0.9, air_drag=0.08)
    assert decide(Evidence(clear, "trees", 0.7), thresholds)[0] == "trees"
    assert decide(Evidence(clear, "trees", -0.05), thresholds)[0] == "unknown"
    assert decide(Evidence(clear, "trees", None), thresholds)[0] == "trees"
    chance = some_odds(none=0.3, trees=0.6, air_drag=0.1)
    assert decide(Evidence(chance, "trees", 0.7), thresholds)[0] == NONE
    torn = some_odds(none=0.02, trees=0.4, air_drag=0.33, roughness=0.25)
    assert decide(Evidence(torn, "trees", 0.7), thresholds)[0] == "unknown"
    assert set(confusion_set("trees", torn, thresholds)) == {"trees", "air_drag", "roughness"}


def test_legs_and_measurements(bench: Bench) -> None:
    case = bench.case
    assert legs_between(case, -5.0, 1e9) == case.legs
    assert legs_between(case, 0.0, 1.0) == case.legs[:1]
    assert measure_next(case, ("trees",)) == ()
    bare = replace(
        case, observations=replace(case.observations, impacts=case.observations.impacts.take(
            np.zeros(len(case.observations.impacts), bool)
        )),
    )  # fmt: skip
    said = measure_next(bare, ("soft_ground", "roughness"))
    assert said and any("before and after impacts" in line for line in said)


def test_impacts_alone_can_be_told_apart_but_not_scored() -> None:
    alone = bench_of(observed(12, 1, tables=("impacts",)), 1)
    tried = [try_task(alone, task, ORDER) for task in tasks_of(("air_drag",), 3)]
    library = library_of(alone, tried)
    assert library.scores.shape == (9, 12)
    found = shrinkage_of(alone, library, "air_drag", folds_of(12, 1), draws=5, seed=1)
    assert found.value is None and "no distance" in found.note


def test_numbers_of_a_campaign_exist_for_few_rocks() -> None:
    case = observed(6, 1, tables=("passages", "deposits"))
    told, _ = summary(case, observed_sample(case), covariates_of(case))
    assert told and not any(name.startswith("hit") for name in told)
    assert ways_of(case).keys.size == 6
