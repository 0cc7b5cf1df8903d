"""Where, why and how far were blocks of the former classes off at Tschamut?

    python pipelines/gap_tschamut2014.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folders ``tschamut2014`` (A. Volkwein and W. Gerber 2018, Repetitive trajectory
testing in Tschamut 2014, EnviDat, doi 10.16904/envidat.34; ODbL), ``authume_quarry_p1`` and
``chant_sura_2020``. The configuration has the ground classes from before the ground resisted with
the speed. ``sassgis gap diagnose`` answers on half of the runs and on all; then resistance, rebound
and others are added step by step, fitted to the same half, and scored on the other half and at both
other sites. Writes configuration, observations, diagnoses, ``results.json`` and figures.

The terrain was not surveyed: it is a surface of 5 m cells interpolated from the heights of the
tracked rocks, clipped 10 m beyond them. Stops are last positions of the tracking. Three blocks were
released repeatedly: the unit of resampling is the run, not the block.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from field_cases.added_steps import added_steps, former_sections
from field_cases.figures import steps_figure
from field_cases.sites import Site, authume, tschamut
from field_cases.study import study
from field_cases.tables import field_file, fresh, in_one_line, parser

from sassgis.report.figures import save


def write(data: Path, out: Path) -> Site:
    """Write the case with the former classes."""
    field_file(data, "tschamut2014", "release_points.csv")
    return tschamut(data, out, more=former_sections(out))


def main(argv: list[str] | None = None) -> None:
    """Write the case, diagnose, add step by step."""
    given = parser(__doc__).parse_args(argv)
    out = fresh(given.output)
    site = write(given.data, out)
    more = {}
    if not given.case_only:
        folder = fresh(out / "authume")
        quarry = authume(given.data, folder, more=former_sections(folder))
        more["steps"] = added_steps(site, quarry, given.data, given.jobs, given.seed)
        save(steps_figure(more["steps"]), out / "steps.png")
    # The steps have their own scores on the other half.
    sides = {"half of the runs": (site.case.splits["halves"][0], ""), "all runs": ("all", "")}
    study(replace(site.case, splits=sides), given, site.groups, more)


if __name__ == "__main__":
    in_one_line(main)
