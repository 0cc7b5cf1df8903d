"""The command line from end to end, in processes of its own where that matters."""

from __future__ import annotations

import json
import os
import pty
import re
import resource
import select
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.listed_results import digests
from helpers.small_slope import SASSGIS, Slope, release_box

import sassgis
from sassgis.grid import Grid
from sassgis.inputs.tiles import read_terrain
from sassgis.settings.results import StopReason


def test_help_is_quick_because_it_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from sassgis.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "heavy = {'numpy', 'numba', 'pandas', 'rasterio', 'shapely', 'matplotlib', 'pydantic'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    for command in ("init", "validate", "run", "profile", "demo"):
        assert re.search(rf"^  {command} ", done.stdout, re.MULTILINE)


def test_from_the_template_to_a_result(slope: Slope, printed) -> None:
    config = slope.folder / "sassgis.toml"
    assert "sassgis validate" in printed("init", config)
    text = config.read_text().replace("rocks_per_point = 50", "rocks_per_point = 3")
    config.write_text(text)
    out = printed("validate", config)
    assert "release area   area 1" in out and "UNVERIFIED" not in out.split("ground")[0]
    out = printed("run", config, "-o", slope.folder / "result", "--jobs", "1")
    manifest = json.loads((slope.folder / "result" / "manifest.json").read_text())
    rocks = manifest["counts"]["rocks"]
    assert rocks > 0 and f"{rocks} blocks in" in out
    assert sum(manifest["counts"][f"rocks_{r.name.lower()}"] for r in StopReason) == rocks


def test_validate_reads_the_terrain_once(
    slope: Slope, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = slope.config.read_text()
    text = re.sub(r"(\[\[blocks\]\]\n)", r"\1onset_frequency = 0.5\n", text)
    slope.config.write_text(text + "\n[hazard]\nref_width_m = 10.0\n")
    opened = []

    def counted(path: object, *args: object, **kwargs: object) -> Grid:
        opened.append(path)
        return read_terrain(path, *args, **kwargs)

    monkeypatch.setattr("sassgis.runs.inputs.read_terrain", counted)
    out = printed("validate", slope.config)
    assert "onset: 0.5 blocks a year" in out and len(opened) == 1


def test_seed_and_area_are_passed_on(slope: Slope, printed) -> None:
    slope.write_release(release_box(), release_box(row=30.0))
    arguments = ("--jobs", "1", "--seed", "77", "--area", "area b")
    printed("run", slope.config, "-o", slope.folder / "result", *arguments)
    manifest = json.loads((slope.folder / "result" / "manifest.json").read_text())
    assert manifest["seed"] == 77 and manifest["counts"]["release_areas"] == 1
    assert manifest["settings"]["areas"] == ["area b"]


def started(command: list[str], **options: object) -> tuple[int, subprocess.Popen[bytes]]:
    """Start a command on a terminal of its own; gives its end of the terminal."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        command, stderr=slave, stdout=subprocess.DEVNULL, start_new_session=True,
        # A shell without a terminal starts what it puts in the background deaf to the interrupt.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler), **options,
    )  # fmt: skip
    os.close(slave)
    return master, process


def read_until(master: int, what: bytes, seconds: float) -> bytes:
    seen = b""
    end = time.monotonic() + seconds
    while time.monotonic() < end and not (what and re.search(what, seen)):
        if select.select([master], [], [], 0.2)[0]:
            try:
                seen += os.read(master, 65536)
            except OSError:
                break
    return seen


def test_ctrl_c_keeps_the_state_and_the_next_run_goes_on_from_it(slope: Slope, call) -> None:
    # Enough chunks and rocks to be interrupted in the middle.
    slope.write_config(release__spacing_m="0.5", release__rocks_per_point="120")
    command = [*SASSGIS, "run", str(slope.config), "-o", str(slope.folder / "result")]
    master, process = started(command)
    try:
        seen = read_until(master, rb"\[#+-+\] +\d+ %, [1-9]\d* blocks, about [\d:]+ left", 300)
        process.send_signal(signal.SIGINT)
        seen += read_until(master, b"", 60)
        assert process.wait(60) == 130, seen.decode()
    finally:
        process.kill()
        os.close(master)
    text = seen.decode().replace("\r\n", "\n")
    # On a terminal a bar with the time left.
    assert "\r" in text and re.search(r"\[#+-+\] +\d+ %, \d+ blocks, about [\d:]+ left", text)
    errors = [line for line in text.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1 and "run the same command to resume" in errors[0]
    assert "Traceback" not in text
    assert not (slope.folder / "result").exists()
    assert (slope.folder / "result.partial" / "checkpoint" / "state.npz").is_file()

    code, _, err = call("run", slope.config, "-o", slope.folder / "result")
    assert code == 0 and re.search(r"Resuming after \d+ chunks", err)
    # Not on a terminal: lines only. That it ends as a run in one go is shown in tests/runs/map.
    assert "\r" not in err
    assert not (slope.folder / "result.partial").exists()


@pytest.mark.battery
def test_a_full_disk_keeps_the_state_and_the_next_run_does_not_simulate_again(
    slope: Slope, call, printed
) -> None:
    """A limit below the largest file of the result lets the state through."""
    slope.write_config(release__rocks_per_point="2")
    printed("run", slope.config, "-o", slope.folder / "whole")
    limit = max(f.stat().st_size for f in (slope.folder / "whole").rglob("*")) * 19 // 20

    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    out = slope.folder / "result"
    done = subprocess.run(
        [*SASSGIS, "run", str(slope.config), "-o", str(out)],
        capture_output=True, text=True, check=False, preexec_fn=little_room,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    errors = [line for line in done.stderr.splitlines() if not line.endswith("...")]
    assert len(errors) == 1 and errors[0].startswith("Error: ")
    assert "result" in errors[0] and "cannot be written" in errors[0]
    assert not out.exists()
    left = {p.name for p in (slope.folder / "result.partial").iterdir()}
    assert left == {"checkpoint", ".sassgis-partial"}
    with np.load(slope.folder / "result.partial" / "checkpoint" / "state.npz") as state:
        chunks = int(state["chunks"])

    code, _, err = call("run", slope.config, "-o", out)
    assert code == 0 and f"Resuming after {chunks} chunks" in err
    assert digests(out) == digests(slope.folder / "whole")


def test_ctrl_c_before_anything_is_computed_is_one_line(slope: Slope) -> None:
    """The interrupt comes at the first opening of a raster, however fast or slow the machine is."""
    program = (
        "import os, signal, rasterio.io\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "rasterio.io.DatasetReader = lambda *a, **k: os.kill(os.getpid(), signal.SIGINT)\n"
        "from sassgis.cli import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "run", slope.config, "-o", slope.folder / "result"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stderr.startswith("Reading the inputs ...\n")
    assert done.returncode == 130
    lines = [line for line in done.stderr.splitlines() if line.strip() and not line.endswith("...")]
    assert len(lines) == 1 and lines[0].startswith("Error: stopped by the user")
    assert not (slope.folder / "result").exists()


def test_ctrl_c_while_the_program_is_loaded_is_one_line() -> None:
    code = (
        "import sys\n"
        "class Stops:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'sassgis.cli.entry': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Stops())\n"
        "from sassgis.cli import main; main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "Error: stopped by the user\n")


def limited(slope: Slope, **limits: int) -> subprocess.CompletedProcess[str]:
    """A run within limits of the system, by their names without ``RLIMIT_``."""

    def limit() -> None:
        for name, most in limits.items():
            resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (most, most))

    return subprocess.run(
        [*SASSGIS, "run", str(slope.config), "-o", str(slope.folder / "out")], preexec_fn=limit,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="limits are set in this way there alone")
@pytest.mark.parametrize(
    ("limits", "code", "words"),
    [
        ({"NOFILE": 9}, 3, "Too many open files"),
        ({"AS": 400_000_000}, 1, "not enough memory"),
        ({"AS": 700_000_000}, 1, "not enough memory"),
    ],
)
def test_limits_of_the_system_are_one_line_and_leave_nothing(
    slope: Slope, limits: dict[str, int], code: int, words: str
) -> None:
    before = sorted(slope.folder.iterdir())
    done = limited(slope, **limits)
    # Python may say at its end, without memory, what it could not free.
    lines = [line for line in done.stderr.splitlines() if not line.startswith("Exception ignored")]
    assert done.returncode == code and words in lines[-1]
    assert "fault of sassgis" not in done.stderr and "Traceback" not in done.stderr
    assert sorted(slope.folder.iterdir()) == before


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_what_cannot_be_printed_is_no_fault_of_the_program(slope: Slope) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*SASSGIS, "validate", str(slope.config)], stdout=full, stderr=subprocess.PIPE,
            text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert done.stderr.startswith("Error: standard output: cannot be written (")
    assert done.stderr.count("\n") == 1


def test_version(printed) -> None:
    assert sassgis.__version__ in printed("--version")
