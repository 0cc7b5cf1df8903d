"""What observers of a site write down: the files of a case as a user has them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from gap_check.motion import FRAGMENT, ROCK, Rocks, Run, draw_rocks, simulate
from gap_check.slopes import CLASSES, FloatArray, Surface
from gap_check.worlds import KINDS, World

CONFIG_NAME = "config.toml"
OBSERVATIONS_NAME = "observations"
FPS = 25.0
#: Errors that every observer makes (standard deviations), as the metadata call them.
ERRORS = {
    "speed_error_rel": 0.05, "rotation_error_rel": 0.06, "height_error_m": 0.10,
    "position_error_m": 0.25,
}  # fmt: skip
_MASS_ERROR_REL = 0.05
#: Errors of the instruments from the weakest to the strongest, where they are the truth of a site.
_WRONG = (0.02, 0.8)

# A made slope falls less steeply in its run-out than the usual limit of a fall line.
_CONFIG = """[project]
name = {title}

[terrain]
dem = "dem.tif"
vertical_datum = "LN02"
energy_line_angle_deg = 10.0

[release]
file = "release.gpkg"

[ground]
default = "{default}"
file = "ground.tif"
raster_classes = {{ {classes} }}

[[blocks]]
name = "blocks"
{blocks}

[run]
seed = 1
jobs = 1
"""


def write_case(world: World, folder: Path, title: str, campaign: int = 0) -> Path:
    """Write what observers of a campaign see and know into a new folder; the configuration."""
    folder.mkdir(parents=True)
    raster = world.survey
    _write_raster(folder / "dem.tif", raster, raster.z)
    _write_raster(folder / "ground.tif", raster, (world.relief.ground + 1).astype(np.uint8))
    x, y, _ = _stated_release(world, world.releases).T
    points = gpd.GeoDataFrame(geometry=gpd.points_from_xy(x, y), crs="EPSG:2056")
    points.to_file(folder / "release.gpkg", layer="release")
    config = _CONFIG.format(
        title=json.dumps(title),
        default=CLASSES[0],
        classes=", ".join(f'{k} = "{name}"' for k, name in enumerate(CLASSES, 1)),
        blocks="\n".join(f"{k} = [{low!r}, {high!r}]" for k, (low, high) in world.blocks.items()),
    )
    (folder / CONFIG_NAME).write_text(config, encoding="utf-8")
    tables, metadata = observed(world, campaign)
    (folder / OBSERVATIONS_NAME).mkdir()
    tables["metadata"] = pd.DataFrame({"key": list(metadata), "value": list(metadata.values())})
    for name, table in tables.items():
        # Tenths of a millimetre of national coordinates; nobody measures nearer.
        file = folder / OBSERVATIONS_NAME / f"{name}.csv"
        table.to_csv(file, index=False, float_format="%.11g")
    return folder / CONFIG_NAME


def _write_raster(file: Path, surface: Surface, values: NDArray[np.generic]) -> None:
    n_rows, n_cols = values.shape
    transform = from_origin(surface.west, surface.north, surface.cell_m, surface.cell_m)
    with rasterio.open(
        file, "w", driver="GTiff", width=n_cols, height=n_rows, count=1, dtype=values.dtype,
        crs="EPSG:2056", transform=transform, compress="deflate",
    ) as dataset:  # fmt: skip
        dataset.write(values, 1)


def observed(world: World, campaign: int = 0) -> tuple[dict[str, pd.DataFrame], dict[str, float]]:
    """Tables of what is seen of the rocks of a campaign, and the metadata."""
    run = simulate(world, draw_rocks(world, world.spec.n_rocks, 1000 + campaign))
    run = _recorded(world, distorted(world, run), campaign)
    rng = np.random.default_rng([world.seed, 808, campaign])
    made = {
        "rocks": lambda: _rocks(world, run.rocks, rng),
        "stations": lambda: _stations(world),
        "passages": lambda: _passages(world, run, rng),
        "deposits": lambda: _deposits(world, run, rng),
        "impacts": lambda: _impacts(world, run, rng),
        "trajectories": lambda: _trajectories(world, run, rng),
    }
    metadata = {
        "fps": FPS,
        **{key: world.spec.error_factor * value for key, value in ERRORS.items()},
        **{key: float(getattr(world.faults, key)) for key in world.faults.stated},
    }
    return {name: made[name]() for name in KINDS[world.spec.kind]}, metadata


def distorted(world: World, run: Run) -> Run:
    """Errors of scale, time base and frame rate, where they are the truth of the site.

    A wrong scale stretches lengths (speeds, heights, distances from the first station), a wrong
    time base speeds and rotations, each rock's by its own share; a low frame rate loses turns of
    fast rocks. At half of the sites one camera of two is wrong: only some of the rocks are.
    """
    effect = world.effect("measurement_error")
    if effect is None:
        return run
    q, sign, n = effect.between(*_WRONG), 1.0 if effect.seed % 2 else -1.0, len(run.rocks)
    rng = np.random.default_rng([effect.seed, 111, n])
    clock = np.clip(1.0 + 0.24 * q * rng.standard_t(4, n).clip(-3.0, 3.0), 0.4, 2.5)
    one_camera = np.random.default_rng([effect.seed, 112]).random() < 0.5
    wrong = one_camera | (rng.random(n) < 0.6)
    scale, clock = np.where(wrong, 1.0 + sign * 0.5 * q, 1.0), np.where(wrong, clock, 1.0)
    frame = world.relief.frame
    anchor = float(world.stations_s[0]) if len(world.stations_s) else 0.0
    fps = FPS * (1.0 - min(0.9, q))
    d, p, i, t = (v.copy() for v in (run.deposits, run.passages, run.impacts, run.tracks))
    x, y = d["x"].to_numpy(), d["y"].to_numpy()
    s = anchor + (frame.s(x, y) - anchor) * (1.0 + sign * 0.25 * q)
    d["x"], d["y"] = frame.xy(
        s + rng.normal(0.0, 8.0 * q, len(d)), frame.c(x, y) + rng.normal(0.0, 8.0 * q, len(d))
    )
    for table in (p, t):
        table["speed_mps"] *= (scale / clock)[table["rock"]]
        table["rotation_hz"] = _by_frames(table["rotation_hz"] / clock[table["rock"]], fps)
    p["height_m"] *= scale[p["rock"]]
    t["t_s"] *= clock[t["rock"]]
    for side in ("in", "out"):
        i[f"vt_{side}_mps"] *= (scale / clock)[i["rock"]]
        i[f"vn_{side}_mps"] *= (scale / clock)[i["rock"]]
        i[f"omega_{side}_radps"] /= clock[i["rock"]]
    return replace(run, deposits=d, passages=p, impacts=i, tracks=t)


def _by_frames(rotation: pd.Series, fps: float) -> pd.Series:
    """Rotation as counted on film: turns faster than half the frame rate appear slower."""
    return rotation.where(rotation <= 0.5 * fps, (fps - rotation).abs())


def _recorded(world: World, run: Run, campaign: int) -> Run:
    """A run as it is recorded: films clipped, contacts too light or soon, passages missed."""
    f, n = world.faults, len(run.rocks)
    rng = np.random.default_rng([world.seed, 818, campaign])
    p, i, t = run.passages, run.impacts, run.tracks
    ends = t.groupby("rock")["t_s"].max().reindex(range(n)).fillna(0.0).to_numpy()
    late = rng.random(n) < 0.5
    cut = ends * rng.uniform(0.1, 0.5, n) * (rng.random(n) < f.clipped_share)
    begin, end = np.where(late, cut, 0.0), np.where(late, ends, ends - cut)
    if f.clipped_share > 0.0:
        i, t = (v[(v["t_s"] >= begin[v["rock"]]) & (v["t_s"] <= end[v["rock"]])] for v in (i, t))
    i = merged_contacts(
        i[-i["vn_in_mps"] >= f.contact_min_normal_speed_mps], f.contact_min_interval_s
    )
    p = p[rng.random(len(p)) >= f.passages_missed_share]
    return replace(run, passages=p, impacts=i, tracks=t)


def merged_contacts(impacts: pd.DataFrame, least_s: float) -> pd.DataFrame:
    """Contacts sooner than ``least_s`` after another as one, with the turn of all of them."""
    rows = impacts.sort_values(["rock", "piece", "t_s"])
    after = ["vt_out_mps", "vn_out_mps", "omega_out_radps"]
    kept: list[dict[str, float]] = []
    for row in rows.to_dict("records"):
        first = kept[-1] if kept else {"rock": -1}
        same = all(first.get(key) == row[key] for key in ("rock", "piece"))
        if same and row["t_s"] - first["t_s"] < least_s:
            first |= {key: row[key] for key in after}
            first["turn_deg"] += row["turn_deg"]
        else:
            kept.append(row)
    return pd.DataFrame(kept, columns=impacts.columns).astype(impacts.dtypes)


# ---------------------------------------------------------------------------------------------
# Tables


def _names(world: World, table: pd.DataFrame, own: str = "") -> list[str]:
    """R7 for rocks, R7.2 for their pieces, U for blocks that nobody can attribute.

    Where observers know no names, only the rock keeps its own. A row of another block has a name to
    itself that begins with ``own``; on film ("") a block is the same from row to row.
    """
    names = []
    for k, (rock, piece, block) in enumerate(
        zip(table["rock"], table["piece"], table["block"], strict=True)
    ):
        if block == ROCK:
            names.append(f"R{rock + 1}")
        elif block == FRAGMENT and world.spec.named:
            names.append(f"R{rock + 1}.{piece}")
        elif own and not world.spec.named:
            names.append(f"U{own}{k}")
        else:
            # An odd factor permutes the numbers: they say nothing of the rock.
            names.append(f"U{(rock * 4096 + piece) * 40503 % 2**32}")
    return names


def _factor(rng: np.random.Generator, values: pd.Series | FloatArray, sd: float) -> FloatArray:
    return np.asarray(values) * np.exp(rng.normal(0.0, sd, len(values)))


def _place(rng: np.random.Generator, table: pd.DataFrame) -> dict[str, FloatArray]:
    sd = ERRORS["position_error_m"]
    return {k: table[k].to_numpy() + rng.normal(0.0, sd, len(table)) for k in "xyz"}


def _stated_release(world: World, places: FloatArray, each_rock: bool = False) -> FloatArray:
    """Release points as they are written down, with as much height above the terrain model."""
    together, each = world.faults.release_m
    frame, (x, y, z) = world.relief.frame, places.T
    apart = np.random.default_rng([world.seed, 820, len(places)]).standard_normal(len(places))
    down = together + each * apart * each_rock
    to_x, to_y = frame.xy(frame.s(x, y) + down, frame.c(x, y))
    above = z - world.survey.at(x, y)
    return np.column_stack([to_x, to_y, world.survey.at(to_x, to_y) + above])


def _rocks(world: World, rocks: Rocks, rng: np.random.Generator) -> pd.DataFrame:
    n = len(rocks)
    x, y, z = _stated_release(world, rocks.stated[:, :3], each_rock=True).T
    by_eye = np.random.default_rng([world.seed, 819, n]).normal(0.0, world.faults.axes_sd, (n, 3))
    axes = -np.sort(-rocks.axes * np.exp(by_eye), axis=1)
    return pd.DataFrame(
        {
            "rock_id": [f"R{k + 1}" for k in range(n)],
            "mass_kg": _factor(rng, rocks.volume * rocks.density, 0.01),
            "volume_m3": _factor(rng, rocks.volume, 0.01),
            **{f"semi_axis_{name}_m": axes[:, k] for k, name in enumerate("abc")},
            "density_kgm3": rocks.density,
            "x": x, "y": y, "z": z, "release_speed_mps": rocks.stated[:, 3],
        }
    )  # fmt: skip


def _stations(world: World) -> pd.DataFrame:
    table = pd.DataFrame(world.station_lines(), columns=["x0", "y0", "x1", "y1"])
    table.insert(0, "station", [f"S{k + 1}" for k in range(len(table))])
    return table


def _moving(rng: np.random.Generator, table: pd.DataFrame) -> dict[str, FloatArray]:
    return {
        "speed_mps": _factor(rng, table["speed_mps"], ERRORS["speed_error_rel"]),
        "rotation_hz": _factor(rng, table["rotation_hz"], ERRORS["rotation_error_rel"]),
    }


def _passages(world: World, run: Run, rng: np.random.Generator) -> pd.DataFrame:
    p = run.passages
    height = p["height_m"] + rng.normal(0.0, ERRORS["height_error_m"], len(p))
    return pd.DataFrame(
        {
            "rock_id": _names(world, p, "P"),
            "station": [f"S{k + 1}" for k in p["station"]],
            **_place(rng, p), **_moving(rng, p),
            "height_m": np.maximum(height.to_numpy(), 0.0),
            "mass_kg": _factor(rng, p["mass_kg"], _MASS_ERROR_REL),
        }
    )  # fmt: skip


def _deposits(world: World, run: Run, rng: np.random.Generator) -> pd.DataFrame:
    d, place, step = run.deposits, _place(rng, run.deposits), world.faults.stops_m
    if step > 0.0:
        place |= {name: step * np.round(place[name] / step) for name in "xy"}
    error = _factor(rng, np.ones(len(d)), _MASS_ERROR_REL)
    sizes = {key: d[key].to_numpy() * error for key in ("mass_kg", "volume_m3")}
    return pd.DataFrame({"rock_id": _names(world, d, "D"), **place, **sizes})


def _impacts(world: World, run: Run, rng: np.random.Generator) -> pd.DataFrame:
    i, n = run.impacts, len(run.impacts)
    table = {"rock_id": _names(world, i), "impact": i["impact"].to_numpy(), **_place(rng, i)}
    table["slope_deg"] = i["slope_deg"].to_numpy() + rng.normal(0.0, 1.0, n)
    for side in ("in", "out"):
        # Both components come from the same film: the direction is known, the length has the error.
        error = _factor(rng, np.ones(n), ERRORS["speed_error_rel"])
        table |= {key: i[key].to_numpy() * error for key in (f"vt_{side}_mps", f"vn_{side}_mps")}
        spin = f"omega_{side}_radps"
        table[spin] = _factor(rng, i[spin], ERRORS["rotation_error_rel"])
    turn = i["turn_deg"].to_numpy() + rng.normal(0.0, 1.5, n)
    table["turn_deg"] = (turn + 180.0) % 360.0 - 180.0
    table["mass_kg"] = _factor(rng, i["mass_kg"], _MASS_ERROR_REL)
    return pd.DataFrame(table)


def _trajectories(world: World, run: Run, rng: np.random.Generator) -> pd.DataFrame:
    t = run.tracks
    film = {"rock_id": _names(world, t), "t_s": t["t_s"].to_numpy()}
    return pd.DataFrame({**film, **_place(rng, t), **_moving(rng, t)})
