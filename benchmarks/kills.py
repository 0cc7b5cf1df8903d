"""Commands that are killed at random moments and given again: do they end with the same bytes?

    python benchmarks/kills.py [--kills 50] [--only run,zone] [--workers] [--json FILE]

``run``, ``zone``, ``batch``, ``calibrate`` and ``gap diagnose`` are run on the sample valley, with
fewer blocks, once without and then with kills (SIGKILL) at moments drawn from the time of the first
run; where a command ends before, it begins anew. The killed process is the parent of the workers;
after each kill none of them may be left, and no result may be there but a whole one. After the last
kill the same command goes on to its end. All files of the result are then compared with those of
the first run, byte by byte, except the column ``seconds`` of ``summary.csv`` of a batch, and the
digest of that file in ``.sassgis-written``.

With ``--workers`` it is the worker processes that are killed, half of them within a moment after
another one, as they start. The command must go on to the same bytes, or end with one line and exit
code 3, and is then given again.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

SAMPLE = Path(__file__).resolve().parents[1] / "sample_dem"
SEED = 12
#: Observed rocks of calibrations and diagnoses.
ROCKS = 12
#: A process that shows itself in none of these seconds after its parent's end is taken for ended.
GONE_S = 15.0
#: A process that is younger may still be starting.
STARTING_S = 1.0


@dataclass(frozen=True)
class Outcome:
    """What became of one command."""

    command: str
    kills: int
    seconds: float  # of the run that was not killed
    kept: int  # kills after which a saved state was there
    orphans: int  # kills after which a worker went on
    half: int  # kills after which a result was there that is not whole
    different: tuple[str, ...]  # files that differ in the end


@dataclass(frozen=True)
class WorkerOutcome:
    """What became of one command whose workers were killed."""

    command: str
    kills: int
    starting: int  # of processes that were at most so old as STARTING_S
    lines: int  # times that the command ended with one line
    orphans: int  # ends of the command after which a worker went on
    different: tuple[str, ...]  # files that differ in the end


def site(folder: Path) -> Path:
    """The sample valley with fewer blocks and observed rocks; returns the configuration."""
    shutil.copytree(SAMPLE / "valley", folder)
    shutil.copytree(SAMPLE / "observed", folder / "observed")
    config = folder / "config.toml"
    text = config.read_text(encoding="utf-8")
    text = re.sub(r"(?m)^(blocks|changed_share_max) = .*\n", "", text)
    # Reports show the day, which may end while this runs.
    text = text.replace("[project]\n", '[project]\ndate = "2026-01-01"\n', 1)
    for key, value in (("spacing_m", 6.0), ("rocks_per_point", 20)):
        text, found = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        if found != 1:
            raise SystemExit(f"{config}: {key} is there {found} times")
    config.write_text(text, encoding="utf-8")
    rocks = tuple(f"R{n:02d}," for n in range(1, ROCKS + 1))
    for name in ("rocks", "passages", "deposits"):
        file = config.parent / "observed" / f"{name}.csv"
        head, *rows = file.read_text(encoding="utf-8").splitlines()
        own = [row for row in rows if row.startswith(rocks)]
        file.write_text("\n".join([head, *own, ""]), encoding="utf-8")
    return config


def commands(config: Path) -> Mapping[str, Sequence[str]]:
    """Arguments of each command, without the folder of the result."""
    seen = str(config.parent / "observed")
    own = str(config)
    return {
        "run": ("run", own),
        "zone": ("zone", own),
        "batch": ("batch", str(config.parent / "release.gpkg"), "--config", own),
        "calibrate": (
            "calibrate", own, "--observations", seen, "--draws", "16",
            "--parameter", "eta_max", "--parameter", "mu_0",
        ),
        "gap diagnose": ("gap", "diagnose", own, "--observations", seen, "--draws", "8"),
    }  # fmt: skip


def start(arguments: Sequence[str], out: Path, jobs: str = "--jobs") -> subprocess.Popen[bytes]:
    """Start a command with two processes or threads."""
    return subprocess.Popen(
        [sys.executable, "-m", "sassgis", *arguments, "-o", str(out), jobs, "2"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def finished(arguments: Sequence[str], out: Path) -> float:
    """Run a command to its end; returns the seconds."""
    began = time.monotonic()
    process = start(arguments, out)
    _, said = process.communicate()
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(arguments)}: exit code {process.returncode}: {said.decode()}")
    return time.monotonic() - began


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file, by its path."""
    found = {}
    for file in sorted(f for f in folder.rglob("*") if f.is_file()):
        content = file.read_bytes()
        if file.name == "summary.csv":
            content = re.sub(rb",[^,\n]*$", b"", content, flags=re.MULTILINE)
        elif file.name == ".sassgis-written":
            content = " ".join(json.loads(content)).encode()
        found[file.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    return found


def members(session: int, parent: int | None = None) -> dict[int, float]:
    """Processes of a session, or the children of one of them, that run: since when (s)."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z" and parent in (None, int(fields[1])):
            since = int(fields[19]) / os.sysconf("SC_CLK_TCK")
            found[int(entry.parent.name)] = time.clock_gettime(time.CLOCK_BOOTTIME) - since
    return found


def all_gone(session: int) -> bool:
    """Whether every process of a session ends within GONE_S; those that do not are killed."""
    ends = time.monotonic() + GONE_S
    while members(session) and time.monotonic() < ends:
        time.sleep(0.1)
    left = members(session)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    return not left


def is_whole(out: Path, whole: Mapping[str, str], batch: bool) -> bool:
    """Whether nothing stands in the place of the result, or all of it.

    A batch grows area by area: each of them, and the map of all, is a result of its own.
    """
    if not out.exists():
        return True
    parts = [*out.glob("areas/*"), *out.glob("mosaic")] if batch else [out]
    for part in parts:
        if part.name.endswith((".partial", ".replaced")):
            continue
        start = part.relative_to(out).as_posix()
        prefix = "" if start == "." else f"{start}/"
        own = {prefix + f.relative_to(part).as_posix() for f in part.rglob("*") if f.is_file()}
        if own != {name for name in whole if name.startswith(prefix)}:
            return False
    return True


def killed(
    name: str, arguments: Sequence[str], folder: Path, kills: int, say: Callable[[str], None]
) -> Outcome:
    """One command with its kills."""
    rng = random.Random(f"{SEED} {name}")
    plain = folder / "plain"
    seconds = finished(arguments, plain)
    whole = digests(plain)
    out = folder / "killed"
    kept = orphans = half = done = 0
    while done < kills:
        process = start(arguments, out)
        try:
            process.communicate(timeout=rng.uniform(0.0, 1.05 * seconds))
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            done += 1
            orphans += not all_gone(process.pid)
            own = [out, out.with_name(out.name + ".partial")]
            saved = ("**/checkpoint*", "areas/*/manifest.json")
            states = [file for place in own for pattern in saved for file in place.glob(pattern)]
            kept += bool(states)
            half += not is_whole(out, whole, name == "batch")
            say(f"{name}: {done} of {kills} kills")
            continue
        # It ended before: compare, and begin anew.
        _compare(out, whole)
        shutil.rmtree(out)
    if not out.exists() or name == "batch":
        finished(arguments, out)
    return Outcome(name, kills, round(seconds, 1), kept, orphans, half, _different(out, whole))


def workers_killed(
    name: str, arguments: Sequence[str], folder: Path, kills: int, say: Callable[[str], None]
) -> WorkerOutcome:
    """One command whose workers are killed."""
    rng = random.Random(f"{SEED} {name} workers")
    jobs = "--jobs" if name == "gap diagnose" else "--workers"
    plain, out = folder / "plain", folder / "killed"
    seconds = finished(arguments, plain)
    whole = digests(plain)
    done = starting = lines = orphans = 0
    ended = False
    while done < kills or not ended:
        if ended:
            _compare(out, whole)
            shutil.rmtree(out)
        process = start(arguments, out, jobs)
        while process.poll() is None:
            wait = rng.uniform(0.0, rng.choice((STARTING_S, 0.25 * seconds)))
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(wait)
            own = members(process.pid, process.pid)
            if done < kills and own:
                victim = rng.choice(sorted(own))
                with contextlib.suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
                done += 1
                starting += own[victim] <= STARTING_S
        _, said = process.communicate()
        ended = process.returncode == 0
        orphans += not all_gone(process.pid)
        errors = [line for line in said.decode().splitlines() if line.startswith("Error: ")]
        if process.returncode == 3 and len(errors) == 1 and b"Traceback" not in said:
            lines += 1
        elif not ended:
            raise SystemExit(f"{name}: exit code {process.returncode}: {said.decode()}")
        say(f"{name}: {done} of {kills} kills of workers, {lines} times one line")
    return WorkerOutcome(name, kills, starting, lines, orphans, _different(out, whole))


def _different(out: Path, whole: Mapping[str, str]) -> tuple[str, ...]:
    found = digests(out)
    return tuple(sorted(k for k in {*found, *whole} if found.get(k) != whole.get(k)))


def _compare(out: Path, whole: Mapping[str, str]) -> None:
    different = _different(out, whole)
    if different:
        raise SystemExit(f"{out}: differs in {', '.join(different[:5])}")


def note(file: Path, outcome: Outcome | WorkerOutcome) -> None:
    """Write an outcome into the file, in place of an earlier one of the same command."""
    known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []
    rows = [row for row in known if row["command"] != outcome.command] + [asdict(outcome)]
    file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50, help="of all commands together")
    parser.add_argument("--only", default="", help="commands, with commas between them")
    parser.add_argument("--workers", action="store_true", help="kill these in place of the parent")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if not Path("/proc/self/stat").exists():
        raise SystemExit("processes are found in /proc, which this system does not have")
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="sassgis-kills-") as made:
        config = site(Path(made) / "site")
        all_ = commands(config)
        chosen = [n for n in all_ if not options.only or n in options.only.split(",")]
        for i, name in enumerate(chosen):
            share = options.kills // len(chosen) + (i < options.kills % len(chosen))
            folder = Path(made) / name.replace(" ", "_")
            folder.mkdir()
            kill = workers_killed if options.workers else killed
            outcomes.append(kill(name, all_[name], folder, share, lambda t: print(t, flush=True)))
            shutil.rmtree(folder)
            print(asdict(outcomes[-1]), flush=True)
            if options.json:
                note(options.json, outcomes[-1])
    if any(own.orphans or getattr(own, "half", 0) or own.different for own in outcomes):
        sys.exit(1)


if __name__ == "__main__":
    main()
