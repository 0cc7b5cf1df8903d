"""An interrupted run goes on where it was, and only where it belongs to the same run."""

from __future__ import annotations

import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely.affinity
from helpers.changed_arrays import Change, change_arrays
from helpers.open_geopackage import moved_in_gis

from sassgis.errors import Interrupted
from sassgis.files.atomic_output import partial_folder
from sassgis.files.saved_arrays import saved_or_refused, write_saved
from sassgis.inputs.config import load_config
from sassgis.runs import resumable_run as job_module
from sassgis.runs.run import run
from sassgis.simulation import loop as map_run
from sassgis.simulation.accumulators import Progress, SourceSums, SourceTally
from sassgis.simulation.checkpoint import Checkpoint, progress_from, state_of
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.loop import simulate_map
from sassgis.simulation.map_sums import MapSums
from sassgis.simulation.workers import held_back
from sassgis.terrain.prepare import plan

TABLES = {"output.rock_table": "csv", "output.passage_table": "csv"}


def in_small_chunks(*args, **kwargs):
    return simulate_map(*args, **kwargs, chunk_points=6)


@pytest.fixture(scope="module")
def stopped(small, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Working folder of a run that was stopped after four of its chunks."""

    def stop(done: int, chunks: int, rocks: int) -> None:
        assert chunks > 6
        if done == 4:
            raise KeyboardInterrupt

    out = tmp_path_factory.mktemp("stopped") / "out"
    with (
        pytest.MonkeyPatch.context() as patch,
        pytest.raises(Interrupted, match="run the same command to resume") as caught,
    ):
        patch.setattr(job_module, "simulate_map", in_small_chunks)
        run(load_config(small.config, TABLES), out, jobs=1, on_progress=stop)
    assert caught.value.exit_code == 130
    assert not out.exists()
    assert (partial_folder(out) / "checkpoint" / "state.npz").is_file()
    return partial_folder(out)


@pytest.fixture
def interrupted(stopped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of that run, for one test."""
    monkeypatch.setattr(job_module, "simulate_map", in_small_chunks)
    shutil.copytree(stopped, partial_folder(tmp_path / "out"))
    return tmp_path / "out"


def firsts(config, out: Path, **options) -> list[int]:
    """Chunks as they are reported by a run that is left to its end."""
    seen: list[int] = []
    run(config, out, on_progress=lambda done, _n, _r: seen.append(done), **options)
    return seen


def test_it_goes_on_and_gives_the_same_bytes(small, interrupted: Path) -> None:
    seen = firsts(load_config(small.config, TABLES), interrupted, jobs=2)
    assert seen[0] == 5
    mine, theirs = ((f / "manifest.json").read_bytes() for f in (interrupted, small.folder))
    assert mine == theirs
    assert not partial_folder(interrupted).exists()
    assert not (interrupted / "checkpoint").exists()


def test_a_state_of_other_settings_is_ignored(small, interrupted: Path) -> None:
    folder = partial_folder(interrupted)
    config = load_config(small.config, {**TABLES, "run.seed": 3})
    job = job_module.read_map_run(config)
    fingerprint = job_module.state_fingerprint(config, job)
    said: list[str] = []
    assert Checkpoint(folder, fingerprint).restore(job, said.append) is None
    assert len(said) == 1 and "state.npz is not used: of other settings" in said[0]
    same = load_config(small.config, TABLES)
    own = Checkpoint(folder, job_module.state_fingerprint(same, small.result.run))
    assert own.restore(small.result.run, said.append) is not None and len(said) == 1


def test_a_damaged_or_changed_state_is_not_used_and_the_run_says_so(
    small, interrupted: Path
) -> None:
    state = partial_folder(interrupted) / "checkpoint" / "state.npz"
    config = load_config(small.config, TABLES)
    rows = state.with_name("rows_000000.npz")
    kept = rows.read_bytes()
    rows.unlink()
    own = Checkpoint(state.parent.parent, job_module.state_fingerprint(config, small.result.run))
    assert own.restore(small.result.run, lambda _text: None) is None
    rows.write_bytes(kept)
    assert own.restore(small.result.run, lambda _text: None) is not None
    change_arrays(state, lambda arrays: arrays["sums.energy_max"].__imul__(0.01))
    said: list[str] = []
    assert firsts(config, interrupted, jobs=1, say=said.append)[0] == 1
    assert [text for text in said if str(state) in text] == [
        f"Saved state {state} is not used: damaged, or changed since it was saved"
    ]
    mine, theirs = ((f / "manifest.json").read_bytes() for f in (interrupted, small.folder))
    assert mine == theirs


def test_a_state_keeps_how_often_the_heaviest_block_counts() -> None:
    tally = SourceTally(
        SourceSums(1), SourceSums(1), ControlLineSums(()), rocks=20, simulated=6, heaviest=8
    )
    progress = Progress(1, MapSums(4), ControlLineSums(()), sources={(0, 1): tally})
    state = state_of(progress)
    found = progress_from(state, 4, ()).sources[0, 1]
    assert (found.rocks, found.simulated, found.heaviest) == (20, 6, 8)


@pytest.fixture(scope="module")
def simulated(small) -> Progress:
    """All blocks of a run, before anything is written."""
    return simulate_map(small.result.run, small.result.planned)


@pytest.fixture
def saved(simulated: Progress, tmp_path: Path) -> tuple[Checkpoint, list[str]]:
    """The state of a whole run with two files of rows, and what is said when it is restored."""
    own = Checkpoint(tmp_path, "own")
    for rows in simulated.stops[:2]:
        own.hand_on(rows)
        own.save(simulated)
    assert len(own.rows()) == 2
    return own, []


def test_rows_and_state_of_different_moments_are_noticed(
    small, simulated: Progress, saved, tmp_path: Path
) -> None:
    """Each file is as it was saved; they are not of the same attempt."""
    (older, said), run, progress = saved, small.result.run, simulated
    state, rows = tmp_path / "checkpoint" / "state.npz", older.rows()
    kept = {f: f.read_bytes() for f in (state, *rows)}

    # The order of rows.
    rows[0].write_bytes(kept[rows[1]])
    assert Checkpoint(tmp_path, "own").restore(run, said.append) is None
    # Another attempt, whose first file holds more.
    newer = Checkpoint(tmp_path, "own")
    for more in progress.stops:
        newer.hand_on(more)
    newer.save(progress)
    for file in (state, rows[0]):
        made = file.read_bytes()
        file.write_bytes(kept[file])
        assert Checkpoint(tmp_path, "own").restore(run, said.append) is None
        file.write_bytes(made)
    assert [text.split()[2] for text in said] == [str(rows[0])] * 3
    assert Checkpoint(tmp_path, "own").restore(run, said.append) is not None
    # That of another simulation for the same result.
    shutil.copytree(tmp_path / "checkpoint", tmp_path / "checkpoint" / "other")
    assert Checkpoint(tmp_path, "own", "other").restore(run, said.append) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s.pop("reasons"),
        lambda s: s.update({"sums.reach": s["sums.reach"][:-1]}),
        lambda s: s["sums.cells"].__setitem__(0, 10**9),
        lambda s: s["sums.cells"].__setitem__(0, -1),
    ],
    ids=["missing", "short", "beyond", "before"],
)
def test_a_state_that_is_not_whole_though_it_fits_is_not_used(
    small, saved, tmp_path: Path, change: Change
) -> None:
    _, said = saved
    file = tmp_path / "checkpoint" / "state.npz"
    state = saved_or_refused(file, "the state")
    change(state)
    write_saved(file, state, "own ")
    assert Checkpoint(tmp_path, "own").restore(small.result.run, said.append) is None
    assert said == [f"Saved state {file} is not used: it is not whole"]


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """As in a terminal: where the tests run in the background, SIGINT is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_waits_until_a_chunk_is_added(job, planned, monkeypatch) -> None:
    """Asked for in the middle of adding, it comes after: sums, stops and count go together."""
    add = map_run.add_chunk

    def interrupted_add(progress, *rest) -> None:
        if progress.chunks == 1:
            signal.raise_signal(signal.SIGINT)
        add(progress, *rest)

    held = map_run.Progress.fresh(job)
    with monkeypatch.context() as patched:
        patched.setattr(map_run, "add_chunk", interrupted_add)
        with pytest.raises(KeyboardInterrupt):
            simulate_map(job, planned, resume=held, chunk_points=9)
    assert held.chunks == 2
    simulate_map(job, planned, resume=held, chunk_points=9)
    whole = simulate_map(job, planned)
    assert np.array_equal(held.reasons, whole.reasons)
    assert np.array_equal(np.sort(held.sums.cells), np.sort(whole.sums.cells))
    assert held.sums.column("reach").sum() == whole.sums.column("reach").sum()


@pytest.mark.usefixtures("ctrl_c")
def test_held_back_restores_the_handler_and_leaves_other_threads_alone() -> None:
    before = signal.getsignal(signal.SIGINT)
    with held_back():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before
    done: list[bool] = []

    def elsewhere() -> None:
        with held_back():
            done.append(True)

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert done == [True]


def test_threads_stop_with_the_run(job, planned) -> None:
    """After an interruption no chunk is worked on any more."""
    count: list[int] = []
    work: Callable[..., object] = map_run._work

    def counted(*args):
        count.append(1)
        return work(*args)

    def stop(progress, chunks, rows) -> None:
        raise KeyboardInterrupt

    map_run._work = counted
    try:
        with pytest.raises(KeyboardInterrupt):
            simulate_map(job, planned, jobs=2, chunk_points=1, on_chunk=stop)
    finally:
        map_run._work = work
    assert len(count) <= 8 < len(plan(job).points)
    assert threading.active_count() == 1 or not any(
        t.name.startswith("ThreadPoolExecutor") for t in threading.enumerate()
    )


def test_a_state_is_of_the_polygons_that_were_read(small, tmp_path: Path) -> None:
    """It counts what was read, not where it lies nor how: a GIS that is open edits no bytes."""
    config = shutil.copytree(small.config.parent, tmp_path / "copy") / small.config.name
    file = config.with_name("release.gpkg")
    frame = gpd.read_file(file)
    shape, srs = frame.geometry.iloc[0], int(frame.crs.to_epsg())

    def fingerprint(path: Path = config) -> str:
        read = load_config(path, TABLES)
        return job_module.state_fingerprint(read, job_module.read_map_run(read))

    whole = fingerprint(small.config)
    assert fingerprint() == whole
    with moved_in_gis(file, shapely.affinity.translate(shape, 6.0, 0.0), srs):
        assert fingerprint() != whole
    with moved_in_gis(file, shape, srs):
        assert fingerprint() == whole


def test_a_state_is_no_other_run_whatever_its_files(small) -> None:
    """A file may be edited after it was read, and before its digest is taken."""
    config, run = load_config(small.config, TABLES), small.result.run
    own = job_module.state_fingerprint(config, run)
    area = run.areas[0]
    moved = replace(area, geometry=shapely.affinity.translate(area.geometry, 6.0, 0.0))
    heights = run.grid.values.copy()
    heights[5, 5] += 0.01
    others = [
        replace(run, areas=(moved, *run.areas[1:])),
        replace(run, grid=replace(run.grid, values=heights)),
        replace(run, ground=np.where(run.ground == 0, 1, run.ground)),
        replace(run, seed=run.seed + 1),
        replace(run, release=replace(run.release, rocks_per_point=5)),
        replace(run, terrain=replace(run.terrain, smoothing_m=6.0)),
        replace(run, stop_points_max=7),
    ]
    found = {job_module.state_fingerprint(config, other) for other in others}
    found.add(job_module.state_fingerprint(load_config(small.config), run))
    assert len(found) == len(others) + 1 and own not in found


def test_inputs_that_change_meanwhile_are_named(
    make_valley: Callable[..., Path], tmp_path: Path
) -> None:
    config = make_valley(spacing_m=40.0)
    file = config.with_name("release.gpkg")

    def edit(_done: int, _chunks: int, _rocks: int) -> None:
        frame = gpd.read_file(file)
        frame.geometry = frame.geometry.translate(1.0, 0.0)
        frame.to_file(file, driver="GPKG")

    told = run(config, tmp_path / "out", jobs=1, on_progress=edit).warnings
    assert [t for t in told if t.startswith("release.gpkg changed after it was read")]
    assert not [t for t in told if t.startswith(("dem.tif", "config.toml"))]
