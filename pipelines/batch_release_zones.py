"""What does each release area of a configuration do on its own?

    python pipelines/batch_release_zones.py CONFIG -o OUT

Every release area gets its own result folder in OUT, and ``OUT/summary.csv`` a row: release points,
rocks, longest run-out, stations and barriers that rocks come to, and how long it took. An area that
cannot be run is reported there and skipped. The rocks of an area are those that it has in a run of
all areas together.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from sassgis.core.errors import InputError, SassgisError
from sassgis.io.config import load_config
from sassgis.io.vectors import release_names
from sassgis.workflow.map_report import file_stems
from sassgis.workflow.run import RunResult, run
from sassgis.workflow.tables import write_table


def row_of(result: RunResult) -> dict[str, object]:
    """What the summary says of an area that was run."""
    gates = result.progress.gates
    came = [g.name for i, g in enumerate(gates.gates) if gates.arrivals(i)]
    furthest = result.progress.furthest
    return {
        "points": len(result.planned.points),
        "rocks": result.rocks,
        "furthest_m": None if furthest is None else round(furthest[0], 2),
        "reached": ";".join(came),
        "status": "done",
        "seconds": round(result.seconds, 2),
    }


def main(argv: list[str] | None = None) -> None:
    """Run area by area and write the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("config", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--overwrite", action="store_true")
    given = parser.parse_args(argv)
    config = load_config(given.config)
    names = release_names(config.release)
    rows: list[dict[str, object]] = []
    for name, stem in zip(names, file_stems(names), strict=True):
        row: dict[str, object] = {"area": name, "folder": stem}
        try:
            result = run(
                config, given.output / stem, areas=[name], jobs=given.jobs,
                overwrite=given.overwrite,
            )  # fmt: skip
            row |= row_of(result)
        except InputError as error:
            row |= {"status": f"skipped: {error}"}
        rows.append(row)
        print(f"{name}: {row['status']}")
    columns = ["area", "folder", "points", "rocks", "furthest_m", "reached", "status", "seconds"]
    summary = pd.DataFrame(rows, columns=columns).astype({"points": "Int64", "rocks": "Int64"})
    write_table(given.output / "summary.csv", [summary])
    if not any(row["status"] == "done" for row in rows):
        raise InputError("no release area could be run", file=given.config)


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
