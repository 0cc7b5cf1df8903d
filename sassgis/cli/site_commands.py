"""Commands before a simulation: terrain, release areas, configuration, frequencies, checks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from sassgis.cli.options import (
    AS_JSON,
    CONFIG,
    DEM_CRS,
    OVERRIDE_CRS,
    OVERWRITE,
    PATH,
    command,
    notes,
    printed,
    settings_as_options,
)


class _Above0(click.FloatRange):
    """A number above 0, and no NaN or infinity."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a number", param, ctx)
        return number


_ABOVE_0 = _Above0(min=0.0, min_open=True)


@command(
    click.argument("polygon", type=PATH),
    click.option(
        "-o", "--output", "out", type=PATH,
        help="Folder for the tiles; without it the command only lists them.",
    ),
    click.option(
        "--resolution", type=click.Choice(["0.5", "2"]), default="2", show_default=True,
        help="Size of the cells (m).",
    ),
    click.option("--layer", help="Layer of the polygons, where the file has several."),
    click.option("--most", type=click.IntRange(1), default=100, show_default=True, help="Tiles."),
    click.option("--server", help="Address of another STAC interface."),
    click.option("--collection", help="Another collection of that interface."),
    click.option(
        "--timeout", "timeout_s", type=click.FloatRange(0.1), default=30.0, show_default=True,
        help="Longest wait for an answer (s).",
    ),
    short_help="List and fetch tiles of swissALTI3D over polygons.",
    example="dem fetch area.gpkg -o terrain",
)  # fmt: skip
def fetch(
    polygon: Path,
    out: Path | None,
    resolution: str,
    layer: str | None,
    most: int,
    timeout_s: float,
    **given: Any,
) -> None:
    """List the tiles of swissALTI3D over the polygons of a file, and fetch them into a folder."""
    from sassgis.outputs.terrain_fetch import fetch_terrain, find_tiles, read_search_area

    stated = {key: value for key, value in given.items() if value is not None}
    with settings_as_options({"polygon.file": "POLYGON", "polygon.layer": "--layer"}):
        area = read_search_area(polygon, layer)
    offers = find_tiles(area, float(resolution), timeout_s=timeout_s, **stated)
    if out is None:
        for offer in offers:
            click.echo(f"{offer.date}  {offer.file}  {offer.href}")
        click.echo(f"{len(offers)} tiles listed. Fetch them with -o FOLDER.")
        return
    vrt = fetch_terrain(offers, out, timeout_s=timeout_s, most=most, say=click.echo)
    click.echo(f"Wrote {vrt} over {len(offers)} tiles. Now: sassgis dem check {vrt}")


@command(
    click.argument("dem", type=PATH),
    DEM_CRS,
    OVERRIDE_CRS,
    AS_JSON,
    click.option("-o", "--output", "out", type=PATH, help="GeoPackage of the flagged cells."),
    click.option("--html", type=PATH, help="Also write the page as HTML."),
    OVERWRITE,
    name="check",
    short_help="Check a terrain model; the result is one page.",
    example="dem check terrain/terrain.vrt",
)
def check_terrain(
    dem: Path,
    as_json: bool,
    out: Path | None,
    html: Path | None,
    overwrite: bool,
    **given: Any,
) -> None:
    """Check the terrain model DEM, a raster or a folder of tiles: a verdict for each item.

    Exit code 1 where an item is bad, so that the model cannot be used as it is.
    """
    from sassgis.runs.dem_check import check_dem, write_dem_cells, write_dem_page

    report = check_dem(dem, **given)
    printed(report, as_json)
    if html is not None:
        write_dem_page(html, report, overwrite)
    if out is not None:
        write_dem_cells(out, report, overwrite)
    asked = f" --crs {given['crs']}" if given.get("crs") else ""
    said = report.suggestion(asked) if out is None else f"Wrote {out}: {len(report.cells)} items"
    if said and not as_json:
        click.echo(said)
    if report.verdict == "bad":
        click.get_current_context().exit(1)


@command(
    click.argument("dem", type=PATH),
    click.option("-o", "--output", "out", required=True, type=PATH, help="GeoPackage."),
    DEM_CRS,
    OVERRIDE_CRS,
    click.option(
        "--ground", type=PATH,
        help="Polygons of ground classes; mapped rock counts from a gentler slope.",
    ),
    click.option("--layer", help="Layer of the ground polygons, where the file has several."),
    click.option(
        "--class-field", default="class", show_default=True, help="Attribute with the class."
    ),
    click.option("--rock", default="rock", show_default=True, help="Name of the class of rock."),
    click.option(
        "--threshold", "threshold_deg", type=click.FloatRange(1.0, 89.0),
        help="Least slope of cliffs (degrees); default: from the distribution of slopes.",
    ),
    click.option(
        "--min-area", "min_area_m2", type=click.FloatRange(0.0), default=50.0, show_default=True,
        help="Smallest area in plan (m2).",
    ),
    OVERWRITE,
    short_help="Propose release areas from the slopes of a terrain model.",
    example="cliffs terrain/terrain.vrt -o release.gpkg",
)  # fmt: skip
def cliffs(dem: Path, out: Path, **given: Any) -> None:
    """Propose release areas from the slopes of DEM; to be checked in the field."""
    from sassgis.runs.propose_release import propose_release

    names = {"file": "--ground", "layer": "--layer", "class_field": "--class-field"}
    with settings_as_options({f"ground.{key}": option for key, option in names.items()}):
        proposal = propose_release(dem, out, **given)
    printed(proposal)
    click.echo(f"Wrote {out}. Check it, then: sassgis init --dem {dem} --release {out}")


@command(
    click.argument("folder", type=PATH, default="sample_dem"),
    short_help="Write the files of the sample, with its configuration.",
    example="sample sample_dem",
)
def sample(folder: Path) -> None:
    """Write the synthetic sample terrain into FOLDER (default: sample_dem), which must be new."""
    from sassgis.outputs.site_template import write_samples

    write_samples(folder)
    config = folder / "valley" / "config.toml"
    click.echo(f"Wrote {folder}. Now: sassgis zone {config} -o zones")


@command(
    click.argument("file", type=PATH),
    click.option("--crs", help="Projected system, such as EPSG:2056; default: that of --dem."),
    click.option("--dem", type=PATH, help="Terrain model as background."),
    OVERRIDE_CRS,
    OVERWRITE,
    short_help="Write empty layers and a QGIS project to draw a site in.",
    example="new site.gpkg --dem terrain/terrain.vrt",
)
def new(file: Path, **given: Any) -> None:
    """Write an empty GeoPackage FILE to draw a site in, and a QGIS project beside it."""
    from sassgis.outputs.site_template import site_template

    with settings_as_options():
        project = site_template(file, **given)
    click.echo(f"Wrote {file}. Draw in {project}, then: sassgis init --dem ... --release {file}")


@command(
    click.argument("file", type=PATH, default="sassgis.toml"),
    click.option("--dem", type=PATH, help="Terrain model: raster or folder."),
    click.option(
        "--release", type=PATH,
        help="Release areas, or a GeoPackage of `sassgis new` with all its drawn layers.",
    ),
    click.option(
        "--set", "settings", multiple=True, metavar="KEY=VALUE",
        help="Set a key, such as release.spacing_m=5; may be given several times.",
    ),
    click.option(
        "--rockyfor3d", "folder", type=PATH,
        help="Folder of inputs of Rockyfor3D; replaces --dem and --release.",
    ),
    click.option("--all", "every", is_flag=True, help="Every key, with its meaning and default."),
    click.option("--overwrite", is_flag=True, help="Overwrite, unless the file was edited."),
    short_help="Write a configuration: settings that every site needs.",
    example="init --dem terrain/terrain.vrt --release site.gpkg",
)  # fmt: skip
def init(
    file: Path,
    dem: Path | None,
    release: Path | None,
    settings: tuple[str, ...],
    folder: Path | None,
    every: bool,
    overwrite: bool,
) -> None:
    """Write a configuration to FILE (default: sassgis.toml): settings that every site needs."""
    if folder is not None:
        if dem or release or every:
            raise click.UsageError("--rockyfor3d takes no --dem, --release and --all")
        _from_rockyfor3d(file, folder, settings, overwrite)
        return
    from sassgis.files.atomic_output import write_new
    from sassgis.inputs.site_layers import project_keys, start_keys, with_system, with_values
    from sassgis.outputs.config_template import config_template, short_template
    from sassgis.runs.inputs import collected_notices

    keys = [*project_keys(file), *start_keys(file.parent, dem, release)]
    asked = with_values(keys, settings)
    with collected_notices() as noticed:
        given = with_system(asked, dem, release)
    notes(noticed)
    if given != asked:
        click.echo(f"terrain.crs: {dict(given)['terrain']['crs']}, from {release}")
    text = config_template(given) if every else short_template(given)
    write_new(file, text, overwrite)
    names = [name for name, path in (("terrain.dem", dem), ("release.file", release)) if not path]
    todo = f"Fill in {' and '.join(names)}, then: " if names else "Now: "
    click.echo(f"Wrote {file}. {todo}sassgis validate {file}")


def _from_rockyfor3d(file: Path, folder: Path, settings: tuple[str, ...], overwrite: bool) -> None:
    """Convert a folder of Rockyfor3D; list the inputs without a counterpart."""
    from sassgis.outputs.site_template import write_rockyfor3d_site

    files, noticed_files = write_rockyfor3d_site(file, folder, settings, overwrite)
    notes(noticed_files)
    click.echo(f"Wrote {', '.join(map(str, files))}. Now: sassgis validate {file}")


@command(
    click.argument("file", type=PATH, default="sassgis.schema.json"),
    OVERWRITE,
    short_help="Write the JSON Schema that lets editors complete keys.",
    example="schema",
)
def schema(file: Path, overwrite: bool) -> None:
    """Write the JSON Schema of the configuration to FILE (default: sassgis.schema.json)."""
    import json

    from sassgis.files.atomic_output import write_new
    from sassgis.inputs.config import config_schema

    write_new(file, json.dumps(config_schema(), indent=1, ensure_ascii=False) + "\n", overwrite)
    click.echo(f"Wrote {file}. First line of the configuration, for editors: #:schema {file.name}")


@command(
    click.argument("file", type=PATH),
    click.option("--like", default="ch-so", show_default=True, help="Built-in preset to copy."),
    OVERWRITE,
    name="new",
    short_help="Copy the rules of a built-in preset into a file to edit.",
    example="preset new office.toml",
)
def write_preset(file: Path, like: str, overwrite: bool) -> None:
    """Copy the rules of a built-in preset into FILE, to be edited (docs/presets.md)."""
    from sassgis.runs.preset_check import new_preset

    new_preset(file, like, overwrite)
    click.echo(f"Wrote {file}. Change it, then: sassgis preset check {file} -o matrix.png")


@command(
    click.argument("preset"),
    click.option("-o", "--output", "out", type=PATH, help="PNG of matrix and computed levels."),
    AS_JSON,
    OVERWRITE,
    name="check",
    short_help="Check the rules of hazard levels, with a picture.",
    example="preset check office.toml -o matrix.png",
)
def check_rules(preset: str, out: Path | None, as_json: bool, overwrite: bool) -> None:
    """Check PRESET, a TOML file or the name of a built-in one: its matrix, codes and colours."""
    from sassgis.runs.preset_check import check_preset, write_preset_figure

    report = check_preset(preset)
    printed(report, as_json)
    if out is not None:
        write_preset_figure(out, report, overwrite)
        if not as_json:
            click.echo(f"Wrote {out}")


@command(
    click.argument("blocks", type=PATH),
    click.option(
        "--complete-from", type=_ABOVE_0, required=True, metavar="M3",
        help="Volume above which every block was recorded.",
    ),
    click.option(
        "--up-to", type=_ABOVE_0, metavar="M3", help="Largest possible volume; default: none."
    ),
    click.option("--scenarios", default="", metavar="M3,M3,...", help="Limits of the scenarios."),
    click.option("--years", type=_ABOVE_0, help="Years in which the blocks were released."),
    click.option(
        "--rate", type=_ABOVE_0, help="Blocks a year above that volume; replaces --years."
    ),
    click.option("--area-ha", type=_ABOVE_0, help="Total release area (ha)."),
    click.option(
        "--length-m", type=_ABOVE_0, help="Length of the release line (m); replaces --area-ha."
    ),
    AS_JSON,
    short_help="Onset frequencies of scenarios from block volumes.",
    example="frequency blocks.csv --complete-from 0.1 --years 40 --scenarios 0.1,1,10",
)  # fmt: skip
def frequency(blocks: Path, scenarios: str, as_json: bool, **given: Any) -> None:
    """Fit a power law to the volumes in BLOCKS (CSV), and print onset frequencies.

    BLOCKS has a column volume_m3, or from_m3, to_m3 and count.
    """
    from sassgis.runs.scenario_frequencies import scenario_frequencies

    if None not in (given["years"], given["rate"]):
        raise click.UsageError("give one of --years and --rate")
    if None not in (given["area_ha"], given["length_m"]):
        raise click.UsageError("give one of --area-ha and --length-m")
    try:
        limits = [float(part) for part in scenarios.split(",") if part.strip()]
    except ValueError:
        raise click.UsageError("--scenarios are volumes with commas between, as 0.1,1,10") from None
    with settings_as_options({"completeness volume": "--complete-from"}):
        found = scenario_frequencies(blocks, limits, **given)
    printed(found, as_json)


@command(
    CONFIG,
    AS_JSON,
    click.option(
        "--all",
        "every",
        is_flag=True,
        help="List every release area and sources of the ground.",
    ),
    short_help="Check all inputs; list the commands that can run.",
    example="validate sassgis.toml",
)
def validate(config: Path, as_json: bool, every: bool) -> None:
    """Check CONFIG and its files; list the commands that can run, with their time and memory."""
    from sassgis.inputs.config import load_config
    from sassgis.runs.check_inputs import check_inputs

    printed(check_inputs(load_config(config)), as_json, every)
