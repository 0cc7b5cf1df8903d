"""Tables of a zoning, and of the areas of a batch."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from sassgis.files.atomic_output import staged_file
from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.curves import Arrivals
from sassgis.hazard.design import (
    arrivals,
    net_class,
    rocks_beyond,
    value_at_rate,
    value_limits,
)
from sassgis.hazard.sources import Sampled
from sassgis.outputs.frames import table_of, without_formulas
from sassgis.settings.results import ControlLine, rounded
from sassgis.simulation.control_lines import BEHIND, FORCE, LOAD, ON_BARRIER, OVER
from sassgis.terrain.fall_lines import mean_height_m, moved_lines


def source_table(sampled: Sequence[Sampled]) -> pd.DataFrame:
    """Return release area, scenario, onset frequency and the blocks behind it."""
    columns = {
        "area": "source.area",
        "scenario": "source.scenario",
        "onset_per_year": "source.frequency",
        "rocks": "source.rocks",
        "per_year_of_one_rock": "source.rate_per_rock",
    }
    return table_of(sampled, columns, {"onset_per_year": 6, "per_year_of_one_rock": 6})


def design_table(
    control_lines: Sequence[ControlLine],
    without_barriers: Sequence[Sampled],
    return_periods_years: Sequence[float],
    confidence: float = 0.95,
) -> pd.DataFrame:
    """Tabulate what reaches each station and barrier without barriers, by residual frequency.

    A value is empty where blocks arrive less often than its return period asks for, a limit
    (``low``, ``high``) where the sample of blocks has none.
    """
    rows = []
    for i, control_line in enumerate(control_lines):
        energy, height = (arrivals(without_barriers, i, q) for q in ("energy_kj", "height_m"))
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
                row |= _named(key, _limited(curve, rate, confidence))
                if what.endswith("y"):
                    row[f"{name}_{what}_rocks_beyond"] = rocks_beyond(curve, rate)
        rows.append(row)
    return pd.DataFrame(rows)


def design_tables(
    grid: Grid,
    lines: Sequence[tuple[ControlLine, FloatArray]],
    without_barriers: Sequence[Sampled],
    return_periods_years: Sequence[float],
    confidence: float = 0.95,
    exposed: Sequence[Any] = (),
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tabulate what reaches each line, and its copies along the slope where simulated.

    ``exposed`` are the geometries of exposed objects, which a line stays above.
    """
    copies = moved_lines(grid, lines)
    sums = without_barriers[0].control_lines.control_lines if without_barriers else ()
    if len(sums) < len(lines) + len(copies):
        copies = ()
    stations = [line for line, _ in lines]
    stations += [copy.as_station(stations[copy.of].name)[0] for copy in copies]
    design = design_table(stations, without_barriers, return_periods_years, confidence)
    if not lines:
        return design, design
    placed = [(line.name, 0.0, trace) for line, trace in lines]
    placed += [(stations[c.of].name, c.moved_m, c.trace) for c in copies]
    moved = [(name, m, round(mean_height_m(grid, trace), 1)) for name, m, trace in placed]
    released = sum(s.source.frequency for s in without_barriers)
    places = places_table(design, moved, released)
    drawn = {line.name: trace for line, trace in lines}
    above = {
        (name, m): m <= 0.0 or stays_above(drawn[name], trace, exposed) for name, m, trace in placed
    }
    of = zip(places["line"], places["moved_m"], strict=True)
    places.insert(3, "above_objects", [above[key] for key in of])
    return design.iloc[: len(lines)], places


def stays_above(trace: FloatArray, moved: FloatArray, exposed: Sequence[Any]) -> bool:
    """Return whether a line passes over no exposed object on its way to a copy of it.

    Both have shape (n, 2).
    """
    corners = np.stack([trace[:-1], trace[1:], moved[1:], moved[:-1]], axis=1)
    swept = shapely.union_all(list(map(shapely.Polygon, corners)))
    return not any(swept.intersects(thing) for thing in exposed)


def places_table(
    design: pd.DataFrame, moved: Sequence[tuple[str, float, float]], released_per_year: float
) -> pd.DataFrame:
    """Tabulate what reaches each line and its copies along the slope.

    ``design`` is the design_table of all; ``moved`` says for each row the line, how far downslope
    it was moved, and the mean height of the ground there (m). ``released_per_year`` may be 0: no
    share.
    """
    places = pd.DataFrame(list(moved), columns=["line", "moved_m", "ground_m"])
    released = released_per_year or float("nan")
    places["share"] = [rounded(rate / released, 4) for rate in design["arrivals_per_year"]]
    table = pd.concat([places, design.drop(columns=["line", "kind"])], axis=1)
    return table.sort_values(["line", "moved_m"], kind="stable", ignore_index=True)


#: What is counted at barriers, and the name of how often it comes; a force comes with each hit.
_AT_BARRIERS = {
    BEHIND: "behind_per_year", LOAD: "hits_per_year", FORCE: "", OVER: "over_per_year",
}  # fmt: skip


def protection_table(
    control_lines: Sequence[ControlLine],
    without_barriers: Sequence[Sampled],
    with_barriers: Sequence[Sampled],
    return_periods_years: Sequence[float],
    density_kgm3: float,
    confidence: float = 0.95,
) -> pd.DataFrame:
    """Tabulate what a net at each line must be, what loads the existing barriers and passes them.

    A row for each line and return period. Heights hold the whole block: the passing height and the
    diameter of the block whose mass comes as rarely, as a sphere of a density.
    """
    rows = []
    for i, line in enumerate(control_lines):
        energies, heights, masses = (
            arrivals(without_barriers, i, q) for q in ("energy_kj", "height_m", "mass_kg")
        )
        # What a barrier does: at stations nothing.
        done = {
            key: (name, arrivals(with_barriers, i, key) if line.kind != "station" else None)
            for key, name in _AT_BARRIERS.items()
        }
        for years in return_periods_years:
            rate = 1.0 / years
            energy, height = (_limited(curve, rate, confidence) for curve in (energies, heights))
            mass = value_at_rate(masses, rate)
            size = float(np.cbrt(6.0 * mass / (np.pi * density_kgm3)))
            row: dict[str, object] = {
                "line": line.name,
                "kind": line.kind,
                "return_period_years": years,
            }
            row |= _named("energy_kj", energy)
            # Walls and galleries have no class.
            of_net = energy if line.kind in ("station", "net") else (float("nan"),) * 3
            row |= {"net_class": net_class(of_net[0]), "net_class_high": net_class(of_net[2])}
            row["block_m"] = rounded(size, 3)
            row |= _named("net_height_m", tuple(value + size for value in height))
            row["arrivals_per_year"] = rounded(energies.rate[0], 4)
            for key, (name, curve) in done.items():
                values: tuple[float, ...] = (float("nan"),) * 3
                # Blocks without such a value lie in the first bin.
                often = float("nan") if curve is None else float(curve.rate[1])
                row |= {name: rounded(often, 4)} if name else {}
                if curve is not None and often > rate:
                    values = _limited(curve, rate, confidence)
                row |= _named(key, values)
            row["side_per_year"] = rounded(_against_the_side(line, with_barriers, i), 4)
            rows.append(row)
    return pd.DataFrame(rows)


def _against_the_side(line: ControlLine, sampled: Sequence[Sampled], i: int) -> float:
    """Return how often blocks hit the uphill side of a gallery (1/year); NaN for other lines."""
    if line.kind != "gallery":
        return float("nan")
    return sum(
        one.source.rate_per_rock * sum(one.control_lines.outcomes(i)[o] for o in ON_BARRIER)
        for one in sampled
    )


def _limited(curve: Arrivals, rate: float, confidence: float) -> tuple[float, ...]:
    """Return the value at a rate and its limits."""
    return value_at_rate(curve, rate), *value_limits(curve, rate, confidence)


def _named(key: str, values: Sequence[float]) -> dict[str, object]:
    """Return a value and its limits as columns."""
    ends = ("", "_low", "_high")
    return {f"{key}{end}": rounded(v, 4) for end, v in zip(ends, values, strict=True)}


def layer_table(layer: VectorLayer) -> pd.DataFrame:
    """Return the attributes of a layer."""
    return pd.DataFrame(layer.frame.drop(columns="geometry"))


#: So many times as long as the table took to write the next one waits.
_SHARE = 50.0


_NOT_RUN, _SKIPPED = "not run", "skipped: "


class BatchSummary:
    """The table of all areas (name and file by folder), written anew whenever one is done."""

    def __init__(
        self, path: Path, areas: Mapping[str, tuple[str, str]], levels: Sequence[str]
    ) -> None:
        self._path = path
        self._levels = list(levels)
        self._next = 0.0
        # Times of areas that an earlier call has run.
        try:
            frame = pd.read_csv(path, dtype={"folder": str}).dropna(subset=["folder", "seconds"])
            self._before = dict(zip(frame["folder"], frame["seconds"].astype(float), strict=True))
        except (OSError, ValueError, KeyError):
            self._before = {}
        self._rows: dict[str, dict[str, object]] = {
            folder: {"area": name, "file": file, "status": _NOT_RUN}
            for folder, (name, file) in areas.items()
        }

    def done(
        self,
        folder: str,
        facts: Mapping[str, object],
        zones_m2: Mapping[str, float],
        seconds: float | None,
    ) -> None:
        """Note an area that was run, or was there already (``seconds`` None); zones by code."""
        self._rows[folder] |= {
            "status": "done",
            "folder": folder,
            **facts,
            **{f"{code}_m2": zones_m2.get(code) for code in self._levels},
            "seconds": self._before.get(folder) if seconds is None else round(seconds, 1),
        }

    def skipped(self, folder: str, reason: str) -> None:
        """Note an area that could not be run."""
        self._rows[folder]["status"] = _SKIPPED + reason

    def reasons(self) -> dict[str, str]:
        """Return the reasons why areas were skipped, by their name."""
        return {
            str(row["area"]): str(row["status"]).removeprefix(_SKIPPED)
            for row in self._rows.values()
            if str(row["status"]).startswith(_SKIPPED)
        }

    def frame(self) -> pd.DataFrame:
        """Return the table."""
        columns = ["area", "file", "folder", "status", "points", "rocks", "furthest_m"]
        columns += [*(f"{code}_m2" for code in self._levels), "seconds"]
        frame = pd.DataFrame(list(self._rows.values()), columns=columns)
        return frame.astype({"points": "Int64", "rocks": "Int64"})

    def write_now_and_then(self) -> None:
        """Write the table, unless that took most of the time of a batch of many small areas."""
        if time.monotonic() > self._next:
            began = time.monotonic()
            self.write()
            self._next = time.monotonic() + _SHARE * (time.monotonic() - began)

    def write(self) -> None:
        """Write the table; whole or not at all."""
        with staged_file(self._path, overwrite=True) as fresh:
            without_formulas(self.frame()).to_csv(fresh, index=False)
