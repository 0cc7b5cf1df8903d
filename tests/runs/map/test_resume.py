"""An interrupted run goes on where it was, and only where it belongs to the same run."""

from __future__ import annotations

import errno
import gc
import os
import signal
import threading
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sassgis.io.read.config import load_config
from sassgis.io.staging import partial_folder
from sassgis.model.errors import Interrupted, OutputError
from sassgis.runs import job as job_module
from sassgis.runs import map as map_run
from sassgis.runs import publish
from sassgis.runs.checkpoint import Checkpoint
from sassgis.runs.interrupts import held_back
from sassgis.runs.map import simulate_map
from sassgis.runs.run import run
from sassgis.terrain.plan import plan

TABLES = {"output.rock_table": "csv", "output.passage_table": "csv"}


@pytest.fixture
def few_points_a_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(*args, **kwargs):
        return simulate_map(*args, **kwargs, chunk_points=6)

    monkeypatch.setattr(job_module, "simulate_map", simulate)


@pytest.fixture
def interrupted(small, tmp_path: Path, few_points_a_chunk: None) -> Path:
    """Folder of a run that was stopped after four of its chunks."""

    def stop(done: int, chunks: int, rocks: int) -> None:
        assert chunks > 6
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match="the same command goes on from there") as caught:
        run(load_config(small.config, TABLES), tmp_path / "out", jobs=1, on_progress=stop)
    assert caught.value.exit_code == 130
    assert not (tmp_path / "out").exists()
    assert (partial_folder(tmp_path / "out") / "checkpoint" / "state.npz").is_file()
    return tmp_path / "out"


def firsts(config, out: Path, **options) -> list[int]:
    """Chunks as they are reported by a run that is left to its end."""
    seen: list[int] = []
    run(config, out, on_progress=lambda done, _n, _r: seen.append(done), **options)
    return seen


def test_it_goes_on_and_gives_the_same_bytes(small, interrupted: Path) -> None:
    seen = firsts(load_config(small.config, TABLES), interrupted, jobs=2)
    assert seen[0] == 5
    whole = interrupted.with_name("whole")
    assert firsts(load_config(small.config, TABLES), whole, jobs=1)[0] == 1
    mine, theirs = ((f / "manifest.json").read_bytes() for f in (interrupted, whole))
    assert mine == theirs
    assert not partial_folder(interrupted).exists()
    assert not (interrupted / "checkpoint").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"release.rocks_per_point": 5},
        {"run.seed": 3},
        {"terrain.smoothing_m": 6.0},
        {"output.stop_points_max": 7},
        {"output.rock_table": "none", "output.passage_table": "none"},
    ],
)
def test_a_state_of_other_settings_is_ignored(small, interrupted: Path, change) -> None:
    checkpoint = partial_folder(interrupted) / "checkpoint"
    config = load_config(small.config, {**TABLES, **change})
    job = job_module.read_map_run(config)
    fingerprint = job_module.state_fingerprint(config, job)
    assert Checkpoint(checkpoint.parent, fingerprint).restore(job) is None
    same = load_config(small.config, TABLES)
    own = Checkpoint(checkpoint.parent, job_module.state_fingerprint(same, small.result.run))
    assert own.restore(small.result.run) is not None


def test_a_state_of_other_areas_is_ignored(small, interrupted: Path) -> None:
    names = [a.name for a in small.result.run.areas[1:]]
    seen = firsts(load_config(small.config, TABLES), interrupted, jobs=1, areas=names)
    assert seen[0] == 1


@pytest.mark.parametrize("harm", ["cut", "rows"])
def test_a_damaged_state_is_ignored(small, interrupted: Path, harm: str) -> None:
    folder = partial_folder(interrupted) / "checkpoint"
    if harm == "cut":
        state = folder / "state.npz"
        state.write_bytes(state.read_bytes()[:1000])
    else:
        (folder / "rows_000000.npz").unlink()
    config = load_config(small.config, TABLES)
    fingerprint = job_module.state_fingerprint(config, small.result.run)
    with warnings.catch_warnings():
        # What it opens it closes.
        warnings.simplefilter("error", ResourceWarning)
        assert Checkpoint(folder.parent, fingerprint).restore(small.result.run) is None
        gc.collect()


def test_results_that_cannot_be_written_leave_the_state(
    small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_args: object, **_kwargs: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    config = load_config(small.config, TABLES)
    with monkeypatch.context() as patched:
        patched.setattr(publish, "write_geopackage", full)
        with pytest.raises(OutputError, match="the disk is full"):
            run(config, tmp_path / "out", jobs=1)
    left = {p.name for p in partial_folder(tmp_path / "out").iterdir()}
    assert "checkpoint" in left and not left & {"maps", "result.gpkg", "figures"}

    def never(*_args: object) -> None:
        raise AssertionError("simulated again")

    # The small sample of the check is not part of what is saved.
    checked = job_module.check_tolerance(small.result.run, small.result.planned, 1)
    monkeypatch.setattr(job_module, "check_tolerance", lambda *_: checked)

    monkeypatch.setattr(map_run, "_work", never)
    run(config, tmp_path / "out", jobs=1)
    mine, theirs = ((f / "manifest.json").read_bytes() for f in (tmp_path / "out", small.folder))
    assert mine == theirs


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
