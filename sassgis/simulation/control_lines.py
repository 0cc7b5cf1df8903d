"""Distributions of what passes stations and meets barriers, streamed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.roofs import roof_force_kn
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.results import ControlLine, Histogram, Outcome, rounded
from sassgis.simulation.map_sums import quantiles

_ENERGY = ("kJ", np.concatenate([[0.0], 30.0 * 10.0 ** (np.arange(-160, 241) / 40.0)]))
#: Parts of a unit to which sums are exact.
_PARTS = 1_000_000
#: Energy of a block behind the line; 0 where a barrier stops it.
BEHIND = "energy_behind_kj"
#: Energy of a block that meets a wall or net, or of its motion into the roof of a gallery; the
#: force on that roof; energy of a block that goes over the top, or over the whole gallery. Else 0.
LOAD, FORCE, OVER = "load_kj", "force_kn", "energy_over_kj"
#: Quantities of a passage: unit, and edges of their bins. Larger values count in the last bin.
QUANTITIES: dict[str, tuple[str, FloatArray]] = {
    "speed_mps": ("m/s", np.arange(0.0, 150.25, 0.25)),
    "rotation_hz": ("Hz", np.arange(0.0, 40.1, 0.1)),
    "height_m": ("m", np.arange(0.0, 200.1, 0.1)),
    "energy_kj": _ENERGY,
    "mass_kg": ("kg", np.concatenate([[0.0], 10.0 ** (np.arange(0, 281) / 40.0)])),
    BEHIND: _ENERGY,
    LOAD: _ENERGY,
    FORCE: ("kN", _ENERGY[1]),
    OVER: _ENERGY,
}
#: Quantities of all passages; the others are counted at barriers only.
OF_ALL = ("speed_mps", "rotation_hz", "height_m", "energy_kj", "mass_kg")


@dataclass(frozen=True, slots=True)
class Distribution:
    """One quantity at one control line."""

    count: int  # blocks that arrived, with their weights
    # Exact, to 1e-6 of the unit; NaN if no block arrived.
    mean: float
    smallest: float
    largest: float
    histogram: Histogram
    # Shape (n_bins,); for each unit drawn (a block, or a release point with its blocks) the square
    # of its number of blocks in a bin of the histogram or beyond, summed.
    squares: IntArray

    def quantile(self, *probabilities: float) -> tuple[float, ...]:
        """Return quantiles, exact to the width of a bin; NaN if no block arrived."""
        values = quantiles(
            self.histogram.counts[None, :],
            self.histogram.edges,
            probabilities,
            np.array([self.largest]),
        )
        return tuple(float(v) for v in values[:, 0])


class ControlLineSums:
    """Growing counts of first passages at each station and barrier."""

    def __init__(self, control_lines: tuple[ControlLine, ...]) -> None:
        self.control_lines = control_lines
        n = len(control_lines)
        self._built = np.array([line.kind != "station" for line in control_lines], np.bool_)
        self._capacities = np.array([line.capacity_kj for line in control_lines], np.float64)
        self._cushions = np.array([line.cushion_kpa for line in control_lines], np.float64)
        self._outcomes = np.zeros((n, len(Outcome)), np.int64)
        self._of: dict[str, dict[str, NDArray[Any]]] = {
            q: {
                "counts": np.zeros((n, edges.size - 1), np.int64),
                # As for Distribution.
                "squares": np.zeros((n, edges.size - 1), np.int64),
                # Sums of whole units and of millionths beyond them: whole numbers, so that the
                # order of adding does not matter. They are kept apart because millionths of many
                # large blocks would overflow.
                "sum": np.zeros((2, n), np.int64),
                "least": np.full(n, np.inf),
                "most": np.full(n, -np.inf),
            }
            for q, (_, edges) in QUANTITIES.items()
        }

    def add(self, passages: NDArray[np.void], weight: int = 1, random_points: bool = False) -> None:
        """Count passages (PASSAGE_DTYPE) of blocks that count ``weight`` times each.

        Where release points were drawn at random, all passages of one are among them.
        """
        passages = passages[np.argsort(passages["control_line"], kind="stable")]
        energy = passages["energy_trans_kj"] + passages["energy_rot_kj"]
        values = {q: energy if q == "energy_kj" else passages[q] for q in OF_ALL}
        self._add(passages, values, weight, random_points)
        built = self._built[passages["control_line"]]
        at_barriers, energy = passages[built], energy[built]
        self._add(at_barriers, self._at_barriers(at_barriers, energy), weight, random_points)
        np.add.at(self._outcomes, (passages["control_line"], passages["outcome"]), weight)

    def _at_barriers(
        self, passages: NDArray[np.void], energy: FloatArray
    ) -> dict[str, NDArray[Any]]:
        """Return the quantities that are counted at barriers only."""
        control_line = passages["control_line"]
        outcome, into_roof = passages["outcome"], passages["roof_energy_kj"]
        cushion = self._cushions[control_line]  # only galleries have one
        return {
            BEHIND: energy_behind(
                energy, outcome, self._capacities[control_line], passages["roof_left_kj"]
            ),
            LOAD: np.where(np.isin(outcome, ON_BARRIER) & (cushion == 0.0), energy, into_roof),
            FORCE: roof_force_kn(into_roof, passages["mass_kg"], cushion),
            OVER: np.where(outcome == Outcome.OVERTOPPED, energy, 0.0),
        }

    def _add(
        self,
        passages: NDArray[np.void],
        quantities: Mapping[str, NDArray[Any]],
        weight: int,
        by_point: bool,
    ) -> None:
        """Count quantities of passages, those of a control line together."""
        if not passages.size:
            return
        control_line = passages["control_line"].astype(np.int64)
        points = _pairs(control_line, passages["line"]) if by_point else None
        first = np.flatnonzero(np.diff(control_line, prepend=-1))
        lines = control_line[first]
        for q, values in quantities.items():
            edges = QUANTITIES[q][1]
            bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
            own = self._of[q]
            counts, squares = _counts(control_line, bins, own["counts"].shape, points)
            own["counts"] += weight * counts
            own["squares"] += weight * weight * squares
            parts = np.divmod(np.rint(values * _PARTS).astype(np.int64), _PARTS)
            for total, part in zip(own["sum"], parts, strict=True):
                total[lines] += weight * np.add.reduceat(part, first)
            for name, extreme in ("least", np.minimum), ("most", np.maximum):
                own[name][lines] = extreme(own[name][lines], extreme.reduceat(values, first))

    def add_sums(self, other: ControlLineSums, numbers: IntArray) -> None:
        """Join the counts of other blocks.

        ``numbers`` are the positions in ``control_lines`` of those of ``other``; each once.
        """
        self._outcomes[numbers] += other._outcomes
        for q, own in self._of.items():
            more = other._of[q]
            own["counts"][numbers] += more["counts"]
            own["squares"][numbers] += more["squares"]
            own["sum"][:, numbers] += more["sum"]
            own["least"][numbers] = np.minimum(own["least"][numbers], more["least"])
            own["most"][numbers] = np.maximum(own["most"][numbers], more["most"])

    def only(self, numbers: IntArray) -> ControlLineSums:
        """Return the counts at some of the control lines, by their positions."""
        out = ControlLineSums(tuple(self.control_lines[i] for i in numbers))
        out._outcomes += self._outcomes[numbers]
        for q, own in out._of.items():
            for name, values in own.items():
                values[...] = np.take(self._of[q][name], numbers, axis=int(name == "sum"))
        return out

    def outcomes(self, control_line: int) -> dict[Outcome, int]:
        """Count the blocks by outcome at a control line (its position)."""
        return {o: int(self._outcomes[control_line, o]) for o in Outcome}

    def arrivals(self, control_line: int) -> int:
        """Return blocks that arrived at a control line (its position)."""
        return int(self._outcomes[control_line].sum())

    def distribution(self, control_line: int, quantity: str) -> Distribution:
        """Return one of QUANTITIES at a control line (its position)."""
        unit, edges = QUANTITIES[quantity]
        count = self.arrivals(control_line)
        own = self._of[quantity]
        units, parts = own["sum"][:, control_line].tolist()
        return Distribution(
            count,
            1e-6 * (units * _PARTS + parts) / count if count else math.nan,
            float(own["least"][control_line]) if count else math.nan,
            float(own["most"][control_line]) if count else math.nan,
            Histogram(edges, own["counts"][control_line].copy(), unit),
            own["squares"][control_line].copy(),
        )

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the state needed to go on later, as plain arrays."""
        sums = {f"{n}_{q}": array for q, own in self._of.items() for n, array in own.items()}
        return {"outcomes": self._outcomes, **sums}

    @classmethod
    def from_state(
        cls, control_lines: tuple[ControlLine, ...], state: Mapping[str, NDArray[np.generic]]
    ) -> ControlLineSums:
        """Return the sums that ``state`` returned."""
        sums = cls(control_lines)
        for name, own in sums.state().items():
            own[...] = state[name]
        return sums


def _pairs(control_line: IntArray, point: IntArray) -> tuple[IntArray, IntArray]:
    """Return the control line of each pair of line and point that occurs, and the pair of each."""
    pair = control_line * (int(point.max()) + 1) + point
    _, first, row = np.unique(pair, return_index=True, return_inverse=True)
    return control_line[first], row


def _counts(
    control_line: IntArray,
    bins: IntArray,
    shape: tuple[int, int],
    points: tuple[IntArray, IntArray] | None,
) -> tuple[IntArray, IntArray]:
    """Return passages and squares as of Distribution, by control line and bin.

    ``points`` are the pairs of line and release point; None: points are no units.
    """
    n_bins = shape[1]
    flat = control_line * n_bins + bins
    counts = np.bincount(flat, minlength=shape[0] * n_bins).reshape(shape)
    if points is None:
        return counts, _and_beyond(counts)
    of_pair, row = points
    own = np.bincount(row * n_bins + bins, minlength=of_pair.size * n_bins)
    squares: IntArray = np.zeros(shape, np.int64)
    np.add.at(squares, of_pair, _and_beyond(own.reshape(-1, n_bins)) ** 2)
    return counts, squares


def _and_beyond(counts: IntArray) -> IntArray:
    """Return what is counted in each bin or beyond."""
    sums: IntArray = np.cumsum(counts[:, ::-1], axis=1)[:, ::-1]
    return sums


ON_BARRIER = (Outcome.STOPPED, Outcome.HELD_BY_NET, Outcome.BROKE_THROUGH)


def energy_behind(
    energy_kj: FloatArray,
    outcome: NDArray[np.uint8],
    capacity_kj: FloatArray,
    roof_left_kj: FloatArray,
) -> FloatArray:
    """Return the energy of blocks behind a line (kJ): 0 for those that a barrier stops.

    ``roof_left_kj`` is that of blocks on a roof as they leave it, 0 for those that end there.
    """
    taken = np.isin(outcome, (Outcome.STOPPED, Outcome.HELD_BY_NET))
    lost = np.where(outcome == Outcome.BROKE_THROUGH, capacity_kj, 0.0)
    behind: FloatArray = np.where(taken, 0.0, np.maximum(energy_kj - lost, 0.0))
    return np.where(outcome == Outcome.ON_ROOF, roof_left_kj, behind)


def trimmed(histogram: Histogram, bins: int = 15) -> Histogram:
    """Return a histogram for drawing: alike bins to just beyond what was counted.

    From 0 for evenly spaced edges; from what was counted where edges grow by a factor. The width
    is a whole number of the fine bins. The last bin is empty, unless the last of the fine ones,
    which is open, is not.
    """
    edges = histogram.edges
    by_factor = not np.isclose(edges[1] - edges[0], edges[2] - edges[1])
    used = np.flatnonzero(histogram.counts)
    first = int(used[0]) if used.size and by_factor else 0
    last = int(used[-1]) + 1 if used.size else first + 1
    width = max(int(np.ceil((last - first) / bins)), 1)
    groups = int(np.ceil((last - first) / width)) + int(histogram.counts[-1] == 0)
    counts: IntArray = np.zeros(groups * width, np.int64)
    fine = histogram.counts[first : first + counts.size]
    counts[: fine.size] = fine
    steps = width * np.arange(groups + 1)
    # The first of the bins that grow reaches down to 0.
    coarse: FloatArray = (
        edges[1] * (edges[2] / edges[1]) ** (first - 1 + steps)
        if by_factor
        else edges[0] + (edges[1] - edges[0]) * steps
    )
    return Histogram(coarse, counts.reshape(groups, width).sum(axis=1), histogram.unit)


#: Outcomes that are counted at barriers.
BARRIER_OUTCOMES = (
    Outcome.STOPPED, Outcome.HELD_BY_NET, Outcome.OVERTOPPED, Outcome.BROKE_THROUGH,
    Outcome.ON_ROOF,
)  # fmt: skip


#: Blocks of single sources at the same lines, and how much each of their blocks counts.
LineParts = Sequence[tuple[float, ControlLineSums]]
#: Weights are rounded to this share of all, which is small compared with the sampling error.
_WHOLE = 2.0**50


def weighted_distribution(parts: LineParts, line: int, quantity: str) -> Distribution:
    """Return the distribution of weighted blocks, without squares."""
    found = [(weight, sums.distribution(line, quantity)) for weight, sums in parts]
    found = [(weight, own) for weight, own in found if own.count and weight > 0.0]
    unit, edges = QUANTITIES[quantity]
    total = sum(weight * own.count for weight, own in found)
    # Blocks that count alike stay whole numbers.
    alike = len({weight for weight, _ in found}) == 1
    scale = 1.0 / found[0][0] if alike else _WHOLE / (total or 1.0)
    counts = sum((weight * own.histogram.counts for weight, own in found), np.zeros(edges.size - 1))
    return Distribution(
        sum(own.count for _, own in found),
        sum(weight * own.count * own.mean for weight, own in found) / total if found else math.nan,
        min((own.smallest for _, own in found), default=math.nan),
        max((own.largest for _, own in found), default=math.nan),
        Histogram(edges, np.rint(scale * counts).astype(np.int64), unit),
        np.zeros(0, np.int64),
    )


def control_line_rows(
    control_lines: ControlLineSums, parts: LineParts = ()
) -> list[dict[str, Any]]:
    """Return a row of statistics for each station and barrier.

    With ``parts``, means and quantiles count blocks by their weights; numbers of blocks do not.
    """
    rows = []
    for i, control_line in enumerate(control_lines.control_lines):
        row: dict[str, Any] = {"name": control_line.name, "kind": control_line.kind}
        outcomes = control_lines.outcomes(i)
        row["rocks"] = control_lines.arrivals(i)
        if control_line.kind != "station":
            row["height_m"] = control_line.height_m
            row["capacity_kj"] = (
                control_line.capacity_kj if np.isfinite(control_line.capacity_kj) else None
            )
            row["hits"] = control_lines.arrivals(i) - outcomes[Outcome.OVERTOPPED]
            for outcome in BARRIER_OUTCOMES:
                row[outcome.name.lower()] = outcomes[outcome]
            row |= _force_row(control_lines, parts, i)
        for quantity in OF_ALL:
            d = _counted(control_lines, parts, i, quantity)
            values = dict(
                zip(("q50", "q95", "q99"), d.quantile(0.5, 0.95, 0.99), strict=True),
                mean=d.mean,
                max=d.largest,
            )
            for name, value in values.items():
                row[f"{quantity}_{name}"] = rounded(value, 5)
        rows.append(row)
    return rows


def _counted(
    control_lines: ControlLineSums, parts: LineParts, line: int, quantity: str
) -> Distribution:
    if parts:
        return weighted_distribution(parts, line, quantity)
    return control_lines.distribution(line, quantity)


def _force_row(control_lines: ControlLineSums, parts: LineParts, line: int) -> dict[str, Any]:
    """Return forces of the blocks that land on a roof; None without any."""
    d = _counted(control_lines, parts, line, FORCE)
    # The first bin holds all other blocks.
    counts = np.concatenate([[0], d.histogram.counts[1:]])
    landed = replace(d, histogram=replace(d.histogram, counts=counts))
    values = (*landed.quantile(0.95, 0.99), d.largest) if counts.any() else (None,) * 3
    names = ("q95", "q99", "max")
    return {
        f"{FORCE}_{name}": None if value is None else rounded(value, 5)
        for name, value in zip(names, values, strict=True)
    }
