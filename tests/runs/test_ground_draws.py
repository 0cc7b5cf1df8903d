"""Draws of the ground classes of the sample valley: bands, what is kept, what does not change."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from field_cases.scores import runout_bands
from helpers.listed_results import digests

from sassgis.errors import Interrupted
from sassgis.files.atomic_output import partial_folder
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import read_ranges
from sassgis.runs import resumable_run as module
from sassgis.runs.inputs import read_map_run
from sassgis.runs.run import ZoneResult, zone
from sassgis.settings.ground import RANGED, ranges_of, with_values
from sassgis.settings.map_run import Config
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.loop import simulate_map
from sassgis.simulation.response import outcome_of
from sassgis.studies.variants import draw_of
from sassgis.terrain.prepare import plan

AREA = {"areas": ["Nord"], "jobs": 1}


@pytest.fixture(scope="module")
def config(make_valley: Callable[..., Path]) -> Config:
    return load_config(make_valley(spacing_m=30.0))


@pytest.fixture(scope="module")
def zoned(config: Config, tmp_path_factory: pytest.TempPathFactory) -> ZoneResult:
    drawn = replace(config, run=replace(config.run, ground_uncertainty=4))
    return zone(drawn, tmp_path_factory.mktemp("zoned") / "out", **AREA)


@pytest.mark.battery
def test_the_result_itself_is_that_of_the_values(
    zoned: ZoneResult, config: Config, tmp_path: Path
) -> None:
    zone(config, tmp_path / "plain", **AREA)
    plain, more = digests(tmp_path / "plain"), digests(zoned.run.folder)
    changed = {name for name, digest in plain.items() if more[name] != digest}
    assert changed == {"report.html", "project.qgz"}
    added = {name for name in more if name not in plain and not name.endswith(("qml", "png"))}
    stems = ("ground_level_q10", "ground_level_q90", "ground_reach_q10", "ground_reach_q90")
    assert added == {
        "ground_spread.gpkg", *(f"maps/{stem}.tif" for stem in stems),
        *(f"tables/ground_{name}.csv" for name in ("uncertainty", "draws", "spread")),
    }  # fmt: skip


def test_each_draw_is_a_run_of_its_own_with_other_classes(
    zoned: ZoneResult, config: Config
) -> None:
    """Simulated here without the machinery, from the values that the seed gives."""
    tables = {f.stem: pd.read_csv(f) for f in (zoned.run.folder / "tables").glob("ground_*.csv")}
    job = read_map_run(config, ["Nord"])
    ranges = ranges_of(job.table, job.table.names, read_ranges(job.table))
    far = []
    for k in range(4):
        own = replace(job, table=with_values(job.table, draw_of(ranges, job.seed, k).values))
        progress = simulate_map(own, plan(own))
        far.append(outcome_of(progress, bins_of(own)).runout_m(0.9)[0])
    draws = tables["ground_draws"].set_index("simulation")["run-out (90 %) (m)"]
    assert draws.index.tolist() == ["base", *(f"draw {k}" for k in range(1, 5))]
    assert draws.iloc[1:].to_numpy() == pytest.approx(np.array(far), rel=1e-4)
    assert np.ptp(far) > 5.0
    band = tables["ground_uncertainty"].set_index("measure").loc["run-out (90 %)"]
    wanted = [draws["base"], *np.percentile(far, [10, 50, 90])]
    assert band[["base", "q10", "q50", "q90"]].to_numpy(float) == pytest.approx(wanted, rel=1e-4)
    # All that blocks may meet is drawn, and told as weakly as it is known.
    spread = zoned.run.spread
    assert spread is not None and len(spread.ranges) == len(tables["ground_spread"])
    assert spread.assumed == sum(r.sites == 0 for r in ranges if r in spread.ranges) > 30
    page = (zoned.run.folder / "report.html").read_text(encoding="utf-8")
    first = page[: page.index("Reach angle")]
    assert "with the spread of the ground classes between sites, the 90 % run-out lies" in first
    assert "the level may be higher" in first and "is an assumption" in first


def test_jobs_do_not_matter(config: Config, tmp_path: Path) -> None:
    said: list[int] = []
    bands = [
        runout_bands(
            config, 3, tmp_path / "none", jobs=jobs, on_progress=lambda n, *_: said.append(n)
        )
        for jobs in (1, 2)
    ]
    assert bands[0] == bands[1] and said == [1, 2, 3, 4, 1, 2, 3, 4]
    assert not (tmp_path / "none").exists() or not any((tmp_path / "none").iterdir())


def test_an_interrupted_draw_goes_on_where_it_was(
    config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = runout_bands(config, 3, tmp_path / "whole", jobs=1)
    simulate, simulated = module.simulate_map, []

    def stopped(*args: object, on_chunk: Callable, resume, **more: object):
        """Stops in the middle of the third simulation, the second draw."""
        simulated.append(resume.chunks)

        def on_own(now, chunks: int, rows) -> None:
            on_chunk(now, chunks, rows)
            if len(simulated) == 3 and now.chunks == 2:
                raise KeyboardInterrupt

        return simulate(*args, on_chunk=on_own, resume=resume, **more)

    monkeypatch.setattr(module, "simulate_map", stopped)
    with pytest.raises(Interrupted, match="after 2 simulations"):
        runout_bands(config, 3, tmp_path / "out", jobs=1)
    kept = partial_folder(tmp_path / "out") / "checkpoint" / "ground_draws"
    assert len(list(kept.glob("*.npz"))) == 2 and (kept / "under_way" / "state.npz").is_file()
    assert runout_bands(config, 3, tmp_path / "out", jobs=1) == whole
    # The draw that was stopped and the last one, the former from its third chunk.
    assert simulated == [0, 0, 0, 2, 0]


def test_without_spread_the_bands_have_no_width(
    printed, refusal, config: Config, tmp_path: Path
) -> None:
    """By the command line, with a table of ranges that the configuration names."""
    rows = [f"{c},{p},factor,1,1" for c in ("*", "rock", "debris", "soft_meadow") for p in RANGED]
    own = tmp_path / "none.csv"
    own.write_text("class,parameter,kind,low,high\n" + "\n".join(rows) + "\n", encoding="utf-8")
    text = config.file.read_text(encoding="utf-8")
    file = config.file.with_name("no_spread.toml")
    file.write_text(text.replace("[ground]", f'[ground]\nranges = "{own}"'), encoding="utf-8")
    out = tmp_path / "out"
    arguments = ("run", file, "-o", out, "--area", "Nord", "--jobs", "1", "--ground-uncertainty")
    assert "run.ground_uncertainty" in refusal(*arguments, "-1")
    lines = printed(*arguments, "3").splitlines()
    assert lines[1].startswith("With the spread of the ground classes between sites")
    assert lines[2].startswith("None of the classes that blocks meet has a spread; only 3 draws")
    bands = pd.read_csv(out / "tables" / "ground_uncertainty.csv")
    for limit in ("q10", "q90"):
        assert np.array_equal(bands[limit], bands["base"], equal_nan=True)
    assert {"energy (95 %) at wall Nord", "energy (95 %) at valley road"} <= set(bands["measure"])
    settings = json.loads((out / "manifest.json").read_text("utf-8"))
    assert settings["settings"]["run"]["ground_uncertainty"] == 3
    assert "ground ranges" in {i["role"] for i in settings["inputs"]}
