"""Where the gap lies: the place, the phase and the quantity in which rocks and model differ.

Observations are compared with predictions in three ways: runs from the release, reaches (runs that
start again at every station), and single steps (impacts and flights). What is right in one step and
wrong in a reach lies between the steps; what is right in all reaches and wrong from the release
lies in the release. Every value that is tested is one of a rock; rocks of a group (block, day,
source) are not independent, and are tested together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sassgis.gap.constants import BEGINNING_SHARE, FINDING_ROCKS, LEVEL
from sassgis.gap.diagnosis import GapFinding, Range
from sassgis.gap.fit.distances import times_drawn
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import Residual, false_discovery_adjusted, mean_gap_tests
from sassgis.grid import FloatArray
from sassgis.settings.profiles import TraceSet
from sassgis.terrain.flatten import chainage_to_xy


def where(
    case: Case, residuals: ResidualTable, *, seed: int, draws: int = 999
) -> tuple[GapFinding, ...]:
    """Find where observation and model differ, most certain first; few rocks say nothing."""
    rng = np.random.default_rng([seed, 33])
    unit = case.unit
    tested = [(r, r.tested()) for r in residuals.rows]
    tested = [(r, v) for r, v in tested if int(np.isfinite(v).sum()) >= FINDING_ROCKS]
    if not tested:
        return ()
    values = np.column_stack([v for _, v in tested])
    t, p, adjusted = mean_gap_tests(values, draws=draws, rng=rng, unit=unit)
    q = false_discovery_adjusted(p)
    # A scatter known from above only is tested by scores that may all be zero.
    size = np.abs(np.nan_to_num(t, posinf=np.inf, neginf=-np.inf))
    times = times_drawn(unit, rng, draws)
    findings = [
        _finding(case, r, values[:, i], float(adjusted[i]), float(q[i]), times)
        for i, (r, _) in enumerate(tested)
    ]
    order = np.lexsort((-size, adjusted))
    return tuple(findings[i] for i in order.tolist())


def _finding(
    case: Case, residual: Residual, tested: FloatArray, adjusted: float, q: float, times: FloatArray
) -> GapFinding:
    own = np.isfinite(tested)
    weight = np.ones(int(own.sum())) if residual.weight is None else residual.weight[own]
    gap = residual.gap[own]
    x, y = _on_map(case, residual, own)
    return GapFinding(
        place=residual.place, phase=residual.phase, quantity=residual.quantity,
        gap=float(np.average(gap, weights=weight)), unit=residual.unit,
        ci95=_interval(gap, weight, times[:, own]), p_adjusted=adjusted, q_value=q,
        rocks=int(own.sum()), observed=float(np.average(residual.observed[own], weights=weight)),
        predicted=float(np.average(residual.predicted[own], weights=weight)), test=residual.test,
        s0_m=residual.s0_m, s1_m=residual.s1_m, x=x, y=y,
        values=max(residual.steps, int(own.sum())),
    )  # fmt: skip


def _interval(gap: FloatArray, weight: FloatArray, times: FloatArray) -> Range:
    """Return percentiles of the mean over rocks; ``times``: how often each was drawn."""
    below = times @ weight
    drawn = below > 0.0
    if not drawn.any():
        return math.nan, math.nan
    means = (times @ (weight * gap))[drawn] / below[drawn]
    low, high = np.quantile(means, (0.025, 0.975)).tolist()
    return low, high


def _on_map(case: Case, residual: Residual, own: np.ndarray) -> tuple[float, float]:
    """Return the mean over the lines of the rocks of the point in the middle of the place."""
    lines = np.unique(case.line[own & (case.line >= 0)])
    if not lines.size:
        return math.nan, math.nan
    last = case.traces.s[case.traces.offset[lines + 1] - 1]
    s = np.full(lines.size, 0.5 * (residual.s0_m + residual.s1_m))
    if residual.place in case.station_names:
        k = case.station_names.index(residual.place)
        crossed = case.stations[lines, case.station_order[k]]
        s = np.where(np.isfinite(crossed), crossed, s)
    x, y = chainage_to_xy(case.traces, lines, np.clip(s, 0.0, last))
    known = np.isfinite(x)
    if not known.any():
        return math.nan, math.nan
    return float(x[known].mean()), float(y[known].mean())


def locate(findings: Sequence[GapFinding]) -> tuple[str, tuple[str, ...]]:
    """Return the phase ("": nothing is certain) and reaches (may be none) in which the gap begins.

    Single steps say most, reaches more than runs from the release: what is wrong in a single step
    is wrong where it is made.
    """
    sure = [f for f in findings if f.p_adjusted < LEVEL]
    phase = ""
    for test in ("one step", "reach", "free run"):
        own = [f for f in sure if f.test == test]
        if not own:
            continue
        phase = phase or own[0].phase
        if test == "one step" or phase == "release":
            own = [f for f in own if f.phase == phase]
        own = [f for f in own if "-" in f.place and f.s0_m < f.s1_m]
        strongest = max((_strength(f) for f in own), default=0.0)
        reaches = {f.place: f.s0_m for f in own if _strength(f) >= BEGINNING_SHARE * strongest}
        if reaches:
            return phase, tuple(sorted(reaches, key=lambda name: reaches[name]))
    return phase, ()


def _strength(finding: GapFinding) -> float:
    """Return the gap over its standard error."""
    low, high = finding.ci95
    return abs(finding.gap) / (high - low) if high > low else math.inf


def line_stretch(traces: TraceSet, line: int, s0: float, s1: float) -> FloatArray:
    """Return coordinates of a fall line between chainages (m), cut to the line, (n, 2)."""
    own = slice(int(traces.offset[line]), int(traces.offset[line + 1]))
    s, x, y = traces.s[own], traces.x[own], traces.y[own]
    low, high = max(s0, float(s[0])), min(s1, float(s[-1]))
    if not low < high:
        return np.empty((0, 2))
    at = np.concatenate([[low], s[(s > low) & (s < high)], [high]])
    return np.column_stack([np.interp(at, s, x), np.interp(at, s, y)])


def is_stretch(finding: GapFinding) -> bool:
    """Return whether a finding belongs to a stretch of the fall lines rather than to a point."""
    return math.isfinite(finding.s0_m) and finding.s0_m < finding.s1_m


def limits_on(case: Case, finding: GapFinding, line: int) -> tuple[float, float]:
    """Return chainages between which a finding lies on one fall line (m).

    Reaches begin and end where this line crosses the stations; else the mean chainages of the
    finding.
    """
    low, high = finding.s0_m, finding.s1_m
    if finding.place in case.reaches:
        edges = case.stations[line][case.station_order]
        number = case.reaches.index(finding.place)
        if number > 0 and math.isfinite(edges[number - 1]):
            low = float(edges[number - 1])
        if number < edges.size and math.isfinite(edges[number]):
            high = float(edges[number])
    return low, high


def used_lines(case: Case) -> list[int]:
    """Return fall lines that rocks have, ascending."""
    lines: list[int] = np.unique(case.line[case.line >= 0]).tolist()
    return lines


def observed_end(case: Case) -> float:
    """Return the chainage beyond which nothing was observed (m); infinite without any."""
    known = np.concatenate([p.s[np.isfinite(p.s)] for p in case.projected.values()])
    return float(known.max()) if known.size else math.inf
