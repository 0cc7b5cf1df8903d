"""Why is the run-out at the Authume quarry too short, and what is the lateral offset of the stops?

    python pipelines/gap_authume.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``authume_quarry_p1`` (B. Garcia et al. 2022, Eng. Geol. 310, 106855; F.
Bourrier et al. 2021, Landslides 18, 639). The data state no licence: the terrain is read from its
folder, and apart from ``results.json`` and the figures the files in OUT must not be passed on.

Writes the configuration of ``docs/studies/authume``, observations of 41 stops and of two halves of
them, the diagnoses, and ``results.json``.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
from field_cases.study import study
from field_cases.tables import FieldCase, field_file, fresh, parser, split_in_two, write_case

from sassgis.model.errors import SassgisError

FOLDER = "authume_quarry_p1"
STUDY = Path(__file__).resolve().parents[1] / "docs" / "studies" / "authume" / "authume.py"


def untuned() -> ModuleType:
    """The study that reads the data and writes the uncalibrated configuration."""
    spec = importlib.util.spec_from_file_location("authume", STUDY)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["authume"] = module  # Dataclasses look their module up.
    spec.loader.exec_module(module)
    return module


def write(data: Path, out: Path) -> FieldCase:
    """Write the case; the release points of single rocks are not known."""
    field_file(data, FOLDER, "Endpoints_P1.txt")
    authume = untuned()
    quarry = (data / FOLDER).resolve()
    seen = authume.read_observed(quarry)
    config = authume.write_inputs(out, quarry, seen, 50, 1.0, {})
    text = config.read_text(encoding="utf-8")
    config.unlink()
    ids = [f"P1-{i + 1:02d}" for i in range(len(seen.stops))]
    half = seen.semi_axes
    rocks = pd.DataFrame(
        {"rock_id": ids, "mass_kg": seen.mass_kg, "semi_axis_a_m": half[:, 0],
         "semi_axis_b_m": half[:, 1], "semi_axis_c_m": half[:, 2]}
    )  # fmt: skip
    deposits = pd.DataFrame(
        {"rock_id": ids, "x": seen.stops[:, 0], "y": seen.stops[:, 1], "mass_kg": seen.mass_kg}
    )
    heavy = np.where(seen.mass_kg > np.median(seen.mass_kg), "heavy", "light")
    splits = {"halves": split_in_two(dict(zip(ids, heavy.tolist(), strict=True)))}
    plan = np.hypot(*(seen.stops - seen.corners.mean(axis=0)).T)
    groups = pd.DataFrame(
        {"rock_id": ids, "mass": heavy, "where": np.where(plan > authume.EDGE_M, "beyond", "above")}
    )
    groups.to_csv(out / "groups.csv", index=False)
    notes = [
        f"{len(ids)} stops; {int((plan <= authume.EDGE_M).sum())} of them above the edge of the "
        "upper face",
        "heights of the stops lie 2.9 m above the terrain: not used",
        "release points of single rocks are not known: rocks take turns on a lattice of 1 m in the "
        "release square",
        "semi-axes: half of the measured boxes; the ellipsoid is lighter than the rock as weighed",
        "ground and drop as in docs/studies/authume.md, by name",
    ]
    meta = {"position_error_m": 0.5}
    return write_case(
        "authume", out, text, {"rocks": rocks, "deposits": deposits}, meta, splits, notes
    )


def main(argv: list[str] | None = None) -> None:
    """Write the case, diagnose it on one half and score on the other."""
    given = parser(__doc__).parse_args(argv)
    case = write(given.data, fresh(given.output))
    groups = pd.read_csv(given.output / "groups.csv")
    study(case, given, dict(zip(groups["rock_id"], groups["mass"], strict=True)))


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
