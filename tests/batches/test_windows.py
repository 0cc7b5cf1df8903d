"""Parts of the terrain model: large enough for the lines of their areas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.cut_valley import Valley

from sassgis.batches.batch_window import windowed
from sassgis.inputs.config import load_config
from sassgis.inputs.tiles import Part, open_terrain
from sassgis.runs.inputs import read_map_run
from sassgis.settings.map_run import MapRun
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.prepare import plan


@pytest.fixture(autouse=True)
def small_first_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that begins close around the area, with a margin of 50 m."""
    monkeypatch.setattr("sassgis.batches.batch_window._FIRST_MARGIN_M", 50.0)


def test_lines_on_a_part_are_those_of_the_whole(valley: Valley) -> None:
    config = load_config(valley.config, {"terrain.path": "fall_line"})
    terrain = open_terrain(valley.dem, None, config.terrain.vertical_datum)
    whole = read_map_run(config, ["Mitte"])

    def make(part: Part) -> MapRun:
        return replace(whole, grid=terrain.read(part))

    part = windowed(terrain, whole.areas[0].geometry.bounds, 10.0, make)
    assert part.part.n_rows < whole.grid.shape[0]
    inside, free = (
        trace(run.grid, planned.surface, planned.starts, run.terrain)
        for run, planned in ((part.run, part.planned), (whole, plan(whole)))
    )
    assert np.array_equal(inside.x, free.x) and np.array_equal(inside.y, free.y)
    assert np.array_equal(inside.offset, free.offset)


def test_few_parts_are_tried(valley: Valley) -> None:
    """The first one, to foresee how large it has to be, and that part or one more."""
    config = load_config(valley.config, {"terrain.path": "fall_line"})
    terrain = open_terrain(valley.dem, None, config.terrain.vertical_datum)
    whole, tried = read_map_run(config, ["Nord"]), []

    def make(part: Part) -> MapRun:
        tried.append(part)
        return replace(whole, grid=terrain.read(part))

    found = windowed(terrain, whole.areas[0].geometry.bounds, 10.0, make)
    assert 2 <= len(tried) <= 3 and found.part == tried[-1]

    def holed(part: Part) -> MapRun:
        """Without a height in any of the cells by which the size is foreseen."""
        values = terrain.read(part).values
        values[::4, ::4] = np.nan
        return replace(whole, grid=replace(terrain.frame(part), values=values))

    assert windowed(terrain, whole.areas[0].geometry.bounds, 10.0, holed).part.n_rows
