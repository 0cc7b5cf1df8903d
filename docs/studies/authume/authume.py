"""Uncalibrated prediction of the block releases P1 at Authume against the measured stops.

    python docs/studies/authume/authume.py [--data ../shared/data] [--rocks 200] [--work FOLDER]

The data (Garcia et al. 2022, Eng. Geol. 310:106855; Bourrier et al. 2021, Landslides 18:639) state
no licence. They are read from their folder; the files written beside this script are distributions
of run-out and counts, no terrain and no coordinates. ``--work`` keeps the whole run and a map of
the stops, which must not be passed on.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from runout_figure import runout_gap_figure
from scipy.stats import energy_distance

import sassgis
from sassgis.errors import InputError, SassgisError
from sassgis.grid import FloatArray
from sassgis.report.figures import save
from sassgis.runs.run import RunResult, run
from sassgis.settings.results import ReleasePoints, TraceSet
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.flatten import xy_to_chainage

HERE = Path(__file__).resolve().parent
DEFAULT_DATA = HERE.parents[2].parent / "shared" / "data"
FOLDER = "authume_quarry_p1"
SHARES = (0.10, 0.25, 0.50, 0.75, 0.90)
SEED = 1986
#: Stopping reasons of rocks without a stop.
NO_STOP = ("left_profile", "step_limit")
#: Zones of the substratum raster: classes of the built-in table, chosen by name alone.
ZONES = {1: "soft_meadow", 2: "rock", 3: "debris"}
#: Edge of the upper rock face (m, plan distance): rocks beyond it have left the upper slope.
EDGE_M = 30.0
#: Limestone; the mass of a rock cancels out of its motion.
DENSITY_KGM3 = 2600.0
#: The same run with other assumptions. None is preferred for its result here.
VARIANTS: dict[str, dict[str, str]] = {
    "vegetated ground as forest_soil": {"zone_1": "forest_soil"},
    "vegetated ground as debris": {"zone_1": "debris"},
    'engine.eta_max_rule = "coulomb"': {"engine": 'eta_max_rule = "coulomb"'},
    'engine.slope_variation = "off"': {"engine": 'slope_variation = "off"'},
    'engine.rolling = "ellipse"': {"engine": 'rolling = "ellipse"'},
}


@dataclass(frozen=True)
class Observed:
    """Measured data, in the coordinates of the rasters (x = X, y = Z)."""

    stops: FloatArray  # shape (n, 2)
    # Shape (n, 3); half of the sides of the box around each block, largest first (m).
    semi_axes: FloatArray
    mass_kg: FloatArray  # shape (n,)
    corners: FloatArray  # shape (4, 2); of the square of release
    release_height_m: float  # of the square, in the height system of the terrain


def read_observed(folder: Path) -> Observed:
    """Read the end points and the square of release.

    Raises
    ------
    InputError
        If a file is missing or not as described.
    """
    tables = []
    for name, columns in (("Endpoints_P1.txt", 7), ("positions_P1.xyz", 3)):
        file = folder / name
        if not file.is_file():
            raise InputError(
                "the measured data are not here",
                file=file,
                expected="the data of the Authume quarry; give their folder with --data",
            )
        table = np.loadtxt(file, ndmin=2)
        if table.shape[1] != columns:
            raise InputError(
                "unexpected table", file=file, found=f"{table.shape[1]} columns",
                expected=f"{columns}",
            )  # fmt: skip
        tables.append(table)
    ends, corners = tables
    # Y is the vertical. The heights of the stops lie 2.9 m above the terrain: not used.
    return Observed(
        stops=ends[:, [0, 2]],
        semi_axes=np.sort(ends[:, 4:7], axis=1)[:, ::-1] / 2.0,
        mass_kg=ends[:, 3],
        corners=corners[:, [0, 2]],
        release_height_m=float(corners[:, 1].mean()),
    )


def drop_limits(observed: Observed, dem: Path) -> tuple[float, float]:
    """Least and greatest height above rest in the square of release (m)."""
    import rasterio

    with rasterio.open(dem) as source:
        heights = source.read(1, masked=True)
        west, south = observed.corners.min(axis=0)
        east, north = observed.corners.max(axis=0)
        top, left = source.index(west, north)
        bottom, right = source.index(east, south)
    ground = heights[top : bottom + 1, left : right + 1].compressed().astype(float)
    rest = float(np.median(observed.semi_axes[:, 2]))
    low, high = observed.release_height_m - rest - np.array([ground.max(), ground.min()])
    return max(round(float(low), 2), 0.0), round(float(high), 2)


def write_inputs(
    folder: Path,
    data: Path,
    observed: Observed,
    rocks: int,
    spacing: float,
    variant: dict[str, str],
) -> Path:
    """Write the release area and the configuration; the rasters are read from their folder."""
    folder.mkdir(parents=True, exist_ok=True)
    square = shapely.MultiPoint(observed.corners).convex_hull
    with warnings.catch_warnings():
        # The coordinates are local: there is no system to state.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        gpd.GeoDataFrame({"name": ["P1"]}, geometry=[square]).to_file(folder / "release.gpkg")
    dem = data / "derived_dtm_0p5m_local.tif"
    zones = {code: variant.get(f"zone_{code}", name) for code, name in ZONES.items()}
    axes = [(round(float(a.min()), 4), round(float(a.max()), 4)) for a in observed.semi_axes.T]
    low, high = drop_limits(observed, dem)
    text = f'''[project]
name = "Authume quarry, P1"

[terrain]
dem = {json.dumps(str(dem))}
crs = "local"
path = "fall_line"

[release]
file = "release.gpkg"
name_field = "name"
spacing_m = {spacing}
rocks_per_point = {rocks}

[ground]
default = "{zones[2]}"
file = {json.dumps(str(data / "derived_substratum_zones_0p5m_local.tif"))}
raster_classes = {{ {", ".join(f'{code} = "{name}"' for code, name in zones.items())} }}

[[blocks]]
name = "P1"
axis_1_m = {list(axes[0])}
axis_2_m = {list(axes[1])}
axis_3_m = {list(axes[2])}
density_kgm3 = {DENSITY_KGM3}
drop_m = [{low}, {high}]

[engine]
readings = "1986"
{variant.get("engine", "")}

[run]
seed = {SEED}

[output]
rock_table = "csv"
'''
    file = folder / "authume.toml"
    file.write_text(text, encoding="utf-8")
    return file


@dataclass(frozen=True)
class RunOut:
    """Run-outs of observed or predicted rocks, all measured in the same way."""

    plan_m: FloatArray  # plan distance from the centre of the square of release
    chainage_m: FloatArray  # along the nearest of all fall lines at its point nearest to the stop
    # Plan distance from the fall line of the centre; positive to the right, looking downhill.
    offset_m: FloatArray


def measure(stops: FloatArray, centre: FloatArray, lines: TraceSet, middle: TraceSet) -> RunOut:
    """Measure stops (m, shape (n, 2)) from the centre and along the fall lines."""
    x, y = stops[:, 0], stops[:, 1]
    found = [xy_to_chainage(lines, i, x, y) for i in range(len(lines))]
    chainage = np.array([f[0] for f in found])
    aside = np.abs([f[1] for f in found])
    nearest = np.argmin(aside, axis=0)
    return RunOut(
        np.hypot(x - centre[0], y - centre[1]),
        chainage[nearest, np.arange(len(x))],
        xy_to_chainage(middle, 0, x, y)[1],
    )


def fall_lines_of(result: RunResult, centre: FloatArray) -> tuple[TraceSet, TraceSet]:
    """All fall lines of a run, and that of the centre of the square."""
    job, planned = result.run, result.planned
    alone = ReleasePoints(
        centre[:1].copy(), centre[1:].copy(), np.zeros(1, np.int64), np.zeros(1, np.uint64), ("c",)
    )
    every, middle = (
        trace(job.grid, planned.surface, p, job.terrain) for p in (planned.starts, alone)
    )
    return every, middle


def bootstrap_quantiles(
    values: FloatArray, rng: np.random.Generator, draws: int = 4000
) -> list[list[float]]:
    """Quantiles at SHARES with 95 % bootstrap limits: rows of (value, lower, upper)."""
    again = rng.choice(values, size=(draws, values.size), replace=True)
    spread = np.quantile(np.quantile(again, SHARES, axis=1), [0.025, 0.975], axis=1)
    middle = np.quantile(values, SHARES)
    return [[float(v), float(lo), float(hi)] for v, lo, hi in zip(middle, *spread, strict=True)]


def permutation_test(
    observed: FloatArray, predicted: FloatArray, rng: np.random.Generator, draws: int = 2000
) -> tuple[float, float]:
    """Energy distance and the share of random relabellings that reach it (one added to both).

    The distance is 2 ∫ (F − G)² (m; G. Székely and M. Rizzo, 2013), the square of that of scipy.
    """
    distance = float(energy_distance(observed, predicted) ** 2)
    pooled = np.concatenate([observed, predicted])
    n = observed.size
    as_far = 0
    for _ in range(draws):
        mixed = rng.permutation(pooled)
        as_far += energy_distance(mixed[:n], mixed[n:]) ** 2 >= distance
    return distance, (1 + as_far) / (1 + draws)


def simulated(
    config: Path, out: Path, centre: FloatArray, observed: Observed
) -> tuple[RunResult, pd.DataFrame, RunOut, RunOut]:
    """Run and measure: result, table of rocks, observed and predicted run-outs.

    Rocks that leave the terrain have no stop; they are counted, not measured.
    """
    result = run(config, out, overwrite=True)
    rocks = pd.read_csv(out / "tables" / "rocks.csv")
    stopped = rocks[~rocks["reason"].isin(NO_STOP)]
    every, middle = fall_lines_of(result, centre)
    predicted = measure(stopped[["x_m", "y_m"]].to_numpy(float), centre, every, middle)
    return result, rocks, measure(observed.stops, centre, every, middle), predicted


def compare(seen: RunOut, made: RunOut, rng: np.random.Generator) -> dict[str, Any]:
    """Quantiles, their bootstrap limits, distances and tests."""
    out: dict[str, object] = {}
    for name in ("plan_m", "chainage_m"):
        a, b = getattr(seen, name), getattr(made, name)
        distance, p = permutation_test(a, b, rng)
        out[name] = {
            "shares": list(SHARES),
            "observed": bootstrap_quantiles(a, rng),
            "predicted": [float(v) for v in np.quantile(b, SHARES)],
            "energy_distance_m": distance,
            "permutation_p": p,
        }
    far = [v.plan_m[v.plan_m > EDGE_M] for v in (seen, made)]
    out["beyond_the_edge"] = {
        "edge_m": EDGE_M,
        "observed_share": far[0].size / seen.plan_m.size,
        "predicted_share": far[1].size / made.plan_m.size,
        "observed": bootstrap_quantiles(far[0], rng),
        "predicted": [float(v) for v in np.quantile(far[1], SHARES)] if far[1].size else None,
    }
    out["offset_m"] = {
        "shares": list(SHARES),
        "observed": [float(v) for v in np.quantile(seen.offset_m, SHARES)],
        "predicted": [float(v) for v in np.quantile(made.offset_m, SHARES)],
        "observed_median_absolute": float(np.median(np.abs(seen.offset_m))),
        "predicted_median_absolute": float(np.median(np.abs(made.offset_m))),
    }
    return out


def _rounded(item: Any) -> Any:
    """Four significant digits."""
    if isinstance(item, dict):
        return {k: _rounded(v) for k, v in item.items()}
    if isinstance(item, list):
        return [_rounded(v) for v in item]
    return float(f"{item:.4g}") if isinstance(item, float) else item


def study(
    data: Path,
    out: Path,
    work: Path,
    *,
    rocks: int = 200,
    spacing: float = 0.5,
    variants: bool = True,
) -> dict[str, object]:
    """Run the study; write ``results.json`` and ``runout.png`` to ``out`` and the rest to ``work``.

    ``data`` holds the folder of the quarry. ``out`` is for what may be shown: distributions and
    counts; ``work`` for what stays with the data: the runs and the map of the stops. There are so
    many rocks at each release point, and so many metres from one point to the next; ``variants``
    are the other readings. Returned is what ``results.json`` holds.

    Raises
    ------
    InputError
        If the data are not there.
    """
    quarry = data / FOLDER
    observed = read_observed(quarry)
    centre = observed.corners.mean(axis=0)
    config = write_inputs(work, quarry, observed, rocks, spacing, {})
    result, table, seen, made = simulated(config, work / "run", centre, observed)
    counts = {str(k): int(v) for k, v in table["reason"].value_counts().items()}
    report: dict[str, object] = {
        "program": f"sassgis {sassgis.__version__}",
        "seed": SEED,
        "observed_rocks": len(observed.stops),
        "release_points": len(result.planned.points),
        "predicted_rocks": len(table),
        "predicted_ends": counts,
        "drop_m": list(drop_limits(observed, quarry / "derived_dtm_0p5m_local.tif")),
        "semi_axes_m": [[float(a.min()), float(a.max())] for a in observed.semi_axes.T],
        "median_mass_kg": {
            "observed": float(np.median(observed.mass_kg)),
            "predicted": float(table["mass_kg"].median()),
        },
        "ground": {str(k): v for k, v in ZONES.items()},
        **compare(seen, made, np.random.default_rng(SEED)),
    }
    if variants:
        others: dict[str, object] = {}
        for i, (name, changes) in enumerate(VARIANTS.items()):
            print(f"Other reading: {name}")
            folder = work / f"variant_{i}"
            other = write_inputs(folder, quarry, observed, max(rocks // 4, 1), spacing, changes)
            _, all_rocks, _, moved = simulated(other, folder / "run", centre, observed)
            others[name] = {
                "rocks": len(all_rocks),
                "plan_m": [float(v) for v in np.quantile(moved.plan_m, SHARES)],
                "share_beyond_the_edge": float(np.mean(moved.plan_m > EDGE_M)),
            }
        report["other_readings"] = others
    report = {k: _rounded(v) for k, v in report.items()}
    out.mkdir(parents=True, exist_ok=True)
    (out / "results.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    title = "Authume quarry, P1: plan distance from the release to the stop"
    save(runout_gap_figure(seen.plan_m, made.plan_m, title=title), out / "runout.png")
    stopped = table[~table["reason"].isin(NO_STOP)]
    save(
        runout_gap_figure(
            seen.plan_m,
            made.plan_m,
            grid=result.run.grid,
            observed_xy=observed.stops,
            predicted_xy=stopped[["x_m", "y_m"]].to_numpy(float),
            release=[observed.corners],
            title=title,
        ),
        work / "stops_map.png",
    )
    return report


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the field data")
    parser.add_argument("--rocks", type=int, default=200, help="rocks per release point")
    parser.add_argument(
        "-o", "--out", type=Path, default=HERE, help="for results.json and runout.png"
    )
    parser.add_argument("--work", type=Path, help="keep the runs and the map of the stops here")
    given = parser.parse_args(arguments)
    try:
        with tempfile.TemporaryDirectory() as scratch:
            study(given.data, given.out, given.work or Path(scratch), rocks=given.rocks)
    except SassgisError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(f"Wrote {given.out / 'results.json'} and {given.out / 'runout.png'}")
    if given.work:
        print(f"Map of the stops: {given.work / 'stops_map.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
