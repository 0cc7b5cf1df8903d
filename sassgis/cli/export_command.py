"""``sassgis export``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import OVERWRITE


@click.command(
    short_help="Write zones as INTERLIS 2 (model 166.1).",
    epilog="Example: sassgis export zones --xtf zones.xtf",
)
@click.argument("result", type=click.Path(path_type=Path))
@click.option(
    "--xtf", required=True, type=click.Path(path_type=Path), help="INTERLIS file to write."
)
@click.option(
    "--models",
    type=click.Path(path_type=Path),
    help="Folder with the model's .ili files: ilivalidator checks the file against them.",
)
@click.option("--validate", is_flag=True, help="Do not write without such a check.")
@click.option("--canton", help="Code of the canton that is responsible for the data, as TI.")
@OVERWRITE
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
