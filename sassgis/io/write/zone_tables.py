"""Tables of a zoning: sources, and what stations and barriers must take."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from sassgis.hazard.design import arrivals, rocks_beyond, value_at_rate, value_limits
from sassgis.hazard.sources import Sampled
from sassgis.io.vector_layer import VectorLayer
from sassgis.model.labels import rounded
from sassgis.model.results import ControlLine


def source_table(sampled: Sequence[Sampled]) -> pd.DataFrame:
    """Release area, scenario, onset frequency and the blocks behind it."""
    return pd.DataFrame(
        {
            "area": [s.source.area for s in sampled],
            "scenario": [s.source.scenario for s in sampled],
            "onset_per_year": [rounded(s.source.frequency, 6) for s in sampled],
            "rocks": [s.source.rocks for s in sampled],
            "per_year_of_one_rock": [rounded(s.source.rate_per_rock, 6) for s in sampled],
        }
    )


def design_table(
    control_lines: Sequence[ControlLine],
    without_barriers: Sequence[Sampled],
    return_periods_years: Sequence[float],
    confidence: float = 0.95,
) -> pd.DataFrame:
    """What reaches each station and barrier line without barriers, by residual frequency.

    A value is empty where blocks arrive less often than its return period asks for, a limit
    (``low``, ``high``) where the sample of blocks has none.
    """
    sources = [s.source for s in without_barriers]
    sums = [s.control_lines for s in without_barriers]
    rows = []
    for i, control_line in enumerate(control_lines):
        energy, height = (arrivals(sources, sums, i, q) for q in ("energy_kj", "height_m"))
        row: dict[str, object] = {
            "line": control_line.name,
            "kind": control_line.kind,
            "rocks": int(energy.rocks[0]),
            "arrivals_per_year": rounded(energy.rate[0], 4),
        }
        for name, curve in (("energy", energy), ("height", height)):
            unit = "kj" if name == "energy" else "m"
            rates = {f"q{100 * p:.0f}": (1.0 - p) * float(curve.rate[0]) for p in (0.95, 0.99)}
            rates |= {f"{years:g}y": 1.0 / years for years in return_periods_years}
            for what, rate in rates.items():
                key = f"{name}_{what}_{unit}"
                row[key] = rounded(value_at_rate(curve, rate), 4)
                limits = value_limits(curve, rate, confidence)
                row[f"{key}_low"], row[f"{key}_high"] = (rounded(v, 4) for v in limits)
                if what.endswith("y"):
                    row[f"{name}_{what}_rocks_beyond"] = rocks_beyond(curve, rate)
        rows.append(row)
    return pd.DataFrame(rows)


def layer_table(layer: VectorLayer) -> pd.DataFrame:
    """The attributes of a layer."""
    return pd.DataFrame(layer.frame.drop(columns="geometry"))
