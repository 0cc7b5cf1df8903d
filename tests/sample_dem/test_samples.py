"""The committed samples are what the script makes, and they are the slopes they claim to be."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable
from pathlib import Path

import generate
import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from rasterio.features import geometry_mask

from sassgis.errors import OutputError
from sassgis.inputs.config import load_config
from sassgis.outputs.site_template import write_samples
from sassgis.runs.inputs import read_rules
from sassgis.runs.resumable_run import read_job
from sassgis.runs.run import prepared
from sassgis.settings.results import Outcome
from sassgis.simulation.loop import simulate_map
from sassgis.terrain.prepare import plan

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_dem"
CLASSES = {"rock", "debris", "talus", "soft_meadow", "asphalt"}
VECTORS = ("release", "ground", "road", "track", "buildings", "stations", "net", "wall")
TEXTS = (
    "valley/config.toml",
    "valley/vulnerability.csv",
    "bedrina/profile.csv",
    "bedrina/config_before.toml",
    "bedrina/config_after.toml",
    "bedrina/config_restart.toml",
    "piota_negra/profile.csv",
    "piota_negra/config.toml",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    generate.main(folder)
    return folder


@pytest.fixture(scope="module")
def slope_deg() -> tuple[np.ndarray, rasterio.Affine]:
    with rasterio.open(SAMPLES / "valley" / "dem.tif") as raster:
        z = raster.read(1).astype(float)
        gy, gx = np.gradient(z, raster.res[0])
        return np.degrees(np.arctan(np.hypot(gx, gy))), raster.transform


def test_the_script_makes_the_committed_heights(made: Path) -> None:
    with (
        rasterio.open(made / "valley/dem.tif") as new,
        rasterio.open(SAMPLES / "valley/dem.tif") as old,
    ):
        assert new.profile == old.profile
        # Heights are rounded to the centimetre: another libm may round one the other way.
        assert np.abs(new.read(1).astype(float) - old.read(1)).max() < 0.011


@pytest.mark.parametrize("name", VECTORS)
def test_the_script_makes_the_committed_vectors(made: Path, name: str) -> None:
    new = gpd.read_file(made / "valley" / f"{name}.gpkg")
    old = gpd.read_file(SAMPLES / "valley" / f"{name}.gpkg")
    assert new.crs == old.crs and new.crs.to_epsg() == 2056
    assert new.drop(columns="geometry").equals(old.drop(columns="geometry"))
    assert new.geometry.geom_equals_exact(old.geometry, tolerance=0.002).all()


@pytest.mark.parametrize("name", TEXTS)
def test_the_script_makes_the_committed_texts(made: Path, name: str) -> None:
    assert (made / name).read_text() == (SAMPLES / name).read_text()


def test_no_sample_is_left_out_of_the_comparison(made: Path) -> None:
    compared = {*TEXTS, "valley/dem.tif", *(f"valley/{n}.gpkg" for n in VECTORS)}
    assert {p.relative_to(made).as_posix() for p in made.rglob("*.*")} == compared
    for room in ("valley", "bedrina", "piota_negra"):
        found = {p.relative_to(SAMPLES).as_posix() for p in (SAMPLES / room).glob("*.*")}
        assert found == {c for c in compared if c.startswith(room)}


def test_the_folder_stays_small() -> None:
    assert sum(p.stat().st_size for p in SAMPLES.rglob("*") if p.is_file()) < 6_000_000


@pytest.mark.parametrize(
    ("ground", "low", "high"),
    [("rock", 60.0, 75.0), ("talus", 29.0, 38.0), ("debris", 30.0, 38.0), ("asphalt", 0.0, 3.0)],
)
def test_each_ground_has_its_slope(
    slope_deg: tuple[np.ndarray, rasterio.Affine], ground: str, low: float, high: float
) -> None:
    slope, transform = slope_deg
    polygons = gpd.read_file(SAMPLES / "valley/ground.gpkg")
    inside = geometry_mask(
        polygons[polygons["class"] == ground].geometry, slope.shape, transform, invert=True
    )
    assert inside.sum() > 1000
    assert low < np.median(slope[inside]) < high


def test_ground_polygons_do_not_overlap_and_cover_the_terrain() -> None:
    polygons = gpd.read_file(SAMPLES / "valley/ground.gpkg")
    assert polygons.is_valid.all()
    assert set(polygons["class"]) == CLASSES
    assert polygons.area.sum() == pytest.approx(1200 * 900, rel=1e-4)
    assert polygons.union_all().area == pytest.approx(1200 * 900, rel=1e-4)


def test_release_areas_lie_in_rock_and_hold_a_fair_number_of_points() -> None:
    releases = gpd.read_file(SAMPLES / "valley/release.gpkg")
    ground = gpd.read_file(SAMPLES / "valley/ground.gpkg")
    rock = ground[ground["class"] == "rock"].union_all()
    assert set(releases["name"]) == {"Nord", "Mitte", "Gully", "Sued"}
    assert releases.within(rock).all()
    config = tomllib.loads((SAMPLES / "valley/config.toml").read_text())
    points = releases.area.sum() / config["release"]["spacing_m"] ** 2
    assert 300 < points < 1500
    assert set(releases["scenario"]) == {b["name"] for b in config["blocks"]}


def down_the_slope(layer: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Places along the slope, ascending, and down the slope of the vertices of a feature."""
    shapes = gpd.read_file(SAMPLES / f"valley/{layer}.gpkg").set_index("name").geometry
    x, y = shapely.get_coordinates(shapes[name]).T
    u, v = generate.to_slope(x, y)
    order = np.argsort(u)
    return u[order], v[order]


@pytest.mark.parametrize(
    ("house", "barrier"),
    [("house 2", None), ("house 4", "net Mitte"), ("house 5", "wall Nord")],
)
def test_houses_by_the_track_lie_behind_what_they_are_said_to_lie_behind(
    house: str, barrier: str | None
) -> None:
    u, v = down_the_slope("buildings", house)
    track = np.interp(u, *down_the_slope("track", "forest track"))
    assert (track < v).all() and (v < track + 25.0).all()
    behind = []
    for layer, name in (("net", "net Mitte"), ("wall", "wall Nord")):
        along, down = down_the_slope(layer, name)
        if along[0] < u.min() and u.max() < along[-1]:
            assert (np.interp(u, along, down) < track - 5.0).all()
            behind.append(name)
    assert behind == ([barrier] if barrier else [])


def test_rocks_come_to_barriers_houses_and_track(make_valley: Callable[..., Path]) -> None:
    """Else the valley would show neither what a net does nor what risk is."""
    config = load_config(make_valley(spacing_m=5.0, rocks_per_point=40))
    job = read_job(config, None, lambda _text: None)
    rules = read_rules(config, job.run)
    run = prepared(job, rules).run
    hits = np.zeros(len(rules.placed))
    reached: dict[str, float] = {}
    stopped: dict[str, float] = {}
    for (area, _), tally in simulate_map(run, plan(run)).sources.items():
        counts = tally.objects.counts()
        hits[counts.places] += counts.count[:, 0]
        for number, (control_line, _) in enumerate(run.control_lines):
            if control_line.name.endswith(run.areas[area].name):
                arrivals = tally.control_lines.arrivals(number)
                reached[control_line.name] = arrivals / tally.rocks
                stopped[control_line.name] = (
                    tally.control_lines.outcomes(number)[Outcome.STOPPED] / arrivals
                )
    assert set(reached) == {"net Mitte", "wall Nord"}
    assert all(0.05 < share < 0.8 for share in reached.values())
    assert all(0.5 < share <= 1.0 for share in stopped.values())
    hit = {o.name for o, n in zip(rules.placed.objects, hits, strict=True) if n}
    assert {"house 2", "house 5"} <= hit
    assert sum(name.startswith("forest track") for name in hit) >= 5


@pytest.mark.parametrize(
    ("folder", "length", "fall"), [("bedrina", 170.0, 150.0), ("piota_negra", 150.0, 135.0)]
)
def test_profiles_have_the_length_and_fall_they_are_said_to_have(
    folder: str, length: float, fall: float
) -> None:
    with (SAMPLES / folder / "profile.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    s = np.array([float(r["s_m"]) for r in rows])
    z = np.array([float(r["z_m"]) for r in rows])
    assert (np.diff(s) > 0).all() and (np.diff(z) <= 0).all()
    assert s[0] == 0.0 and s[-1] == pytest.approx(length)
    assert z[0] - z[-1] == pytest.approx(fall)
    assert {r["ground"] for r in rows} <= CLASSES


@pytest.mark.parametrize("name", [t for t in TEXTS if t.endswith(".toml")])
def test_configurations_can_be_loaded(name: str) -> None:
    config = load_config(SAMPLES / name)
    assert config.project.name
    assert config.run.seed == 1986


def test_every_ground_of_the_samples_is_built_in() -> None:
    with (ROOT / "sassgis/data/ground_classes.csv").open() as lines:
        assert {row["name"] for row in csv.DictReader(lines)} >= CLASSES


@pytest.mark.parametrize("name", [t for t in TEXTS if t.endswith(".toml")])
def test_configurations_name_files_that_exist_and_places_on_the_slope(name: str) -> None:
    path = SAMPLES / name
    config = tomllib.loads(path.read_text())
    entries = [config.get(k, {}) for k in ("terrain", "release", "ground", "profile")]
    entries += config.get("stations", []) + config.get("barriers", [])
    files = [e[k] for e in entries for k in ("dem", "file") if k in e]
    assert files and all((path.parent / f).is_file() for f in files)
    if "profile" in config:
        end = float((path.parent / "profile.csv").read_text().split()[-1].split(",")[0])
        places = [e["chainage_m"] for e in entries if "chainage_m" in e]
        assert places and all(config["profile"]["start_m"][1] < c < end for c in places)
        assert config["profile"]["rocks"] == 100


def test_noise_is_repeatable_and_of_unit_strength() -> None:
    x, y = np.meshgrid(np.arange(0.0, 900.0, 3.1), np.arange(0.0, 900.0, 3.1))
    for seed in (1, 23, 47):
        values = generate.noise(x, y, 20.0, seed)
        assert abs(values.mean()) < 0.1
        assert values.std() == pytest.approx(1.0, abs=0.12)
        # A neighbour differs little, a point three lattice cells on is unrelated.
        near = np.corrcoef(values[:, :-1].ravel(), values[:, 1:].ravel())[0, 1]
        far = np.corrcoef(values[:, :-20].ravel(), values[:, 20:].ravel())[0, 1]
        assert near > 0.9 and abs(far) < 0.1
    assert not np.allclose(generate.noise(x, y, 20.0, 1), generate.noise(x, y, 20.0, 2))


def test_written_samples_are_those_of_the_package_and_never_go_over_a_folder(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "own" / "sample"
    write_samples(folder)
    written = {p.relative_to(folder) for p in folder.rglob("*") if p.is_file()}
    sample = {p.relative_to(SAMPLES) for p in SAMPLES.rglob("*") if p.is_file()}
    assert written == {p for p in sample if p.suffix not in (".py", ".pyc")}
    assert all((folder / p).read_bytes() == (SAMPLES / p).read_bytes() for p in written)
    assert load_config(folder / "valley" / "config.toml").label
    with pytest.raises(OutputError, match="exists"):
        write_samples(folder)
