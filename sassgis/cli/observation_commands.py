"""Commands for sites with observations: calibration, and the diagnosis of the gap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sassgis.cli.options import (
    CONFIG,
    FIT_SEED,
    JOBS,
    OBSERVATIONS,
    OUT,
    OVERWRITE,
    PATH,
    WORKERS,
    ProgressBar,
    at_work,
    command,
    notes,
    printed,
    settings_as_options,
    several,
)
from sassgis.errors import collected_notices
from sassgis.gap.constants import FIT_DRAWS


@command(
    CONFIG,
    OBSERVATIONS,
    click.argument("more", nargs=-1, type=PATH),
    OUT,
    several("--class", "classes", "Calibrate only this ground class"),
    several("--parameter", "parameters", "Calibrate only this parameter"),
    FIT_SEED,
    *WORKERS,
    click.option(
        "--draws", type=click.IntRange(16, 100_000),
        help="Parameter sets in each of six rounds; more take longer and give a stabler result.",
    ),
    OVERWRITE,
    short_help="Fit ground classes to observations.",
    example="calibrate sassgis.toml --observations observed -o calibrated",
)  # fmt: skip
def calibrate(
    config: Path, observations: Path, more: tuple[Path, ...], out: Path, **given: Any
) -> None:
    """Fit ground classes to OBSERVATIONS; MORE sites as pairs: CONFIG2 OBS2 ...

    The same command resumes after an interruption.
    """
    from sassgis.report.calibration_report import calibration_warnings, verdict
    from sassgis.runs.calibrate import calibrate as run_calibration

    if len(more) % 2:
        raise click.UsageError(f"{more[-1]}: a configuration without observations; give pairs")
    sites = [(config, observations), *zip(more[::2], more[1::2], strict=True)]
    with at_work(given) as how, settings_as_options({"classes": "--class"}, True):
        result = run_calibration(sites, out, **how)
    notes(calibration_warnings(result))
    click.echo(verdict(result))
    click.echo(f"Open {out / 'report.html'} in a browser; run {out / 'config.toml'}.")
    click.echo(result.recommendation)


@command(
    click.argument("path", type=PATH),
    click.option("--crs", help="Coordinate system of a .gpkg; preferably that of the DEM."),
    click.option(
        "--site", type=PATH, metavar="CONFIG",
        help="Also simulate which effects 20, 40 and 100 rocks would show there (some minutes).",
    ),
    JOBS,
    short_help="Write empty tables of observations.",
    example="gap template observed --site sassgis.toml",
)  # fmt: skip
def template(path: Path, crs: str | None, site: Path | None, jobs: int | None) -> None:
    """Write empty tables of observations: a .gpkg, or a folder of CSV files."""
    if site is None:
        from sassgis.outputs.site_template import observations_template

        observations_template(path, crs=crs)
    else:
        from sassgis.runs.plan_campaign import plan_campaign

        with at_work({"jobs": jobs}) as how:
            power = plan_campaign(path, site, crs=crs, **how)
        printed(power)
    click.echo(f"Wrote {path}. Delete the columns and tables that you did not measure.")


@command(
    click.argument("observations", type=PATH),
    click.option("--config", type=PATH, help="Compare them with this terrain and ground."),
    name="validate",
    short_help="Check observations; list what they can identify.",
    example="gap validate observed --config sassgis.toml",
)
def validate_observations(observations: Path, config: Path | None) -> None:
    """Check OBSERVATIONS; list their faults and what they can identify.

    Exit code 1 where something is wrong; a warning leaves it at 0.
    """
    from sassgis.gap.advice.measure_next import what_is_identifiable
    from sassgis.gap.observations.case import drop_and_density
    from sassgis.inputs.config import load_config
    from sassgis.inputs.observation_files import read_observations
    from sassgis.inputs.observation_files import validate_observations as check
    from sassgis.runs.inputs import read_map_run

    compared: tuple[Any, ...] = ()
    if config is not None:
        # Whole, as a diagnosis reads it.
        run = read_map_run(load_config(config))
        compared = run.grid, *drop_and_density(run.blocks)
    with collected_notices(quietly=[]) as noticed:
        read = read_observations(observations, *compared)
    findings = check(read, *compared)
    of_findings = {str(finding).partition(": ")[2] for finding in findings}
    for line in (*(text for text in noticed if text not in of_findings), *map(str, findings)):
        click.echo(line)
    found = what_is_identifiable(read)
    unknown = f"{found.unattributed} passages and deposits without a known rock"
    click.echo(f"{found.rocks} rocks, {unknown}")
    for own in found.quantities:
        click.echo(f"  {own.name} ({own.table}): {own.values} values of {own.rocks} rocks")
    for line in found.not_identifiable:
        click.echo(f"not identifiable: {line}")
    if found.not_testable:
        click.echo(found.not_testable)
    if any(finding.level == "error" for finding in findings):
        click.get_current_context().exit(1)


@command(
    CONFIG,
    OBSERVATIONS,
    OUT,
    FIT_SEED,
    JOBS,
    click.option(
        "--draws", type=click.IntRange(8, 1000),
        help="Parameter sets per hypothesis; more take longer and separate effects better.",
    ),
    click.option(
        "--ground-range", type=click.FloatRange(0.1, 10.0), default=1.0, show_default=True,
        help="Factor on how far the ground may be calibrated; above 1 where its classes are "
        "guesses.",
    ),
    click.option(
        "--map", "with_map", is_flag=True, help="Also run the map with the calibrated model."
    ),
    OVERWRITE,
    short_help="Where simulation and observations differ, and why.",
    example="gap diagnose sassgis.toml --observations observed -o diagnosis",
)  # fmt: skip
def diagnose(
    config: Path, observations: Path, out: Path, draws: int | None, with_map: bool, **given: Any
) -> None:
    """Say where simulation and OBSERVATIONS differ, which effect causes it, and how far it helps.

    After an interruption it begins anew.
    """
    from sassgis.gap.words import file_has
    from sassgis.report.gap_answer import verdict_sentence
    from sassgis.runs.diagnose import MAP_NAME
    from sassgis.runs.diagnose import diagnose as run_diagnosis

    with at_work(given) as how:
        result = run_diagnosis(config, observations, out, draws=draws or FIT_DRAWS, **how)
    notes(result.warnings)
    for line in filter(None, (result.first_sentence, verdict_sentence(result))):
        click.echo(line)
    click.echo(
        f"Open {out / 'report.html'} in a browser, {out / 'gap.gpkg'} in QGIS; "
        f"{out / 'model' / 'config.toml'} has {file_has(result.advice.recommended)}"
        f"{'' if result.advice.short is None else ', and is not recommended'}."
    )
    if with_map:
        from sassgis.runs.compare import map_change

        with ProgressBar() as progress:
            model = out / "model" / "config.toml"
            change = map_change(config, model, out / MAP_NAME, given["jobs"], say=progress.say)
        printed(change)
