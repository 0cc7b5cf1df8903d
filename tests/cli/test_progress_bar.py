"""What a bar says of the time left."""

from __future__ import annotations

import pytest

from sassgis.cli import options
from sassgis.cli.options import ProgressBar


@pytest.fixture
def seconds(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What the clock shows; a line is told each second."""
    shown = [0.0]
    monkeypatch.setattr(options.time, "monotonic", lambda: shown[0])
    monkeypatch.setenv("SASSGIS_PROGRESS_S", "1")
    return shown


def test_the_time_left_is_told_once_there_is_a_pace(
    seconds: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with ProgressBar() as bar:
        # Compiling takes 40 s of the second step; all others take one.
        for done in range(1, 1001):
            seconds[0] += 40.0 if done == 2 else 1.0
            bar.step(done, 1000, 10 * done)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["  0 %, 10 blocks", "  0 %, 20 blocks"]
    told = [line for line in lines if "left" in line]
    assert told[0] == "  5 %, 510 blocks, about 28:09 left" and len(told) == 950
    assert told[-1] == "  100 %, 10000 blocks, about 0:00 left"


def test_a_stage_has_a_pace_of_its_own(
    seconds: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with ProgressBar() as bar:
        for pace in (100.0, 1.0):
            bar.say("Stage")
            for done in range(1, 11):
                seconds[0] += pace
                bar.step(done, 10, done)
    lines = capsys.readouterr().err.splitlines()
    assert lines[9].endswith("about 1:40 left") and lines[20].endswith("about 0:01 left")
