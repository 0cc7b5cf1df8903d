"""Does the diagnosis name an effect in runs of another program, in which none was added?

    python pipelines/gap_authume_program.py [DATA] -o OUT [--jobs 2] [--campaigns 12]

DATA holds the folders ``authume_rockable_p1`` (1,024 runs of the discrete-element program Rockable
with real block shapes, B. Garcia et al. 2022, Eng. Geol. 310, 106855: output of a model, not
observations) and ``authume_quarry_p1``. The data state no licence: apart from ``results.json`` the
files in OUT must not be passed on.

Each campaign is noted by an observer with faults, and diagnosed as a user would. One of four has
speeds 1.2 times as high, one of four its starts stated 15 m further down; half has nothing. Writes
``results.json``.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import shapely
from field_cases import tables
from field_cases.program_campaigns import ProgramRuns, campaign
from field_cases.sites import AUTHUME_ZONES, SLOPE_ZONE, Site, quarry, written

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.runs.diagnose import diagnose

#: What is put on the runs, and the cause that it is.
EFFECTS = {"": "", "scale": "measurement_error", "start": "release_error"}
_IN_TURN = ("", "", "scale", "start")


@dataclass(frozen=True)
class Design:
    """One campaign."""

    number: int
    rocks: int
    everything: bool
    effect: str


def designs(n: int) -> list[Design]:
    """100 rocks with everything and 40 rocks at stations and stops by turns."""
    return [
        Design(k, 100 if k % 2 == 0 else 40, k % 2 == 0, _IN_TURN[(k // 2) % 4]) for k in range(n)
    ]


def write(data: Path, runs: ProgramRuns, design: Design, out: Path) -> Site:
    """Write one campaign as a user has it."""
    seen = campaign(
        runs, design.rocks, design.everything, design.effect, tables.SEED + design.number
    )
    slope = AUTHUME_ZONES[SLOPE_ZONE]
    blocks = {"blocks": f"drop_m = {list(seen.drop_m)}"}
    points = [shapely.Point(*xy) for xy in seen.rocks[["x", "y"]].to_numpy()]
    notes = ["runs of a discrete-element program, not observations", f"effect: {design.effect}"]
    site = written(
        "Authume, another program", out, {**quarry(data, slope), **blocks}, slope, seen.rocks,
        points, {}, seen.metadata, notes,
    )  # fmt: skip
    tables.write_tables(site.case.observations["all"], seen.tables, seen.metadata)
    tables.check(site.case)
    return site


def answered(site: Site, design: Design, out: Path, jobs: int, seed: int) -> dict[str, Any]:
    """The diagnosis of one campaign, and what was true."""
    found = diagnose(site.case.config, site.case.observations["all"], out, jobs=jobs, seed=seed)
    verdict = found.verdict
    prints = sorted(
        (f for f in found.fingerprints if f.observable and f.z > 0.0), key=lambda f: -f.z
    )
    return {
        "rocks": design.rocks, "everything": design.everything, "truth": EFFECTS[design.effect],
        "effect": verdict.effect, "group": verdict.group, "base": verdict.base,
        "confidence": verdict.confidence, "confusion_set": verdict.confusion_set,
        "first_sentence": found.first_sentence,
        "fingerprints": {f.statistic: f.z for f in prints[:5]},
    }  # fmt: skip


def counted(rows: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Answers by what was true."""
    found: dict[str, Counter[str]] = {}
    for row in rows:
        truth, effect = row["truth"], row["effect"]
        names = [] if effect not in CAUSES or effect == "contact_law" else [effect]
        kind = ("right" if truth in names else "wrong") if names else "none named"
        found.setdefault(truth or "no effect", Counter())[kind] += 1
    return {name: dict(counts) for name, counts in found.items()}


def main(argv: list[str] | None = None) -> None:
    """Write and diagnose all campaigns."""
    parser = tables.parser(__doc__)
    parser.add_argument("--campaigns", type=int, default=12)
    given = parser.parse_args(argv)
    out, runs = tables.fresh(given.output), ProgramRuns.read(given.data)
    rows: list[dict[str, Any]] = []
    for design in designs(given.campaigns):
        folder = out / f"{design.number:02d}"
        folder.mkdir()
        site = write(given.data, runs, design, folder)
        if not given.case_only:
            rows.append(answered(site, design, folder / "answer", given.jobs, given.seed))
            tables.write_json(out / "results.json", {"answers": counted(rows), "campaigns": rows})


if __name__ == "__main__":
    tables.in_one_line(main)
