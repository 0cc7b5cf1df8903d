"""What does a mass point do that the ellipse does not, on the rocks of Tschamut?

``python docs/studies/point.py DATA -o FOLDER`` simulates each rock as the ellipse and as the mass
point of the first model of Bozzolo and Pamini (1986), with the friction of the class and with the
one that gives the observed median run-out; writes point.json beside this file and the table into
point.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from field_cases.kinematics import Values, kinematics, observed
from field_cases.sites import tschamut
from field_cases.tables import fresh
from study_tables import replaced, table

from sassgis.gap.observations.case import Case
from sassgis.runs.calibrate import read_case
from sassgis.settings.ground import GroundTable

HERE = Path(__file__).parent
CLASS = "soft_meadow"
COUNT, SEED, STEPS = 12, 2014, 7
#: Between what the friction of the point is looked for.
FRICTIONS = (0.1, 0.9)
QUANTITIES = (
    "run-out", "speed 20 m", "speed 40 m", "speed 60 m", "height 20 m", "height 40 m",
    "height 60 m", "contacts",
)  # fmt: skip


def with_friction(ground: GroundTable, mu_f: float) -> GroundTable:
    """The classes, one with another sliding friction."""
    return GroundTable(
        tuple(replace(c, mu_f=mu_f) if c.name == CLASS else c for c in ground.classes)
    )


def friction_of(case: Case, run_out_m: float) -> float:
    """The sliding friction with which points stop at a median run-out."""
    low, high = FRICTIONS
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        made = kinematics(case, with_friction(case.table, middle), 4, SEED, {"block": "point"})
        low, high = (middle, high) if np.median(made["run-out"]) > run_out_m else (low, middle)
    return round(0.5 * (low + high), 3)


def quantiles(values: Values) -> dict[str, list[float]]:
    """Median and 90 % quantile of each quantity."""
    found = {name: values[name] for name in QUANTITIES if values.get(name, np.empty(0)).size}
    return {
        name: [round(float(q), 2) for q in np.quantile(own, (0.5, 0.9))]
        for name, own in found.items()
    }


def page(results: dict[str, Any]) -> str:
    """The table of the page."""
    models = results["models"]
    rows = [
        " | ".join(
            [name, *(" / ".join(f"{q:.3g}" for q in own.get(name, [])) or "–"
                     for own in models.values())]
        )
        for name in QUANTITIES
        if "20 m" not in name
    ]  # fmt: skip
    return table(" | ".join(["median / 90 %", *models]), rows)


def main(argv: list[str] | None = None) -> None:
    """Simulate, and fill the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args(argv)
    site = tschamut(given.data, fresh(given.output))
    case = read_case(*site.case.pair("all"))
    seen = observed(case)
    mu_f = friction_of(case, float(np.median(seen["run-out"])))
    point = {"block": "point"}
    stated = next(c.mu_f for c in case.table.classes if c.name == CLASS)
    fitted = with_friction(case.table, mu_f)
    models = {
        "observed": seen,
        "ellipse": kinematics(case, case.table, COUNT, SEED),
        f"point, μ_f {stated:g}": kinematics(case, case.table, COUNT, SEED, point),
        f"point, μ_f {mu_f:g}": kinematics(case, fitted, COUNT, SEED, point),
    }
    results = {
        "rocks": case.n_rocks,
        "friction": mu_f,
        "models": {name: quantiles(own) for name, own in models.items()},
    }
    text = json.dumps(results, indent=1, ensure_ascii=False) + "\n"
    (HERE / "point.json").write_text(text, encoding="utf-8")
    replaced(HERE / "point.md", "table", page(results))
    print(page(results))


if __name__ == "__main__":
    main()
