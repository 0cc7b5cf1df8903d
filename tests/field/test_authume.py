"""The study of the Authume quarry with few rocks: its mechanics, not its numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import authume
import numpy as np
import pytest

from sassgis.errors import InputError


@pytest.fixture(scope="module")
def done(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, Any], Path]:
    if not (shared_data / authume.FOLDER).is_dir():
        pytest.skip("the data of the Authume quarry are not in the folder of the field data")
    folder = tmp_path_factory.mktemp("authume")
    report = authume.study(
        shared_data, folder / "out", folder / "work", rocks=4, spacing=1.0, variants=False
    )
    return report, folder


@pytest.mark.battery
def test_every_rock_is_accounted_for(done: tuple[dict[str, Any], Path]) -> None:
    report, folder = done
    assert report["observed_rocks"] == 41
    assert report["predicted_rocks"] == 4 * report["release_points"]
    assert sum(report["predicted_ends"].values()) == report["predicted_rocks"]
    assert json.loads((folder / "out" / "results.json").read_text(encoding="utf-8")) == report


@pytest.mark.battery
def test_observed_and_predicted_are_measured_alike(done: tuple[dict[str, Any], Path]) -> None:
    report, _ = done
    for key in ("plan_m", "chainage_m"):
        part = report[key]
        for value, low, high in part["observed"]:
            assert low <= value <= high
        assert part["predicted"] == sorted(part["predicted"])
        assert 0.0 < part["permutation_p"] <= 1.0
        # The fall lines run away from the release: one distance cannot be far from the other.
        plan, chainage = np.array(report["plan_m"]["predicted"]), np.array(part["predicted"])
        assert np.abs(plan - chainage).max() < 6.0
    # A block let go high above the terrain in the square of release.
    low, high = report["drop_m"]
    assert 0.0 < low < high < 12.0


@pytest.mark.battery
def test_what_may_be_shown_holds_no_coordinates(
    shared_data: Path, done: tuple[dict[str, Any], Path]
) -> None:
    report, folder = done
    assert {f.name for f in (folder / "out").iterdir()} == {"results.json", "runout.png"}
    assert (folder / "work" / "stops_map.png").stat().st_size > 10_000
    numbers: list[float] = []

    def collect(item: object) -> None:
        if isinstance(item, dict):
            item = list(item.values())
        if isinstance(item, list):
            for part in item:
                collect(part)
        elif isinstance(item, float):
            numbers.append(item)

    collect(report)
    # Northings and heights are far from any run-out, so that one among them would be seen.
    observed = authume.read_observed(shared_data / authume.FOLDER)
    northings = observed.stops[:, 1]
    assert northings.min() > 200.0 and len(numbers) > 40
    assert not any(northings.min() - 1.0 < n < northings.max() + 1.0 for n in numbers)
    assert not any(abs(n - observed.release_height_m) < 1.0 for n in numbers)


def test_the_permutation_test_is_fair_and_has_power() -> None:
    rng = np.random.default_rng(5)
    alike = [
        authume.permutation_test(rng.normal(size=20), rng.normal(size=40), rng, 99)[1]
        for _ in range(60)
    ]
    assert 0.3 < np.mean(alike) < 0.7
    assert np.mean(np.array(alike) <= 0.05) < 0.2
    assert (
        authume.permutation_test(rng.normal(size=20), rng.normal(3.0, size=40), rng, 99)[1] == 0.01
    )


def test_without_the_data_one_clear_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=r"Endpoints_P1\.txt.*--data"):
        authume.read_observed(tmp_path)
    assert authume.main(["--data", str(tmp_path), "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "not here" in said
