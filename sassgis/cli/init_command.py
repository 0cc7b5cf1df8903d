"""``sassgis init``."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    short_help="Write a configuration: the lines that every site decides.",
    epilog="Example: sassgis init --dem terrain/terrain.vrt --release site.gpkg",
)
@click.argument("file", type=click.Path(path_type=Path), default="sassgis.toml")
@click.option("--dem", type=click.Path(path_type=Path), help="Terrain model: raster or folder.")
@click.option(
    "--release",
    type=click.Path(path_type=Path),
    help="Release areas; or a GeoPackage of `sassgis new`, whose drawn layers are all used.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set a key, as release.spacing_m=5; may be given several times.",
)
@click.option("--all", "every", is_flag=True, help="Every key, with its meaning and default.")
@click.option("--overwrite", is_flag=True, help="Replace a file that nobody has changed.")
def init(
    file: Path,
    dem: Path | None,
    release: Path | None,
    settings: tuple[str, ...],
    every: bool,
    overwrite: bool,
) -> None:
    """Write a configuration to FILE (default: sassgis.toml): the lines that every site decides."""
    from sassgis.io.read.start_keys import start_keys, with_values
    from sassgis.io.write.config_template import config_template, short_template, write_new

    given = with_values(start_keys(file.parent, dem, release), settings)
    text = config_template(given) if every else short_template(given)
    write_new(file, text, overwrite)
    names = [name for name, path in (("terrain.dem", dem), ("release.file", release)) if not path]
    todo = f"Fill in {' and '.join(names)}, then: " if names else "Now: "
    click.echo(f"Wrote {file}. {todo}sassgis validate {file}")
