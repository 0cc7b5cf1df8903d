"""The command line: thin, and quick to answer, as everything heavy is imported when it is used."""

from __future__ import annotations

import logging
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from sassgis import __version__
from sassgis.model.errors import Interrupted, SassgisError

_OUT = click.option(
    "-o", "--output", "out", required=True, type=click.Path(path_type=Path), help="Folder to write."
)
_CONFIG = click.argument("config", type=click.Path(path_type=Path))
_OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace a result that is there.")
_SEED = click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), help="In place of run.seed of the configuration."
)
_AREAS = click.option(
    "--area", "areas", multiple=True, help="Only this release area; may be given several times."
)
_JOBS = click.option("--jobs", type=click.IntRange(0), help="Processor cores; 0: all.")


class _Progress:
    """A bar with the time left on a terminal; a line now and then in a log.

    A context manager: the line of the bar ends with it, however it is left.
    """

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._began: tuple[float, int] | None = None
        self._told = time.monotonic()
        self._open = False

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def say(self, text: str) -> None:
        self.close()
        click.echo(f"{text} ...", err=True)

    def step(self, done: int, total: int, rocks: int) -> None:
        now = time.monotonic()
        # The first chunk tells no pace: it waits for the program to be compiled, and in a run that
        # goes on from a saved state all before it was done another time.
        if self._began is None or done < self._began[1]:
            self._began = (now, done)
        since, first = self._began
        pace = (now - since) / (done - first) if done > first else None
        left = "" if pace is None else f", about {_clock(pace * (total - done))} left"
        if self._terminal:
            if now - self._told < 0.1 and done < total:
                return
            width = 28
            filled = width * done // total
            bar = "#" * filled + "-" * (width - filled)
            click.echo(
                f"\r  [{bar}] {100 * done // total:3d} %, {rocks} rocks{left}  ",
                nl=False,
                err=True,
            )
            self._open = True
        elif now - self._told >= 30.0:
            click.echo(f"  {100 * done // total} %, {rocks} rocks{left}", err=True)
        else:
            return
        self._told = now

    def close(self) -> None:
        if self._open:
            click.echo("", err=True)
            self._open = False


def _conclude(warnings: Sequence[str], summary: str, folder: Path) -> None:
    """Say how a simulation came out and where to look at it."""
    for warning in warnings:
        click.echo(f"Note: {warning}", err=True)
    click.echo(summary)
    click.echo(f"Open {folder / 'project.qgz'} in QGIS, {folder / 'report.html'} in a browser.")


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="sassgis")
@click.option("--debug", is_flag=True, help="Show the full traceback of an error.")
def cli(debug: bool) -> None:
    """Rockfall hazard zoning with the SASS model of Bozzolo and Pamini (1986)."""


@cli.command()
@click.argument("file", type=click.Path(path_type=Path), default="sassgis.toml")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
def init(file: Path, overwrite: bool) -> None:
    """Write a commented configuration to FILE (default: sassgis.toml)."""
    from sassgis.io.read.config import config_template
    from sassgis.model.errors import OutputError

    if file.exists() and not overwrite:
        raise OutputError(f"{file}: exists; choose another name, or --overwrite")
    try:
        file.write_text(config_template(), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror}") from error
    click.echo(f"Wrote {file}. Fill in the paths, then: sassgis validate {file}")


@cli.command()
@_CONFIG
def validate(config: Path) -> None:
    """Read CONFIG and every file that it names, and say what they hold."""
    from sassgis.io.read.check_inputs import check_inputs
    from sassgis.io.read.config import load_config

    settings = load_config(config)
    report = check_inputs(settings)
    for line in report.lines():
        click.echo(line)
    if any(o.frequency is not None for o in settings.onsets.values()) or settings.objects:
        from sassgis.runs.assessment import check_rules

        for line in check_rules(settings, report.terrain):
            click.echo(line)


@cli.command()
@_CONFIG
@_OUT
@_AREAS
@_SEED
@_JOBS
@_OVERWRITE
def run(
    config: Path,
    out: Path,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    overwrite: bool,
) -> None:
    """Simulate CONFIG on the map: maps, GeoPackage, QGIS project, figures, report."""
    from sassgis.runs.run import run as run_map

    with _Progress() as progress:
        result = run_map(
            config,
            out,
            areas=areas or None,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    _conclude(result.warnings, f"{result.rocks} rocks in {result.seconds:.1f} s.", out)


@cli.command()
@_CONFIG
@_OUT
@_AREAS
@_SEED
@_JOBS
@_OVERWRITE
def zone(
    config: Path,
    out: Path,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    overwrite: bool,
) -> None:
    """Simulate CONFIG and make hazard zones: all that run writes, levels, intensities, risk."""
    _zone(config, out, areas, seed, jobs, overwrite)


def _zone(
    config: Path,
    out: Path,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    overwrite: bool,
) -> None:
    from sassgis.runs.zone import zone as make_zones

    with _Progress() as progress:
        result = make_zones(
            config,
            out,
            areas=areas or None,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    hazard = result.found.hazard
    summary = (
        f"{result.run.rocks} rocks, {hazard.levels.polygons.size} zones, "
        f"{100 * hazard.undecided_share:.1f} % of the reached cells undecided."
    )
    _conclude(result.run.warnings, summary, out)


@cli.command()
@click.argument("releases", type=click.Path(path_type=Path))
@_OUT
@click.option(
    "-c",
    "--config",
    type=click.Path(path_type=Path),
    help="Everything but the release areas; default: the only TOML file beside them.",
)
@click.option(
    "--dem",
    type=click.Path(path_type=Path),
    help="In place of terrain.dem: a raster, a VRT, or a folder of tiles.",
)
@_SEED
@_JOBS
@click.option(
    "--overwrite", is_flag=True, help="Replace areas that were made from other settings or inputs."
)
def batch(
    releases: Path,
    out: Path,
    config: Path | None,
    dem: Path | None,
    seed: int | None,
    jobs: int | None,
    overwrite: bool,
) -> None:
    """Zone each release area of RELEASES alone, and all of them on one map.

    RELEASES is a vector file, a folder of vector files, or a configuration. The same command goes
    on after an interruption, and runs nothing again that is there.
    """
    from sassgis.runs.batch import batch as run_batch

    with _Progress() as progress:
        result = run_batch(
            releases,
            out,
            config=config,
            dem=dem,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    done = int((result.summary["status"] == "done").sum())
    summary = f"{done} of {len(result.summary)} areas done: {out / 'summary.csv'}"
    _conclude(result.warnings, summary, out / "mosaic")


@cli.command()
@_CONFIG
@_OUT
@click.option(
    "--csv", "csv_file", type=click.Path(path_type=Path), help="Profile: s_m, z_m, ground."
)
@click.option(
    "--point",
    type=(float, float),
    metavar="X Y",
    help="Cut the profile from the terrain, from here.",
)
@click.option("--rocks", type=click.IntRange(1), help="Rocks per block scenario.")
@_SEED
@_OVERWRITE
def profile(
    config: Path,
    out: Path,
    csv_file: Path | None,
    point: tuple[float, float] | None,
    rocks: int | None,
    seed: int | None,
    overwrite: bool,
) -> None:
    """Simulate one profile: trajectories, stations, run-out, energy along the slope."""
    from sassgis.model.errors import ConfigError
    from sassgis.runs.profile import run_profile

    if csv_file is not None and point is not None:
        raise ConfigError("--csv and --point exclude each other", expected="one of them")
    result = run_profile(
        config, out, csv_file=csv_file, point=point, rocks=rocks, seed=seed, overwrite=overwrite
    )
    click.echo(f"{result.rocks.size} rocks. Open {out / 'report.html'} in a browser.")


@cli.command()
@click.argument("result", type=click.Path(path_type=Path))
@click.option(
    "--xtf", required=True, type=click.Path(path_type=Path), help="INTERLIS file to write."
)
@click.option(
    "--models", type=click.Path(path_type=Path), help="Folder with the model's .ili files."
)
@click.option("--validate", is_flag=True, help="Check the file with ilivalidator.")
@click.option("--canton", help="Code of the canton that is responsible for the data, as TI.")
@_OVERWRITE
def export(
    result: Path,
    xtf: Path,
    models: Path | None,
    validate: bool,
    canton: str | None,
    overwrite: bool,
) -> None:
    """Write the zones of the folder RESULT as INTERLIS 2 (model 166.1, EPSG:2056)."""
    from sassgis.io.interlis.transfer import export_xtf
    from sassgis.model.errors import OutputError

    exported = export_xtf(result, xtf, models, validate, canton=canton, overwrite=overwrite)
    for line in exported.lines():
        click.echo(line)
    if not exported.accepted:
        raise OutputError(f"{xtf}: the validator does not accept it; its messages are above")


@cli.group()
def gap() -> None:
    """Observations in the field, to be compared with the simulation."""


@gap.command()
@click.argument("path", type=click.Path(path_type=Path))
def template(path: Path) -> None:
    """Write empty tables of observations: a .gpkg, or a folder of CSV files."""
    from sassgis.io.read.observation_files import observations_template

    click.echo(f"Wrote {observations_template(path)}. Leave out what you did not measure.")


@gap.command()
@_CONFIG
@click.option(
    "--observations",
    required=True,
    type=click.Path(path_type=Path),
    help="A GeoPackage, or a folder of CSV files.",
)
@_OUT
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=1, show_default=True)
@_JOBS
@click.option(
    "--draws",
    type=click.IntRange(8, 1000),
    help="Parameter sets of each contender; more take longer and tell effects apart better.",
)
@click.option(
    "--ground-range",
    type=click.FloatRange(0.1, 10.0),
    default=1.0,
    show_default=True,
    help="Factor on how far the ground may be calibrated; above 1 where its classes are guesses.",
)
@click.option("--map", "with_map", is_flag=True, help="Run the map with the calibrated model, too.")
@_OVERWRITE
def diagnose(
    config: Path,
    observations: Path,
    out: Path,
    seed: int,
    jobs: int | None,
    draws: int | None,
    ground_range: float,
    with_map: bool,
    overwrite: bool,
) -> None:
    """Say where simulation and OBSERVATIONS differ, which effect causes it, and how far it helps.

    The same command goes on after an interruption.
    """
    from sassgis.report.gap_answer import verdict_sentence
    from sassgis.runs.diagnose import DRAWS
    from sassgis.runs.diagnose import diagnose as run_diagnosis

    with _Progress() as progress:
        result = run_diagnosis(
            config,
            observations,
            out,
            jobs=jobs,
            seed=seed,
            overwrite=overwrite,
            draws=draws or DRAWS,
            ground_range=ground_range,
            on_progress=progress.step,
            say=progress.say,
        )
    for warning in result.warnings:
        click.echo(f"Note: {warning.removeprefix('warning: ')}", err=True)
    click.echo(verdict_sentence(result))
    click.echo(f"Open {out / 'report.html'} in a browser, {out / 'gap.gpkg'} in QGIS.")
    if with_map:
        from sassgis.runs.gap_map_change import map_change

        with _Progress() as progress:
            change = map_change(
                config, out / "model" / "config.toml", out / "map", jobs, say=progress.say
            )
        for line in change.lines():
            click.echo(line)


@gap.command("validate")
@click.argument("observations", type=click.Path(path_type=Path))
@click.option("--config", type=click.Path(path_type=Path), help="Compare them with its terrain.")
def validate_observations(observations: Path, config: Path | None) -> None:
    """Read OBSERVATIONS and say what is wrong with them and what they can tell."""
    from sassgis.gap.observations.identifiable import what_is_identifiable
    from sassgis.io.read.config import load_config
    from sassgis.io.read.observation_files import read_observations
    from sassgis.io.read.observation_files import validate_observations as check
    from sassgis.io.read.tiles import read_terrain

    grid = None
    if config is not None:
        settings = load_config(config)
        terrain = settings.terrain
        grid = read_terrain(settings.dem_path, terrain.crs, terrain.vertical_datum)
    read = read_observations(observations, grid)
    for finding in check(read, grid):
        click.echo(str(finding))
    told = what_is_identifiable(read)
    click.echo(f"{told.rocks} rocks, {told.unattributed} blocks of unknown origin")
    for quantity in told.quantities:
        click.echo(
            f"  {quantity.name} ({quantity.table}): {quantity.values} values of "
            f"{quantity.rocks} rocks"
        )
    for line in told.not_identifiable:
        click.echo(f"cannot tell: {line}")


@gap.command("check")
@_OUT
@click.option("--worlds", type=click.IntRange(1), default=150, show_default=True)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    default=2026,
    show_default=True,
    help="Of the battery.",
)
@_JOBS
@click.option("--quick", is_flag=True, help="Six small worlds, to see whether everything runs.")
@click.option(
    "--development", is_flag=True, help="Allow a battery on which the thresholds were chosen."
)
def check_diagnosis(
    out: Path, worlds: int, seed: int, jobs: int | None, quick: bool, development: bool
) -> None:
    """Let the diagnosis answer on made worlds with sealed labels, and score it.

    The same command goes on after an interruption.
    """
    from sassgis.gap.check.check_scores import acceptance
    from sassgis.runs.gap_check import check

    with _Progress() as progress:
        result = check(
            out,
            worlds=worlds,
            seed=seed,
            jobs=jobs,
            quick=quick,
            development=development,
            on_progress=progress.step,
            say=progress.say,
        )
    for warning in result.warnings:
        click.echo(f"Note: {warning}", err=True)
    for row in acceptance(result.scores):
        share = f"{100 * row['reached']:.0f} %" if row["worlds"] else "-"
        click.echo(
            f"{row['measure']}: {share} ({row['hits']} of {row['worlds']}; "
            f"asked for: {row['asked_is']} {100 * row['asked']:.0f} %)"
        )
    click.echo(f"Open {out / 'report.html'} in a browser.")


@cli.command()
@_OUT
@_JOBS
@_OVERWRITE
def demo(out: Path, jobs: int | None, overwrite: bool) -> None:
    """Make the zones of the sample valley, a terrain that is made, not surveyed."""
    from sassgis.runs.samples import sample_folder

    _zone(sample_folder() / "valley" / "config.toml", out, (), None, jobs, overwrite)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; errors print as one line and set the exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in given
    logging.basicConfig(level=logging.DEBUG if debug else logging.ERROR, format="%(message)s")
    for chatty in ("numba", "matplotlib", "rasterio", "fiona"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    try:
        code: Any = cli.main(
            args=[a for a in given if a != "--debug"], prog_name="sassgis", standalone_mode=False
        )
    except SassgisError as error:
        _fail(str(error), error.exit_code, debug)
    except click.exceptions.Abort:
        _fail("stopped by the user", Interrupted.exit_code, debug)
    except KeyboardInterrupt:
        _fail("stopped by the user", Interrupted.exit_code, debug)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code, debug)
    except MemoryError:
        _fail("not enough memory; fewer release points or larger cells need less", 1, debug)
    except Exception as error:
        # Compiled code that Ctrl-C strikes turns it into a SystemError.
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            _fail("stopped by the user", Interrupted.exit_code, debug)
        _fail(
            f"unexpected {type(error).__name__}: {' '.join(str(error).split())} "
            "(a fault of sassgis; run again with --debug and report what it says)",
            70,
            debug,
        )
    else:
        sys.exit(code if isinstance(code, int) else 0)


def _fail(text: str, code: int, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    click.echo(f"Error: {text}", err=True)
    sys.exit(code)
