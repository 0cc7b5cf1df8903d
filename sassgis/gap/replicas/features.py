"""Numbers of a campaign that are scored: one row per rock."""

from __future__ import annotations

import numpy as np

from sassgis.gap.observations.campaign import Campaign, main_blocks
from sassgis.gap.observations.case import Case
from sassgis.model.grid import FloatArray


def rock_quantities(case: Case, sample: Campaign) -> dict[str, FloatArray]:
    """One number per rock and quantity, NaN where there is none."""
    found: dict[str, FloatArray] = {}
    if (stops := sample.deposits) is not None:
        # -1, of rocks without one, takes the last.
        main = main_blocks(stops, case.n_rocks)
        found["stop:runout"] = np.append(stops.s, np.nan)[main]
        found["stop:aside"] = np.append(stops.lateral_m, np.nan)[main]
        own = stops.rock[stops.rock >= 0]
        found["stop:blocks"] = np.bincount(own, minlength=case.n_rocks).astype(np.float64)
    if (rows := sample.passages) is not None:
        numbers = {
            "speed": np.log(np.maximum(rows.speed_mps, 0.1)),
            "rotation": rows.rotation_hz,
            "height": rows.height_m,
            "aside": rows.lateral_m,
        }
        for k in range(len(case.station_names)):
            here = np.flatnonzero((rows.station == k) & (rows.rock >= 0))
            # The heaviest of a rock's blocks represents it.
            here = here[np.argsort(np.nan_to_num(rows.mass_kg[here]), kind="stable")]
            first = np.full(case.n_rocks, -1, np.int64)
            first[rows.rock[here]] = here
            found[f"S{k}:passed"] = (first >= 0).astype(float)
            for what, values in numbers.items():
                found[f"S{k}:{what}"] = np.append(values, np.nan)[first]
    return found
