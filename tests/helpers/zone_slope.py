"""Slopes on which zones are made, small enough to be counted rock by rock."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import rasterio
import shapely
from rasterio.transform import from_origin

from sassgis.hazard.assess import Assessment, Rules
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_rules
from sassgis.runs.resumable_run import Job, Simulation, Workplace, configured, read_job
from sassgis.runs.run import assessed, prepared, zone_simulation
from sassgis.settings.hazard_rules import HazardCurves
from sassgis.settings.map_run import Config
from sassgis.simulation.workers import OnProgress

WEST, NORTH, CELL = 2_700_000.0, 1_150_000.0, 2.0
CRS = "EPSG:2056"


def plane(rows: int = 21, cols: int = 90, slope_deg: float = 40.0) -> np.ndarray:
    """A plane that falls to the east."""
    fall = np.tan(np.radians(slope_deg)) * CELL * np.arange(cols)
    return np.broadcast_to(1500.0 - fall, (rows, cols)).copy()


def gully(rows: int = 70, cols: int = 90) -> np.ndarray:
    """A slope of 40 degrees above one of 6 degrees, hollow towards the middle row."""
    x, y = CELL * np.arange(cols), CELL * (np.arange(rows) - 0.5 * rows)
    foot = 0.65 * CELL * cols
    fall = np.tan(np.radians(40.0)) * np.minimum(x, foot)
    fall += np.tan(np.radians(6.0)) * np.maximum(x - foot, 0.0)
    return 1500.0 - fall[None, :] + 0.012 * y[:, None] ** 2


def place(col: float, row: float) -> tuple[float, float]:
    """Coordinates of a position in cells, counted from the north-western corner."""
    return WEST + CELL * col, NORTH - CELL * row


def box(col: float, row: float, cols: float, rows: float) -> shapely.Polygon:
    """So many cells east and south of a position."""
    (west, north), (east, south) = place(col, row), place(col + cols, row + rows)
    return shapely.box(west, south, east, north)


#: A block of each scenario; semi-axes in metres.
FREQUENT = {"name": "frequent", "axis_1_m": [0.2, 0.4], "axis_2_m": 0.25, "axis_3_m": 0.2}
RARE = {"name": "rare", "axis_1_m": [0.6, 0.9], "axis_2_m": 0.6, "axis_3_m": 0.5}

LOSSES = {"building": (0.01, 0.1, 0.5), "people": (0, 0, 0)}
DEATHS = {"building": 0.1, "people": 0.4, "road": 0, "vehicle": 0.2, "line": 0}


def vulnerable(*kinds: str) -> str:
    """Rows of a table of vulnerability."""
    return "".join(
        f"{kind},{intensity},{loss},{DEATHS[kind]},invented\n"
        for kind in kinds
        for intensity, loss in zip(
            ("low", "mean", "high"), LOSSES.get(kind, (0.1, 0.4, 0.9)), strict=True
        )
    )


VULNERABILITY = "kind,intensity,vulnerability,lethality,source\n" + vulnerable(*LOSSES)
#: Numbers of a house.
HOUSE = {"value": 4e5, "persons": 2.0, "presence": 0.5}


def toml(value: object) -> str:
    """A value as TOML writes it."""
    return json.dumps(value, ensure_ascii=False)


@dataclass
class Case:
    """A configuration and its files."""

    folder: Path
    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    blocks: list[dict[str, Any]] = field(default_factory=list)
    lists: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    @property
    def config(self) -> Path:
        return self.folder / "config.toml"

    def write(self) -> Path:
        """Write the configuration."""
        lines = []
        for name, keys in self.sections.items():
            lines += [f"[{name}]", *(f"{k} = {toml(v)}" for k, v in keys.items()), ""]
        for name, items in {"blocks": self.blocks, **self.lists}.items():
            for item in items:
                lines += [f"[[{name}]]", *(f"{k} = {toml(v)}" for k, v in item.items()), ""]
        self.config.write_text("\n".join(lines), encoding="utf-8")
        return self.config

    def set(self, dotted: str, value: object) -> Case:
        """Set a key and write the configuration; None takes it out."""
        section, key = dotted.split(".")
        keys = self.sections.setdefault(section, {})
        keys.pop(key, None)
        if value is not None:
            keys[key] = value
        self.write()
        return self

    def write_dem(self, heights: np.ndarray, crs: str | None = CRS) -> None:
        with rasterio.open(
            self.folder / "dem.tif", "w", driver="GTiff", count=1, dtype="float64", crs=crs,
            height=heights.shape[0], width=heights.shape[1], nodata=-9999.0,
            transform=from_origin(WEST, NORTH, CELL, CELL),
        ) as raster:  # fmt: skip
            raster.write(np.where(np.isfinite(heights), heights, -9999.0), 1)

    def write_layer(
        self,
        name: str,
        shapes: Sequence[Any],
        columns: Mapping[str, Sequence[object]] | None = None,
        crs: str | None = CRS,
    ) -> None:
        """Write shapes with attributes to a GeoPackage."""
        file = self.folder / name
        file.unlink(missing_ok=True)
        gpd.GeoDataFrame(dict(columns or {}), geometry=list(shapes), crs=crs).to_file(
            file, driver="GPKG"
        )

    def expose(
        self,
        name: str,
        kind: str,
        objects: Mapping[str, Any],
        columns: Mapping[str, Sequence[object]] | None = None,
        **keys: object,
    ) -> None:
        """Exposed objects by their names in a layer of their own, and how vulnerable they are.

        ``columns`` are further ones of the layer, each read as a number of its objects.
        """
        own = {"name": name, "kind": kind, "file": f"{name}.gpkg", "name_field": "name"}
        own |= {f"{column}_field": column for column in columns or {}}
        attributes = {"name": list(objects), **(columns or {})}
        self.write_layer(f"{name}.gpkg", list(objects.values()), attributes)
        self.lists.setdefault("objects", []).append({**own, **keys})
        rest = vulnerable("road", "vehicle", "line").rstrip()
        self.write_text("vulnerability.csv", VULNERABILITY + rest)
        self.sections["risk"] = {"vulnerability": "vulnerability.csv"}

    def write_text(self, name: str, *lines: str) -> None:
        (self.folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def two_areas(folder: Path, **settings: Mapping[str, Any]) -> Case:
    """Two release areas on both sides of a gully, two block scenarios."""
    case = Case(
        folder,
        {
            "terrain": {"dem": "dem.tif"},
            "release": {
                "file": "release.gpkg", "name_field": "name", "spacing_m": 6.0,
                "rocks_per_point": 4,
            },
            "ground": {"default": "debris"},
            "hazard": {"ref_width_m": 2.0},
            "zones": {},
            "run": {"seed": 5, "jobs": 1},
        },
        [{**FREQUENT, "onset_frequency": 0.4}, {**RARE, "onset_frequency": 0.03}],
    )  # fmt: skip
    for name, keys in settings.items():
        case.sections.setdefault(name, {}).update(keys)
    case.write_dem(gully())
    case.write_layer(
        "release.gpkg",
        [box(4.0, 20.0, 8.0, 9.0), box(5.0, 41.0, 7.0, 9.0)],
        {"name": ["north", "south"]},
    )
    case.write()
    return case


@dataclass(frozen=True)
class Zoned:
    """What zoning finds, without the files."""

    job: Job
    rules: Rules
    done: Simulation
    found: Assessment

    @property
    def curves(self) -> HazardCurves:
        return self.found.hazard.curves

    def rate(self, energy_kj: float) -> np.ndarray:
        """Rate of every cell of the map at an energy."""
        out = np.zeros(self.done.run.grid.values.size)
        out[self.curves.places] = self.curves.rate[:, self.curves.column(energy_kj)]
        return out


def zoned(
    config: Config | Path,
    work: Path,
    *,
    areas: Sequence[str] | None = None,
    seed: int | None = None,
    jobs: int = 1,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] = lambda _text: None,
) -> Zoned:
    """Zoning as the command does it, apart from maps, figures and report."""
    config = configured(load_config(config) if isinstance(config, Path) else config, seed)
    job = read_job(config, areas, say)
    rules = read_rules(config, job.run)
    job = prepared(job, rules)
    work.mkdir(parents=True, exist_ok=True)
    done = zone_simulation(job, rules, Workplace(work, jobs, on_progress, say))
    return Zoned(job, rules, done, assessed(rules, done))
