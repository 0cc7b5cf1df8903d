"""Put the tables of the studies into their pages.

``python docs/studies/tables.py`` rewrites what stands between ``<!-- table: NAME -->`` and
``<!-- end -->`` in the pages of this folder from the committed CSV files.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

HERE = Path(__file__).parent


def rows_of(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file of this folder."""
    with (HERE / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def markdown(head: list[str], body: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rounded(value: str | float, digits: int = 3) -> str:
    """A number with a few significant digits, whole where it is large."""
    number = float(value)
    return f"{number:.0f}" if abs(number) >= 10 ** (digits - 1) else f"{number:.{digits}g}"


def discretisation(slope: str) -> str:
    """Pooled results over the tolerances, with the interval at the default."""
    rows = [r for r in rows_of("discretisation/summary.csv") if r["slope"] == slope]
    tolerances = list(dict.fromkeys(r["tolerance_m"] for r in rows))
    length = {r["tolerance_m"]: r["segment_length_m"] for r in rows}
    body = [["*segment length (m)*", *(f"*{float(length[t]):.1f}*" for t in tolerances), ""]]
    for quantity in dict.fromkeys(r["quantity"] for r in rows):
        some = {r["tolerance_m"]: r for r in rows if r["quantity"] == quantity}
        half = [0.5 * (float(some[t]["high_95"]) - float(some[t]["low_95"])) for t in tolerances]
        body.append(
            [
                quantity,
                *(rounded(some[t]["value"]) for t in tolerances),
                f"± {rounded(max(half), 2)}",
            ]
        )
    return markdown(["tolerance (m)", *tolerances, "sampling, at most"], body)


def lines() -> str:
    """Change of single lines of the valley against the finest tolerance."""
    rows = rows_of("discretisation/lines_valley.csv")
    tolerances = list(dict.fromkeys(r["tolerance_m"] for r in rows))
    quantities = ("run-out 50 % (m)", "run-out 95 % (m)", "E95 at 150 m (kJ)")
    finest = {r["slope"]: r for r in rows if r["tolerance_m"] == tolerances[0]}
    body = []
    for quantity in quantities:
        for word, pick in (("median", 0.5), ("largest", 1.0)):
            cells = []
            for t in tolerances[1:]:
                gaps = sorted(
                    abs(float(r[quantity]) / float(finest[r["slope"]][quantity]) - 1.0)
                    for r in rows
                    if r["tolerance_m"] == t
                    and r[quantity] not in ("", "nan")
                    and finest[r["slope"]][quantity] not in ("", "nan")
                )
                cells.append(f"{100.0 * gaps[round(pick * (len(gaps) - 1))]:.0f} %")
            body.append([f"{quantity.split(' (')[0]}, {word} of the lines", *cells])
    return markdown([f"against {tolerances[0]} m", *(f"{t} m" for t in tolerances[1:])], body)


def splitting() -> str:
    """Polylines with divided segments against the original ones."""
    return markdown(
        [
            "slope",
            "parts",
            "same rocks",
            "mean change (m)",
            "D, same draws",
            "p, other draws",
            "p, uncut",
        ],
        [
            [
                r["slope"],
                r["parts"],
                f"{float(r['same_rocks_percent']):.0f} %",
                f"{float(r['mean_change_m']):+.2f} ± {float(r['standard_error_m']):.2f}",
                f"{float(r['D_same_seed']):.3f}",
                f"{float(r['p_other_seed']):.3f}",
                f"{float(r['p_other_seed_unsplit']):.3f}",
            ]
            for r in rows_of("discretisation/splitting.csv")
        ],
    )


def convergence(kind: str) -> str:
    """Numerical tolerances, or modelling assumptions, against the base."""
    base = {
        (r["slope"], r["quantity"]): r
        for r in rows_of("convergence/convergence.csv")
        if r["kind"] == "base"
    }
    body = []
    for r in rows_of("convergence/convergence.csv"):
        if r["kind"] != kind:
            continue
        reference = base[r["slope"], r["quantity"]]
        change = [
            f"{100.0 * (float(r[q]) / float(reference[q]) - 1.0):+.1f} %" for q in ("median", "q95")
        ]
        body.append(
            [
                r["variant"],
                r["slope"],
                r["quantity"],
                *change,
                f"{float(r['same_rocks_percent']):.0f} %",
                f"{float(r['D_same_draws']):.3f}",
                f"{float(r['D_other_draws']):.3f}",
                f"{float(r['p_other_draws']):.2g}",
            ]
        )
    head = ["change", "slope", "quantity", "median", "95 %", "same rocks", "D, same draws"]
    return markdown([*head, "D, other draws", "p"], body)


TABLES = {
    "discretisation valley": lambda: discretisation("valley"),
    "discretisation bedrina": lambda: discretisation("bedrina"),
    "discretisation piota_negra": lambda: discretisation("piota_negra"),
    "discretisation lines": lines,
    "discretisation splitting": splitting,
    "convergence tolerance": lambda: convergence("tolerance"),
    "convergence assumption": lambda: convergence("assumption"),
}


def filled(text: str) -> str:
    """A page with its tables written again."""

    def table(match: re.Match[str]) -> str:
        name = match[1]
        return f"<!-- table: {name} -->\n\n{TABLES[name]()}\n\n<!-- end -->"

    return re.sub(r"<!-- table: (.+?) -->\n.*?<!-- end -->", table, text, flags=re.S)


def main() -> None:
    """Rewrite the pages."""
    for page in sorted(HERE.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        new = filled(text)
        if new != text:
            page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
