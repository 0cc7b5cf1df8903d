"""How far results go beyond what was ever measured on rocks: speed, passing height and rotation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.design import Arrivals, arrivals, value_at_rate
from sassgis.hazard.sources import Sampled
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.built_in_rows import built_in_rows
from sassgis.settings.labels import short
from sassgis.settings.languages import joined, phrase

#: What is compared: its name in the table of measurements, in words, and its unit.
_COMPARED = (
    ("speed_mps", "speeds", "m/s"),
    ("height_m", "passing heights", "m"),
    ("rotation_hz", "rotations", "Hz"),
)
#: Shares of the cells below this are single cells, not the map.
_LEAST_SHARE = 0.01


@cache
def measured_motion() -> tuple[dict[str, float], ...]:
    """Read the largest measured values, by rising volume: sassgis/data/measured_motion.csv."""
    names = ("volume_to_m3", *(name for name, _, _ in _COMPARED))
    return tuple(
        {name: float(row[name]) for name in names} for row in built_in_rows("measured_motion")
    )


def measured_at(volume_m3: float) -> dict[str, float]:
    """Return measurements on blocks of a volume's (m³) size class; the largest class beyond it."""
    rows = measured_motion()
    return next((row for row in rows if volume_m3 <= row["volume_to_m3"]), rows[-1])


def size_warnings(blocks: tuple[BlockPopulation, ...]) -> list[str]:
    """Return scenarios with blocks larger than any whose motion was measured."""
    known = measured_motion()[-2]["volume_to_m3"]
    beyond = [f"{own.name} ({short(own.largest_volume_m3)} m³)" for own in blocks
              if own.largest_volume_m3 > known]  # fmt: skip
    if not beyond:
        return []
    text = (
        "Blocks larger than any measured in motion ({} m³): {}. Their speeds and heights are "
        "extrapolated."
    )
    return [phrase(text, short(known), ", ".join(beyond))]


def motion_warnings(
    blocks: tuple[BlockPopulation, ...], maps: Mapping[str, NDArray[np.floating[Any]]]
) -> list[str]:
    """Warn where maps exceed measurements on blocks as large as the largest of a run.

    ``maps`` are 95 % values in cells by name of a measured quantity; NaN where no block arrives.
    """
    known = measured_at(max(own.largest_volume_m3 for own in blocks))
    out: list[str] = []
    for name, words, unit in _COMPARED:
        if name not in maps:
            continue
        values, limit = maps[name][np.isfinite(maps[name])], known[name]
        share = float(np.mean(values > limit)) if values.size else 0.0
        if share >= _LEAST_SHARE:
            out.append(
                phrase(
                    "On {} % of the reached area, the 95 % {} exceed {} {}, the largest measured "
                    "for blocks of this size. They reach {} {}, {} % more.",
                    f"{100.0 * share:.0f}", phrase(words), short(limit), unit,
                    short(float(values.max())), unit,
                    f"{100.0 * (float(values.max()) / limit - 1.0):.0f}",
                )
            )  # fmt: skip
    return out


def words_at_line(sampled: Sequence[Sampled], line: int) -> str:
    """State how far 95 % values at a station or barrier exceed measurements; else empty.

    The size is that of the mass of which 95 % are below, at the density of a block of which nothing
    is said.
    """
    curves = {name: arrivals(sampled, line, name) for name, _, _ in _COMPARED}
    mass = _q95(arrivals(sampled, line, "mass_kg"))
    known = measured_at(mass / BlockPopulation().density_kgm3[0])
    found = []
    for name, words, unit in _COMPARED:
        value, limit = _q95(curves[name]), known[name]
        if value > limit:
            over = f"{100.0 * (value / limit - 1.0):.0f}"
            text = "{} {} {}, {} % above the largest measured"
            found.append(phrase(text, phrase(words), short(value), unit, over))
    return joined("; ", found)


def _q95(curve: Arrivals) -> float:
    return value_at_rate(curve, 0.05 * float(curve.rate[0]))
