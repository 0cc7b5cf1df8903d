"""Where findings lie on fall lines."""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.diagnosis import GapFinding
from sassgis.gap.observations.case import Case
from sassgis.model.grid import FloatArray
from sassgis.model.profiles import TraceSet


def line_stretch(traces: TraceSet, line: int, s0: float, s1: float) -> FloatArray:
    """The part of a fall line between two chainages (m), cut to those of the line, shape (n, 2).

    Coordinates (m); empty where nothing of the line lies between.
    """
    own = slice(int(traces.offset[line]), int(traces.offset[line + 1]))
    s, x, y = traces.s[own], traces.x[own], traces.y[own]
    low, high = max(s0, float(s[0])), min(s1, float(s[-1]))
    if not low < high:
        return np.empty((0, 2))
    at = np.concatenate([[low], s[(s > low) & (s < high)], [high]])
    return np.column_stack([np.interp(at, s, x), np.interp(at, s, y)])


def is_stretch(finding: GapFinding) -> bool:
    """Whether a finding belongs to a stretch of the fall lines rather than to a point."""
    return math.isfinite(finding.s0_m) and finding.s0_m < finding.s1_m


def limits_on(case: Case, finding: GapFinding, line: int) -> tuple[float, float]:
    """Chainages between which a finding lies on one fall line (m).

    Reaches begin and end where this line crosses the stations; other places, and lines that do not
    cross, take the mean chainages of the finding.
    """
    low, high = finding.s0_m, finding.s1_m
    if finding.place in case.reaches:
        edges = case.stations.s[line][case.station_order]
        number = case.reaches.index(finding.place)
        if number > 0 and math.isfinite(edges[number - 1]):
            low = float(edges[number - 1])
        if number < edges.size and math.isfinite(edges[number]):
            high = float(edges[number])
    return low, high


def used_lines(case: Case) -> list[int]:
    """Fall lines that rocks have, ascending."""
    lines: list[int] = np.unique(case.line[case.line >= 0]).tolist()
    return lines


def observed_end(case: Case) -> float:
    """Chainage beyond which nothing was observed (m); infinite if no point has a chainage."""
    known = np.concatenate([p.s[np.isfinite(p.s)] for p in case.projected.values()])
    return float(known.max()) if known.size else math.inf
