"""``sassgis frequency``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import AS_JSON
from sassgis.cli.progress_bar import print_json

_ABOVE_0 = click.FloatRange(min=0.0, min_open=True)


@click.command(
    short_help="Onset frequencies of scenarios from block volumes.",
    epilog="Example: sassgis frequency blocks.csv --complete-from 0.1 --years 40 "
    "--scenarios 0.1,1,10",
)
@click.argument("blocks", type=click.Path(path_type=Path))
@click.option(
    "--complete-from", type=_ABOVE_0, required=True, metavar="M3",
    help="Volume from which on no block was missed.",
)  # fmt: skip
@click.option(
    "--up-to", type=_ABOVE_0, metavar="M3", help="Largest possible volume; default: none."
)
@click.option("--scenarios", default="", metavar="M3,M3,...", help="Limits of the scenarios.")
@click.option("--years", type=_ABOVE_0, help="Years in which the blocks were released.")
@click.option(
    "--rate", type=_ABOVE_0, help="Blocks a year from that volume on, in place of --years."
)
@click.option("--area-ha", type=_ABOVE_0, help="Release area of all of them (ha).")
@click.option("--length-m", type=_ABOVE_0, help="Length of the release line, in place of it (m).")
@AS_JSON
def frequency(
    blocks: Path,
    complete_from: float,
    up_to: float | None,
    scenarios: str,
    years: float | None,
    rate: float | None,
    area_ha: float | None,
    length_m: float | None,
    as_json: bool,
) -> None:
    """Fit a power law to the volumes in BLOCKS (CSV), and print onset frequencies.

    BLOCKS has a column volume_m3, or from_m3, to_m3 and count.
    """
    from sassgis.runs.scenario_frequencies import Onsets, scenario_frequencies

    if years is not None and rate is not None:
        raise click.UsageError("give one of --years and --rate")
    if area_ha is not None and length_m is not None:
        raise click.UsageError("give one of --area-ha and --length-m")
    try:
        limits = [float(part) for part in scenarios.split(",") if part.strip()]
    except ValueError:
        raise click.UsageError("--scenarios are volumes with commas between, as 0.1,1,10") from None
    if area_ha is not None:
        onsets = Onsets(years, rate, area_ha, "per_year_ha")
    elif length_m is not None:
        onsets = Onsets(years, rate, length_m, "per_year_m")
    else:
        onsets = Onsets(years, rate)
    found = scenario_frequencies(blocks, complete_from, up_to, limits, onsets)
    if as_json:
        print_json(found.as_dict())
        return
    for line in found.lines():
        click.echo(line)
