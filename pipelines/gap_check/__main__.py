"""How often is the diagnosis of a gap right, on synthetic sites whose truth it does not see?

    python pipelines/gap_check --worlds N --seed S [--law own|elastic|plastic] [--jobs 2] -o OUT

Makes N sites, lets ``sassgis.runs.diagnose`` answer on each with blinded labels, and writes
``scores.json``, ``worlds.csv`` and ``confusion.png``; docs/gap_check.md describes all of it. The
same command goes on after an interruption. Laws ``elastic`` and ``plastic`` need
``pip install "sassgis[mujoco]"``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

# Scripts import what lies beside them: here the folder itself.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gap_check.check import check, sites_of
from gap_check.worlds import LAWS
from sassgis.errors import SassgisError


def main(argv: list[str] | None = None) -> None:
    """Check, and print each share with its sites; SystemExit with one line if it cannot be made."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n", 1)[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--worlds", type=int, default=150, help="number of sites")
    parser.add_argument("--seed", type=int, default=2026, help="of the battery")
    parser.add_argument("--law", choices=LAWS, help="of the motion at all sites; else all in turn")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the check")
    given = parser.parse_args(argv)
    laws = (given.law,) if given.law else LAWS
    try:
        scores = check(
            given.output,
            sites_of(given.seed, given.worlds, laws),
            seed=given.seed,
            jobs=given.jobs,
            say=lambda text: print(text, file=sys.stderr),
        )
    except (SassgisError, OSError) as error:
        raise SystemExit(f"Error: {error}") from None
    for share in scores.measures.values():
        print(f"{share.measure}: {share.hits} of {share.trials}")
    print(f"Wrote {given.output / 'scores.json'}")


if __name__ == "__main__":
    main()
