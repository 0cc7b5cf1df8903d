"""``sassgis schema``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from sassgis.cli.options import OVERWRITE


@click.command(
    short_help="Write the JSON Schema with which editors complete keys.",
    epilog="Example: sassgis schema",
)
@click.argument("file", type=click.Path(path_type=Path), default="sassgis.schema.json")
@OVERWRITE
def schema(file: Path, overwrite: bool) -> None:
    """Write the JSON Schema of the configuration to FILE (default: sassgis.schema.json)."""
    from sassgis.io.read.config import config_schema
    from sassgis.io.write.config_template import write_new

    write_new(file, json.dumps(config_schema(), indent=1, ensure_ascii=False) + "\n", overwrite)
    click.echo(f"Wrote {file}. First line of the configuration, for editors: #:schema {file.name}")
