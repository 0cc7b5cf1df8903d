"""Areas at work at the same time, areas that keep sums only, and mosaics made block by block."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
from helpers.cut_valley import Stopped, Valley, write_vrt
from helpers.listed_results import digests

from sassgis.batches import batch as runs_batch
from sassgis.batches import batch_mosaic, batch_window
from sassgis.batches.batch import batch
from sassgis.batches.batch_mosaic import (
    BASE,
    _zones_by_group,
    bytes_for_zones,
    bytes_needed,
    divided,
    groups,
    kept_mosaic,
    shared,
)
from sassgis.batches.batch_window import Reached, Record, added_up
from sassgis.errors import OutputError
from sassgis.files.atomic_output import check_output
from sassgis.inputs.tiles import Part, hull
from sassgis.settings.map_run import BlockRows
from sassgis.settings.results import PASSAGE_DTYPE, ROCK_DTYPE
from sassgis.settings.statistics_table import default_bins
from sassgis.simulation.accumulators import Progress, evenly_kept, joined_rows
from sassgis.simulation.checkpoint import state_of
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums

GIGABYTE = 1e9


@pytest.mark.battery
def test_areas_at_the_same_time_files_tiles_and_sums_only_give_the_same_mosaic(
    done: Stopped, valley: Valley, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs_batch, "_AREAS_PER_CORE", 1)
    folder = tmp_path / "files"
    folder.mkdir()
    frame = gpd.read_file(valley.releases)
    for i, name in enumerate(frame["name"].iloc[::-1]):
        frame[frame["name"] == name].to_file(folder / f"{i}.gpkg", driver="GPKG")
    (folder / "notes.txt").write_text("no release area")
    vrt = tmp_path / "dem.vrt"
    write_vrt(valley.tiles, valley.dem, vrt)
    steps: list[tuple[int, int, int]] = []
    result = batch(
        folder, tmp_path / "out", config=valley.config, dem=vrt, jobs=2, mosaic_only=True,
        on_progress=lambda *step: steps.append(step),
    )  # fmt: skip
    assert [s[:2] for s in steps] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    columns = ["area", "points", "rocks", "furthest_m"]
    assert result.summary[columns].equals(done.result.summary[columns])
    # Why an area is skipped names its file.
    states = [summary["status"].str[:8] for summary in (result.summary, done.result.summary)]
    assert states[0].equals(states[1])
    for name in ("mitte", "mitte_bis", "nord"):
        own, whole = (f / "areas" / name for f in (tmp_path / "out", done.folder))
        held = {f.name for f in own.iterdir()}
        assert held == {"area.json", "manifest.json", "simulation.npz"}
        assert (own / "simulation.npz").read_bytes() == (whole / "simulation.npz").read_bytes()
        check_output(own, overwrite=True)
    check_output(tmp_path / "out" / "mosaic", overwrite=True)
    for suffix in (".tif", ".csv"):
        assert digests(tmp_path / "out" / "mosaic", suffix) == digests(
            done.folder / "mosaic", suffix
        )
    # Whole results serve for sums, but not the other way round.
    with pytest.raises(OutputError, match="made from other settings, inputs or versions"):
        batch(folder, tmp_path / "out", config=valley.config, dem=vrt, jobs=1)
    batch(valley.releases, done.folder, dem=valley.tiles, jobs=1, mosaic_only=True)


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Little memory is enough for all but the whole mosaic, and for the zones of all areas."""
    monkeypatch.setattr(batch_mosaic, "TILE", 128)
    by_group = batch_mosaic._zones_by_group

    def with_enough(work, mosaic, areas, jobs, _memory, tell):
        return by_group(work, mosaic, areas, jobs, 1 << 40, tell)

    monkeypatch.setattr(batch_mosaic, "_zones_by_group", with_enough)


_CHANCES: dict[str, bytes] = {}
#: Columns of zones that rest on what another sample would change.
_POOLED = ("energy_", "height_")
_BY_BLOCK = ["uncertain_share", "limit_moves_m"]


def _pooled(whole: pd.DataFrame, blocks: pd.DataFrame) -> list[str]:
    """Columns of values at objects: pooled over the areas of a mosaic that is made as a whole."""
    return [c for c in whole.columns.difference(blocks.columns) if c.startswith(_POOLED)]


def assert_about_the_same_chances(one: Path, two: Path) -> None:
    """Chances of another level of a map in one block and in several."""
    # Whatever the blocks are.
    assert _CHANCES.setdefault("bytes", two.read_bytes()) == two.read_bytes()
    with rasterio.open(one) as whole, rasterio.open(two) as blocks:
        said = [text.startswith("Probability that another") for text in whole.descriptions]
        band = said.index(True) + 1
        chances = [f.read(band, masked=True).filled(0.0) for f in (whole, blocks)]
    apart = np.abs(chances[0] - chances[1])[np.max(chances, axis=0) > 0.0]
    assert (
        apart.size > 1000
        and apart.mean() < 0.2
        and np.corrcoef([c.ravel() for c in chances])[0, 1] > 0.8
    )


@pytest.mark.battery
@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("jobs", [1, 2])
def test_blocks_give_the_maps_of_the_whole_to_the_last_bit(
    jobs: int, done: Stopped, valley: Valley, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    memory = 1.05 * BASE / GIGABYTE
    if jobs == 2:
        # As if the program itself were small.
        monkeypatch.setattr(batch_mosaic, "BASE", 1 << 20)
        monkeypatch.setattr(batch_mosaic, "_LEAST_SHARE", 1 << 20)
        memory = 0.1
    shutil.copytree(done.folder / "areas", out / "areas")
    said: list[str] = []
    own_batch = partial(
        batch, valley.releases, out, dem=valley.tiles, jobs=jobs, memory_gb=memory,
        mosaic_only=True, say=said.append,
    )  # fmt: skip
    result = own_batch()
    assert sum(text.startswith("Block ") for text in said) > 5
    assert result.found is None and any("has no report" in text for text in result.warnings)
    assert not list(out.rglob("*.zones"))
    whole = sorted((done.folder / "mosaic" / "maps").glob("*.tif"))
    assert [f.name for f in sorted((out / "mosaic" / "maps").glob("*.tif"))] == [
        f.name for f in whole
    ]
    for file in whole:
        own = out / "mosaic" / "maps" / file.name
        if file.name == "confidence.tif":
            # What is counted over all places of a map is left out block by block.
            assert_about_the_same_chances(file, own)
            continue
        with rasterio.open(file) as one, rasterio.open(own) as two:
            assert np.array_equal(one.read(), two.read()), file.name
            assert one.transform == two.transform and one.crs == two.crs
            assert one.nodatavals == two.nodatavals and one.dtypes == two.dtypes
            assert one.tags() == two.tags() and one.descriptions == two.descriptions
            assert one.units == two.units and one.overviews(1) == two.overviews(1)
            assert two.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            for i in one.indexes:
                tags, others = one.tags(i), two.tags(i)
                # GDAL adds up mean and deviation in the order of the tiles of the file.
                for name in ("STATISTICS_MEAN", "STATISTICS_STDDEV"):
                    sums = [float(t.pop(name, "0")) for t in (tags, others)]
                    assert sums[1] == pytest.approx(sums[0], rel=1e-9)
                assert tags == others
        assert file.with_suffix(".qml").read_text() == own.with_suffix(".qml").read_text(), file
    for layer in ("hazard_zones", "hazard_area", "synoptic_intensity", "indicative_hazard_area"):
        one, two = (
            gpd.read_file(f / "mosaic" / "hazard.gpkg", layer=layer) for f in (done.folder, out)
        )
        one, two = (f.drop(columns=_BY_BLOCK, errors="ignore") for f in (one, two))
        assert len(one) and one.equals(two), layer
    layers = {
        "hazard.gpkg": ("risk_objects", "risk_lines"),
        "result.gpkg": ("release_areas", "stations", "barriers", "exposed_areas"),
    }
    for file, names in layers.items():
        for name in names:
            one, two = (gpd.read_file(f / "mosaic" / file, layer=name) for f in (done.folder, out))
            assert len(one) and one.drop(columns=_pooled(one, two)).equals(two), name
    tables = {f.name: f.read_bytes() for f in (out / "mosaic" / "tables").glob("*.csv")}
    assert {"zones.csv", "risk_total.csv", "risk_objects_without_barriers.csv"} <= set(tables)
    for name, text in tables.items():
        other = (done.folder / "mosaic" / "tables" / name).read_bytes()
        one, two = (pd.read_csv(io.BytesIO(own)) for own in (other, text))
        if name == "zones.csv":
            one, two = (own.drop(columns=_BY_BLOCK) for own in (one, two))
            assert len(one) and one.equals(two)
        elif pooled := _pooled(one, two):
            assert name.startswith("risk_objects")
            assert len(one) and one.drop(columns=pooled).equals(two), name
        else:
            assert text == other, name
    with zipfile.ZipFile(out / "mosaic" / "project.qgz") as packed:
        project = packed.read("project.qgs").decode()
    for source in (
        "hazard.gpkg|layername=risk_objects",
        "maps/hazard_level.tif",
        "maps/energy.tif",
    ):
        assert source in project
    origins = [json.loads((f / "mosaic" / "manifest.json").read_text()) for f in (done.folder, out)]
    for key in ("inputs", "ref_widths_m", "preset", "crs", "seed"):
        assert origins[0][key] == origins[1][key], key
    again = own_batch()
    assert said[-1] == "The mosaic is complete" and again.found is None
    assert again.warnings == result.warnings
    # With the memory for the whole it is made anew.
    kept = json.loads((out / "mosaic" / "batch.json").read_text())
    for more in (kept["report_bytes"], None):
        assert kept_mosaic(out / "mosaic", kept["fingerprint"], more) is None


def area(part: Part, reached: int) -> Reached:
    record = Record(
        fingerprint="", area="a", west=0.0, north=0.0, n_rows=part.n_rows, n_cols=part.n_cols,
        repetitions=1, points=1, rocks=1, furthest_m=None, zones_m2={}, control_lines=(),
        objects=(), notices=(), sums_only=True, reached=reached,
        counted=(0, 0, part.n_rows, part.n_cols), never_started=0, frequencies={}, sums={},
    )  # fmt: skip
    return Reached("a", record, Path(), part)


def test_blocks_cover_a_place_once_and_fit_into_the_memory() -> None:
    place, bins = Part(-30, 17, 3000, 5003), default_bins()
    areas = [area(Part(100 * i, 120 * i, 90, 110), 4000) for i in range(28)]
    most = BASE + 900_000_000
    blocks = divided(place, areas, bins, most)
    covered = np.zeros((place.n_rows, place.n_cols), np.int8)
    for block, own in blocks:
        rows = slice(block.row - place.row, block.end[0] - place.row)
        cols = slice(block.col - place.col, block.end[1] - place.col)
        covered[rows, cols] += 1
        assert bytes_needed(block, areas, bins) <= most
        assert own == [a for a in areas if a.part.common(block) is not None]
        assert rows.start % batch_mosaic.TILE == 0 and cols.start % batch_mosaic.TILE == 0
    assert len(blocks) > 4 and (covered == 1).all()
    # A block of one tile is not divided, whatever it needs.
    assert max(b.n_rows for b, _ in divided(place, areas, bins, 0)) == batch_mosaic.TILE


def test_zones_along_a_valley_fit_into_the_memory() -> None:
    """27 km of release areas, one beside the other: maps have to be divided, zones cannot be."""
    bins = default_bins(5000.0)
    areas = [area(Part(14 * i, 0, 60, 120), 6000) for i in range(370)]
    box = hull([a.part for a in areas]).grown(54, 54, 54, 54)
    assert bytes_for_zones(box, areas, 3) < 4e9 < bytes_needed(box, areas, bins)


@pytest.mark.parametrize(
    ("zones", "report", "memory", "there"),
    [
        ([], None, None, True),
        ([], 8_000, 7_999, True),
        ([], 8_000, 8_000, False),
        ([], 8_000, None, False),
        ([6_000, 9_000], None, 5_999, True),
        ([9_000, 6_000], None, 6_000, False),
        # As many bytes as there are without --memory.
        ([(4 << 30) + 1], None, None, True),
        ([4 << 30], None, None, False),
    ],
)
def test_a_mosaic_is_completed_as_soon_as_there_is_the_memory(
    zones: list[int], report: int | None, memory: int | None, there: bool, tmp_path: Path
) -> None:
    kept = {"fingerprint": "a", "zones_bytes": zones, "report_bytes": report}
    (tmp_path / "batch.json").write_text(json.dumps(kept))
    assert kept_mosaic(tmp_path, "a", memory) is None
    (tmp_path / "manifest.json").write_text(json.dumps({"warnings": ["left out"]}))
    assert kept_mosaic(tmp_path, "a", memory) == (("left out",) if there else None)
    assert kept_mosaic(tmp_path, "b", memory) is None


def test_stops_of_areas_are_kept_at_one_share(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an area whose blocks count 8 times an eighth is kept, and so of the other."""
    shares = {"a": 1.0, "b": 0.125}
    none, rocks = np.zeros(0, np.int64), np.zeros(4000, ROCK_DTYPE)
    rocks["rock"] = np.arange(rocks.size)
    rows = BlockRows(
        rocks, np.zeros(rocks.size, np.int64), *np.zeros((2, rocks.size)),
        np.zeros(0, PASSAGE_DTYPE), none, np.ones(rocks.size, np.int64), none,
    )  # fmt: skip

    def state(of: Reached, _wanted: Callable[[str], bool]) -> dict[str, Any]:
        share = shares[of.name]
        own = Progress(
            0, MapSums(4), ControlLineSums(()), stops=[evenly_kept(rows, 3, share)],
            stop_share=share,
        )  # fmt: skip
        return state_of(own) | {"thresholds_kj": np.zeros(1)}

    monkeypatch.setattr(batch_window, "read_state", state)
    areas = [replace(area(Part(0, 0, 2, 2), 0), name=n, folder=Path(n)) for n in shares]
    run: Any = SimpleNamespace(control_lines=(), stop_points_max=10**5, seed=3)
    planned: Any = SimpleNamespace(points=SimpleNamespace(area=np.array([0, 1])))
    total = added_up(run, Part(0, 0, 2, 2), areas, default_bins(), planned=planned)
    lines = joined_rows(total.stops).rocks["line"]
    assert np.bincount(lines) == pytest.approx([500, 500], abs=80)


def test_zones_that_are_left_out_say_how_much_memory_they_need(tmp_path: Path) -> None:
    far = [
        replace(area(Part(500 * i, 0, 60, 120), 6000 * (i + 1)), name=name)
        for i, name in enumerate("ab")
    ]
    rules = SimpleNamespace(preset=SimpleNamespace(thresholds_kj=(0.0, 30.0, 300.0)))
    mosaic: Any = SimpleNamespace(
        beside=54, place=Part(0, 0, 1000, 200), setting=SimpleNamespace(rules=rules)
    )
    drawn, left_out = _zones_by_group(tmp_path, mosaic, far, {}, 1, 1000, lambda _text: None)
    assert not drawn and len(left_out) == 2
    for text, need in left_out.items():
        assert f"need about {need / 1e9:.1f} GB of memory and were left out" in text


def test_counts_elsewhere_take_no_memory_of_a_block() -> None:
    block, bins = Part(0, 0, 512, 512), default_bins()
    inside, across = area(Part(0, 0, 100, 100), 4000), area(Part(0, 462, 100, 100), 4000)
    beyond = area(Part(0, 512, 100, 100), 4000)
    own = bytes_needed(block, [inside], bins) - bytes_needed(block, [], bins)
    assert bytes_needed(block, [across], bins) - bytes_needed(block, [], bins) == own // 2
    assert bytes_needed(block, [beyond], bins) == bytes_needed(block, [], bins)


def test_cores_share_the_memory_of_a_mosaic() -> None:
    for memory in (0, 4 << 30, 8 << 30, 64 << 30):
        for cores in (1, 2, 8):
            n, share = shared(memory, cores)
            assert 1 <= n <= cores
            if n > 1:
                assert (n + 1) * BASE + 2 * (n + 1) * (share - BASE) <= memory
            else:
                assert share == memory
    assert shared(8 << 30, 2)[0] == 2 and shared(1 << 30, 8)[0] == 1


def test_areas_that_meet_through_others_are_one_group() -> None:
    boxes = [Part(0, 0, 10, 10), Part(0, 40, 10, 10), Part(100, 0, 5, 5), Part(5, 20, 10, 10)]
    areas = [area(b, 1) for b in boxes]
    assert [[areas.index(a) for a in g] for g in groups(areas, 5)] == [[0], [1], [2], [3]]
    # 0 and 3 are 10 columns apart, 3 and 1 as well; 0 and 1 meet only through 3.
    assert [[areas.index(a) for a in g] for g in groups(areas, 6)] == [[0, 1, 3], [2]]


def test_what_cannot_be_read_is_no_trouble_with_writing_zones(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def gone(_mosaic: object, _areas: object, _shapes: object) -> None:
        raise FileNotFoundError("simulation.npz")

    monkeypatch.setattr(batch_mosaic, "_zones", gone)
    mosaic: Any = None
    with pytest.raises(FileNotFoundError):
        batch_mosaic._draw_zones(mosaic, ([], {}, tmp_path / "0.zones"))
