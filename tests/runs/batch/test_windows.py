"""Parts of the terrain model: large enough for the ways of every round."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.cut_valley import Valley

from sassgis.io.read.config import load_config
from sassgis.io.read.tiles import Part, open_terrain
from sassgis.model.map_run import MapRun
from sassgis.runs.batch_window import Windowed, windowed
from sassgis.runs.inputs import read_map_run
from sassgis.terrain.plan import plan
from sassgis.terrain.prepare import trace_lines


def test_a_window_holds_the_ways_of_every_round(valley: Valley) -> None:
    config = load_config(
        valley.config,
        {"terrain.path": "fall_line", "effects.lateral_deflection": {"angle_deg": 10.0}},
    )
    terrain = open_terrain(valley.dem, None, config.terrain.vertical_datum)
    whole = read_map_run(config, ["Mitte"])

    def make(part: Part) -> MapRun:
        return replace(whole, grid=terrain.read(part))

    def window(repetitions: int) -> Windowed:
        bounds = whole.areas[0].geometry.bounds
        return windowed(terrain, bounds, 10.0, make, repetitions, 50.0)

    one, four = window(1), window(4)
    assert one.part.n_rows < four.part.n_rows
    planned = plan(whole)
    for repetition in range(4):
        inside = trace_lines(four.run, four.planned.surface, four.planned.starts, repetition)
        free = trace_lines(whole, planned.surface, planned.starts, repetition)
        assert np.array_equal(inside.x, free.x) and np.array_equal(inside.y, free.y)
        assert np.array_equal(inside.offset, free.offset)
