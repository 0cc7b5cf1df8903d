"""What must not depend on how a zoning is run: areas, repetitions, stops, threads, barriers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.listed_results import digests
from helpers.zone_slope import Case, Zoned, place, two_areas, zoned

from sassgis.errors import ConfigError, Interrupted
from sassgis.hazard.sampling_error import LevelChances
from sassgis.inputs.config import load_config
from sassgis.runs.check_inputs import check_inputs
from sassgis.runs.run import zone
from sassgis.settings.hazard_rules import HazardCurves
from sassgis.settings.map_run import BlockRows, Round
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.loop import plan_of_points, simulate_map
from sassgis.simulation.map_sums import count_variance

#: Of the zoning that is stopped and goes on.
CHUNKS = 14


def same_curves(one: HazardCurves, two: HazardCurves) -> bool:
    """To the last bit."""
    return all(
        np.array_equal(getattr(one, name), getattr(two, name))
        for name in ("places", "energies_kj", "rate", "variance", "rate_of_a_rock")
    )


def same_chances(one: LevelChances, two: LevelChances) -> bool:
    """Also of all other samples, to the last bit."""
    names = ("places", "level", "at_least")
    return all(np.array_equal(getattr(one, name), getattr(two, name)) for name in names)


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


def adaptive(folder: Path, share: float, most: int = 10**6) -> Case:
    """A zoning of as many blocks as it needs, ``most`` at most."""
    case = two_areas(folder)
    # Frequencies between the limits of the matrix, so that rocks can decide the level.
    case.blocks[0]["onset_frequency"], case.blocks[1]["onset_frequency"] = 0.2, 0.02
    case.sections["release"]["rocks_per_point"] = 8
    case.sections["hazard"] |= {"blocks": "auto", "changed_share_max": share, "blocks_max": most}
    case.write()
    return case


def test_blocks_are_added_until_little_would_change(tmp_path: Path) -> None:
    case = adaptive(tmp_path, 0.2)
    said: list[str] = []
    found = zoned(case.config, tmp_path / "work", say=said.append)
    assert found.found.hazard.chances.target_share <= 0.2
    # What was said after each round is what made it go on.
    history = found.done.progress.history
    told = [s for s in said if "another random seed" in s]
    assert len(told) == len(history) == len(found.done.run.rounds) > 3
    for text, (blocks, share) in zip(told, history, strict=True):
        assert text.startswith(f"{blocks} blocks") and f"{100 * share:.1f} %" in text
    assert all(share > 0.2 for _, share in history[:-1])
    assert history[-1] == (found.done.progress.simulated, found.found.hazard.chances.target_share)
    # With their weights there are as many of each point: those of all rounds.
    whole = 8 * found.done.run.repetitions
    points = np.bincount(found.done.planned.points.area)
    for (area, _), tally in found.done.progress.sources.items():
        assert tally.rocks == whole * points[area] > tally.simulated
    blocks = found.done.planned.blocks_of_point(found.done.run)
    assert blocks.sum() == found.done.progress.simulated < whole * 2 * points.sum()


def test_a_budget_that_is_spent_is_told(tmp_path: Path) -> None:
    case = adaptive(tmp_path, 0.01, most=1000)
    result = zone(case.config, tmp_path / "out", jobs=1)
    assert result.run.n_blocks <= 1000 and result.run.run.repetitions > 3
    share = result.found.hazard.changed_share
    assert share > 0.01
    told = [w for w in result.run.warnings if "With another random seed" in w]
    assert len(told) == 1
    assert f"{100 * share:.1f} % of the zoned area" in told[0]
    assert "limit of 1 %" in told[0] and "blocks_max" in told[0]
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert told[0] in report
    repeated = f"{result.run.run.repetitions} repetitions, 8 blocks per release point in each"
    assert f"{result.run.n_blocks} (weighted to " in report and repeated in report


def test_a_time_that_is_spent_ends_it(tmp_path: Path) -> None:
    case = adaptive(tmp_path, 0.001)
    case.set("hazard.minutes_max", 1e-4)
    case.write()
    found = zoned(case.config, tmp_path / "work")
    assert found.done.run.repetitions == 1
    assert found.found.hazard.changed_share > 0.001


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("hazard.blocks_max", 127, ("hazard.blocks_max", "found 127", "expected 128")),
        ("release.rocks_per_point", 1, ("release.rocks_per_point", "2 or more")),
        ("release.placement", "random", ("release.placement", "found random", "grid")),
    ],
)
@pytest.mark.parametrize("how", [zoned, lambda config, _: check_inputs(load_config(config))])
def test_a_budget_that_allows_nothing_is_one_line(
    tmp_path: Path, key: str, value: object, words: tuple[str, ...], how: Callable[..., object]
) -> None:
    case = adaptive(tmp_path, 0.3)
    case.set(key, value)
    case.write()
    with pytest.raises(ConfigError) as error:
        how(case.config, tmp_path / "work")
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


def test_rocks_of_the_first_repetitions_stay_as_they_are(tmp_path: Path) -> None:
    case = two_areas(tmp_path)
    job = zoned(case.config, tmp_path / "work").job

    def rocks(repetitions: int) -> list[BlockRows]:
        rows: list[BlockRows] = []
        run = replace(job.run, rounds=(Round(0, repetitions),))
        simulate_map(run, job.planned, on_chunk=lambda _p, _n, own: rows.append(own))
        return rows

    one, three = rocks(1), rocks(3)
    assert len(three) == 3 * len(one)
    for before, after in zip(one, three, strict=False):
        assert np.array_equal(before.rocks, after.rocks)
    # Later repetitions are other rocks: none is run twice.
    drawn = np.concatenate([r.rocks["mass_kg"] for r in three])
    assert np.unique(drawn).size == drawn.size


def test_weights_make_up_for_blocks_that_are_left_out(tmp_path: Path) -> None:
    """Points with a quarter of the blocks, each of which counts four times, one by one."""
    found = zoned(adaptive(tmp_path, 0.9).config, tmp_path / "work")
    run, planned = found.job.run, found.job.planned
    n = len(planned.points)
    halved = np.zeros((n, 2), np.uint8)
    halved[::3] = 2
    rounds = (Round(), Round(1, 8, halved))
    together = simulate_map(replace(run, rounds=rounds), planned, chunk_points=5)
    assert together.simulated == 8 * 2 * (n + 8 * (halved == 0)[:, 0].sum() + 2 * (n + 2) // 3)

    def counts(progress: Progress) -> dict[str, np.ndarray]:
        size = run.grid.values.size
        out = {"cells": np.zeros(size), "energy": np.zeros(size), "variance": np.zeros(size)}
        reach, square = (progress.sums.column(k).astype(int) for k in ("reach", "reach_square"))
        out["cells"][progress.sums.cells] = reach
        out["energy"][progress.sums.cells] = progress.sums.column("energy").sum(axis=1)
        out["variance"][progress.sums.cells] = count_variance(reach, square, 8, 0, False)
        for key, tally in progress.sources.items():
            own = tally.cells.counts()
            out[f"{key}"] = np.zeros(size)
            out[f"{key}"][own.places] = own.count[:, 0]
            out[f"{key} at objects"] = tally.objects.counts().count.sum(axis=0)
        out["runout"] = np.pad(progress.runout, ((0, 0), (0, 999 - progress.runout.shape[1])))
        out["stops"] = np.bincount(progress.sums.cells, progress.sums.column("stops"), size)
        return out

    expected: dict[str, np.ndarray] = {}
    for h, repetitions, weight in ((None, Round(), 1), (0, Round(1, 8), 1), (2, Round(1, 2), 4)):
        which = np.arange(n) if h is None else np.flatnonzero(halved[:, 0] == h)
        own = simulate_map(replace(run, rounds=(repetitions,)), plan_of_points(planned, which))
        for key, value in counts(own).items():
            factor = weight**2 if key == "variance" else weight
            expected[key] = expected.get(key, 0.0) + factor * value
    assert all(tally.heaviest == 4 for tally in together.sources.values())
    for key, value in counts(together).items():
        np.testing.assert_allclose(value, expected[key], rtol=1e-12, err_msg=key)


def with_barriers(case: Case) -> Case:
    """A wall across the gully, and a net that some rocks break."""
    wall, net = ([list(place(col, row)) for row in (20.0, 50.0)] for col in (50.0, 30.0))
    case.lists["barriers"] = [
        {"name": "wall", "kind": "wall", "height_m": 2.0, "line": wall},
        {"name": "net", "kind": "net", "height_m": 3.0, "capacity_kj": 100.0, "line": net},
    ]
    case.write()
    return case


def test_barriers_are_compared_with_the_same_rocks(tmp_path: Path) -> None:
    case = with_barriers(adaptive(tmp_path, 0.3, most=256))
    with_them = zoned(case.config, tmp_path / "with")
    case.lists.clear()
    case.write()
    without = zoned(case.config, tmp_path / "without")
    before = with_them.found.without
    assert before is not None and with_them.done.run.repetitions == 2
    assert same_chances(before.chances, without.found.hazard.chances)
    assert not same_curves(with_them.curves, without.curves)
    # Above the first barrier nothing changes, below the wall less comes. Blocks that break the net
    # go on slower and on other paths: single cells may see more of them.
    column = np.arange(with_them.done.run.grid.values.size) % with_them.done.run.grid.shape[1]
    held, free = on_map(with_them), on_map(without)
    assert np.array_equal(held[column < 29], free[column < 29])
    assert held[column > 51].sum() < 0.8 * free[column > 51].sum()


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
    """An adaptive run with barriers: rounds of blocks that count differently; once more without."""
    folder = tmp_path_factory.mktemp("whole")
    case = with_barriers(adaptive(folder, 0.01, most=1200))
    result = zone(case.config, folder / "out", jobs=1)
    assert any(own.halvings is not None for own in result.run.run.rounds)
    assert result.found.without is not None
    assert result.run.progress.chunks == CHUNKS
    return case, folder / "out"


@pytest.mark.battery
def test_interrupted_and_resumed_is_uninterrupted(whole: tuple[Case, Path], tmp_path: Path) -> None:
    case, out = whole
    with pytest.raises(Interrupted):
        zone(case.config, tmp_path / "out", jobs=1, on_progress=stop_at(CHUNKS - 2))
    assert not (tmp_path / "out").exists()
    chunks: list[int] = []
    zone(case.config, tmp_path / "out", jobs=2, on_progress=lambda d, _n, _r: chunks.append(d))
    assert len(chunks) == 2
    assert digests(tmp_path / "out") == digests(out)


def test_other_repetitions_than_those_of_an_interrupted_run(
    whole: tuple[Case, Path], tmp_path: Path
) -> None:
    """What was computed for more repetitions does not get into a result of fewer."""
    config = load_config(whole[0].config)
    with pytest.raises(Interrupted):
        zoned(config, tmp_path / "work", on_progress=stop_at(CHUNKS - 1))
    other = replace(config, hazard=replace(config.hazard, blocks_max=256))
    resumed = zoned(other, tmp_path / "work")
    fresh = zoned(other, tmp_path / "fresh")
    assert fresh.done.run.repetitions == 2 == resumed.done.run.repetitions
    assert same_curves(resumed.curves, fresh.curves)
    assert resumed.found.without is not None and fresh.found.without is not None
    assert same_chances(resumed.found.without.chances, fresh.found.without.chances)
