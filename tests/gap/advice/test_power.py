"""What planned campaigns would name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers.small_slope import Slope
from scipy import stats

from sassgis.gap.advice.power import (
    STRENGTHS,
    TABLE_SETS,
    CampaignPower,
    PlannedCampaign,
    PlannedTrial,
    Power,
    in_tables,
    planned_case,
    power_of,
    powers_of,
    usual_rocks,
)
from sassgis.gap.causes.all_causes import FAMILIES, STATISTICS
from sassgis.gap.constants import PLANNED_ROCKS, STRENGTH_SHARES
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.observations.case import Case
from sassgis.inputs.config import load_config
from sassgis.inputs.observation_values import cause_weights_of, read_thresholds, thresholds_of
from sassgis.runs.inputs import read_map_run

CONTENT = read_thresholds()


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    slope = Slope.made(tmp_path_factory.mktemp("planned"))
    return planned_case(read_map_run(load_config(slope.config)), 20, 1, slope.config)


@pytest.fixture(scope="module")
def planned(case: Case) -> PlannedCampaign:
    weights, thresholds = cause_weights_of(CONTENT), thresholds_of(CONTENT)
    return PlannedCampaign({20: usual_rocks(case, 20, 1)}, FAMILIES, weights, thresholds, 1)


def named(trial: PlannedTrial) -> tuple[bool, ...]:
    """Name air drag by paths in time, fragments by masses, nothing else."""
    if trial.cause == "fragmentation":
        return (False, True, True, True)
    drag = trial.strength == "strong" or (trial.strength == "medium" and trial.rocks >= 40)
    return (False, False, False, trial.cause == "air_drag" and drag)


def run(tried: list[PlannedTrial]) -> Callable[..., Iterator[Power]]:
    def work(_: object, trials: Sequence[PlannedTrial]) -> Iterator[Power]:
        for own in trials:
            tried.append(own)
            yield Power(own, STRENGTH_SHARES[own.strength], named(own))

    return work


def test_the_weakest_named_effect_is_found_and_what_cannot_be_named_is_not_tried() -> None:
    tried: list[PlannedTrial] = []
    causes = ("air_drag", "fragmentation", "trees")
    power = CampaignPower(causes, tuple(powers_of(causes, run(tried))), (50.0,), 0.0, 0.0)
    assert [t for t in tried if t.cause == "trees"] == [PlannedTrial("trees", "strong", 100)]
    assert len(tried) == len(set(tried))
    for cause in causes:
        for k in range(len(TABLE_SETS)):
            for rocks in PLANNED_ROCKS:
                right = [s for s in STRENGTH_SHARES if named(PlannedTrial(cause, s, rocks))[k]]
                found = power.least(cause, k, rocks)
                assert (found and found.trial.strength) == (right[0] if right else None)
    rows = power.lines()
    assert len(rows) == 2 + len(causes) + 1
    assert rows[2].startswith("air drag (C_d)") and rows[2].endswith("0.83 / 0.5 / 0.5")
    german = replace(power, language="de").lines()
    assert german[2].startswith("Luftwiderstand") and german[2].endswith("0.83 / 0.5 / 0.5")


def test_fingerprints_of_tables_that_lack_are_not_seen_and_the_others_count_less_often() -> None:
    z = dict.fromkeys(STATISTICS, 3.0)
    prints = [Fingerprint(c, n, 1.0, z[n], 0.5, True, 20) for n, c in STATISTICS.items()]
    few, many = (in_tables(prints, tables) for tables in (TABLE_SETS[0], TABLE_SETS[-1]))
    assert {f.statistic for f in few} < {f.statistic for f in many} == set(STATISTICS)
    assert not any(f.effect == "fragmentation" for f in few)
    for some in (few, many):
        # Holm: all of them are alike.
        assert some[0].p_adjusted == pytest.approx(len(some) * stats.norm.sf(3.0))


def test_a_stronger_effect_has_a_stronger_parameter(case: Case) -> None:
    assert set(STRENGTHS) == set(FAMILIES)
    for cause, own in STRENGTHS.items():
        weak, medium, strong = (
            own.part(case, cause, share).parameters[own.reported]
            for share in STRENGTH_SHARES.values()
        )
        less = cause in ("soft_ground", "fragmentation")
        assert (weak > medium > strong) if less else (weak < medium < strong)


def test_a_planned_campaign_has_measured_rocks_and_stations_before_they_stop(case: Case) -> None:
    rocks = case.observations.rocks
    assert case.n_rocks == 20 and np.unique(rocks.x).size == 1
    assert (case.mass_kg > 0.0).all() and np.isfinite(rocks.semi_axis_c_m).all()
    first, second, third = case.station_s[0]
    assert 0.0 < first < second < third
    assert second / third == pytest.approx(0.75, abs=0.02)
    assert not any(len(case.observations.tables[name]) for name in ("passages", "deposits"))


def test_strong_fragmentation_is_named_where_masses_lie(planned: PlannedCampaign) -> None:
    found = power_of(planned, PlannedTrial("fragmentation", "strong", 20))
    assert found.named == (False, True, True, True)
    assert found.value == pytest.approx(24.0, rel=0.05)
