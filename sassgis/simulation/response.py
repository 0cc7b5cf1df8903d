"""Response of a result to a change: the same blocks are simulated again and compared.

Example: the error of flattening, by a sample of the blocks at half and at double the tolerance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.languages import joined, phrase
from sassgis.settings.statistics_table import Bins
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.map_sums import MapSums, quantiles

#: Quantities that are compared, with names for sentences. The reached area is left out, because it
#: depends on the number of blocks.
MEASURES: Mapping[str, str] = {
    "runout_q50": "median run-out",
    "runout_q95": "run-out (95 %)",
    "energy_q95": "energy (95 %)",
}
#: Change by the tolerance beyond which the user is warned.
LARGEST_CHANGE = 0.2
#: Blocks that a cell needs for its 95 % quantile, and cells for their median.
_FEWEST_BLOCKS, _FEWEST_CELLS = 20, 10


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Outcome of the blocks, as far as it is compared."""

    runout: IntArray  # shape (n,); blocks that started by run-out, in whole metres
    cells: IntArray  # shape (n_cells,); flat indices of the cells that blocks reach, ascending
    # Shape (n_cells,); 95 % quantile of the kinetic energy there (kJ); NaN where too few blocks
    # arrive.
    energy_kj: FloatArray

    @property
    def blocks(self) -> int:
        """Return the number of blocks that started."""
        return int(self.runout.sum())

    def runout_m(self, *probabilities: float) -> FloatArray:
        """Return quantiles of the run-out (m); NaN without blocks."""
        edges = np.arange(self.runout.size + 1, dtype=np.float64)
        given = tuple(float(np.clip(p, 0.0, 1.0)) for p in probabilities)
        if not self.blocks:
            return np.full(len(given), np.nan)
        return quantiles(self.runout[None, :], edges, given)[:, 0]

    def runout_limits(self, probability: float) -> FloatArray:
        """Return limits of about 95 % confidence of a run-out quantile, from its order (m)."""
        room = 1.96 * np.sqrt(probability * (1.0 - probability) / max(self.blocks, 1))
        return self.runout_m(probability - room, probability + room)


class RelativeChange(NamedTuple):
    """A relative change; ``certain`` if sampling error does not explain it."""

    value: float
    certain: bool

    def __str__(self) -> str:
        if np.isnan(self.value):
            return "unknown"
        percent = round(100.0 * self.value)
        return f"{percent:+d} %" if percent else "0 %"


def outcome_of(progress: Progress, bins: Bins) -> RunOutcome:
    """Return the outcome of the blocks of a run."""
    runout, cells = progress.started_runout, progress.sums.cells
    if not cells.size:
        return RunOutcome(runout, cells, np.empty(0))
    reach = progress.sums.column("reach")
    order = np.argsort(cells)
    order = order[reach[order] > 0]
    energy = energy_q95_kj(progress.sums, order, bins)
    energy = np.where(reach[order] >= _FEWEST_BLOCKS, energy, np.nan)
    return RunOutcome(runout, cells[order].copy(), energy)


def energy_q95_kj(sums: MapSums, which: NDArray[Any], bins: Bins) -> FloatArray:
    """Return 95 % quantile of the kinetic energy (kJ) in some rows of the sums."""
    counts, largest = (sums.column(name)[which] for name in ("energy", "energy_max"))
    energy: FloatArray = quantiles(counts, bins.edges["energy"], (0.95,), largest)[0]
    return energy


def response(base: RunOutcome, other: RunOutcome) -> dict[str, RelativeChange]:
    """Return relative changes of the MEASURES from ``base`` to ``other``.

    The energies are compared cell by cell where enough blocks arrive in both; the answer is the
    median over these cells. Changes of run-out are certain where the confidence limits of the
    quantiles do not meet.
    """
    out = {}
    for p in (0.5, 0.95):
        (before,), (after,) = base.runout_m(p), other.runout_m(p)
        low, high = base.runout_limits(p), other.runout_limits(p)
        apart = bool(low[1] < high[0] or high[1] < low[0])
        change = float(after / before - 1.0) if before > 0.0 else np.nan
        out[f"runout_q{round(100 * p)}"] = RelativeChange(change, apart)
    _, one, two = np.intersect1d(base.cells, other.cells, assume_unique=True, return_indices=True)
    ratio = other.energy_kj[two] / base.energy_kj[one]
    ratio = ratio[np.isfinite(ratio)]
    enough = ratio.size >= _FEWEST_CELLS
    out["energy_q95"] = RelativeChange(float(np.median(ratio)) - 1.0 if enough else np.nan, enough)
    return out


@dataclass(frozen=True, slots=True)
class ToleranceCheck:
    """How results depend on the tolerance of the segments."""

    tolerance_m: float  # that of the run (m)
    blocks: int  # of the sample
    answers: Mapping[float, Mapping[str, RelativeChange]]  # by the tolerance (m) and the measure

    def sentence(self) -> str:
        """Return the changes in words."""
        text = "{}: median run-out {}, run-out (95 %) {}, energy (95 %) {}"
        parts = (
            phrase(text, f"{t:g} m", *map(str, found.values())) for t, found in self.answers.items()
        )
        return joined("; ", parts)

    def facts(self) -> dict[str, object]:
        """Return plain numbers for the manifest, None where there are too few blocks."""
        changes = {
            f"{t:g} m": {
                name: None if np.isnan(own.value) else round(own.value, 3)
                for name, own in found.items()
            }
            for t, found in self.answers.items()
        }
        return {"tolerance_m": self.tolerance_m, "blocks": self.blocks, "changes": changes}

    def warnings(self) -> list[str]:
        """Return warnings for the user."""
        large = [
            phrase("{} {} at {} m", phrase(MEASURES[name]), str(answer), f"{t:g}")
            for t, found in self.answers.items()
            for name, answer in found.items()
            if answer.certain and abs(answer.value) > LARGEST_CHANGE
        ]
        if not large:
            return []
        text = (
            "Results depend on terrain.segment_tolerance_m ({} m): {} (sample of {} blocks). "
            "Reduce it until halving it changes little."
        )
        return [phrase(text, f"{self.tolerance_m:g}", joined(", ", large), self.blocks)]
