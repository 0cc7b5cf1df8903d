"""Why is the run-out at the Authume quarry too short, and what is the lateral offset of the stops?

    python pipelines/gap_authume.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``authume_quarry_p1`` (B. Garcia et al. 2022, Eng. Geol. 310, 106855; F.
Bourrier et al. 2021, Landslides 18, 639). The data state no licence: the terrain is read from its
folder, and apart from ``results.json`` and the figures the files in OUT must not be passed on.

Writes the configuration, observations of 41 stops and of two halves of them, the diagnoses, and
``results.json``.
"""

from __future__ import annotations

from pathlib import Path

from field_cases import tables
from field_cases.sites import Site, authume
from field_cases.study import study

from sassgis.model.errors import SassgisError


def write(data: Path, out: Path) -> Site:
    """Write the case; the release points of single rocks are not known."""
    return authume(data, out)


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
