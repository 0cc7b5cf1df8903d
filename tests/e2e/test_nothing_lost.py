"""What may happen while a command runs: one line, and what was computed is kept."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from helpers.small_slope import SASSGIS
from helpers.worker_tasks import kill_as_they_start, wait_for
from helpers.zone_slope import box, two_areas

from sassgis.cli.options import ProgressBar
from sassgis.files.atomic_output import MARKER_NAME, alone, check_output

COMMANDS = {
    "run": ("run", "config.toml"),
    "zone": ("zone", "config.toml"),
    "batch": ("batch", "release.gpkg", "--config", "config.toml"),
}


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A slope with a release area of few points, and another one."""
    case = two_areas(tmp_path)
    case.set("release.spacing_m", 8.0).set("release.rocks_per_point", 2)
    shapes = [box(4.0, 30.0, 5.0, 5.0), box(5.0, 41.0, 5.0, 5.0)]
    case.write_layer("release.gpkg", shapes, {"name": ["north", "south"]})
    return tmp_path


def command(site: Path, name: str, *options: object) -> tuple[object, ...]:
    files = [site / a if "." in a else a for a in COMMANDS[name]]
    return (*files, "-o", site / "out", "--jobs", "1", *options)


def error_of(err: str) -> str:
    """The one line of an error, below those of the progress."""
    assert "Traceback" not in err
    found = [line for line in err.splitlines() if line.startswith("Error: ")]
    assert len(found) == 1 and err.rstrip().splitlines()[-1] == found[0], err
    return found[0]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_second_run_into_one_folder_is_refused(site: Path, call, name: str) -> None:
    before = {p.name for p in site.iterdir()}
    with alone(site / "out"):
        code, _, err = call(*command(site, name))
        assert code == 3 and "another run is writing this result" in error_of(err)
        assert not (site / "out").exists()
    assert {p.name for p in site.iterdir()} == before


def test_results_that_are_open_elsewhere_are_replaced_whole(site: Path, printed) -> None:
    """The folder is put in the place of the old one: nothing is written into an open file."""
    printed(*command(site, "run"))
    whole = {p.name: p.read_bytes() for p in (site / "out" / "maps").glob("*.tif")}
    with closing(sqlite3.connect(site / "out" / "result.gpkg", isolation_level=None)) as database:
        database.execute("BEGIN EXCLUSIVE")
        printed(*command(site, "run", "--overwrite"))
    assert whole == {p.name: p.read_bytes() for p in (site / "out" / "maps").glob("*.tif")}
    with closing(sqlite3.connect(site / "out" / "result.gpkg")) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert not list(site.glob("out.*"))


def everything(folder: Path) -> dict[str, bytes]:
    files = [p for p in folder.rglob("*") if p.is_file()]
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def refused(site: Path, call, monkeypatch: pytest.MonkeyPatch, *command: object) -> str:
    """The line with which a command stops before it computes anything; all stays as it was."""
    before = everything(site)
    with monkeypatch.context() as patched:
        patched.setattr("sassgis.runs.resumable_run.simulate_map", None)
        patched.setattr("sassgis.runs.run.read_job", None)
        code, _, err = call(*command)
    assert code == 3, err
    assert everything(site) == before
    return error_of(err)


def test_overwrite_stops_at_a_file_of_the_user(
    site: Path, call, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The configuration and the terrain of the next run, kept in the result of the last."""
    again = command(site, "run", "--overwrite")
    printed(*command(site, "run"))
    for own in ("config.toml", "dem.tif"):
        mine = site / "out" / own
        mine.write_bytes((site / own).read_bytes())
        assert f"{mine}: is not a file that" in refused(site, call, monkeypatch, *again)
        mine.unlink()
    project = site / "out" / "project.qgz"
    project.write_bytes(project.read_bytes() + b"saved")
    assert f"{project}: has changed" in refused(site, call, monkeypatch, *again)
    project.rename(site / "project.qgz")
    printed(*again)
    check_output(site / "out", overwrite=True)
    assert (site / "project.qgz").read_bytes().endswith(b"saved")


@pytest.mark.battery
def test_overwrite_of_a_batch_stops_at_a_file_of_the_user(
    site: Path, call, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = site / "out"
    printed(*command(site, "batch"))
    again = command(site, "batch", "--seed", "7", "--overwrite")
    for place in ("areas/south", "areas/south.partial", "mosaic", "mosaic.partial"):
        mine = out / place / "mine.toml"
        mine.parent.mkdir(exist_ok=True)
        if place.endswith(".partial"):
            (mine.parent / MARKER_NAME).touch()
        mine.write_text("mine")
        assert f"{mine}: " in refused(site, call, monkeypatch, *again)
        mine.unlink()
    summary = out / "summary.csv"
    whole = summary.read_text()
    summary.write_text(whole + "a note\n")
    # Neither is it touched where nothing is to be computed.
    for line in (command(site, "batch"), again):
        assert f"{summary}: has changed" in refused(site, call, monkeypatch, *line)
    summary.unlink()
    # Beside what the batch writes, anything may lie.
    for place in (out, out / "areas"):
        (place / "mine.toml").write_text("mine")
    printed(*again)
    assert [(p / "mine.toml").read_text() for p in (out, out / "areas")] == ["mine"] * 2
    for place in ("areas/north", "areas/south", "mosaic"):
        check_output(out / place, overwrite=True)


def test_a_folder_with_a_summary_is_no_batch(
    site: Path, call, monkeypatch: pytest.MonkeyPatch
) -> None:
    (site / "out").mkdir()
    (site / "out" / "summary.csv").write_text("chapter,words\n")
    line = refused(site, call, monkeypatch, *command(site, "batch", "--overwrite"))
    assert "summary.csv: has changed since sassgis wrote it, or is not of sassgis" in line


@pytest.mark.battery
def test_what_other_commands_write_is_replaced_as_long_as_nobody_changed_it(
    site: Path, call, printed
) -> None:
    for name in ("run", "zone"):
        printed(name, site / "config.toml", "-o", site / name, "--jobs", "1")
    x, y = 2_700_010.0, 1_149_935.0
    commands = (
        ("run", site / "config.toml", "--jobs", "1"),
        ("zone", site / "config.toml", "--jobs", "1"),
        ("compare", site / "run", site / "run"),
        ("profile", site / "config.toml", "--point", x, y),
        ("sensitivity", site / "config.toml", "--samples", "4", "--rocks", "2", "--jobs", "1"),
        ("export", site / "zone", "--canton", "TI", ".xtf"),
        ("export", site / "zone", ".kml"),
        ("init", ".toml"),
        ("schema", ".json"),
        ("new", ".gpkg", "--crs", "EPSG:2056"),
        ("dem", "check", site / "dem.tif", "--html", ".html"),
        ("cliffs", site / "dem.tif", "--threshold", "30", ".gpkg"),
    )
    for k, words in enumerate(commands):
        target = site / f"made{k}"
        ending = next((w for w in words if isinstance(w, str) and w[:1] == "." and w[1:]), None)
        if ending is None:
            given = [*words, "-o", target]
        else:
            target = target.with_suffix(ending)
            given = [target if w == ending else w for w in words]
            if words[0] in ("export", "cliffs"):
                given.insert(-1, "-o")
        for overwrite in ((), ("--overwrite",), ("--overwrite",)):
            printed(*given, *overwrite)
        assert call(*given)[0] == 3
        changed = target if target.is_file() else target / "report.html"
        changed.write_bytes(changed.read_bytes() + b"mine")
        before = everything(site)
        code, _, err = call(*given, "--overwrite")
        assert code == 3 and f"{changed}: has changed" in error_of(err), words
        assert everything(site) == before


def contents(folder: Path) -> dict[str, bytes]:
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["files"]
    return {own["path"]: (folder / own["path"]).read_bytes() for own in manifest["files"]}


@pytest.mark.battery
def test_workers_that_are_killed_as_they_start_change_nothing(
    site: Path, call, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, out = site / "config.toml", site / "out"
    printed("zone", config, "-o", site / "whole", "--jobs", "1")
    with monkeypatch.context() as patched:
        killed = kill_as_they_start(patched, 1000)
        code, _, err = call("zone", config, "-o", out, "--workers", "2")
        assert code == 3 and "run the same command to resume from what is saved" in error_of(err)
        assert 3 <= len(killed) <= 6
    killed = kill_as_they_start(monkeypatch, 2)
    printed("zone", config, "-o", out, "--workers", "2")
    assert len(killed) == 2
    assert contents(out) == contents(site / "whole")
    assert not list(site.glob("out.*"))


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are found in /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_run_whose_workers_are_stopped_can_be_ended(site: Path, number: signal.Signals) -> None:
    """As they are stopped while they start, nothing is computed; what there is, is saved."""
    arguments = ("run", site / "config.toml", "-o", site / "out", "--workers", "2")
    with subprocess.Popen(
        [*SASSGIS, *map(str, arguments)], stderr=subprocess.PIPE, text=True,
        # A shell without a terminal starts what it puts in the background deaf to the interrupt.
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    ) as process:  # fmt: skip
        children = Path(f"/proc/{process.pid}/task")
        found: list[int] = []
        while len(found) < 2 and process.poll() is None:
            time.sleep(0.02)
            with contextlib.suppress(OSError):
                threads = [(own / "children").read_text() for own in children.iterdir()]
                pids = [int(pid) for pid in " ".join(threads).split()]
                # One that is stopped before it is a program of its own holds up who started it.
                found = [p for p in pids if b"serve" in Path(f"/proc/{p}/cmdline").read_bytes()]
        for pid in found:
            os.kill(pid, signal.SIGSTOP)
        wait_for("T", *found)
        process.send_signal(number)
        _, err = process.communicate(timeout=120.0)
    assert process.returncode == 130 and "stopped by the user after 0 blocks" in error_of(err)
    wait_for("Z", *found)
    assert (site / "out.partial" / "checkpoint" / "state.npz").is_file()


def mount(*arguments: object) -> None:
    """Mount a disk, or skip the test where that is not allowed."""
    done = subprocess.run(["mount", *map(str, arguments)], capture_output=True, check=False)
    if done.returncode:
        pytest.skip("no disk can be mounted here")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 60 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount("-t", "tmpfs", "-o", "size=60m", "none", place)
    yield place
    subprocess.run(["umount", str(place)], check=True)


def write_protect(disk: Path) -> None:
    """Lay the same disk over itself, without the right to write: files that are open stay so."""
    mount("--bind", disk, disk)
    mount("-o", "remount,bind,ro", disk)


def fill(disk: Path) -> None:
    with contextlib.suppress(OSError), (disk / "other.bin").open("wb", buffering=0) as stream:
        while stream.write(b"x" * 4096):
            pass


#: What happens when the second area begins, how it is undone, and what is said.
FAULTS = {
    "full disk": (fill, lambda disk: (disk / "other.bin").unlink(), "the disk is full"),
    "read-only disk": (
        write_protect,
        lambda disk: subprocess.run(["umount", str(disk)], check=True),
        "read-only",
    ),
    "a terrain model that is gone": (
        lambda disk: (disk.parent / "dem.tif").rename(disk.parent / "elsewhere.tif"),
        lambda disk: (disk.parent / "elsewhere.tif").rename(disk.parent / "dem.tif"),
        "is gone",
    ),
}


@pytest.mark.parametrize(
    "fault", [f if f == "full disk" else pytest.param(f, marks=pytest.mark.battery) for f in FAULTS]
)
def test_a_batch_keeps_what_was_done_before_a_fault(
    site: Path, disk: Path, call, printed, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first area stays; the same command goes on with the second."""
    begins, ends, words = FAULTS[fault]
    say = ProgressBar.say

    def faulty(self: ProgressBar, text: str) -> None:
        say(self, text)
        if text.startswith("Area 2"):
            begins(disk)

    out = disk / "out"
    arguments = (*command(site, "batch")[:4], "-o", out, "--jobs", "1")
    with monkeypatch.context() as patched:
        patched.setattr(ProgressBar, "say", faulty)
        code, _, err = call(*arguments)
    assert code in (2, 3) and words in error_of(err)
    first = out / "areas" / "north" / "manifest.json"
    kept = first.stat().st_mtime_ns
    assert not (out / "mosaic").exists()
    ends(disk)
    printed(*arguments)
    assert first.stat().st_mtime_ns == kept and (out / "mosaic" / "manifest.json").is_file()
    assert not list(disk.glob("out.*"))
