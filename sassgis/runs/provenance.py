"""Origin of a result: its manifest, and what its files say of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import sassgis
from sassgis.files.atomic_output import MANIFEST_NAME
from sassgis.grid import Grid
from sassgis.inputs.config import as_named, settings_hash
from sassgis.outputs.manifest import write_manifest
from sassgis.runs.inputs import input_files
from sassgis.settings.crs import crs_name
from sassgis.settings.languages import translated
from sassgis.settings.map_run import Config, MapRun
from sassgis.settings.schema import Input


def write_origin(
    work: Path,
    config: Config,
    counts: Mapping[str, int],
    warnings: Sequence[str],
    *,
    seed: int,
    grid: Grid | None = None,
    inputs: Mapping[str, Input] | None = None,
    preset: str = "",
    hazard_width_m: float | None = None,
    settings: Mapping[str, object] | None = None,
    checks: Mapping[str, object] | None = None,
    maps: bool = True,
) -> None:
    """Write the manifest of a result of a configuration, after all other files.

    Without ``grid`` it lies on no map; ``maps`` are those of the blocks. Inputs by their role and
    settings are written next to those of the configuration; ``hazard_width_m`` is the reference
    width of the hazard.
    """
    widths = {"reach_probability": grid.cell_size} if maps and grid is not None else {}
    if hazard_width_m is not None:
        widths["hazard"] = hazard_width_m
    write_manifest(
        work / MANIFEST_NAME, inputs={**input_files(config), **(inputs or {})}, base=config.base,
        crs="" if grid is None else grid.crs,
        vertical_datum="" if grid is None else grid.vertical_datum, seed=seed,
        ref_widths_m=widths, preset=preset, settings=as_named(config) | dict(settings or {}),
        counts=counts, warnings=warnings, checks=checks,
    )  # fmt: skip


def provenance(config: Config) -> dict[str, str]:
    """Return the statement of origin in reports."""
    return {
        "Program": f"sassgis {sassgis.__version__}",
        "Seed": str(config.run.seed),
        "Settings and inputs (SHA-256)": settings_hash(config),
    }


def facts_of(config: Config, run: MapRun) -> dict[str, object]:
    """Return the facts that the maps rest on, for the GeoPackage and the report."""
    return {
        "program": f"sassgis {sassgis.__version__}",
        "model": "SASS (Bozzolo and Pamini, 1986)",
        "title": config.project.name,
        "crs": crs_name(run.grid.crs) if run.grid.crs else "local coordinates",
        "vertical_datum": run.grid.vertical_datum or "not stated",
        "seed": run.seed,
        "ref_width_m": run.grid.cell_size,
        "lateral_spread": run.lateral_spread,
        "effects": ", ".join(run.effects.names) or "none",
        "settings_hash": settings_hash(config),
    }


def made_on(config: Config) -> str:
    """Return the date on sheets and in the report: that of the configuration, or today."""
    return config.project.date or date.today().isoformat()


def byline(config: Config) -> tuple[str, ...]:
    """State who made it, when, with which program; where to ask; whose data."""
    project = config.project
    status = translated(project.status)
    parts = (status, project.author, made_on(config), f"sassgis {sassgis.__version__}",
             project.contact, project.rights)  # fmt: skip
    return tuple(part for part in parts if part)
