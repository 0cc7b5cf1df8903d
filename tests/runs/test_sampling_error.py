"""A hundred runs with a hundred seeds scatter as the standard errors of each of them say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from helpers.zone_slope import box, two_areas

from sassgis.hazard.assess import curves_of, risk_of
from sassgis.hazard.risk import RiskTable
from sassgis.hazard.sources import sampled_sources
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_rules
from sassgis.runs.resumable_run import read_job
from sassgis.runs.run import prepared
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.loop import simulate_map
from sassgis.terrain.prepare import plan

SEEDS = 100
ENERGIES = (0.0, 30.0, 300.0)
#: Cells must be expected to see so many rocks, of which the errors can be told.
ENOUGH = 10.0


@dataclass(frozen=True)
class Repeated:
    """Rates and variances of repeated runs: (seeds, cells, energies); risk tables."""

    rate: np.ndarray
    variance: np.ndarray
    rocks: np.ndarray
    risk: list[RiskTable]
    random: bool


def repeated(folder: Path, **settings: dict[str, object]) -> Repeated:
    case = two_areas(folder, **settings)
    case.sections["release"] |= {"rocks_per_point": 60, "spacing_m": 8.0}
    case.blocks[0] |= {"axis_1_m": [0.2, 0.5], "onset_frequency": 0.1}
    case.blocks[1] |= {"axis_1_m": [0.7, 1.2], "axis_2_m": 0.7, "onset_frequency": 0.1}
    houses = {"first": box(62.0, 33.0, 2.0, 5.0), "second": box(66.0, 35.0, 2.0, 1.0)}
    numbers = {"value": [1e6, 3e5], "persons": [4.0, 1.0]}
    case.expose("houses", "building", houses, numbers, presence=0.6)
    case.write()
    job = read_job(load_config(case.config), None, lambda _: None)
    rules = read_rules(load_config(case.config), job.run)
    run = prepared(job, rules).run
    n_cells = run.grid.values.size
    out = np.zeros((3, SEEDS, n_cells, len(ENERGIES)))
    tables = []
    for seed in range(SEEDS):
        this = replace(run, seed=1000 + seed)
        planned = plan(this) if run.release.placement == "random" else job.planned
        sampled = sampled_sources(this, simulate_map(this, planned), rules.frequencies)
        energies = bins_of(this).threshold
        curves = curves_of(sampled, energies)
        columns = [curves.column(e) for e in ENERGIES]
        out[0, seed, curves.places] = curves.rate[:, columns]
        out[1, seed, curves.places] = curves.variance[:, columns]
        for s in sampled:
            out[2, seed, s.cells.places] += s.cells.count[:, columns]
        table = risk_of(rules, sampled, energies)
        assert table is not None
        tables.append(table)
    return Repeated(*out, tables, run.release.placement == "random")


CASES = {
    "lattice, 10 m wide": {"hazard": {"ref_width_m": 10.0}},
    "random": {"release": {"placement": "random"}},
}
SLOW = pytest.param("random", marks=pytest.mark.battery)


@pytest.fixture(scope="module", params=["lattice, 10 m wide", SLOW])
def runs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Repeated:
    return repeated(tmp_path_factory.mktemp("repeated"), **CASES[request.param])


@pytest.mark.battery
@pytest.mark.parametrize("column", range(len(ENERGIES)), ids=[f"{e:g} kJ" for e in ENERGIES])
def test_the_spread_is_as_predicted(runs: Repeated, column: int) -> None:
    rate, variance = runs.rate[..., column], runs.variance[..., column]
    enough = runs.rocks[..., column].mean(axis=0) >= ENOUGH
    # Where (nearly) all rocks of every line come, nothing scatters.
    enough &= variance.mean(axis=0) > (0.02 * rate.mean(axis=0)) ** 2
    assert enough.sum() > 30
    spread = rate.std(axis=0, ddof=1)[enough]
    told = np.sqrt(variance.mean(axis=0))[enough]
    ratio = spread / told
    # Errors of the two scenarios of random points are added, as if both reached the same cells: up
    # to √2 too large where paths part.
    least = 0.5**0.5 if runs.random else 1.0
    # A standard deviation of 100 values is itself known to 7 %, so that 20 % are 2.8 times that.
    usual = (ratio > 0.8 * least) & (ratio < 1.2)
    assert np.mean(usual) > 0.95, np.percentile(ratio, [1, 5, 50, 95, 99])
    assert 0.55 * least < ratio.min() and ratio.max() < 1.45
    assert 0.92 * least < np.sqrt(np.mean(ratio**2)) < 1.08


def test_errors_of_risk_are_no_smaller_than_the_spread(runs: Repeated) -> None:
    """They are upper bounds; for a single object they are not far above."""
    hits = 1.25 * 2.0**0.5 if runs.random else 1.25
    for quantity, most in (("hits", hits), ("loss", 1.6), ("deaths", 1.6)):
        values = np.array([t.of_object(quantity) for t in runs.risk])
        told = np.sqrt(np.mean([t.standard_error(quantity) ** 2 for t in runs.risk], axis=0))
        ratio = told / values.std(axis=0, ddof=1)
        assert np.all(ratio > 0.8), (quantity, ratio)
        assert np.all(ratio < most), (quantity, ratio)
