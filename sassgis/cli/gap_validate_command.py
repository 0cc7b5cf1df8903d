"""``sassgis gap validate``."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    "validate",
    short_help="Check observations, and what they can tell.",
    epilog="Example: sassgis gap validate observed --config sassgis.toml",
)
@click.argument("observations", type=click.Path(path_type=Path))
@click.option("--config", type=click.Path(path_type=Path), help="Compare them with its terrain.")
def validate_observations(observations: Path, config: Path | None) -> None:
    """Read OBSERVATIONS and say what is wrong with them and what they can tell."""
    from sassgis.gap.which.identifiable import what_is_identifiable
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
    found = what_is_identifiable(read)
    click.echo(f"{found.rocks} rocks, {found.unattributed} blocks of unknown origin")
    for quantity in found.quantities:
        click.echo(
            f"  {quantity.name} ({quantity.table}): {quantity.values} values of "
            f"{quantity.rocks} rocks"
        )
    for line in found.not_identifiable:
        click.echo(f"cannot tell: {line}")
