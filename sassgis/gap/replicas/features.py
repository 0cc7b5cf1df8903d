"""Numbers of a campaign that are scored: one row per rock."""

from __future__ import annotations

import numpy as np

from sassgis.gap.observations.campaign import Campaign, DepositRows, PassageRows, main_blocks
from sassgis.gap.observations.case import Case
from sassgis.model.grid import FloatArray


def rock_quantities(case: Case, sample: Campaign) -> dict[str, FloatArray]:
    """One number per rock and quantity, NaN where there is none."""
    found: dict[str, FloatArray] = {}
    if sample.deposits is not None:
        found |= _stops(sample.deposits, sample.n_rocks)
    if sample.passages is not None:
        found |= _passages(case, sample.passages)
    return found


def _stops(rows: DepositRows, n: int) -> dict[str, FloatArray]:
    main = main_blocks(rows, n)
    has = main >= 0
    out = {name: np.full(n, np.nan) for name in ("runout", "aside")}
    out["runout"][has] = rows.s[main[has]]
    out["aside"][has] = rows.lateral_m[main[has]]
    own = rows.rock >= 0
    out["blocks"] = np.bincount(rows.rock[own], minlength=n).astype(np.float64)
    return {f"stop:{k}": v for k, v in out.items()}


def _passages(case: Case, rows: PassageRows) -> dict[str, FloatArray]:
    numbers = {
        "speed": np.log(np.maximum(rows.speed_mps, 0.1)),
        "rotation": rows.rotation_hz,
        "height": rows.height_m,
        "aside": rows.lateral_m,
    }
    out: dict[str, FloatArray] = {}
    for k in range(len(case.station_names)):
        here = np.flatnonzero((rows.station == k) & (rows.rock >= 0))
        # The heaviest of a rock's blocks represents it.
        here = here[np.argsort(np.nan_to_num(rows.mass_kg[here]), kind="stable")]
        first = np.full(case.n_rocks, -1, np.int64)
        first[rows.rock[here]] = here
        passed = first >= 0
        out[f"S{k}:passed"] = passed.astype(float)
        for what, values in numbers.items():
            out[f"S{k}:{what}"] = np.full(case.n_rocks, np.nan)
            out[f"S{k}:{what}"][passed] = values[first[passed]]
    return out
