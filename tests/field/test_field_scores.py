"""Stops at Tschamut and Authume with built-in classes that the description of the site names."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.scripts import load

pytestmark = pytest.mark.battery

#: Simulations of each rock. With 2600 and 3900 blocks another seed moves median and 90 % quantile
#: by up to 1 % of the observed, widths by up to 4 %.
COUNT = 64
FOLDERS = {"tschamut": "tschamut2014", "authume": "authume_quarry_p1"}
CONTACTS = "chant_sura_2020"
#: At Authume nothing stopped between 41 and 46 m, and 46 % beyond. Where more than a half of the
#: simulated blocks pass the gap, their median has crossed it: see the test of the two heaps.
MEDIAN = {"tschamut": 0.10, "authume": 0.17}
#: The aim for widths is 25 %. What is reached is 32 to 35 % and 24 to 28 %, by the seed.
WIDTH = {"tschamut": 0.40, "authume": 0.33}


@pytest.fixture(scope="module")
def scored(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], tuple[Any, Any, dict[str, Any]]]:
    from field_cases import sites
    from field_cases.scores import score

    made: dict[str, tuple[Any, Any, dict[str, Any]]] = {}

    def score_site(name: str) -> tuple[Any, Any, dict[str, Any]]:
        if not (shared_data / FOLDERS[name]).is_dir():
            pytest.skip(f"{FOLDERS[name]} is not in the folder of the field data")
        if name not in made:
            folder = tmp_path_factory.mktemp(name)
            site = getattr(sites, name)(shared_data, folder)
            blocks = sites.simulated(site, folder / "run", COUNT)
            made[name] = site, blocks, score(site, blocks)
        return made[name]

    return score_site


@pytest.mark.parametrize("name", FOLDERS)
def test_run_out_of_the_built_in_classes(name: str, scored: Callable[[str], Any]) -> None:
    _, _, found = scored(name)
    _, median, most = found["error"]
    assert abs(median) < MEDIAN[name]
    assert abs(most) < 0.15
    assert found["never_started"] < 0.05


@pytest.mark.parametrize("name", FOLDERS)
def test_width_of_the_stops(name: str, scored: Callable[[str], Any]) -> None:
    _, _, found = scored(name)
    assert abs(found["width_error"]) < WIDTH[name]


def test_two_heaps_at_authume(scored: Callable[[str], Any]) -> None:
    """The median lies between bench and floor, so that only the shares of both say much."""
    from field_cases.sites import run_out

    site, blocks, found = scored("authume")
    beyond = found["beyond"]
    share = beyond["observed"]
    error = float(np.sqrt(share * (1.0 - share) / len(site)))
    assert beyond["simulated"] == pytest.approx(share, abs=2.0 * error)
    # Few come to rest on the overgrown slope, by observation and simulation.
    seen = run_out(site, site.stops)[:, 0]
    simulated = run_out(site, blocks.stops)[blocks.started][:, 0]
    assert np.mean(simulated < 30.0) == pytest.approx(np.mean(seen < 30.0), abs=0.07)


def test_calibration_starts_the_rocks_as_a_run_does(scored: Callable[[str], Any]) -> None:
    """Stops of its campaigns are those of ``sassgis run``, with the configured classes."""
    from scipy.stats import ks_2samp

    from sassgis.gap.forward.released_rocks import all_rocks, configured_model, in_plane, move
    from sassgis.gap.forward.rock_lines import rock_lines_of
    from sassgis.runs.calibrate import read_case

    site, blocks, _ = scored("tschamut")
    case = read_case(site.case.config, site.case.observations["all"])
    lines = rock_lines_of(case)
    moved = move(case, lines, all_rocks(case, lines), configured_model(case), seed=3, count=COUNT)
    other = moved.rocks["runout_m"].reshape(len(site), COUNT)
    for rock in np.flatnonzero(blocks.started.all(axis=1)).tolist():
        own, _ = in_plane(case, np.full(COUNT, rock), *blocks.stops[rock].T)
        assert ks_2samp(own, other[rock]).pvalue > 1e-5


def test_one_command_makes_every_table_of_the_page(
    shared_data: Path, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With few simulations: calibrated on a half, run, scored on the other half."""
    import field_scores
    from field_cases import scores

    if not all((shared_data / folder).is_dir() for folder in (*FOLDERS.values(), CONTACTS)):
        pytest.skip("not all sites are in the folder of the field data")
    monkeypatch.setattr(scores, "TILTS", (7.0,))
    monkeypatch.setattr(scores, "DRIFTS", (5.0,))
    few = ["--count", "16", "--halves", "1", "--draws", "8", "--jobs", "1"]
    field_scores.main([str(shared_data), "-o", str(tmp_path / "out"), *few])
    found = json.loads((tmp_path / "out" / "results.json").read_text("utf-8"))
    # The default settings are among those whose widths are compared.
    for name, one in found["built_in"].items():
        assert found["widths"][0][name]["width_error"] == one["width_error"]
    tables = load(repository / "docs/studies/tables.py")
    monkeypatch.setattr(tables, "results", lambda _name: found)
    made = {name: table() for name, table in tables.TABLES.items() if name.startswith("field")}
    assert len(made) == 2 and all(text.count("\n") >= 2 for text in made.values())
