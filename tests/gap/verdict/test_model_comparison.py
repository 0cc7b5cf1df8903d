"""Distances and shares of the ladder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import observed, with_observed
from scipy.spatial.distance import euclidean

from sassgis.gap.diagnosis import Rung
from sassgis.gap.fit.distances import RockDistances
from sassgis.gap.fit.hypothesis_fit import NONE
from sassgis.gap.fit.linear_fit import law_changes, summary_of
from sassgis.gap.fit.site_data import SiteData, model_rows, site_data_of
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.verdict.model_comparison import (
    Ladder,
    ground_is_enough,
    group_weights,
    needs_contact_law,
    share_of,
    shrinkage_of,
)


def test_the_distance_is_the_mean_over_pairs_of_different_rocks() -> None:
    rng = np.random.default_rng(5)
    seen, replicas = rng.normal(size=(6, 3)), rng.normal(0.5, 1.0, size=(4, 6, 3))
    pairs = [(i, j) for i in range(6) for j in range(6) if i != j]
    across = np.mean([euclidean(seen[i], r[j]) for r in replicas for i, j in pairs])
    own = np.mean([euclidean(seen[i], seen[j]) for i, j in pairs])
    among = np.mean([euclidean(a[i], b[j]) for a in replicas for b in replicas for i, j in pairs])
    found = RockDistances.of(seen, replicas)
    assert found.value() == pytest.approx(2.0 * across - own - among, rel=1e-12)
    # A rock of weight zero is not there.
    weights = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    less = RockDistances.of(np.delete(seen, 2, axis=0), np.delete(replicas, 2, axis=1))
    assert found.value(weights) == pytest.approx(less.value(), rel=1e-12)


def test_the_distance_is_zero_in_the_mean_whatever_the_rocks_differ_in() -> None:
    rng = np.random.default_rng(6)
    centre = 5.0 * rng.normal(size=(15, 2))
    found = [
        RockDistances.of(centre + rng.normal(size=(15, 2)), centre + rng.normal(size=(4, 15, 2)))
        for _ in range(300)
    ]
    values = np.array([f.value() for f in found])
    assert abs(values.mean()) < 3.0 * values.std() / np.sqrt(300)
    floors = np.array([f.floor for f in found])
    assert abs(floors.mean()) < 3.0 * floors.std() / np.sqrt(300)
    assert np.mean([f.above_chance for f in found]) < 0.25


def test_shares_are_those_of_known_distributions() -> None:
    """D between normal distributions at a small distance d grows as d²: half as far, 3/4 closed."""
    rng = np.random.default_rng(7)
    seen = rng.normal(size=(400, 1))
    far, half, near = (
        RockDistances.of(seen, rng.normal(shift, 1.0, size=(8, 400, 1)))
        for shift in (0.4, 0.2, 0.0)
    )
    weights = group_weights(np.arange(400), rng, 200)
    for model, expected in ((half, 0.75), (near, 1.0)):
        value, interval = share_of(far, model, 0.0, [d.drawn(weights) for d in (far, model)])
        assert value == pytest.approx(expected, abs=0.15)
        assert interval is not None and interval[0] < expected < interval[1]
    assert far.above_chance and not near.above_chance


def test_groups_are_drawn_whole_and_widen_the_interval() -> None:
    rng = np.random.default_rng(8)
    group = np.repeat(np.arange(8), 10)
    weights = group_weights(group, rng, 50)
    assert (weights.reshape(-1, 8, 10).std(axis=2) == 0.0).all()
    # What all rocks of a group have in common.
    seen = rng.normal(size=(80, 2)) + 2.0 * rng.normal(size=(8, 2))[group]
    far = RockDistances.of(seen, rng.normal(2.0, 2.2, size=(6, 80, 2)))
    near = RockDistances.of(seen, rng.normal(0.0, 2.2, size=(6, 80, 2)))
    spans = []
    for own in (np.arange(80), group):
        weights = group_weights(own, np.random.default_rng(1), 400)
        _, span = share_of(far, near, 0.0, [d.drawn(weights) for d in (far, near)])
        assert span is not None
        spans.append(span[1] - span[0])
    assert spans[1] > 1.3 * spans[0]


def rows_of(problem: SiteData, count: int = 6) -> np.ndarray:
    return model_rows(problem, configured_model(problem.case), 7, count)


def ladder(problem: SiteData, *models: tuple[str, np.ndarray]) -> Ladder:
    """Each model added to the one before it."""
    over = ["", *(name for name, _ in models)]
    made = Ladder(problem)
    for (name, rows), simpler in zip(models, over, strict=False):
        made.add(name, simpler, rows)
    return made


def test_the_ladder_goes_from_the_configured_model_to_chance(problem: SiteData) -> None:
    near = rows_of(problem)
    far = near + 1.0
    first, ground, floor = ladder(problem, ("configured", far), ("ground", near)).rungs(
        "configured", "ground"
    )
    assert [r.rung for r in (first, ground, floor)] == ["configured", "ground", "floor"]
    assert first.share is None and first.distance > ground.distance
    share = (first.distance - ground.distance) / (first.distance - floor.distance)
    assert ground.share == pytest.approx(share)
    assert ground.ci95 is not None and ground.ci95[0] < share < ground.ci95[1]
    assert ground.over == "configured" and ground.gain_ci95 is not None
    assert ground.gain == pytest.approx(first.distance - ground.distance)
    assert ground.gain_ci95[0] < ground.gain < ground.gain_ci95[1]
    # Without a gap there are no shares.
    seen = replace(problem, rows=near[0])
    rungs = ladder(seen, ("configured", near[1:]), ("ground", near[1:])).rungs(
        "configured", "ground"
    )
    assert [r.share for r in rungs] == [None] * 3


def test_nothing_is_recommended_whose_gain_does_not_clear_zero(
    problem: SiteData,
) -> None:
    near = rows_of(problem)
    own = replace(problem, rows=near[0])
    # Each rock of the model a bit off by itself: no nearer to the observed ones, and no farther.
    noise = 0.3 * np.random.default_rng(4).normal(size=near[1:].shape)
    names = ("configured", "ground", "trees")
    made = ladder(
        own, ("configured", near[1:] + 1.0), ("ground", near[1:]), ("trees", near[1:] + noise)
    )
    best, why = made.recommended(*names)
    assert best == "ground"
    assert why.endswith("on held-out rocks: trees over calibrated ground")
    # What helps is taken, and what is added to a model that helps no more must better that one.
    made = ladder(own, ("configured", near + 1.0), ("ground", near + 0.9), ("trees", near))
    assert made.recommended(*names) == ("trees", "")
    made = ladder(own, ("configured", near), ("ground", near + 0.9), ("trees", near))
    best, why = made.recommended(*names)
    assert best == "configured" and "calibrated ground over" in why and "trees over" in why
    gain = made.gain("ground", "trees")
    assert gain is not None and gain.low > 0.0


def test_without_a_gap_no_shrinkage_is_stated(problem: SiteData) -> None:
    rows = rows_of(problem)
    found = shrinkage_of(problem, rows, NONE, rows)
    assert found.value is None and not found.note
    seen = replace(problem, rows=rows[0])
    found = shrinkage_of(seen, rows[1:], "air_drag", rows[1:])
    assert found.value is None and "may be chance" in found.note


def test_impacts_alone_have_scores_but_no_distance() -> None:
    alone = site_data_of(observed(12, 1, tables=("impacts",)), 1)
    rows = rows_of(alone, 2)
    found = shrinkage_of(alone, rows, "air_drag", rows)
    assert found.value is None and "Too few rocks" in found.note
    made = ladder(alone, ("configured", rows), ("ground", rows))
    assert made.rungs("configured", "ground") == ()
    assert made.recommended("configured", "ground")[0] == "configured"


def test_a_stop_that_is_not_known_is_no_stop_that_did_not_happen() -> None:
    case = observed(12, 1)
    deposits = case.observations.deposits
    names = np.where(np.arange(len(deposits)) % 3 == 0, "", deposits.rock_id)
    blind = with_observed(case, deposits=replace(deposits, rock_id=names.astype(str)))
    own = site_data_of(blind, 1)
    made = rows_of(own, 2)
    assert own.unseen.any(axis=1).sum() == 4
    # Replicas have them no more than nature: no distance comes of it.
    np.testing.assert_allclose(made[:, own.unseen], own.rows[own.unseen][None].repeat(2, axis=0))
    assert not site_data_of(case, 1).unseen.any()


def test_a_law_of_the_contact_is_needed_where_it_certainly_closes_more() -> None:
    def rungs(ground: tuple[float, float], law: tuple[float, float]) -> list[Rung]:
        return [
            Rung("configured", 3.0),
            Rung("ground", 1.0, sum(ground) / 2.0, ground),
            Rung("contact_law", 0.5, sum(law) / 2.0, law),
        ]

    assert needs_contact_law(rungs((0.3, 0.5), (0.6, 0.9)))
    assert not needs_contact_law(rungs((0.3, 0.7), (0.6, 0.9)))
    assert not needs_contact_law([Rung("configured", 3.0), Rung("ground", 1.0)])
    assert ground_is_enough(rungs((0.6, 1.02), (0.6, 0.9)))
    assert not ground_is_enough(rungs((0.3, 0.5), (0.6, 1.1)))


def test_shares_that_a_law_may_be_off_are_no_gain_of_a_cause(problem: SiteData) -> None:
    summary = summary_of(problem)
    law = law_changes(summary)
    assert law.shape[0] == summary.used.sum() and np.isfinite(law).all()
    names = problem.scale.names
    speeds = [k for k, name in enumerate(names) if name.endswith(":speed")]
    # Each column is one share: all stations of a quantity, and no scatter.
    changed = np.zeros((summary.used.size, law.shape[1]))
    changed[summary.used] = law
    of_speed = np.abs(changed[speeds]).sum(axis=0) > 0.0
    assert of_speed.sum() == 2
    scatters = changed[len(names) : 3 * len(names)]
    assert not scatters.any()
