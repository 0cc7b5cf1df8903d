"""The example that docs/risk.md works out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sassgis.settings.exposure import ExposedObject, Traffic, Vulnerability, VulnerabilityRow
from sassgis.settings.hazard_rules import Source, SourceCounts

ENERGIES = (0.0, 30.0, 300.0)


def vulnerability() -> Vulnerability:
    numbers = {
        "building": ((0.01, 0.0), (0.1, 0.01), (0.5, 0.2)),
        "road": ((0.1, 0.0), (0.3, 0.0), (0.8, 0.0)),
        "vehicle": ((0.2, 0.05), (0.6, 0.3), (1.0, 0.8)),
        "people": ((0.0, 0.3), (0.0, 0.7), (0.0, 1.0)),
        "line": ((0.0, 0.0), (0.2, 0.0), (0.6, 0.0)),
    }
    codes = ("low", "mean", "high")
    rows = tuple(
        VulnerabilityRow(kind, code, v, p, "made up for the test")
        for kind, pairs in numbers.items()
        for code, (v, p) in zip(codes, pairs, strict=True)
    )
    return Vulnerability(codes, rows)


HOUSE = ExposedObject("house", "building", value=600_000.0, persons=4.0, presence=0.5)
ROAD = ExposedObject(
    "road 0+000–0+050", "road", parent="road", value_per_m=2000.0, length_m=50.0,
    traffic=Traffic(
        traffic_per_day=4800.0, speed_kmh=60.0, vehicle_length_m=5.0, persons_per_vehicle=1.5,
        vehicle_value=30_000.0, trips_per_day=2.0,
    ),
)  # fmt: skip
SOURCES = (
    Source("cliff", "frequent", 0.5, 1000, 50, block_width_m=1.0),
    Source("cliff", "rare", 0.1, 500, 50, block_width_m=2.0),
)


def counts(places: Sequence[int], count: Sequence[Sequence[int]]) -> SourceCounts:
    """Each rock on a line of its own: the sum of squares is the count."""
    k = np.array(count, np.int64).reshape(len(places), len(ENERGIES))
    return SourceCounts(np.array(places, np.int64), k, k.copy())


#: Rocks on (house, road) with at least 0, 30, 300 kJ.
COUNTS = (counts([0, 1], [[20, 8, 2], [40, 10, 0]]), counts([0], [[5, 5, 3]]))
