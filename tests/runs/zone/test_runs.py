"""What must not depend on how a zoning is run: areas, repetitions, stops, threads, barriers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.zone_slope import Case, Zoned, place, two_areas, zoned

from sassgis.io.read.config import load_config
from sassgis.model.errors import Interrupted
from sassgis.model.hazard import HazardCurves
from sassgis.model.map_run import BlockRows
from sassgis.runs.map import simulate_map
from sassgis.runs.zone import zone


def same_curves(one: HazardCurves, two: HazardCurves) -> bool:
    """To the last bit."""
    return all(
        np.array_equal(getattr(one, name), getattr(two, name))
        for name in ("places", "energies_kj", "rate", "variance", "rate_of_a_rock")
    )


def on_map(zoned: Zoned) -> np.ndarray:
    """Rates of all cells at all energies."""
    n = zoned.done.run.grid.values.size
    out = np.zeros((n, zoned.curves.energies_kj.size))
    out[zoned.curves.places] = zoned.curves.rate
    return out


def test_frequencies_of_areas_add_to_the_last_bit(tmp_path: Path) -> None:
    case = two_areas(tmp_path)
    both = zoned(case.config, tmp_path / "both")
    alone = [zoned(case.config, tmp_path / a, areas=[a]) for a in ("north", "south")]
    assert np.array_equal(on_map(both), on_map(alone[0]) + on_map(alone[1]))
    for a in alone:
        assert (on_map(a) > 0.0).any() and (on_map(a) < on_map(both)).any()
    # In whatever order they are asked for.
    turned = zoned(case.config, tmp_path / "turned", areas=["south", "north"])
    assert same_curves(both.curves, turned.curves)


def adaptive(folder: Path, share: float, rounds_max: int = 64) -> Case:
    case = two_areas(folder)
    # Frequencies between the limits of the matrix, so that rocks can decide the level.
    case.blocks[0]["onset_frequency"], case.blocks[1]["onset_frequency"] = 0.2, 0.02
    case.sections["release"]["rocks_per_point"] = 8
    case.sections["hazard"] |= {"changed_share_max": share, "repetitions_max": rounds_max}
    case.write()
    return case


def test_repetitions_go_on_until_few_cells_are_uncertain(tmp_path: Path) -> None:
    case = adaptive(tmp_path, 0.3)
    said: list[str] = []
    found = zoned(case.config, tmp_path / "work", say=said.append)
    assert found.done.run.repetitions in (2, 4, 8, 16, 32)
    assert found.found.hazard.changed_share <= 0.3
    # What was said of each try is what made it go on.
    shares = [float(s.split(" %")[0].split()[-1]) for s in said if "Another sample" in s]
    assert len(shares) == np.log2(found.done.run.repetitions) + 1
    assert all(s > 30.0 for s in shares[:-1]) and shares[-1] <= 30.0
    assert shares[-1] == round(100.0 * found.found.hazard.changed_share, 1)
    # The number of rocks of each source is that of its repetitions.
    for s in found.found.hazard.sampled:
        assert s.source.rocks % (8 * found.done.run.repetitions) == 0


def test_too_few_repetitions_are_told(tmp_path: Path) -> None:
    case = adaptive(tmp_path, 0.01, rounds_max=3)
    result = zone(case.config, tmp_path / "out", jobs=1)
    assert result.run.run.repetitions == 3
    share = result.found.hazard.changed_share
    assert share > 0.01
    told = [w for w in result.run.warnings if "Another sample of blocks" in w]
    assert len(told) == 1
    assert f"{100 * share:.1f} % of the zoned area" in told[0]
    assert "3 repetitions" in told[0] and "1 %, hazard.changed_share_max" in told[0]
    assert told[0] in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_rocks_of_the_first_repetitions_stay_as_they_are(tmp_path: Path) -> None:
    case = two_areas(tmp_path)
    job = zoned(case.config, tmp_path / "work").job

    def rocks(repetitions: int) -> list[BlockRows]:
        rows: list[BlockRows] = []
        run = replace(job.run, repetitions=repetitions)
        simulate_map(run, job.planned, on_chunk=lambda _p, _n, own: rows.append(own))
        return rows

    one, three = rocks(1), rocks(3)
    assert len(three) == 3 * len(one)
    for before, after in zip(one, three, strict=False):
        assert np.array_equal(before.rocks, after.rocks)
    # Later repetitions are other rocks: none is run twice.
    drawn = np.concatenate([r.rocks["mass_kg"] for r in three])
    assert np.unique(drawn).size == drawn.size


def with_barriers(case: Case) -> Case:
    """A wall across the gully, and a net that some rocks break."""
    (x, top), (_, bottom) = place(50.0, 20.0), place(50.0, 50.0)
    (west, _), _ = place(30.0, 0.0), None
    case.lists["barriers"] = [
        {"name": "wall", "kind": "wall", "height_m": 2.0, "line": [[x, top], [x, bottom]]},
        {"name": "net", "kind": "net", "height_m": 3.0, "capacity_kj": 100.0,
         "line": [[west, top], [west, bottom]]},
    ]  # fmt: skip
    case.write()
    return case


def test_barriers_are_compared_with_the_same_rocks(tmp_path: Path) -> None:
    case = with_barriers(adaptive(tmp_path, 0.3, rounds_max=2))
    with_them = zoned(case.config, tmp_path / "with")
    case.lists.clear()
    case.write()
    without = zoned(case.config, tmp_path / "without")
    before = with_them.found.without
    assert before is not None and with_them.without is not None
    assert with_them.without.run.repetitions == with_them.done.run.repetitions == 2
    assert same_curves(before.curves, without.curves)
    assert not same_curves(with_them.curves, without.curves)
    # Above the first barrier nothing changes, below the wall less comes. Blocks that break the net
    # go on slower and on other paths: single cells may see more of them.
    column = np.arange(with_them.done.run.grid.values.size) % with_them.done.run.grid.shape[1]
    held, free = on_map(with_them), on_map(without)
    assert np.array_equal(held[column < 29], free[column < 29])
    assert held[column > 51].sum() < 0.8 * free[column > 51].sum()


def digests(folder: Path) -> dict[str, str]:
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    return {f["path"]: f["sha256"] for f in manifest["files"]}


def stop_at(call: int) -> Callable[[int, int, int], None]:
    """Ctrl-C after so many chunks, whatever they are counted as."""
    seen = [0]

    def stop(_done: int, _chunks: int, _rocks: int) -> None:
        seen[0] += 1
        if seen[0] == call:
            raise KeyboardInterrupt

    return stop


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, Path]:
    """An adaptive run with barriers: two chunks, four repetitions, once more without barriers."""
    folder = tmp_path_factory.mktemp("whole")
    case = with_barriers(adaptive(folder, 0.01, rounds_max=4))
    result = zone(case.config, folder / "out", jobs=1)
    assert result.run.progress.chunks == 8 and result.found.without is not None
    return case, folder / "out"


@pytest.mark.parametrize("call", [5, 11], ids=["round 3", "without barriers"])
def test_interrupted_and_resumed_is_uninterrupted(
    whole: tuple[Case, Path], tmp_path: Path, call: int
) -> None:
    case, out = whole
    with pytest.raises(Interrupted):
        zone(case.config, tmp_path / "out", jobs=1, on_progress=stop_at(call))
    assert not (tmp_path / "out").exists()
    chunks: list[int] = []
    zone(case.config, tmp_path / "out", jobs=2, on_progress=lambda d, _n, _r: chunks.append(d))
    assert len(chunks) == 16 - call
    assert digests(tmp_path / "out") == digests(out)


@pytest.mark.parametrize(
    ("change", "repetitions"),
    [
        ({"hazard.changed_share_max": None}, 1),
        ({"hazard.repetitions_max": 2}, 2),
    ],
    ids=["no repetitions", "two repetitions"],
)
def test_other_repetitions_than_those_of_an_interrupted_run(
    whole: tuple[Case, Path], tmp_path: Path, change: dict[str, object], repetitions: int
) -> None:
    """What was computed for more repetitions does not get into a result of fewer."""
    config = load_config(whole[0].config)
    with pytest.raises(Interrupted):
        zoned(config, tmp_path / "work", on_progress=stop_at(7))
    hazard = {key.split(".")[1]: value for key, value in change.items()}
    other = replace(config, hazard=replace(config.hazard, **hazard))
    resumed = zoned(other, tmp_path / "work")
    fresh = zoned(other, tmp_path / "fresh")
    assert fresh.done.run.repetitions == repetitions == resumed.done.run.repetitions
    assert same_curves(resumed.curves, fresh.curves)
    assert resumed.found.without is not None and fresh.found.without is not None
    assert same_curves(resumed.found.without.curves, fresh.found.without.curves)
