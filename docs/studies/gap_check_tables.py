"""Put the scores of a blinded check into docs/gap_check.md.

``python docs/studies/gap_check_tables.py CHECK`` takes scores and figures from the folder that
``sassgis gap check -o CHECK`` wrote, keeps them in ``docs/studies/gap_check`` and rewrites what
stands between ``<!-- check -->`` and ``<!-- end check -->``. Without CHECK it uses those kept.
"""

from __future__ import annotations

import csv
import json
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from study_tables import between_marks

HERE = Path(__file__).parent
KEPT = HERE / "gap_check"
PAGE = HERE.parent / "gap_check.md"
FIGURES = ("confusion.png", "reliability.png", "shrinkage.png")


def percent(value: float | None) -> str:
    """A share in per cent; a dash where there is none."""
    return "–" if value is None else f"{100.0 * value:.0f} %"


def value_of(row: dict[str, Any], key: str) -> str:
    """A share in per cent, or a number with two digits."""
    value = row[key]
    return percent(value) if row["is_share"] or value is None else f"{value:.2f}"


def count_of(row: dict[str, Any]) -> str:
    """Sites, where it is a share."""
    return f"{row['hits']} of {row['worlds']}" if row["is_share"] else ""


def interval(limits: list[float | None] | None) -> str:
    """An interval of shares; empty for what is none."""
    if limits is None:
        return ""
    return f"{percent(limits[0])} to {percent(limits[1])}"


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]


def share_row(name: str, share: dict[str, Any]) -> list[str]:
    """Name, share, counts, interval."""
    counts = f"{share['hits']} of {share['trials']}"
    return [name, percent(share["value"]), counts, interval([share["low"], share["high"]])]


def page_part(scores: dict[str, Any], worlds: list[dict[str, str]]) -> str:
    """The part of the page that comes from the scores and the list of sites."""
    met = {True: "yes", False: "**no**", None: "–"}
    lines = table(
        ["measure", "required", "reached", "sites", "95 % interval", "met"],
        [
            [
                row["measure"],
                f"{row['asked_is']} {value_of(row, 'asked')}",
                value_of(row, "reached"),
                count_of(row),
                interval(row["ci95"]),
                met[row["met"]],
            ]
            for row in scores["acceptance"]
        ],
    )
    laws = {law: own["acceptance"] for law, own in scores["by_law"].items()}
    lines += ["", "The same by law of the motion:", ""]
    lines += table(
        ["measure", *laws],
        [
            [rows[0]["measure"], *(f"{value_of(r, 'reached')} ({count_of(r)})" for r in rows)]
            for rows in zip(*laws.values(), strict=True)
        ],
    )
    lines = [line.replace(" ()", "") for line in lines]
    lines += ["", "All other measures:", ""]
    asked = {row["key"] for row in scores["acceptance"]}
    lines += table(
        ["measure", "reached", "sites", "95 % interval"],
        [share_row(m["measure"], m) for k, m in scores["measures"].items() if k not in asked],
    )
    for title, rows in scores["single_effects_named_by"].items():
        lines += ["", f"Single effects named, by {title}:", ""]
        lines += table(
            [title, "named", "sites", "95 % interval"], [share_row(r["measure"], r) for r in rows]
        )
    lines += unknown_part(worlds)
    check = scores["shrinkage"]
    error, bias = check["mean_error"], check["bias"]
    lines += [
        "",
        f"Shrinkage: {check['compared']} sites with one stated and one measured"
        + (
            f"; mean error {error:.2f}, bias {bias:+.2f}; "
            if error is not None and bias is not None
            else "; "
        )
        + f"stated only {check['only_stated']}, measured only {check['only_measured']}, "
        f"neither {check['neither']}.",
        "",
        f"Calibration error: {scores['numbers']['calibration_error']:.2f}; so few answers, each "
        "right with the stated confidence, have "
        f"{scores['numbers']['calibration_error_by_chance']:.2f} in the mean.",
    ]
    return "\n".join(lines)


def unknown_part(worlds: list[dict[str, str]]) -> list[str]:
    """Answers to unknown effects, by kind."""
    own = [w for w in worlds if w["truth"] == "unknown"]
    rows = []
    for kind in sorted({w["effects"] for w in own}):
        answers = Counter(w["answer"].replace("_", " ") for w in own if w["effects"] == kind)
        rows.append([kind, ", ".join(f"{answer} {n}" for answer, n in answers.most_common())])
    head = ["unknown effect", "answers"]
    return ["", "Answers to unknown effects, by kind:", "", *table(head, rows)]


def replaced(page: Path, name: str, part: str) -> None:
    """Put a part between its two marks."""
    text = page.read_text(encoding="utf-8")
    page.write_text(between_marks(text, name, part), encoding="utf-8")


def main() -> None:
    """Rewrite the pages."""
    if len(sys.argv) > 1:
        KEPT.mkdir(exist_ok=True)
        for name in ("scores.json", "worlds.csv", *FIGURES):
            if (Path(sys.argv[1]) / name).is_file():
                shutil.copyfile(Path(sys.argv[1]) / name, KEPT / name)
    scores = json.loads((KEPT / "scores.json").read_text(encoding="utf-8"))
    with (KEPT / "worlds.csv").open(encoding="utf-8", newline="") as file:
        worlds = list(csv.DictReader(file))
    replaced(PAGE, "check", page_part(scores, worlds))


if __name__ == "__main__":
    main()
