"""Whether the answers of a blinded check move with the seed of the diagnosis.

``python docs/studies/gap_seeds.py CHECK -o FOLDER --seeds 2 3 --jobs 2`` diagnoses the sites of the
folder that ``python pipelines/gap_check -o CHECK`` wrote again, with other seeds, keeps the
counts in ``docs/studies/gap_check/seeds.json`` and rewrites what stands between the marks
``<!-- seeds -->`` of docs/gap_check.md. A site that FOLDER has is not diagnosed again.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[2] / "pipelines"))

from gap_check.answers import Answer, answer_from, in_order, names_in
from study_tables import replaced

from sassgis import diagnose

KEPT = Path(__file__).parent / "gap_check"
PAGE = Path(__file__).parents[1] / "gap_check.md"


def diagnosed(case: Path, folder: Path, seed: int) -> None:
    """Diagnose a site, if it is not yet."""
    if not (folder / "diagnosis.json").exists():
        diagnose(
            case / "config.toml", case / "observations", folder, jobs=1, seed=seed, overwrite=True
        )


def answer(folder: Path) -> Answer:
    """What a diagnosis answered."""
    found = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    return answer_from(folder.name, found)


def counted(pairs: list[tuple[Answer, Answer]]) -> dict[str, Any]:
    """How many of pairs of answers, of the first seed and of another, agree."""
    same = [(a, b) for a, b in pairs if in_order(a.effect) == in_order(b.effect)]
    named, named_same = (
        sum(bool(names_in(a.effect) | names_in(b.effect)) for a, b in own) for own in (pairs, same)
    )
    moves = [abs(a.confidence - b.confidence) for a, b in same if math.isfinite(a.confidence)]
    return {
        "answers": len(pairs),
        "same": len(same),
        "named": named,
        "named_same": named_same,
        "sets_same": sum({*a.confusion_set} == {*b.confusion_set} for a, b in pairs),
        "confidence_moves": max(moves, default=0.0),
        "other": Counter(
            " / ".join(sorted([a.effect, b.effect])) for a, b in pairs if (a, b) not in same
        ),
    }


def page_part(found: dict[str, Any]) -> str:
    """The sentence of the page."""
    other = [f"{n} {name.replace('_', ' ')}" for name, n in sorted(found["other"].items())]
    seeds = ", ".join(map(str, found["seeds"]))
    return (
        f"With another seed of the diagnosis ({seeds} in place of 1), {found['same']} of "
        f"{found['answers']} answers are the same, and {found['named_same']} of the "
        f"{found['named']} that name an effect with either seed; answers that differ: "
        f"{', '.join(other) or 'none'}. The confusion set is the same at {found['sets_same']} "
        "sites; where the answer is the same, its confidence moves by "
        f"{found['confidence_moves']:.2f} at most."
    )


def main() -> None:
    """Diagnose, count, rewrite the page."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("check", type=Path)
    asked.add_argument("-o", "--output", type=Path, required=True)
    asked.add_argument("--seeds", type=int, nargs="+", default=[2, 3])
    asked.add_argument("--sites", type=int, help="the first so many; default: all")
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    cases = sorted((given.check / "cases").iterdir())[: given.sites]
    tasks = [
        (case, given.output / str(seed) / case.name, seed) for seed in given.seeds for case in cases
    ]
    with ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn")) as pool:
        for job in [pool.submit(diagnosed, *task) for task in tasks]:
            job.result()
    answers = given.check / "answers"
    pairs = [(answer(answers / case.name), answer(folder)) for case, folder, _ in tasks]
    found = {"seeds": given.seeds, "sites": len(cases)} | counted(pairs)
    (KEPT / "seeds.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    replaced(PAGE, "seeds", page_part(found))


if __name__ == "__main__":
    main()
