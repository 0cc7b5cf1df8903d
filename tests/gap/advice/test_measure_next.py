"""What to measure next: what two models would show differently."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import BASE, TABLE, observed

from sassgis.gap.advice.measure_next import (
    Separation,
    best_measurement,
    new_places,
    not_testable,
    recorded_rocks,
    separations,
)
from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.forward.released_rocks import HypothesisModel, MeasurementError
from sassgis.gap.forward.rock_lines import RockLines, rock_lines_of
from sassgis.gap.observations.case import Case
from sassgis.settings.ground import GroundTable


@pytest.fixture(scope="module")
def case() -> Case:
    """Only where rocks stopped is known."""
    return observed(20, 3, tables=("deposits",))


@pytest.fixture(scope="module")
def lines(case: Case) -> RockLines:
    return rock_lines_of(case)


def between(
    case: Case, lines: RockLines, one: HypothesisModel, other: HypothesisModel
) -> Separation:
    models = {"none": [one], "trees": [other]}
    (found,) = separations(case, lines, models, 4)
    return found


def test_models_that_are_alike_are_not_told_apart(case: Case, lines: RockLines) -> None:
    found = between(case, lines, BASE, BASE)
    assert (found.what, found.rocks) == ("", 0)
    assert "No measurement" in found.sentence and "no missing effect" in found.sentence
    assert separations(case, lines, {"none": [BASE]}, 4) == ()


def test_what_differs_most_is_measured(case: Case, lines: RockLines) -> None:
    turned = replace(BASE, measurement=MeasurementError(rotation_scale=1.6))
    found = between(case, lines, BASE, turned)
    assert "rotation" in found.what and found.rocks >= 5


def test_stations_lie_on_the_lines_of_the_rocks_where_no_stop_is_known(
    case: Case, lines: RockLines
) -> None:
    # Followed paths have no end.
    there = replace(case, projected={})
    places = new_places(there, replace(lines, end=np.full(case.n_rocks, np.inf)))
    assert places.size and places.max() < case.traces.s.max()


def test_rocks_are_fewer_the_larger_the_difference(case: Case, lines: RockLines) -> None:
    counts = []
    for scale in (1.05, 1.4):
        faster = replace(BASE, measurement=MeasurementError(scale=scale))
        counts.append(between(case, lines, BASE, faster).rocks)
    assert counts[0] >= counts[1] == 5
    # As many as a test of one mean takes: a difference of d scatters needs (2.8 / d)² rocks.
    low = GroundTable(tuple(replace(c, eta_max=0.9 * c.eta_max) for c in TABLE.classes))
    slow = between(case, lines, BASE, replace(BASE, table=low))
    assert slow.what and slow.rocks < 40


def test_what_was_recorded_of_enough_rocks_is_not_asked_for_again(case: Case) -> None:
    what = "where rocks stop along the fall line"
    assert recorded_rocks(case)[what] == 20
    rng = np.random.default_rng(1)
    one, other = ({what: mean + rng.normal(size=(4, 4, 20))} for mean in (0.0, 2.0))
    assert best_measurement("none", "trees", one, other, {}).what == what
    assert not best_measurement("none", "trees", one, other, {what: 20}).what


def test_what_draws_of_one_model_differ_by_tells_nothing(case: Case, lines: RockLines) -> None:
    def scaled(*scales: float) -> list[HypothesisModel]:
        return [replace(BASE, measurement=MeasurementError(scale=k)) for k in scales]

    surely = {"none": scaled(1.0, 1.01, 0.99, 1.0), "trees": scaled(1.3, 1.31, 1.29, 1.3)}
    perhaps = {"none": scaled(0.8, 1.0, 1.2, 1.4), "trees": scaled(0.9, 1.1, 1.3, 1.5)}
    assert separations(case, lines, surely, 4)[0].what
    assert not separations(case, lines, perhaps, 4)[0].what


def test_stations_are_put_where_there_are_none_yet() -> None:
    seen = observed(20, 3)
    blind = observed(20, 3, tables=("deposits",))
    places = [new_places(own, rock_lines_of(own)) for own in (seen, blind)]
    # Stations at which nothing was measured are no reason.
    assert places[1].size == 4 and set(places[0]) < set(places[1])
    there = np.nanmedian(seen.station_s, axis=0)
    left_out = np.setdiff1d(places[1], places[0])
    assert np.abs(there[:, None] - left_out).min(axis=0).max() < 0.08 * places[1][-1] / 0.8


def test_what_cannot_be_tested_is_one_line_with_what_shows_most_first() -> None:
    seen = observed(20, 3, tables=("deposits",)).observations
    said = not_testable(seen, ("trees", "fragmentation", "contact_law", "soft_ground", "air_drag"))
    assert said.startswith("Not testable with these data: ") and said.count(". ") == 0
    # A table alone comes with all the causes that it shows, each cause once.
    groups = [own.rpartition(" (record ") for own in said[:-1].partition(": ")[2].split("; ")]
    sizes = [len(names.split(", ")) for names, _, _ in groups]
    assert sizes[0] == max(sizes) and sum(sizes) == 4
    # What every table is there for needs more rocks.
    full = observed(20, 3).observations
    needed = {t for own in CAUSES["fragmentation"].statistics for t in own.tables}
    there = all(len(full.tables[name]) for name in needed)
    assert there
    said = not_testable(full, ("fragmentation",))
    assert said == "Not testable with these data: fragmentation (record more rocks)."
    assert not_testable(full, ()) == ""
