"""Field data as a configuration and folders of observations, with held-out rocks."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import rasterio
import rasterio.features
import shapely

from sassgis.errors import InputError, OutputError, SassgisError
from sassgis.gap.observations.case import drop_and_density
from sassgis.grid import Grid
from sassgis.inputs.config import load_config
from sassgis.inputs.observation_files import read_observations, validate_observations
from sassgis.inputs.tiles import read_terrain

#: Beside the repository.
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
#: Seed of the splits; stated, and never changed because of a result.
SEED = 2014
#: File that marks the folder of a field case.
_NOTES = "notes.txt"

Tables = Mapping[str, pd.DataFrame]


@dataclass(frozen=True)
class FieldCase:
    """Files of one field case.

    Attributes
    ----------
    observations : mapping
        Folder of each set: "all", and for each split the fitted and the held-out rocks.
    splits : mapping of name to (str, str)
        Names of its two sets; without the second nothing is scored.
    notes : tuple of str
        Rows left out and decisions while reading.
    """

    name: str
    config: Path
    observations: Mapping[str, Path]
    splits: Mapping[str, tuple[str, str]]
    notes: tuple[str, ...]

    def pair(self, side: str) -> tuple[Path, Path]:
        """The configuration, and a set of observations."""
        return self.config, self.observations[side]


def in_one_line(main: Callable[[], None]) -> None:
    """Run a pipeline.

    Raises
    ------
    SystemExit
        With one line, if an input cannot be used or an output cannot be written.
    """
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None


def parser(doc: str | None) -> argparse.ArgumentParser:
    """Arguments that all field cases take."""
    made = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    made.add_argument("data", type=Path, nargs="?", default=DATA, help="folder of the field data")
    made.add_argument("-o", "--output", type=Path, required=True)
    made.add_argument("--jobs", type=int, default=1)
    made.add_argument("--seed", type=int, default=1986)
    made.add_argument("--case-only", action="store_true", help="write the case without a diagnosis")
    return made


def field_file(data: Path, folder: str, file: str) -> Path:
    """A file of the field data.

    Raises
    ------
    InputError
        If it is not there.
    """
    path = data / folder / file
    if not path.is_file():
        raise InputError(
            "the field data are not here",
            file=path,
            field="data",
            expected=f"a folder that holds {folder}/{file}",
        )
    return path


def fresh(folder: Path) -> Path:
    """An empty folder for the results.

    Raises
    ------
    OutputError
        If it is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise OutputError(f"{folder}: is not empty; expected an empty folder")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def split_in_two(strata: Mapping[str, str], seed: int = SEED) -> tuple[list[str], list[str]]:
    """Rocks to fit and rocks to score, as close to half of each stratum as possible.

    Parameters
    ----------
    strata : mapping of rock to stratum

    Returns
    -------
    fit, left_out : list of str
        In the order of the mapping. Odd ones are assigned to either side in turn.
    """
    rng = np.random.default_rng(seed)
    chosen: set[str] = set()
    spare = 0
    for stratum in sorted(set(strata.values())):
        names = [r for r, s in strata.items() if s == stratum]
        take, odd = divmod(len(names), 2)
        if odd:
            take += spare == 0
            spare = 1 - spare
        chosen.update(rng.permutation(names)[:take].tolist())
    return [r for r in strata if r in chosen], [r for r in strata if r not in chosen]


def write_tables(folder: Path, tables: Tables, metadata: Mapping[str, object]) -> Path:
    """Tables of observations as CSV files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in tables.items():
        frame.to_csv(folder / f"{name}.csv", index=False, float_format="%.10g")
    rows = pd.DataFrame({"key": list(metadata), "value": list(metadata.values())})
    rows.to_csv(folder / "metadata.csv", index=False)
    return folder


def write_case(
    name: str,
    out: Path,
    config: str,
    tables: Tables,
    metadata: Mapping[str, object],
    splits: Mapping[str, tuple[Sequence[str], Sequence[str]]],
    notes: Sequence[str],
) -> FieldCase:
    """Write configuration and observations, and check them.

    Raises
    ------
    InputError
        If the check finds an error in them.
    """
    (out / _NOTES).write_text("\n".join(notes) + "\n", encoding="utf-8")
    file = out / "config.toml"
    file.write_text(config, encoding="utf-8")
    sets = {"all": write_tables(out / "observed", tables, metadata)}
    names = {}
    for key, sides in splits.items():
        names[key] = (f"{key}_fit", f"{key}_left_out")
        for side, rocks in zip(names[key], sides, strict=True):
            own = {
                name: frame[frame["rock_id"].isin(set(rocks))] if "rock_id" in frame else frame
                for name, frame in tables.items()
            }
            sets[side] = write_tables(out / f"observed_{side}", own, metadata)
    case = FieldCase(name, file, sets, names, tuple(notes))
    check(case)
    return case


def terrain_of(config: Path) -> Grid:
    """The terrain model of a configuration."""
    settings = load_config(config)
    terrain = settings.terrain
    return read_terrain(settings.dem_source, terrain.crs, terrain.vertical_datum)


def check(case: FieldCase) -> None:
    """Check the observations.

    Raises
    ------
    InputError
        If there is an error in them.
    """
    grid, of_blocks = terrain_of(case.config), drop_and_density(load_config(case.config).blocks)
    for folder in case.observations.values():
        read = read_observations(folder, grid, *of_blocks)
        for finding in validate_observations(read, grid, *of_blocks):
            if finding.level == "error":
                raise InputError(f"observations do not pass the check: {finding}", file=folder)


def write_dem(source: Path, target: Path, within: shapely.Geometry | None = None) -> None:
    """A terrain model as GeoTIFF; cells outside an area have no height."""
    with rasterio.open(source) as read:
        profile = {**read.profile, "driver": "GTiff", "compress": "deflate"}
        heights = read.read()
        if within is not None:
            outside = rasterio.features.geometry_mask([within], heights.shape[1:], read.transform)
            heights[:, outside] = read.nodata
    with rasterio.open(target, "w", **profile) as written:
        written.write(heights)


def write_areas(
    target: Path, areas: Mapping[str, shapely.Geometry], crs: str | None, **columns: Sequence[str]
) -> None:
    """Release areas as GeoPackage, with further columns."""
    import warnings

    import geopandas as gpd

    with warnings.catch_warnings():
        # Local coordinates have no system to state.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        rows = {"name": list(areas), **columns}
        frame = gpd.GeoDataFrame(rows, geometry=list(areas.values()), crs=crs)
        frame.to_file(target)


def write_json(file: Path, results: Mapping[str, Any]) -> None:
    """Plain values, numbers to four digits."""
    file.write_text(json.dumps(_plain(results), indent=1) + "\n", encoding="utf-8")


def _plain(item: Any) -> Any:
    """Plain values, numbers to four digits: more would be noise."""
    if isinstance(item, Mapping):
        return {str(k): _plain(v) for k, v in item.items()}
    if isinstance(item, np.ndarray):
        return _plain(item.tolist())
    if isinstance(item, list | tuple):
        return [_plain(v) for v in item]
    if isinstance(item, float | np.floating):
        return float(f"{item:.4g}") if np.isfinite(item) else None
    return int(item) if isinstance(item, np.integer) else item
