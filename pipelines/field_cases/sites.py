"""Sites with observed stops as folders of a user: configuration, release, terrain, observations."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from field_cases.tables import (
    SEED,
    FieldCase,
    field_file,
    split_in_two,
    write_areas,
    write_case,
    write_dem,
)
from sassgis.grid import FloatArray
from sassgis.inputs.config import load_config
from sassgis.inputs.tiles import read_terrain
from sassgis.runs.run import run
from sassgis.settings.results import StopReason
from sassgis.terrain.release import points_in_polygon

#: Lines of the configuration by section.
Sections = Mapping[str, str]

#: Tschamut: the terrain is known this far beyond the tracks (m), further out it is a plane.
BEYOND_M = 10.0
TSCHAMUT_BLOCKS = {1: "St. Leonard", 2: "heaviest", 4: "plate"}
#: Tschamut: release places, by the least x of each; within one, positions scatter by a metre.
PLACES_M = (0.0, 17.5, 25.0, 32.0, 45.0)
#: Tschamut: plan distance of the stations from the mean release, half of their length, and error
#: of the positions in time (m); heights of the contacts above those of the terrain model (m).
STATIONS_M, HALF_STATION_M = (20.0, 40.0, 60.0), 60.0
CONTACT_ERROR_M, CONTACT_DATUM_M = 0.3, 1600.0
#: Authume: the substratum zones, read as ground classes by their description; the slope has the
#: first code. Cells without one are hard ground, as in the quarry around them.
AUTHUME_ZONES = {1: "overgrown_slope", 2: "rock", 3: "debris"}
SLOPE_ZONE = 1
AUTHUME = "authume_quarry_p1"
QUARRY_DEM = "derived_dtm_0p5m_local.tif"
QUARRY_ZONES = "derived_substratum_zones_0p5m_local.tif"
#: Distance of the release points in the square of release (m).
SPACING_M = 1.0
#: Authume: limestone; the mass of a rock cancels out of its motion.
DENSITY_KGM3 = 2600.0
AXES = [f"semi_axis_{c}_m" for c in "abc"]
STOP = ["x_stop", "y_stop"]


@dataclass(frozen=True)
class Site:
    """A site and the stops that were observed on it.

    Attributes
    ----------
    case : FieldCase
        Its files. Each rock is a release area of its own.
    slope : str
        Class of the ground below the release.
    rocks : DataFrame
        Of each rock: ``rock_id``, ``x`` and ``y`` of the release (of the middle of the square where
        single ones are unknown), ``x_stop``, ``y_stop``, ``mass_kg``, ``label`` of the group of
        which each half holds as many, ``place`` of release.
    points : int
        Release points of each rock.
    """

    case: FieldCase
    slope: str
    rocks: pd.DataFrame
    points: int

    @property
    def name(self) -> str:
        """As the configuration has it."""
        return self.case.name

    def __len__(self) -> int:
        return len(self.rocks)

    @property
    def release(self) -> FloatArray:
        """Plan positions, shape (n, 2) (m)."""
        return self.rocks[["x", "y"]].to_numpy(float)

    @property
    def stops(self) -> FloatArray:
        """Observed plan positions, shape (n, 2) (m)."""
        return self.rocks[STOP].to_numpy(float)

    @property
    def groups(self) -> dict[str, str]:
        """Label of each rock."""
        return dict(zip(self.rocks["rock_id"], self.rocks["label"], strict=True))

    def numbers(self, side: str) -> list[int]:
        """Rows of the rocks of a set of observations."""
        names = set(pd.read_csv(self.case.observations[side] / "rocks.csv")["rock_id"])
        return [i for i, name in enumerate(self.rocks["rock_id"]) if name in names]

    def take(self, rocks: list[int]) -> Site:
        """The same site with some of the rocks."""
        return replace(self, rocks=self.rocks.iloc[rocks])


def tschamut(
    data: Path,
    out: Path,
    slope: str = "soft_meadow",
    divisions: int = 1,
    more: Sections | None = None,
) -> Site:
    """Write the runs of Tschamut 2014, each from where it was released.

    Parameters
    ----------
    data, out : Path
        Folder of the field data; folder to write.
    slope : str
        Class of the slope.
    divisions : int
        Random divisions into halves whose observations are written.
    more : mapping, optional
        Further lines of the configuration.
    """
    folder = "tschamut2014"
    release = pd.read_csv(field_file(data, folder, "release_points.csv"))
    ends = pd.read_csv(field_file(data, folder, "observed_deposition.csv"))
    sizes = pd.read_csv(field_file(data, folder, "block_metadata.csv")).set_index("block_id")
    runs = release.merge(ends, on="trajectory_id", suffixes=("", "_stop"), validate="1:1")
    same = runs.duplicated(["x_m", "y_m", "x_m_stop", "y_m_stop"])
    copies = runs.loc[same, "trajectory_id"].tolist()
    runs = runs[~same].reset_index(drop=True)
    half = np.sort(sizes[["size_x_m", "size_y_m", "size_z_m"]].to_numpy() / 2.0, axis=1)[:, ::-1]
    rocks = pd.DataFrame(
        {"rock_id": runs["trajectory_id"], "x": runs["x_m"], "y": runs["y_m"],
         "x_stop": runs["x_m_stop"], "y_stop": runs["y_m_stop"], "mass_kg": runs["mass_kg"],
         "label": runs["block_id"].map(TSCHAMUT_BLOCKS),
         "place": np.searchsorted(PLACES_M, runs["x_m"]) - 1}
    )  # fmt: skip
    rocks[AXES] = pd.DataFrame(half, index=sizes.index).loc[runs["block_id"]].to_numpy()
    rocks["density_kgm3"] = rocks["mass_kg"] / (4.0 / 3.0 * np.pi * rocks[AXES].prod(axis=1))
    away = rocks[["x", "y"]] - rocks.groupby("place")[["x", "y"]].transform("mean")
    scatter = float(np.sqrt((away.to_numpy() ** 2).sum() / (2 * (len(rocks) - len(PLACES_M)))))
    points = rocks[["x", "y"]].to_numpy(float)
    tracks = shapely.MultiPoint(np.vstack([points, rocks[STOP]])).convex_hull.buffer(BEYOND_M)
    write_dem(field_file(data, folder, "terrain.asc"), out / "dem.tif", tracks)
    notes = [
        f"{len(release)} runs; left out as exact copies of another run: {copies}",
        f"{rocks['label'].value_counts().to_dict()} runs of each block",
        f"positions at a release place scatter by {scatter:.2f} m: stated as position_error_m",
        "heights of releases are taken from the terrain, release speeds are first samples: not "
        "used",
        "density: the weighed mass over the volume of the ellipsoid of the measured axes",
        f"ground by its description (not in the data): {slope} everywhere",
    ]
    plate = rocks["label"] == "plate"
    of_plate = {"plate": tuple(rocks.loc[own, "rock_id"].tolist() for own in (~plate, plate))}
    meta, tables = {"position_error_m": round(scatter, 2)}, {}
    if (file := data / folder / "contacts.csv").is_file():
        tables, noted = contacts_at_tschamut(file, rocks)
        meta = {"position_error_m": CONTACT_ERROR_M, "stop_error_m": round(scatter, 2)}
        notes += noted
    return written(
        "Tschamut",
        out,
        joined({"terrain": 'dem = "dem.tif"', "ground": f'default = "{slope}"'}, more or {}),
        slope,
        rocks,
        [shapely.Point(*xy) for xy in points],
        halves(rocks, divisions) | of_plate,
        meta,
        notes,
        tables,
    )


def contacts_at_tschamut(
    file: Path, rocks: pd.DataFrame
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Contacts of the runs, and stations across their mean direction; what was left out."""
    read = pd.read_csv(file)
    own = read[read["test"].isin(rocks["rock_id"])]
    early, lost = own["end_s"] < own["start_s"], own[["x", "y", "z"]].isna().any(axis=1)
    turns = own[["rot_before", "rot_after"]] / (2.0 * np.pi)
    # A row stays for its contact: left out whole, two hops would be taken for a long one.
    contacts = pd.DataFrame(
        {"rock_id": own["test"], "t_start_s": own["start_s"],
         "t_end_s": own["end_s"].mask(early), "x": own["x"], "y": own["y"],
         "z": own["z"] - CONTACT_DATUM_M, "rotation_before_hz": turns["rot_before"],
         "rotation_after_hz": turns["rot_after"]}
    )  # fmt: skip
    points, stops = rocks[["x", "y"]].to_numpy(float), rocks[STOP].to_numpy(float)
    ahead = mean_direction(points, stops)
    middle = points.mean(axis=0) + np.array(STATIONS_M)[:, None] * ahead
    aside = HALF_STATION_M * np.array([-ahead[1], ahead[0]])
    stations = pd.DataFrame(np.hstack([middle + aside, middle - aside]))
    stations.columns = ["x0", "y0", "x1", "y1"]
    stations.insert(0, "station", [f"{at:.0f} m" for at in STATIONS_M])
    notes = [
        f"{len(own)} contacts of {own['test'].nunique()} runs; left out: "
        f"{len(read) - len(own)} of other runs, the end of {int(early.sum())} that would be before "
        f"its start, the place of {int(lost.sum())} that have none",
        f"errors of positions in time: {CONTACT_ERROR_M} m; the scatter at a release place is "
        "stated as stop_error_m",
        f"stations: {', '.join(stations['station'])} from the mean release, across the mean "
        "direction",
    ]
    return {"contacts": contacts, "stations": stations}, notes


def authume(
    data: Path,
    out: Path,
    slope: str = AUTHUME_ZONES[SLOPE_ZONE],
    divisions: int = 1,
    more: Sections | None = None,
) -> Site:
    """Write the blocks of position P1, released somewhere in a square above the quarry.

    Arguments are those of tschamut. The data state no licence: terrain and zones are read from
    their folder.
    """
    folder = AUTHUME
    ends = np.loadtxt(field_file(data, folder, "Endpoints_P1.txt"), ndmin=2)
    corners = np.loadtxt(field_file(data, folder, "positions_P1.xyz"), ndmin=2)
    mass = ends[:, 3]
    # Y is the vertical. The heights of the stops lie 2.9 m above the terrain: not used.
    square = corners[:, [0, 2]]
    middle = square.mean(axis=0)
    rocks = pd.DataFrame(
        {"rock_id": [f"P1-{i + 1:02d}" for i in range(len(ends))], "x": middle[0], "y": middle[1],
         "x_stop": ends[:, 0], "y_stop": ends[:, 2], "mass_kg": mass,
         "label": np.where(mass > np.median(mass), "heavy", "light"), "place": 0}
    )  # fmt: skip
    rocks[AXES] = np.sort(ends[:, 4:7], axis=1)[:, ::-1] / 2.0
    rocks["density_kgm3"] = DENSITY_KGM3
    grid = read_terrain(field_file(data, AUTHUME, QUARRY_DEM), "local")
    x, y = grid.cell_centres(np.arange(grid.values.size))
    (west, south), (east, north) = square.min(axis=0), square.max(axis=0)
    under = grid.values.ravel()[(x >= west) & (x <= east) & (y >= south) & (y <= north)]
    height = corners[:, 1].mean() - float(rocks[AXES[2]].median())
    drop = [max(float(height - under.max()), 0.0), float(height - under.min())]
    notes = [
        f"{len(ends)} stops; their heights lie 2.9 m above the terrain: not used",
        "release points of single rocks are not known: each may start anywhere in the square",
        "semi-axes: half of the measured boxes; the ellipsoid is lighter than the rock as weighed",
        f"ground by its description: {', '.join(_classes(slope).values())}",
    ]
    return written(
        "Authume",
        out,
        joined({**quarry(data, slope), "blocks": f"drop_m = {drop}"}, more or {}),
        slope,
        rocks,
        [shapely.MultiPoint(square).convex_hull] * len(rocks),
        halves(rocks, divisions),
        {"position_error_m": 0.5},
        notes,
    )


def quarry(data: Path, slope: str) -> Sections:
    """Terrain and ground at Authume, read from the folder of the data."""
    dem, zones = (field_file(data, AUTHUME, f).resolve() for f in (QUARRY_DEM, QUARRY_ZONES))
    classes = ", ".join(f"{code} = {json.dumps(own)}" for code, own in _classes(slope).items())
    return {
        "terrain": f"dem = {json.dumps(str(dem))}",
        "ground": f'default = "rock"\nfile = {json.dumps(str(zones))}\n'
        f"raster_classes = {{ {classes} }}",
    }


def _classes(slope: str) -> dict[int, str]:
    """Ground classes at Authume by their code, with that of the slope."""
    return {**AUTHUME_ZONES, SLOPE_ZONE: slope}


def joined(lines: Sections, more: Sections) -> dict[str, str]:
    """Lines of both, by section."""
    return {
        section: "\n".join(of[section] for of in (lines, more) if section in of)
        for section in dict.fromkeys([*lines, *more])
    }


def halves(rocks: pd.DataFrame, divisions: int) -> dict[str, tuple[list[str], list[str]]]:
    """Random divisions into a half to fit on and one to score, with as many of each label."""
    strata = dict(zip(rocks["rock_id"], rocks["label"], strict=True))
    names = ["halves", *(f"halves_{k + 1}" for k in range(1, divisions))]
    return {name: split_in_two(strata, SEED + k) for k, name in enumerate(names)}


def written(
    name: str,
    out: Path,
    sections: Sections,
    slope: str,
    rocks: pd.DataFrame,
    areas: list[shapely.Geometry],
    splits: Mapping[str, tuple[list[str], list[str]]],
    meta: Mapping[str, object],
    notes: list[str],
    more: Mapping[str, pd.DataFrame] | None = None,
) -> Site:
    """Write a site: a release area for each rock, a scenario for each block.

    ``meta``: metadata of the observations; ``more``: tables beside rocks and deposits.
    """
    scenario = rocks.groupby([*AXES, "density_kgm3"])["rock_id"].transform("first").tolist()
    places = dict(zip(rocks["rock_id"], areas, strict=True))
    write_areas(out / "release.gpkg", places, None, scenario=scenario)
    lines = {
        "project": f'name = "{name}"',
        "terrain": 'crs = "local"',
        "release": 'file = "release.gpkg"\nname_field = "name"\nscenario_field = "scenario"\n'
        f"spacing_m = {SPACING_M}",
        "output": 'rock_table = "csv"\npaths_max = 0',
    }
    text = []
    for section, own in joined(lines, sections).items():
        if section != "blocks":
            text.append(f"[{section}]\n{own}\n")
    block = sections.get("blocks", "")
    for row in rocks[rocks["rock_id"] == scenario].to_dict("records"):
        axes = "\n".join(f"axis_{k + 1}_m = {row[axis]!r}" for k, axis in enumerate(AXES))
        text.append(
            f'[[blocks]]\nname = "{row["rock_id"]}"\n{axes}\n'
            f"density_kgm3 = {row['density_kgm3']!r}\n{block}\n"
        )
    measured = ["x", "y", "density_kgm3"] if areas[0].geom_type == "Point" else []
    tables = {
        "rocks": rocks[["rock_id", *measured, "mass_kg", *AXES]],
        "deposits": rocks[["rock_id", *STOP, "mass_kg"]].rename(
            columns=dict(zip(STOP, "xy", strict=True))
        ),
        **(more or {}),
    }
    case = write_case(name, out, "\n".join(text), tables, meta, splits, notes)
    # All rocks of a site are released from a point each, or from the same square.
    points = 1 if measured else len(points_in_polygon(areas[0], SPACING_M)[0])
    return Site(case, slope, rocks, points)


@dataclass(frozen=True)
class Simulated:
    """Stops of a site's rocks, simulated.

    Attributes
    ----------
    stops : float64, shape (n, m, 2)
        Of m simulations of each rock (m); of those that left the terrain, its edge.
    left : bool, shape (n, m)
        Whether they left the terrain.
    started : bool, shape (n, m)
    """

    stops: FloatArray
    left: NDArray[np.bool_]
    started: NDArray[np.bool_]

    def take(self, rocks: list[int]) -> Simulated:
        """The simulations of some of the rocks."""
        return Simulated(self.stops[rocks], self.left[rocks], self.started[rocks])


def simulated(
    site: Site,
    out: Path,
    count: int,
    settings: Mapping[str, object] | None = None,
    config: Path | None = None,
) -> Simulated:
    """``sassgis run`` of a site, and where its rocks stop.

    Parameters
    ----------
    out : Path
        For the result of the run.
    count : int
        Simulations of each rock, about.
    settings : mapping of key to value, optional
        In place of those of the configuration.
    config : Path, optional
        In place of that of the site, with the same releases.
    """
    each = {"release.rocks_per_point": max(1, round(count / site.points)), **(settings or {})}
    run(load_config(config or site.case.config, each), out, overwrite=True)
    table = pd.read_csv(out / "tables" / "rocks.csv").set_index("area")
    own = [table.loc[[name]] for name in site.rocks["rock_id"]]
    reason = np.array([rows["reason"] for rows in own])
    return Simulated(
        np.array([rows[["x_m", "y_m"]].to_numpy(float) for rows in own]),
        reason == StopReason.LEFT_PROFILE.name.lower(),
        reason != StopReason.NEVER_STARTED.name.lower(),
    )


def mean_direction(release: FloatArray, stops: FloatArray) -> FloatArray:
    """Unit vector of the mean direction in plan from releases to stops, each of shape (n, 2)."""
    away = stops - release
    ahead: FloatArray = (away / np.linalg.norm(away, axis=1)[:, None]).mean(axis=0)
    return ahead / np.linalg.norm(ahead)


def run_out(site: Site, stops: FloatArray) -> FloatArray:
    """Plan distance and offset from the mean direction of the observed stops (m).

    Parameters
    ----------
    stops : float64, shape (n, ..., 2)

    Returns
    -------
    float64, shape (n, ..., 2)
        Run-out, and offset, positive to the right.
    """
    ahead = mean_direction(site.release, site.stops)
    start = site.release.reshape(len(site), *[1] * (stops.ndim - 2), 2)
    d = stops - start
    return np.stack(
        [np.hypot(d[..., 0], d[..., 1]), d[..., 0] * ahead[1] - d[..., 1] * ahead[0]], axis=-1
    )
