"""From the files of the sample valley to risk: what the engine counts is what the objects get."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sassgis.hazard.bins import bins_of
from sassgis.hazard.risk import assess_risk, risk_totals
from sassgis.io.read.config import load_config
from sassgis.io.read.objects import joined_objects, object_cells, read_objects, read_vulnerability
from sassgis.model.hazard import Source, SourceCounts
from sassgis.model.map_run import ObjectCells
from sassgis.runs.inputs import read_map_run
from sassgis.runs.map import simulate_map
from sassgis.terrain.plan import plan

CODES, LIMITS = ("low", "mean", "high"), (0.0, 30.0, 300.0)


@pytest.fixture(scope="module")
def valley(make_valley):
    config: Path = make_valley(spacing_m=10.0, rocks_per_point=8)
    folder = config.parent
    job = replace(read_map_run(load_config(config)), control_lines=())
    # On rock all the way down, many rocks come as far as the road and the houses.
    rock = job.table.names.index("rock")
    job = replace(job, ground=np.full_like(job.ground, rock))
    houses = read_objects(
        folder / "buildings.gpkg",
        job.grid,
        kind="building",
        name="houses",
        name_field="name",
        fields={"value": "value_chf", "persons": "persons", "presence": "presence"},
    )
    road = read_objects(
        folder / "road.gpkg",
        job.grid,
        kind="road",
        name="road",
        name_field="name",
        fields={
            "value_per_m": "chf_per_m",
            "traffic_per_day": "traffic_per_day",
            "speed_kmh": "speed_kmh",
            "vehicle_length_m": "vehicle_m",
            "persons_per_vehicle": "persons_per_vehicle",
            "vehicle_value": "vehicle_chf",
        },
    )
    placed = joined_objects([houses, road])
    cells, owner = object_cells(placed, job.grid)
    job = replace(job, thresholds_kj=LIMITS, objects=ObjectCells(len(placed.objects), cells, owner))
    return job, placed, simulate_map(job, plan(job)), folder


def test_hits_of_an_object_lie_between_those_of_its_cells(valley):
    """The most that one of its cells gets, and all that its cells get together."""
    job, _, progress, _ = valley
    reached = 0
    for tally in progress.sources.values():
        on_cells, on_objects = tally.cells.counts(), tally.objects.counts()
        for place, count in zip(on_objects.places, on_objects.count, strict=True):
            own = job.objects.cell[job.objects.number == place]
            rows = on_cells.count[np.isin(on_cells.places, own)]
            assert (count >= rows.max(axis=0)).all()
            assert (count <= rows.sum(axis=0)).all()
            reached += int(count[0] > 0)
    assert reached > 5


def table_of(valley):
    job, placed, progress, folder = valley
    sources, counts = [], []
    for (area, scenario), tally in sorted(progress.sources.items()):
        blocks = job.blocks[scenario]
        sources.append(
            Source(
                job.areas[area].name,
                blocks.name,
                1.0,
                tally.rocks,
                job.rocks_per_point,
                block_width_m=blocks.mean_width_m,
            )
        )
        own: SourceCounts = tally.objects.counts()
        counts.append(own)
    table = read_vulnerability(folder / "vulnerability.csv", CODES)
    return assess_risk(placed.objects, sources, counts, bins_of(job).threshold, LIMITS, table)


def test_risk_of_the_valley(valley):
    _, placed, _, _ = valley
    table = table_of(valley)
    hits = table.of_object("hits")
    assert hits.max() > 0.0
    # One block of each source a year: no object is hit more often than there are blocks.
    assert hits.max() <= len(table.sources)
    totals = {(t.scope, t.name): t for t in risk_totals(table)}
    road = totals["whole", "valley road"]
    assert road.objects == sum(o.kind == "road" for o in placed.objects) > 10
    assert road.values["loss"] > 0.0 and road.values["deaths"] > 0.0
    assert 0.0 < road.standard_error_apart["loss"] < road.standard_error["loss"]
    # Every rock that comes to the road is on one of its stretches at least.
    assert road.values["hits"] >= hits[[o.kind == "road" for o in placed.objects]].max()


def test_shorter_stretches_tell_the_same_road(valley):
    """Only rocks that touch two stretches make a difference."""
    job, placed, progress, folder = valley
    road = [o for o in placed.objects if o.kind == "road"]
    long = read_objects(
        folder / "road.gpkg", job.grid, kind="road", name="road", name_field="name", segment_m=1e4
    )
    cells, owner = object_cells(long, job.grid)
    whole = replace(job, objects=ObjectCells(1, cells, owner))
    once = simulate_map(whole, plan(whole))
    for source, tally in progress.sources.items():
        own = tally.objects.counts()
        of_road = np.array([placed.objects[k].kind == "road" for k in own.places], bool)
        stretches = int(own.count[of_road, 0].sum())
        together = int(once.sources[source].objects.counts().count[:, 0].sum())
        assert together <= stretches <= 1.15 * together + 3
    assert sum(o.length_m for o in road) == pytest.approx(long.objects[0].length_m)
