"""Whole runs with pieces: the same bits for any jobs and chunks, and after an interruption."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.map_sums_state import assert_same

from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.settings.blocks import EffectSettings
from sassgis.simulation.accumulators import joined_rows
from sassgis.simulation.loop import simulate_map
from sassgis.terrain.prepare import plan


@pytest.fixture(scope="module")
def job(make_valley):
    effects = EffectSettings(
        Fragmentation(energy_jkg=60.0),
        Entrainment(),
        LateralDeflection(),
    )
    run = read_map_run(load_config(make_valley(spacing_m=25.0)))
    return replace(run, effects=effects, stop_points_max=10**6)


@pytest.fixture(scope="module")
def planned(job):
    return plan(job)


@pytest.fixture(scope="module")
def whole(job, planned):
    return simulate_map(job, planned)


@pytest.mark.parametrize(("jobs", "points"), [(2, 4), (1, 1)])
def test_pieces_do_not_hang_on_jobs_and_chunks(job, planned, whole, jobs, points):
    assert_same(simulate_map(job, planned, jobs=jobs, chunk_points=points), whole)


def test_a_run_that_goes_on_is_the_run_that_was_not_stopped(job, planned, whole):
    held = []

    def stop(progress, chunks, rows):
        if progress.chunks == 2:
            held.append(progress)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_map(job, planned, on_chunk=stop, chunk_points=3)
    assert 0 < held[0].pieces < whole.pieces
    assert_same(simulate_map(job, planned, resume=held[0], chunk_points=3), whole)


def test_pieces_are_rows_and_stops_but_no_rocks(job, planned, whole):
    rows = joined_rows(whole.stops).rocks
    released = planned.blocks_of_point(job).sum()
    assert whole.reasons.sum() + whole.lost == released
    assert rows.size == whole.reasons.sum() + whole.pieces
    assert (rows["piece"] > 0).sum() == whole.pieces > 100
    stopped = np.isin(rows["reason"], (0, 1)).sum()
    assert whole.sums.column("stops").sum() == stopped
    assert whole.sums.column("reach").max() <= released
