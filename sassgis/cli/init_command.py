"""``sassgis init``."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("file", type=click.Path(path_type=Path), default="sassgis.toml")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
def init(file: Path, overwrite: bool) -> None:
    """Write a commented configuration to FILE (default: sassgis.toml)."""
    from sassgis.io.write.config_template import config_template
    from sassgis.model.errors import OutputError

    if file.exists() and not overwrite:
        raise OutputError(f"{file}: exists; choose another name, or --overwrite")
    try:
        file.write_text(config_template(), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror}") from error
    click.echo(f"Wrote {file}. Fill in the paths, then: sassgis validate {file}")
