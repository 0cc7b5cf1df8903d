"""Blocks without barriers are those of a full repetition, to the last bit."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.map_sums_state import assert_same
from helpers.zone_slope import Case, box, place, two_areas

from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.errors import ConfigError, InputError
from sassgis.grid import FloatArray
from sassgis.runs.inputs import compared_run, read_rules
from sassgis.runs.resumable_run import Simulation, Workplace, configured, read_job
from sassgis.runs.run import prepared, zone, zone_simulation
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.map_run import Config, MapRun, Round
from sassgis.settings.results import ControlLine, Outcome, StopReason
from sassgis.simulation.accumulators import Progress, as_stations
from sassgis.simulation.checkpoint import progress_from, state_of
from sassgis.simulation.loop import simulate_map
from sassgis.simulation.reuse import KEPT_NAME
from sassgis.terrain.prepare import Plan, plan


def _across(col: float, first: float = 0.0, last: float = 70.0) -> FloatArray:
    """A line across the slope, given in cells."""
    return np.array([place(col, first), place(col + 1.3, last)])


#: Of the barriers, the first ends in the middle of the slope, and a part of the blocks goes over
#: or through each.
LINES = (
    (ControlLine("wall", "wall", height_m=1.0), _across(20.4, last=33.0)),
    (ControlLine("net", "net", height_m=2.0, capacity_kj=30.0), _across(31.6)),
    (ControlLine("held", "net", 1.0, 15.0, restarts_from_rest=True), _across(36.2, first=35.0)),
    (
        ControlLine("gallery", "gallery", 0.8, width_m=6.0, roof_slope_deg=10.0, cushion_kpa=500.0),
        _across(45.1),
    ),
    (ControlLine("road", "station"), _across(52.0)),
    (ControlLine("dam", "wall", height_m=0.9), _across(56.7)),
)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    made = two_areas(tmp_path_factory.mktemp("slope"), hazard={"ref_width_m": 6.0})
    made.expose("houses", "building", {"a": box(40, 20, 3, 30), "b": box(58, 30, 4, 10)})
    made.write()
    return made


@pytest.fixture(scope="module")
def job(case: Case) -> MapRun:
    config = configured(case.config, None)
    read = read_job(config, None, lambda _text: None)
    run = replace(prepared(read, read_rules(config, read.run)).run, control_lines=LINES)
    return compared_run(config, run, along_slope=True)


def _repeated(run: MapRun, planned: Plan) -> Progress:
    """All blocks of a run once more, without barriers."""
    stations = as_stations([line for line, _ in run.all_lines])
    lines = tuple(zip(stations, (trace for _, trace in run.all_lines), strict=True))
    return simulate_map(replace(run, control_lines=lines, further_stations=None), planned)


def _assert_same_without(progress: Progress, run: MapRun, planned: Plan) -> None:
    full = _repeated(run, planned)
    assert progress.sources.keys() == full.sources.keys()
    for source, tally in progress.sources.items():
        own, other = tally.without_barriers(), full.sources[source]
        for part in ("cells", "objects", "control_lines"):
            mine, theirs = getattr(own, part).state(), getattr(other, part).state()
            assert mine.keys() == theirs.keys()
            for name, values in theirs.items():
                assert mine[name].dtype == values.dtype
                assert mine[name].tobytes() == values.tobytes(), (source, part, name)
        for number in ("rocks", "simulated", "never_started", "heaviest"):
            assert getattr(own, number) == getattr(other, number)


SETTINGS: dict[str, dict[str, Any]] = {
    "followed": {},
    "fall lines": {"path": "fall_line"},
    "cells": {"ref_width_m": 0.0},
    "random points": {"placement": "random"},
    "fragments": {"effects": EffectSettings(Fragmentation(energy_jkg=50.0))},
    "weighted": {},
}


def _varied(run: MapRun, name: str) -> tuple[MapRun, Plan]:
    change = dict(SETTINGS[name])
    if "path" in change:
        change = {"terrain": replace(run.terrain, path=change["path"])}
    if "placement" in change:
        points = replace(run.release, placement="random")
        change = {"release": points}
    run = replace(run, **change)
    planned = plan(run)
    if name == "weighted":
        halvings = np.arange(2 * len(planned.points), dtype=np.uint8).reshape(-1, 2) % 3
        run = replace(run, rounds=(Round(), Round(1, 4, halvings)))
    return run, planned


@pytest.mark.parametrize("name", SETTINGS)
def test_they_are_those_of_a_full_repetition(job: MapRun, name: str) -> None:
    run, planned = _varied(job, name)
    both = simulate_map(run, planned, jobs=2, chunk_points=7)
    assert_same(both, simulate_map(replace(run, further_stations=None), planned))
    _assert_same_without(both, run, planned)
    # There is something to tell: blocks that barriers take, let go on, and do not meet.
    met = {o for i in range(len(LINES)) for o, n in both.control_lines.outcomes(i).items() if n}
    assert met >= set(Outcome) - {Outcome.HELD_BY_NET}
    assert both.reasons[StopReason.REST] and both.reasons[StopReason.BARRIER]


def test_they_are_the_same_in_rounds_of_as_many_blocks_as_needed(
    case: Case, tmp_path: Path
) -> None:
    wall = {"name": "wall", "kind": "wall", "height_m": 2.0, "line": LINES[0][1].tolist()}
    adaptive = {"blocks": "auto", "changed_share_max": 0.01, "blocks_max": 1500}
    sections = {**case.sections, "hazard": {**case.sections["hazard"], **adaptive}}
    config = configured(replace(case, sections=sections, lists={"barriers": [wall]}).write(), None)
    read = read_job(config, None, lambda _text: None)
    rules = read_rules(config, read.run)
    job = prepared(read, rules)
    done = zone_simulation(job, rules, Workplace(tmp_path, 2, None, lambda _text: None))
    assert done.run.further_stations is None
    assert len(done.run.rounds) > 2 and any(r.halvings is not None for r in done.run.rounds)
    run = compared_run(config, done.run)
    _assert_same_without(done.progress, run, done.planned)
    # A state that is saved and read gives the same.
    lines = tuple(line for line, _ in run.all_lines)
    again = progress_from(state_of(done.progress), run.grid.values.size, lines, run.compared)
    _assert_same_without(again, run, done.planned)


def test_nothing_is_simulated_without_barriers_where_nobody_asks(case: Case, job: MapRun) -> None:
    stations = replace(job, control_lines=LINES[4:5], further_stations=None)
    config = configured(case.config, None)
    for run in (stations, compared_run(config, stations)):
        assert not simulate_map(run, plan(run)).compared
    asked = replace(config, hazard=replace(config.hazard, compare_barriers=False))
    assert compared_run(asked, replace(stations, control_lines=LINES)).further_stations is None


def _zone_case(folder: Path, *nets: dict[str, Any], blocks_max: int = 900) -> Path:
    """A zoning of two areas, one far below the other, in rounds, with some nets."""
    case = two_areas(
        folder, hazard={"ref_width_m": 6.0, "blocks": "auto", "blocks_max": blocks_max}
    )
    # The second area lies below all places at which a net of the first may stand.
    areas = [box(4.0, 20.0, 8.0, 9.0), box(50.0, 52.0, 7.0, 9.0)]
    case.write_layer("release.gpkg", areas, {"name": ["north", "south"]})
    case.lists["barriers"] = [{"kind": "net", "capacity_kj": 100.0, **own} for own in nets]
    return case.write()


def _net(name: str, col: float, row: float, height_m: float = 2.0) -> dict[str, Any]:
    line = [list(place(col, at)) for at in (row, row + 5.0)]
    return {"name": name, "height_m": height_m, "line": line}


def _simulated(
    config: Path, work: Path, chunks: list[int], reuse: Path | None = None
) -> tuple[Config, Simulation]:
    """Simulate as for zones into a folder; ``chunks`` grows with each that is simulated."""
    settings = configured(config, None)
    read = read_job(settings, None, lambda _text: None)
    rules = read_rules(settings, read.run)
    work.mkdir()
    where = Workplace(work, 1, lambda done, *_: chunks.append(done), lambda _text: None)
    job = prepared(read, rules)
    return settings, zone_simulation(job, rules, where, along_slope=True, reuse=reuse)


def test_only_areas_near_a_changed_barrier_are_simulated_again(tmp_path: Path) -> None:
    other = _net("south", 16.0, 43.0)
    config = _zone_case(tmp_path, _net("north", 14.0, 22.0), other)
    _, first = _simulated(config, tmp_path / "first", before := [])
    # The north net is moved; another is new, and the south one, which stays, has another place in
    # the list.
    # A larger budget adds no blocks.
    nets = _net("new", 12.0, 24.0), other, _net("north", 15.0, 22.0, 3.0)
    config = _zone_case(tmp_path, *nets, blocks_max=9000)
    settings, again = _simulated(config, tmp_path / "again", chunks := [], tmp_path / "first")
    progress = again.progress
    assert progress.reused == (1,) and 0 < len(chunks) < len(before)
    # All is as if all were simulated, in the rounds of the first result.
    run = compared_run(settings, again.run, along_slope=True)
    assert len(run.rounds) == len(first.run.rounds) > 1
    assert_same(progress, simulate_map(again.run, again.planned))
    _assert_same_without(progress, run, again.planned)
    # And so it can be used once more: with nothing changed nothing is simulated.
    _, third = _simulated(config, tmp_path / "third", chunks := [], tmp_path / "again")
    assert not chunks and third.progress.reused == (0, 1)
    assert_same(third.progress, progress)


def test_an_area_near_copies_of_a_moved_net_alone_is_counted_there(tmp_path: Path) -> None:
    """Nothing comes to the net itself, but from the north to some of its copies along the slope."""
    config = _zone_case(tmp_path, _net("north", 30.0, 60.0))
    _simulated(config, tmp_path / "first", before := [])
    config = _zone_case(tmp_path, _net("north", 31.0, 60.0))
    settings, again = _simulated(config, tmp_path / "again", chunks := [], tmp_path / "first")
    assert again.progress.reused == (0, 1) and 0 < len(chunks) < len(before)
    counted = [own.without for own in again.progress.sources.values()]
    assert any(own.control_lines.arrivals(i) for own in counted for i in again.progress.new_lines)
    run = compared_run(settings, again.run, along_slope=True)
    assert_same(again.progress, simulate_map(again.run, again.planned))
    _assert_same_without(again.progress, run, again.planned)
    _, third = _simulated(config, tmp_path / "third", chunks := [], tmp_path / "again")
    assert not chunks
    assert_same(third.progress, again.progress)


def test_a_result_that_cannot_be_used_again_is_refused(tmp_path: Path) -> None:
    config = _zone_case(tmp_path, _net("north", 14.0, 22.0))
    zone(config, tmp_path / "first", jobs=1)
    again = partial(zone, out=tmp_path / "again", jobs=1, reuse=tmp_path / "first")
    said = r"run\.seed: the earlier result is of other inputs \(found 7; expected 5, as in the"
    with pytest.raises(InputError, match=said):
        again(config, seed=7)
    again(config)
    manifest = json.loads((tmp_path / "again" / "manifest.json").read_text())["settings"]["zoning"]
    assert (manifest["reused_from"], manifest["reused_areas"]) == ("first", "north, south")
    assert "north, south (from the result first)" in (tmp_path / "again/report.html").read_text()
    again = partial(again, out=tmp_path / "other")
    (tmp_path / "first" / KEPT_NAME).unlink()
    with pytest.raises(InputError, match="no sums of release areas"):
        again(config)
    with pytest.raises(ConfigError, match="where there are walls, nets or galleries"):
        again(_zone_case(tmp_path))
