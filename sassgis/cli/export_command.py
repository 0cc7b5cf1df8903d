"""``sassgis export``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import OVERWRITE


@click.command()
@click.argument("result", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "--xtf",
    "out",
    required=True,
    type=click.Path(path_type=Path),
    help="File to write: .xtf (INTERLIS 2), .geojson or .kml.",
)
@click.option(
    "--layer",
    type=click.Choice(["zones", "paths"]),
    default="zones",
    show_default=True,
    help="Hazard zones, or paths of blocks in space (not .xtf).",
)
@click.option(
    "--models",
    type=click.Path(path_type=Path),
    help=".xtf: folder with the model's .ili files: ilivalidator checks the file against them.",
)
@click.option("--validate", is_flag=True, help=".xtf: do not write without such a check.")
@click.option("--canton", help=".xtf: code of the canton responsible for the data, as TI.")
@OVERWRITE
def export(
    result: Path,
    out: Path,
    layer: str,
    models: Path | None,
    validate: bool,
    canton: str | None,
    overwrite: bool,
) -> None:
    """Write zones or paths of the folder RESULT for other programs.

    The suffix of the file names the format. INTERLIS 2 is model 166.1 in EPSG:2056; GeoJSON and KML
    are in WGS 84.
    """
    if out.suffix.lower() != ".xtf":
        if models or validate or canton:
            raise click.UsageError("--models, --validate and --canton are for .xtf")
        from sassgis.io.write.view_files import export_view

        click.echo(export_view(result, out, layer, overwrite=overwrite))
        return
    if layer != "zones":
        raise click.UsageError("an .xtf holds zones; write paths as .geojson or .kml")
    from sassgis.io.interlis.transfer import export_xtf
    from sassgis.model.errors import OutputError

    exported = export_xtf(result, out, models, validate, canton=canton, overwrite=overwrite)
    for line in exported.lines():
        click.echo(line)
    if not exported.accepted:
        raise OutputError(f"{out}: the validator does not accept it; its messages are above")
