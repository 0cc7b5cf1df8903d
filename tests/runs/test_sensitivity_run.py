"""A small sensitivity of the sample valley: what it writes, and what it keeps."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
from helpers.changed_arrays import change_arrays

from sassgis.errors import Interrupted
from sassgis.files.atomic_output import partial_folder
from sassgis.inputs.config import load_config
from sassgis.runs import resumable_run as module
from sassgis.runs.sensitivity_run import SensitivityResult, sensitivity
from sassgis.settings.ground import RANGED
from sassgis.settings.map_run import Config

OPTIONS = {"samples": 4, "rocks": 48, "jobs": 1, "areas": ["Nord"]}


@pytest.fixture(scope="module")
def config(make_valley: Callable[..., Path]) -> Config:
    path = make_valley(spacing_m=30.0)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[project]", '[project]\nlanguage = "de"'), encoding="utf-8")
    return load_config(path)


@pytest.fixture(scope="module")
def eta_only(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ranges without width but for η_max of the debris."""
    file = tmp_path_factory.mktemp("ranges") / "eta.csv"
    still = [f"{c},{p},factor,1,1" for c in ("*", "rock", "debris", "soft_meadow") for p in RANGED]
    rows = ["class,parameter,kind,low,high", *still, "debris,eta_max,value,0.3,0.98"]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def small(
    config: Config, eta_only: Path, tmp_path_factory: pytest.TempPathFactory
) -> SensitivityResult:
    out = tmp_path_factory.mktemp("sensitivity") / "out"
    return sensitivity(config, out, ranges=eta_only, **OPTIONS)


def test_run_out_rises_with_what_an_impact_keeps(small: SensitivityResult) -> None:
    assert [r.label for r in small.ranges] == ["debris: eta_max"]
    # Base, another seed, farthest, two ends, four points.
    assert small.simulations == 9
    (found,) = [e for e in small.effects if e.measure == "run-out (95 %)"]
    # Above the base value an impact is charged what rolling takes, whatever η_max.
    assert found.low < found.base <= found.high and found.beyond_chance
    assert found.correlation > 0.5


def test_what_is_written(small: SensitivityResult, config: Config) -> None:
    maps = {f.stem for f in (small.folder / "maps").glob("*.tif")}
    assert maps == {
        "level_could_be", "level_higher", "reach_share", "energy_ratio", "strongest_parameter",
        "terrain",
    }  # fmt: skip
    with rasterio.open(small.folder / "maps" / "level_could_be.tif") as raster:
        highest, base, lowest = raster.read(masked=True)
    either = ~np.ma.getmaskarray(highest)
    assert either.sum() >= (~np.ma.getmaskarray(base)).sum() > 0
    both = ~np.ma.getmaskarray(base)
    assert (highest[both] >= base[both]).all()
    assert (lowest.filled(0)[both] <= base[both]).all()
    tables = {f.stem: pd.read_csv(f) for f in (small.folder / "tables").glob("*.csv")}
    assert set(tables) == {"ranges", "effects", "simulations"}
    assert len(tables["simulations"]) == small.simulations
    assert tables["simulations"]["debris: eta_max"].between(0.3, 0.98).all()
    manifest = json.loads((small.folder / "manifest.json").read_text(encoding="utf-8"))
    counts = manifest["counts"]
    assert counts["simulations"] == 9 and counts["rocks_per_point"] == OPTIONS["rocks"]
    assert {i["role"] for i in manifest["inputs"]} >= {"config", "dem", "ranges"}
    page = (small.folder / "report.html").read_text(encoding="utf-8")
    assert 'alt="' in page and 'alt=""' not in page
    # In the language of the project.
    assert "Welche Bereiche Reichweite und Energie ändern" in page
    assert "1 von 1 Bereichen sind Annahmen" in page
    # But for a station above the road.
    shown = re.sub("<[^>]*>", " ", page.partition("<body>")[2]).replace("above the road", "")
    assert not re.findall(r"\b(?:[Tt]he|of|and|blocks|which|is|by)\b", shown)
    assert (small.folder / "project.qgz").is_file()


def test_an_interrupted_one_goes_on_and_is_the_same(
    small: SensitivityResult, config: Config, eta_only: Path, tmp_path: Path, monkeypatch
) -> None:
    def stop(done: int, _total: int, _blocks: int) -> None:
        if done == 5:
            raise Interrupted("stopped by the user")

    with pytest.raises(Interrupted):
        sensitivity(config, tmp_path / "out", ranges=eta_only, on_progress=stop, **OPTIONS)
    assert not (tmp_path / "out").exists()
    files = sorted((partial_folder(tmp_path / "out") / "checkpoint").iterdir())
    assert len(files) == 4
    change_arrays(files[0], lambda arrays: arrays["line_share"].__imul__(0.5))
    shutil.copy(files[1], files[2])
    simulated, said = [], []
    simulate = module.simulate_map
    monkeypatch.setattr(
        module, "simulate_map", lambda *a, **k: simulated.append(1) or simulate(*a, **k)
    )
    again = {**OPTIONS, "jobs": 2, "say": said.append}
    sensitivity(config, tmp_path / "out", ranges=eta_only, **again)
    # One was changed, one put in the place of another: both are simulated again.
    assert len(simulated) == 4 + 2
    assert [sum(str(file) in text for text in said) for file in files] == [1, 0, 1, 0]
    mine, theirs = ((f / "manifest.json").read_bytes() for f in (tmp_path / "out", small.folder))
    assert mine == theirs
    assert not (tmp_path / "out" / "checkpoint").exists()


def test_without_frequencies_reach_and_energy_alone(
    make_valley: Callable[..., Path], eta_only: Path, tmp_path: Path
) -> None:
    path = make_valley(spacing_m=30.0)
    text = path.read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith(("onset_", "frequencies"))]
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")
    result = sensitivity(load_config(path), tmp_path / "out", ranges=eta_only, **OPTIONS)
    assert any("no onset frequency" in w for w in result.warnings)
    maps = {f.stem for f in (result.folder / "maps").glob("*.tif")}
    assert not {m for m in maps if m.startswith("level")} and "energy_ratio" in maps
    assert not any(e.measure.startswith("area of level") for e in result.effects)


def test_command_line(refusal, config: Config, eta_only: Path, tmp_path: Path) -> None:
    err = refusal(
        "sensitivity", config.file, "-o", tmp_path / "out", "--ranges", tmp_path / "none.csv"
    )
    assert "none.csv" in err
    assert not (tmp_path / "out").exists()
