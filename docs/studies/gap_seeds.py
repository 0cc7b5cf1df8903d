"""Whether the answers of a blinded check move with the seed of the diagnosis.

``python docs/studies/gap_seeds.py CHECK -o FOLDER --seeds 2 3 --jobs 2`` diagnoses the sites of the
folder that ``sassgis gap check -o CHECK`` wrote again, with other seeds, keeps the counts in
``docs/studies/gap_check/seeds.json`` and rewrites what stands between ``<!-- seeds -->`` and
``<!-- end seeds -->`` of docs/gap_check.md. A site that FOLDER has is not diagnosed again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from study_tables import between_marks

from sassgis import diagnose

HERE = Path(__file__).parent
KEPT = HERE / "gap_check" / "seeds.json"
PAGE = HERE.parent / "gap_check.md"
NOT_NAMED = ("none", "unknown", "contact_law")


def diagnosed(case: Path, folder: Path, seed: int) -> None:
    """Diagnose a site, if it is not yet."""
    if not (folder / "diagnosis.json").exists():
        diagnose(
            case / "config.toml", case / "observations", folder, jobs=1, seed=seed, overwrite=True
        )


def verdict(folder: Path) -> dict[str, Any]:
    """Answer, whether an effect is named, confidence and confusion set of a diagnosis."""
    whole = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    found: dict[str, Any] = whole["verdict"]
    named = found["effect"] not in NOT_NAMED
    return found | {"named": named, "set": sorted(found["confusion_set"])}


def counted(pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> dict[str, Any]:
    """How many of pairs of answers, of the first seed and of another, agree."""
    named = [(a, b) for a, b in pairs if a["named"] or b["named"]]
    both = [(a, b) for a, b in pairs if a["effect"] == b["effect"] and a["confidence"] is not None]
    return {
        "answers": len(pairs),
        "same": sum(a["effect"] == b["effect"] for a, b in pairs),
        "named": len(named),
        "named_same": sum(a["effect"] == b["effect"] for a, b in named),
        "sets_same": sum(a["set"] == b["set"] for a, b in pairs),
        "confidence_moves": max(
            (abs(a["confidence"] - b["confidence"]) for a, b in both), default=0.0
        ),
        "other": Counter(
            " / ".join(sorted([a["effect"], b["effect"]]))
            for a, b in pairs
            if a["effect"] != b["effect"]
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
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    cases = sorted((given.check / "cases").iterdir())
    tasks = [
        (case, given.output / str(seed) / case.name, seed) for seed in given.seeds for case in cases
    ]
    with ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn")) as pool:
        for job in [pool.submit(diagnosed, *task) for task in tasks]:
            job.result()
    answers = given.check / "answers"
    pairs = [(verdict(answers / case.name), verdict(folder)) for case, folder, _ in tasks]
    found = {"seeds": given.seeds, "sites": len(cases)} | counted(pairs)
    KEPT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(between_marks(text, "seeds", page_part(found)), encoding="utf-8")


if __name__ == "__main__":
    main()
