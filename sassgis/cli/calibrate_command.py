"""``sassgis calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import CONFIG, JOBS, OUT, OVERWRITE, cluster_options, who_works
from sassgis.cli.progress_bar import ProgressBar

_PATH = click.Path(path_type=Path)


@click.command(
    short_help="Fit ground classes to observations.",
    epilog="Example: sassgis calibrate sassgis.toml --observations observed -o calibrated",
)
@CONFIG
@click.option(
    "--observations",
    required=True,
    type=_PATH,
    help="A GeoPackage, or a folder of CSV files.",
)
@click.argument("more", nargs=-1, type=_PATH)
@OUT
@click.option(
    "--class",
    "classes",
    multiple=True,
    help="Calibrate only this ground class; may be given several times.",
)
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    help="Calibrate only this parameter; may be given several times.",
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=1, show_default=True)
@JOBS
@cluster_options
@click.option(
    "--draws",
    type=click.IntRange(16, 100_000),
    help="Parameter sets to begin with; more take longer and settle the result.",
)
@OVERWRITE
def calibrate(
    config: Path,
    observations: Path,
    more: tuple[Path, ...],
    out: Path,
    classes: tuple[str, ...],
    parameters: tuple[str, ...],
    seed: int,
    jobs: int | None,
    scheduler: str | None,
    workers: int | None,
    draws: int | None,
    overwrite: bool,
) -> None:
    """Fit ground classes to OBSERVATIONS; MORE sites as pairs: CONFIG2 OBS2 ...

    The same command goes on after an interruption.
    """
    from sassgis.report.calibration_report import calibration_warnings, verdict
    from sassgis.runs.calibrate import calibrate as run_calibration

    if len(more) % 2:
        raise click.UsageError(f"{more[-1]}: a configuration without observations; give pairs")
    sites = [(config, observations), *zip(more[::2], more[1::2], strict=True)]
    with who_works(jobs, scheduler, workers) as working, ProgressBar() as progress:
        result = run_calibration(
            sites,
            out,
            classes=classes or None,
            parameters=parameters or None,
            jobs=working,
            seed=seed,
            draws=draws,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    for warning in calibration_warnings(result):
        click.echo(f"Note: {warning}", err=True)
    click.echo(verdict(result))
    click.echo(f"Open {out / 'report.html'} in a browser; run {out / 'config.toml'}.")
