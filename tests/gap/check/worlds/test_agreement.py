"""The synthetic sites against the engine: same slope, same rocks, same law and parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sassgis.gap.check.worlds import WorldSpec, setup
from sassgis.gap.check.worlds.make import LAW_KEYS, base_world
from sassgis.gap.check.worlds.observe import write_down
from sassgis.gap.check.worlds.simulation import draw_rocks, simulate
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.gap.residuals.flights import _GROUND_MPS2
from sassgis.gap.residuals.free_run import RunModel, free_run, observed_at_stations
from sassgis.gap.residuals.table import residuals_of
from sassgis.io.read.config import load_config
from sassgis.model.ground import GroundTable
from sassgis.runs.blinded_cases import write_seen
from sassgis.runs.gap_case import read_case

#: Sampling errors of the difference of two means are near 0.1 standard deviations.
ROCKS, REPLICATES, NEAR_SD = 120, 4, 0.3
#: Rolling friction of all blocks of a site is the same.
ALIKE = {"terrain.path": "fall_line", "engine.rolling_friction_sd": 0.0}


def true_site(slope: str, kind: str, folder: Path) -> Case:
    """A site without an effect, in the engine with its true parameters."""
    world = base_world(WorldSpec(slope), 1)
    known = setup(world)
    seen = write_down(
        world, simulate(world, draw_rocks(world, ROCKS, 77)), kind, np.random.default_rng(1)
    )
    config = write_seen(world, folder, "agreement", seen)
    # In the plane of the fall line: what is compared is the law of the motion.
    settings = load_config(config, ALIKE)
    case = read_case(settings, config.parent / "observations")
    law = {
        name: dict(zip(LAW_KEYS, row.tolist(), strict=True))
        for name, row in zip(known.class_names, world.law, strict=True)
    }
    classes = tuple(replace(c, mu_v=0.0, **law.get(c.name, {})) for c in case.table.classes)
    return replace(case, table=GroundTable(classes))


@pytest.fixture(scope="module", params=["cliff_talus_meadow", "forested_slope"])
def site(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    return true_site(request.param, "both", Path(tmp_path_factory.mktemp("agreement")) / "case")


def test_engine_and_sites_agree_at_every_station(site: Case) -> None:
    run = free_run(site, RunModel.of(site, configured_model(site), 5), REPLICATES)
    seen = observed_at_stations(site)
    for name in ("speed_mps", "rotation_hz", "height_m"):
        for k, station in enumerate(site.station_names):
            one = getattr(seen, name)[:, k]
            other = getattr(run.at, name)[:, :, k].ravel()
            one, other = one[np.isfinite(one)], other[np.isfinite(other)]
            scale = np.sqrt(0.5 * (one.var() + other.var()))
            assert abs(one.mean() - other.mean()) < NEAR_SD * scale, (name, station)
    arrived = np.nanmean(seen.arrived, axis=0), np.nanmean(run.at.arrived, axis=(0, 1))
    assert arrived[0] == pytest.approx(arrived[1], abs=0.15)


def test_paths_along_the_ground_differ_by_less_than_counts(tmp_path: Path) -> None:
    site = true_site("grass_slope", "everything", tmp_path / "case")
    found = residuals_of(site, configured_model(site), seed=5, replicates=REPLICATES)
    (ground,) = (r for r in found.rows if r.quantity == "acceleration_mps2" and r.place == "all")
    assert np.isfinite(ground.gap).sum() > 20
    assert abs(np.nanmean(ground.gap)) < _GROUND_MPS2
