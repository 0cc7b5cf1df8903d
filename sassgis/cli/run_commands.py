"""Commands that simulate, and those that compare and export results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sassgis.cli.options import (
    AREAS,
    AS_JSON,
    CONFIG,
    GROUND_DRAWS,
    JOBS,
    MEMORY,
    OUT,
    OVERWRITE,
    PATH,
    SEED,
    WORKERS,
    at_work,
    command,
    conclude,
    notes,
    printed,
)

if TYPE_CHECKING:
    from sassgis.hazard.zoning.applied_edits import AppliedEdit
    from sassgis.runs.run import RunResult
    from sassgis.settings.map_run import Config


@command(OUT, JOBS, OVERWRITE, AS_JSON, example="demo -o demo_out")
def demo(out: Path, as_json: bool, **given: Any) -> None:
    """Make the zones of the sample valley, a synthetic terrain."""
    from sassgis.outputs.site_template import sample_folder

    config = sample_folder() / "valley" / "config.toml"
    _zoned(config, out, as_json, given)


@command(
    CONFIG,
    OUT,
    click.option("--csv", "csv_file", type=PATH, help="Profile: s_m, z_m, ground."),
    click.option(
        "--point", type=(float, float), metavar="X Y",
        help="Profile along the fall line from this point of the terrain.",
    ),
    click.option(
        "--line", "line_file", type=PATH,
        help="Profile under the line of this vector file, drawn downslope.",
    ),
    click.option("--rocks", type=click.IntRange(1), help="Blocks per block scenario."),
    SEED,
    OVERWRITE,
    short_help="Simulate one profile: paths, stations, run-out, energy.",
    example="profile sassgis.toml --point 2700300 1120500 -o one_line",
)  # fmt: skip
def profile(config: Path, out: Path, **given: Any) -> None:
    """Simulate one profile: trajectories, stations, run-out, energy along the slope."""
    from sassgis.errors import ConfigError
    from sassgis.runs.profile_run import run_profile

    if sum(given[key] is not None for key in ("csv_file", "point", "line_file")) > 1:
        raise ConfigError("--csv, --point and --line exclude each other", expected="one of them")
    result = run_profile(config, out, **given)
    notes(result.warnings)
    click.echo(f"{result.found.rocks.size} blocks. Open {out / 'report.html'} in a browser.")


@command(
    CONFIG, OUT, AREAS, SEED, GROUND_DRAWS, *WORKERS, MEMORY, OVERWRITE, AS_JSON,
    short_help="Simulate blocks: maps, GeoPackage, QGIS project, report.",
    example="run sassgis.toml -o result",
)  # fmt: skip
def run(config: Path, out: Path, as_json: bool, **given: Any) -> None:
    """Simulate CONFIG on the map: maps, GeoPackage, QGIS project, figures, report."""
    from sassgis.runs.run import run as run_map

    with at_work(given) as how:
        result = run_map(_with_draws(config, how), out, **how)
    summary = _with_spread(f"{result.n_blocks} blocks in {result.seconds:.1f} s.", result)
    conclude(result.warnings, summary, out, _run_facts(result) if as_json else None)


def _with_draws(config: Path, how: dict[str, Any]) -> Config:
    """The configuration with the settings that options replace."""
    from sassgis.inputs.config import load_config

    asked = {f"run.{key}": how.pop(key, None) for key in ("seed", "ground_uncertainty")}
    values = {key: own for key, own in asked.items() if own is not None}
    if (edits := how.pop("edits", None)) is not None:
        values |= {"edits.file": str(edits.absolute()), "edits.layer": None}
    return load_config(config, values)


def _with_spread(summary: str, result: RunResult) -> str:
    """The summary of a run, with the effect of the spread of the ground classes, if known."""
    if result.spread is None:
        return summary
    from sassgis.report.change_report import spread_lines

    lines = (f"{text[:1].upper()}{text[1:]}." for _, text in spread_lines(result.spread))
    return "\n".join((summary, *lines))


def _run_facts(result: RunResult) -> dict[str, object]:
    """The facts of a run for --json."""
    return {
        "blocks": result.n_blocks,
        "stopping_reasons": {r.name.lower(): count for r, count in result.reasons.items()},
        "seconds": result.seconds,
        **({} if result.spread is None else {"ground_uncertainty": asdict(result.spread)}),
    }


@command(
    CONFIG, OUT, AREAS, SEED, GROUND_DRAWS,
    click.option(
        "--edits", type=PATH,
        help="Polygons of levels set by hand, with author, date and reason; replaces [edits].",
    ),
    click.option(
        "--reuse", type=PATH,
        help="Result of the same inputs but for stations, walls, nets and galleries: only release "
        "areas whose blocks come near a changed one are simulated again, with as many blocks.",
    ),
    *WORKERS, MEMORY, OVERWRITE, AS_JSON,
    short_help="Simulate blocks; make hazard zones and risk.",
    example="zone sassgis.toml -o zones",
)  # fmt: skip
def zone(config: Path, out: Path, as_json: bool, **given: Any) -> None:
    """Simulate CONFIG and make hazard zones: all results of run, plus levels, intensities, risk."""
    _zoned(config, out, as_json, given)


def _zoned(config: Path, out: Path, as_json: bool, given: Mapping[str, Any]) -> None:
    """Make hazard zones and report the result."""
    from sassgis.hazard.warnings import edge_words, sample_words
    from sassgis.runs.run import zone as make_zones

    with at_work(given) as how:
        result = make_zones(_with_draws(config, how), out, **how)
    hazard, zones = result.found.hazard, int(result.found.hazard.levels.polygons.size)
    edge = edge_words(result.run.run, result.run.progress, hazard.facts.open_limit)
    said = (
        f"{result.run.n_blocks} blocks, {zones} zones.",
        sample_words(hazard.chances, result.rules.preset), edge, _edited(hazard.edits),
    )  # fmt: skip
    summary = _with_spread(" ".join(filter(None, said)), result.run)
    facts = {
        **_run_facts(result.run),
        "zones": zones,
        "changed_share": float(hazard.changed_share),
        "uncertain_share": float(hazard.uncertain_share),
        "edits": len(hazard.edits),
        "edits_with_another_level": sum(a.has_changed for a in hazard.edits),
        "left_terrain_share": result.run.progress.lost_share,
    }
    conclude(result.run.warnings, summary, out, facts if as_json else None)


def _edited(edits: Sequence[AppliedEdit]) -> str:
    """Count edits by hand for the last line; empty without any."""
    if not edits:
        return ""
    changed = sum(a.has_changed for a in edits)
    places = "1 place" if len(edits) == 1 else f"{len(edits)} places"
    since = f"; at {changed} of them the computed level has changed since" * bool(changed)
    return f"Edited by hand: {places}{since}."


@command(
    click.argument("releases", type=PATH),
    OUT,
    click.option(
        "-c", "--config", type=PATH,
        help="Configuration for all other settings; default: the only TOML file in that folder.",
    ),
    click.option(
        "--dem", type=PATH, help="Raster, VRT or folder of tiles; replaces terrain.dem."
    ),
    SEED,
    *WORKERS,
    click.option(
        "--overwrite", is_flag=True,
        help="Overwrite areas whose settings, inputs or files differ, unless files were edited.",
    ),
    click.option(
        "--mosaic-only", is_flag=True,
        help="Write only the mosaic: no maps, zones and report of single areas.",
    ),
    MEMORY,
    short_help="Zone many release areas, separately and all on one map.",
    example="batch releases -c sassgis.toml --dem terrain -o batch",
)  # fmt: skip
def batch(releases: Path, out: Path, **given: Any) -> None:
    """Zone each release area of RELEASES separately, and all of them on one map.

    RELEASES is a vector file, a folder of vector files, or a configuration. After an interruption,
    the same command resumes.
    """
    from sassgis.batches.batch import batch as run_batch
    from sassgis.files.atomic_output import alone

    with alone(out), at_work(given) as how:
        result = run_batch(releases, out, **how)
    done = int((result.summary["status"] == "done").sum())
    summary = f"{done} of {len(result.summary)} areas done: {out / 'summary.csv'}"
    conclude(result.warnings, summary, out / "mosaic")


@command(
    CONFIG,
    OUT,
    click.option(
        "--samples", type=click.IntRange(4, 10_000), default=32, show_default=True,
        help="Simulations that vary all ranges together.",
    ),
    click.option(
        "--rocks", type=click.IntRange(2, 1_000_000),
        help="Blocks per release point and simulation; default: a fifth of the configured number.",
    ),
    click.option(
        "--ranges", type=PATH,
        help="Ranges (CSV: class, parameter, kind, low, high) that replace built-in ones.",
    ),
    AREAS,
    SEED,
    JOBS,
    OVERWRITE,
    short_help="Vary the ground classes within their ranges.",
    example="sensitivity sassgis.toml -o sensitivity",
)  # fmt: skip
def sensitivity(config: Path, out: Path, **given: Any) -> None:
    """Show how levels, reach and energy of CONFIG change with its ground classes."""
    from sassgis.runs.sensitivity_run import sensitivity as vary

    with at_work(given) as how:
        result = vary(config, out, **how)
    summary = f"{result.simulations} simulations of {len(result.ranges)} ranges."
    conclude(result.warnings, summary, out)


@command(
    click.argument("before", type=PATH),
    click.argument("after", type=PATH),
    OUT,
    OVERWRITE,
    example="compare zones_before zones_after -o change",
)
def compare(before: Path, after: Path, out: Path, overwrite: bool) -> None:
    """Report changes from the result BEFORE to the result AFTER."""
    from sassgis.runs.compare import compare as compare_results

    change = compare_results(before, after, out, overwrite=overwrite)
    notes(change.notes)
    printed(change)
    click.echo(change.beyond_sampling)
    click.echo(f"Open {out / 'project.qgz'} in QGIS, {out / 'report.html'} in a browser.")


@command(
    click.argument("result", type=PATH),
    click.option(
        "-o", "--output", "--xtf", "out", required=True, type=PATH,
        help="File to write: .xtf (INTERLIS 2), .geojson or .kml.",
    ),
    click.option(
        "--layer", type=click.Choice(["zones", "paths"]), default="zones", show_default=True,
        help="Hazard zones, or paths of blocks in space (not .xtf).",
    ),
    click.option(
        "--models", type=PATH,
        help=".xtf: folder of the model's .ili files, with which ilivalidator checks the file.",
    ),
    click.option("--validate", is_flag=True, help=".xtf: write only if this check is possible."),
    click.option("--canton", help=".xtf: code of the canton responsible for the data, such as TI."),
    OVERWRITE,
    short_help="Write zones or paths as INTERLIS 2, GeoJSON or KML.",
    example="export zones -o zones.xtf --canton TI",
)  # fmt: skip
def export(result: Path, out: Path, layer: str, overwrite: bool, **of_xtf: Any) -> None:
    """Write zones or paths of the folder RESULT for other programs.

    The suffix of the file names the format. INTERLIS 2 is model 166.1 in EPSG:2056; GeoJSON and KML
    are in WGS 84.
    """
    if out.suffix.lower() != ".xtf":
        if any(of_xtf.values()):
            raise click.UsageError("--models, --validate and --canton are for .xtf")
        from sassgis.outputs.view_files import export_view

        click.echo(export_view(result, out, layer, overwrite=overwrite))
        return
    if layer != "zones":
        raise click.UsageError("an .xtf holds zones; write paths as .geojson or .kml")
    from sassgis.errors import OutputError
    from sassgis.outputs.swiss.transfer import export_xtf

    exported = export_xtf(result, out, overwrite=overwrite, **of_xtf)
    printed(exported)
    if not exported.accepted:
        raise OutputError(f"{out}: the validator rejects the file; its messages are above")
