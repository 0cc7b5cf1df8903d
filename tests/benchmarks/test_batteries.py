"""The batteries see what they look for."""

from __future__ import annotations

import logging
from pathlib import Path

import extremes
import fuzz
import kills
import numpy as np
import pytest
import watched
from helpers.watched_cases import prepare
from helpers.zone_slope import two_areas

from sassgis.engine.state import EVENT_DTYPE, IMPACT
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.results import ROCK_DTYPE
from sassgis.settings.settings import EngineSettings


def test_every_kind_of_failure_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watched, "FIRST_S", 20.0)
    counts, failures = watched.watched(prepare, ("a word",), range(7), 2.0)
    assert counts == {"done": 4, "failed": 1, "process ended": 1, "too long": 1}
    said = {one["number"]: one["said"] for one in failures}
    assert set(said) == {1, 3, 5}
    assert "ValueError: a word" in said[1] and said[3] == "exit code 7" and "2 s" in said[5]


def test_a_result_that_is_not_whole_is_seen(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "areas" / "a").mkdir(parents=True)
    (out / "areas" / "a" / "x").write_text("1")
    (out / "areas" / "a" / "y").write_text("2")
    (out / "summary.csv").write_text("name,seconds\na,1.5\n")
    (out / ".sassgis-written").write_text('{"summary.csv": ["1"]}')
    whole = kills.digests(out)
    (out / "summary.csv").write_text("name,seconds\na,2.5\n")
    (out / ".sassgis-written").write_text('{"summary.csv": ["2"]}')
    assert kills.digests(out) == whole
    assert kills.is_whole(out, whole, batch=True)
    (out / "areas" / "a" / "y").unlink()
    assert not kills.is_whole(out, whole, batch=True)
    (out / "areas" / "a").rename(out / "areas" / "a.partial")
    assert kills.is_whole(out, whole, batch=True) and not kills.is_whole(out, whole, batch=False)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found in /proc")
def test_a_batch_that_is_killed_ends_with_the_same_bytes(tmp_path: Path) -> None:
    """The battery in short, at a small site."""
    case = two_areas(tmp_path, project={"date": "2026-01-01"})
    case.set("release.spacing_m", 8.0).set("release.rocks_per_point", 2)
    own = ("--config", str(case.config), "--mosaic-only")
    arguments = ("batch", str(tmp_path / "release.gpkg"), *own)
    found = kills.killed("batch", arguments, tmp_path, 1, print)
    assert found == kills.Outcome("batch", 1, found.seconds, found.kept, 0, 0, ())


def test_an_energy_that_grows_is_seen() -> None:
    rock = np.ones(1, ROCK_DTYPE)[0]
    log = np.zeros(4, EVENT_DTYPE)
    log["t_s"] = [0.0, 1.0, 2.0, 3.0]
    log["phase"] = IMPACT
    log["vx_mps"] = [3.0, 2.0, 2.0, 0.0]
    extremes.check_log(log, rock, EngineSettings(), EffectSettings())
    log["vx_mps"] = [3.0, 2.0, 2.1, 0.0]
    with pytest.raises(AssertionError, match="energy grows"):
        extremes.check_log(log, rock, EngineSettings(), EffectSettings())
    log["vz_mps"][1] = np.nan
    with pytest.raises(AssertionError, match="NaN"):
        extremes.check_log(log, rock, EngineSettings(), EffectSettings())


@pytest.mark.parametrize("kind", ["config", "frequencies"])
def test_damaged_files_are_given_to_their_reader(
    tmp_path: Path, kind: str, request: pytest.FixtureRequest
) -> None:
    fuzz._site(tmp_path / "site")
    # The battery reads in a process of its own, and keeps that silent.
    request.addfinalizer(lambda: logging.disable(logging.NOTSET))
    case = fuzz.reading(kind, str(tmp_path / "site"))
    assert {next(iter(case(number))) for number in range(60)} == {"read", "refused"}
