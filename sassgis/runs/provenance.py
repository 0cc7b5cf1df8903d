"""Origin of a result: its manifest, and what its files say of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
from sassgis.settings.map_run import MapRun
from sassgis.settings.run_config import Config
from sassgis.settings.schema import Input


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a result besides the files that every run of its configuration reads."""

    inputs: Mapping[str, Input] = field(default_factory=dict)  # files by their role
    preset: str = ""
    # Reference widths besides that of the reach probability (m).
    ref_widths_m: dict[str, float] = field(default_factory=dict)


def write_origin(
    work: Path,
    config: Config,
    counts: Mapping[str, int],
    warnings: Sequence[str],
    *,
    seed: int,
    grid: Grid | None = None,
    origin: Origin,
    settings: Mapping[str, object] | None = None,
    checks: Mapping[str, object] | None = None,
    maps: bool = True,
) -> None:
    """Write the manifest of a result of a configuration, after all other files.

    Without ``grid`` it lies on no map; ``maps`` are those of the blocks. The settings are written
    next to those of the configuration.
    """
    reach = {"reach_probability": grid.cell_size} if maps and grid is not None else {}
    write_manifest(
        work / MANIFEST_NAME,
        inputs={**input_files(config), **origin.inputs},
        base=config.base,
        crs="" if grid is None else grid.crs,
        vertical_datum="" if grid is None else grid.vertical_datum,
        seed=seed,
        ref_widths_m=reach | origin.ref_widths_m,
        preset=origin.preset,
        settings=as_named(config) | dict(settings or {}),
        counts=counts,
        warnings=warnings,
        checks=checks,
    )


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
