"""One list of warnings: each says what it is about, and only where there is cause."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely
from helpers.hazard_samples import swiss
from helpers.terrains import grid_of, rough

from sassgis.hazard.sampling_error import LevelChances
from sassgis.hazard.warnings import (
    assessed_warnings,
    edge_words,
    ground_warnings,
    path_warnings,
    rule_warnings,
    simulation_warnings,
    zone_warnings,
)
from sassgis.inputs.ground_map import built_in_table
from sassgis.settings.hazard_rules import BlockBudget
from sassgis.settings.results import ControlLine, LineEnd, SetUp, StopReason
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums


def test_what_happened_to_blocks_and_lines_is_told_with_its_number() -> None:
    net, grid = ControlLine("net", "net", 4.0), grid_of(rough, 10, 10)
    run: Any = SimpleNamespace(
        grid=grid, ground=np.zeros(grid.shape, int), table=built_in_table(), followed=False,
        areas=[SimpleNamespace(name="idle")], control_lines=[(net, None)],
        terrain=SimpleNamespace(path="followed"),
    )  # fmt: skip
    progress = Progress(0, MapSums(4), ControlLineSums((net,)), lost=3)
    progress.reasons[[StopReason.REST, StopReason.LEFT_PROFILE, StopReason.NEVER_STARTED]] = (
        700, 200, 100,
    )  # fmt: skip
    ends: Any = SimpleNamespace(end=np.array([LineEnd.NODATA, LineEnd.ENERGY_LINE], np.uint8))
    progress.lines.append(ends)
    said = simulation_warnings(run, progress)
    beginnings = (
        "1 of 2 fall lines runs into cells", "22 % of the blocks left the terrain model",
        "10 % of the blocks never started", "Blocks not simulated", "No block starts in these",
        "No block reaches: net.",
    )  # fmt: skip
    for text, begins in zip(said, beginnings, strict=False):
        assert text.startswith(begins)
    # Of these only what nothing reaches, and the ground, describe the set-up.
    assert [isinstance(text, SetUp) for text in said] == [False] * 5 + [True] * (len(said) - 5)
    run.followed = True
    assert simulation_warnings(run, progress) == said[1:]


def test_classes_are_named_by_how_far_they_may_be_trusted() -> None:
    own = replace(built_in_table().classes[0], trust="estimate", d_star_m=0.0)
    paper = replace(own, name="three", trust="paper")
    used = [(replace(own, name="one"), 0.25), (paper, 0.5), (replace(own, name="two"), 0.25)]
    (text,) = ground_warnings(used)
    assert text.endswith(": one 25 %, two 25 %.")
    # A check before a run does not know what blocks reach.
    assert ground_warnings(used)[0] != ground_warnings(used, "share of the terrain")[0]
    (text,) = ground_warnings([(replace(own, trust="fitted"), 1.0)])
    assert "fitted to field sites" in text
    assert not ground_warnings([(paper, 1.0)])
    (text,) = ground_warnings([(replace(paper, d_star_m=0.3), 1.0)])
    assert "three 0.3 m. Measure it" in text


def test_lines_without_a_width_are_told() -> None:
    assert len(path_warnings("fall_line")) == 1
    assert not path_warnings("followed")


def test_sources_that_never_release_are_named() -> None:
    texts = rule_warnings(swiss(), {("A", "small"): 0.0, ("A", "big"): 0.1, ("B", "big"): 0.0})
    assert texts[-1] == "Onset frequency 0: A / small, B / big. These sources add no hazard."
    assert [isinstance(text, SetUp) for text in texts] == [True] * (len(texts) - 1) + [False]
    assert not [t for t in rule_warnings(swiss(), {("A", "big"): 0.1}) if "Onset" in t]


def test_what_stays_uncertain_is_told_beyond_the_limit_only() -> None:
    # Nine places of the first level keep it, one of the second changes in 4 of 10 samples.
    level = np.array([1] * 9 + [2], np.int16)
    at_least = np.repeat([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]], 10, axis=0)
    at_least[9, 2] = 0.6
    chances = LevelChances(np.arange(10), level, at_least)
    assert chances.changed_share == pytest.approx(0.04)
    assert chances.target_share == pytest.approx(0.2)
    assert not zone_warnings(chances, swiss(), None)
    assert not zone_warnings(chances, swiss(), BlockBudget(0.21))
    (text,) = zone_warnings(chances, swiss(), BlockBudget(0.05))
    assert "4.0 % of the zoned area changes level" in text and "limit of 5 %" in text
    assert "slight 40.0 %, residual 0.0 %" in text and "moderate" not in text
    (text,) = zone_warnings(chances, swiss(), BlockBudget(0.05), reused=True)
    assert "--reuse" in text and "blocks_max" not in text
    # Four places without a level: one of them gets one in half of the samples.
    more = np.repeat([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]], 4, axis=0)
    more[3, 1] = 0.5
    level, at_least = np.append(level, [0] * 4).astype(np.int16), np.vstack([at_least, more])
    chances = LevelChances(np.arange(14), level, at_least)
    assert chances.newly_zoned_share == pytest.approx(0.05)
    cells = np.bincount(level, minlength=5)[1:]
    of_levels = np.nansum(chances.changed_by_level * cells) / cells.sum()
    assert chances.changed_share == pytest.approx(of_levels + 0.05)


def test_zones_beyond_the_assessed_area_are_told() -> None:
    zone, half = shapely.box(0, 0, 10, 10), shapely.box(0, 0, 5, 10)
    assert assessed_warnings([zone], (half,)) == [
        "50 m² of the zones (50 %) lie outside the area of hazard.assessed. The layers of the "
        "federal model are cut there; hazard_zones are not."
    ]
    assert not assessed_warnings([zone], ()) and not assessed_warnings([half], (zone,))


def test_where_zones_end_at_a_gap_it_is_to_be_filled() -> None:
    grid = grid_of(rough, 20, 20, 2.0, west=0.0, north=40.0)
    grid.values[10:12, 10:12] = np.nan
    grid.values[15:, 18:] = np.nan
    run: Any = SimpleNamespace(followed=True, grid=grid)
    progress: Any = SimpleNamespace(lost_share=0.1)
    gap = shapely.LineString([(20.0, 20.0), (20.0, 16.0)])
    edge = shapely.LineString([(36.0, 10.0), (36.0, 0.0), (20.0, 0.0)])
    both, inner, outer, none = (edge_words(run, progress, own) for own in (
        [gap, edge], [gap], [edge], []))  # fmt: skip
    assert all(
        ("at E, N 22, 18." in text) == filled
        for text, filled in ((both, True), (inner, True), (outer, False), (none, False))
    )
    assert all(
        ("26 m" in text and "Extend" in text) == open_
        for text, open_ in ((both, True), (inner, False), (outer, True), (none, False))
    )


def test_of_many_gaps_the_largest_are_named() -> None:
    grid = grid_of(rough, 40, 20, 2.0, west=0.0, north=40.0)
    sides = []
    for k in range(8):
        # Each gap is one row higher than the one before.
        grid.values[2 : 4 + k, 4 * k + 2] = np.nan
        sides.append(shapely.LineString([(8.0 * k + 4.0, 36.0), (8.0 * k + 4.0, 32.0 - 2.0 * k)]))
    run: Any = SimpleNamespace(followed=True, grid=grid)
    text = str(edge_words(run, SimpleNamespace(lost_share=0.1), sides))  # type: ignore[arg-type]
    assert text.count(";") == 4
    assert "not listed: 3" in text
    assert "at E, N 61, " in text and " 5, " not in text
