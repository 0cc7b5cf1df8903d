"""Is the run-out at Tschamut wrong, because of which effect, and how far does the gap shrink?

    python pipelines/gap_tschamut2014.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``tschamut2014`` (A. Volkwein and W. Gerber 2018, Repetitive trajectory
testing in Tschamut 2014, EnviDat, doi 10.16904/envidat.34; ODbL). Writes configuration, terrain,
observations of all runs and of two splits, the diagnoses, and ``results.json``. The terrain was not
surveyed: it is a surface of 5 m cells interpolated from the heights of the tracked rocks, clipped
10 m beyond them. Stops are last positions of the tracking. Three blocks were released repeatedly:
the unit of resampling is the run, not the block.
"""

from __future__ import annotations

from pathlib import Path

from field_cases import tables
from field_cases.sites import Site, tschamut
from field_cases.study import study

from sassgis.model.errors import SassgisError


def write(data: Path, out: Path) -> Site:
    """Write the case: each rock in the tables is one run."""
    return tschamut(data, out)


def main(argv: list[str] | None = None) -> None:
    """Write the case, diagnose it on one half and score on the other."""
    given = tables.parser(__doc__).parse_args(argv)
    site = write(given.data, tables.fresh(given.output))
    study(site.case, given, site.groups)


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
