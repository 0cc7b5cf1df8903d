"""Field observations from a GeoPackage or a folder of CSV files.

Unusable values are excluded and reported row by row; reading fails only where nothing remains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd

from sassgis.errors import InputError, notice, shown
from sassgis.files.gdal_safety import layers_of, read_frame, vector_file
from sassgis.files.plain_file import read_text
from sassgis.gap.constants import DENSITY_KGM3
from sassgis.gap.observations.checks import check_observations, empty_tables
from sassgis.gap.observations.observed import ObservationFinding, Observations, without
from sassgis.gap.observations.projection import with_passages
from sassgis.gap.observations.tables import TABLES, Metadata, Table
from sassgis.grid import Grid
from sassgis.inputs.csv_table import csv_cells
from sassgis.inputs.observation_values import KEY, RawTable, metadata_of, table_of
from sassgis.inputs.vector_features import nearest
from sassgis.settings.schema import InMemory, Input

#: A GeoPackage, a folder of CSV files, or DataFrames by the name of the table.
AnyObservations = str | Path | Mapping[str, Any]

_METADATA = "metadata"
#: Tables that are not about rocks: of a GeoPackage, and what a template says of a campaign.
_FOREIGN = frozenset({"layer_styles", "run_metadata", "power"})


def observation_source(given: AnyObservations) -> Path | dict[str, InMemory]:
    """Return a path, or tables in memory by their names; InputError for anything else."""
    if not isinstance(given, Mapping | str | PathLike):
        raise InputError(
            "cannot be used", field=KEY, found=type(given).__name__,
            expected="a GeoPackage, a folder of CSV files, or DataFrames by name",
        )  # fmt: skip
    if not isinstance(given, Mapping):
        return Path(given)
    from sassgis.inputs.in_memory import as_input

    tables: dict[str, InMemory] = {}
    for name, table in given.items():
        own = as_input(table, f"{KEY}.{name}")
        if not isinstance(own, InMemory) or own.kind != "table":
            raise InputError(
                "is no table", field=f"{KEY}.{name}", found=type(table).__name__,
                expected="a DataFrame",
            )  # fmt: skip
        tables[name] = own
    return tables


def read_observations(
    path: AnyObservations,
    grid: Grid | None = None,
    drop_m: float = 0.0,
    density_kgm3: float = DENSITY_KGM3,
) -> Observations:
    """Read observations, check them, and leave out what cannot be used; each finding is a notice.

    Parameters
    ----------
    path
        A GeoPackage, a folder of CSV files, or DataFrames by name; with tables named as in
        ``sassgis.gap.observations.tables.TABLES``, and ``metadata``. Any of them may be missing.
    grid
        The DEM. Geometries are brought into its coordinates, and all is compared with it.
    drop_m
        Height above the ground from which blocks were released, at most.
    density_kgm3
        Of rocks of which it was not observed.

    Raises
    ------
    InputError
        If there is no such file or folder, it cannot be read, it holds no table of observations
        with rows, or no table with places lies on the DEM.
    """
    source = observation_source(path)
    path = source if isinstance(source, Path) else Path(KEY)
    findings: list[ObservationFinding] = []
    raws, metadata = _raw_tables(source, findings)
    tables: dict[str, Table] = {}
    failed: list[InputError] = []
    for name, raw in raws.items():
        try:
            tables[name] = table_of(raw, grid)
        except InputError as error:
            failed.append(error)
            found, expected = str(error.found or ""), error.expected or ""
            raw.note(error.problem, found=found, expected=expected, left_out="table")
    observations = Observations(
        **tables,  # type: ignore[arg-type]
        metadata=metadata_of(metadata) if metadata else Metadata(),
        files={name: raw.file for name, raw in raws.items()},
    )
    findings += empty_tables(observations, [r for r in raws if r in tables])
    checked = check_observations(observations, grid, drop_m, density_kgm3)
    hopeless = [f for f in findings if f.problem == "holds no observed rock"]
    if hopeless and failed:
        raise failed[0]
    _refuse_elsewhere(observations, checked, path)
    if hopeless:
        first = hopeless[0]
        raise InputError(first.problem, file=path, found=first.found, expected=first.expected)
    # What was left out while reading is gone already: only its record is kept.
    observations = replace(observations, findings=tuple(findings))
    observations = with_passages(without(observations, checked))
    for finding in observations.findings:
        notice(str(finding).partition(": ")[2], finding.level)
    return observations


def validate_observations(
    observations: Observations,
    grid: Grid | None = None,
    drop_m: float = 0.0,
    density_kgm3: float = DENSITY_KGM3,
) -> list[ObservationFinding]:
    """Collect findings on observations, as read or made by a program; errors come first.

    Without the DEM, nothing is compared with the terrain.
    """
    checked = check_observations(observations, grid, drop_m, density_kgm3)
    fresh = [f for f in checked if f not in observations.findings]
    # Leaving values out must not turn into new findings of the same kind.
    known = {(f.problem, f.table, f.column) for f in observations.findings}
    fresh = [f for f in fresh if (f.problem, f.table, f.column) not in known]
    return sorted((*observations.findings, *fresh), key=lambda f: f.level != "error")


def _refuse_elsewhere(
    observations: Observations, checked: Sequence[ObservationFinding], path: Path
) -> None:
    """Raise InputError where every table that has places lies outside the DEM."""
    beside = {f.table: f for f in checked if f.problem.startswith("no row lies on the DEM")}
    placed = {name for name, columns in observations.present.items() if {"x", "y"} <= columns}
    if placed and placed <= set(beside):
        first = beside[sorted(placed, key=list(TABLES).index)[0]]
        raise InputError(
            first.problem, file=first.file or path, field=first.table, found=first.found,
            expected=first.expected,
        )  # fmt: skip


def _raw_tables(
    source: Path | Mapping[str, InMemory], findings: list[ObservationFinding]
) -> tuple[dict[str, RawTable], RawTable | None]:
    each = ""
    if not isinstance(source, Path):
        raws = _csv_tables(source, findings)
    elif source.is_dir():
        each = " (each a CSV file)"
        files = (p for p in sorted(source.iterdir()) if p.suffix.lower() == ".csv")
        raws = _csv_tables({file.stem: file for file in files}, findings)
    elif source.suffix.lower() == ".csv" and source.is_file():
        raise InputError(
            "is a single table", file=source, field=KEY, found="a CSV file",
            expected="the folder that holds it, or a GeoPackage",
        )  # fmt: skip
    elif source.exists():
        raws = _geopackage(source, findings)
    else:
        raise InputError(
            "not found", file=source, field=KEY, expected="a GeoPackage or a folder of CSV files"
        )
    metadata = raws.pop(_METADATA, None)
    if not raws:
        file = source if isinstance(source, Path) else None
        problem, expected = "holds no table of observations", f"at least one of {', '.join(TABLES)}"
        raise InputError(problem, file=file, field=KEY, expected=f"{expected}{each}")
    return {name: raws[name] for name in TABLES if name in raws}, metadata


def _known_table(name: str, file: Input, findings: list[ObservationFinding]) -> str | None:
    lower = name.strip().lower()
    if lower in TABLES or lower == _METADATA:
        return lower
    if lower not in _FOREIGN:
        problem = f"table {shown(name)} is not one of observations and is not read"
        known = nearest(lower, (*TABLES, _METADATA))
        findings.append(ObservationFinding("warning", problem, str(file), expected=known))
    return None


def _csv_tables(
    tables: Mapping[str, Input], findings: list[ObservationFinding]
) -> dict[str, RawTable]:
    raws: dict[str, RawTable] = {}
    for stem, file in tables.items():
        name = _known_table(stem, file, findings)
        if name is None:
            continue
        columns, delimiter, lines = csv_cells(read_text(file, KEY, "a table (CSV)"), file)
        texts = {c.name for c in TABLES.get(name, ()) if c.text} | {"key", "value"}
        rows, cells, short = [], [], []
        for line, row in lines:
            if len(row) == len(columns):
                rows.append(line)
                cells.append([v.strip() for v in row])
            else:
                short.append(line)
        data = {c: np.array([row[i] for row in cells], dtype=object) for i, c in enumerate(columns)}
        if delimiter == ";":
            for c in data:
                if c.lower() not in texts:
                    data[c] = np.array([v.replace(",", ".") for v in data[c]], dtype=object)
        raws[name] = raw = RawTable(name, file, np.array(rows, np.int64), data, findings)
        if len(set(columns)) < len(columns):
            twice = next(c for c in columns if columns.count(c) > 1)
            raw.note("column is there twice: the last one is read", twice)
        if short:
            expected = f"{len(columns)} values (texts with a {delimiter} in quotes)"
            raw.note("does not fit the header", rows=short, expected=expected, left_out="row")
    return raws


def _geopackage(file: Path, findings: list[ObservationFinding]) -> dict[str, RawTable]:
    raws = {}
    with vector_file(file, KEY):
        for layer, geometry in layers_of(file).items():
            name = _known_table(layer, file, findings)
            if name is None:
                continue
            frame = read_frame(file, layer, fid_as_index=True, on_invalid="ignore")
            shapes, crs = None, None
            if geometry is not None and isinstance(frame, gpd.GeoDataFrame):
                shapes, crs = tuple(frame.geometry.array), frame.crs
                frame = pd.DataFrame(frame.drop(columns=frame.geometry.name))
            columns = {str(c): frame[c].to_numpy(dtype=object) for c in frame.columns}
            rows = frame.index.to_numpy(np.int64)
            raws[name] = RawTable(
                name=name,
                file=file,
                rows=rows,
                columns=columns,
                findings=findings,
                shapes=shapes,
                crs=crs,
            )
    return raws
