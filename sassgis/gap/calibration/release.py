"""The observed rocks released again with a class table: what a calibration compares with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sassgis.gap.observations.campaign import Campaign, main_blocks, observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, LateralWalk
from sassgis.gap.replicas.rock_lines import RockLines
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable
from sassgis.model.settings import LateralDeflection
from sassgis.terrain.flatten import chainage_to_xy


@dataclass(frozen=True, slots=True)
class Released:
    """What one campaign left.

    Attributes
    ----------
    x, y : float64, shape (n_rocks,)
        Where the largest block of each rock lies (m); NaN where none was found.
    campaign : Campaign
        Its passages at stations.
    """

    x: FloatArray
    y: FloatArray
    campaign: Campaign


def observed(case: Case) -> Released:
    """The observed campaign."""
    seen = observed_campaign(case)
    x, y = (np.full(case.n_rocks, np.nan) for _ in range(2))
    if seen.deposits is not None:
        main = main_blocks(seen.deposits, case.n_rocks)
        has, table = main >= 0, case.observations.deposits
        x[has], y[has] = table.x[main[has]], table.y[main[has]]
    return Released(x, y, seen)


def released(
    case: Case, rock_lines: RockLines, table: GroundTable, *, count: int, seed: int, number: int
) -> list[Released]:
    """Release the rocks of a case ``count`` times with a class table, as configured else.

    Campaigns of other numbers are other draws. The stated errors of measurement are in them.
    """
    walk = LateralWalk()
    lateral = case.effects.get(LateralDeflection)
    if lateral is not None:
        kicks = lateral.form != "constant"
        walk = (
            LateralWalk(angle_deg=lateral.angle_deg, hop_m=lateral.hop_m)
            if kicks
            else LateralWalk(width_percent=lateral.width_percent)
        )
    model = HypothesisModel(table, case.effects.without(LateralDeflection), lateral_walk=walk)
    made = campaigns(case, rock_lines, model, count=count, seed=seed, number=number, impacts=False)
    return [_on_the_map(case, one) for one in made]


def _on_the_map(case: Case, sample: Campaign) -> Released:
    """Stops along fall lines as places."""
    x, y = (np.full(case.n_rocks, np.nan) for _ in range(2))
    if sample.deposits is not None:
        main = main_blocks(sample.deposits, case.n_rocks)
        has = np.flatnonzero(main >= 0)
        rows, traces = main[has], case.traces
        line = case.line[has]
        low = traces.s[traces.offset[line]]
        s = np.clip(sample.deposits.s[rows], low, traces.s[traces.offset[line + 1] - 1])
        at_x, at_y = chainage_to_xy(traces, line, s)
        # The direction of the line, from one metre before to one metre behind.
        ends = traces.s[traces.offset[line + 1] - 1]
        x0, y0 = chainage_to_xy(traces, line, np.maximum(s - 1.0, low))
        x1, y1 = chainage_to_xy(traces, line, np.minimum(s + 1.0, ends))
        size = np.maximum(np.hypot(x1 - x0, y1 - y0), 1e-9)
        lateral = sample.deposits.lateral_m[rows]
        x[has] = at_x + lateral * (y1 - y0) / size
        y[has] = at_y - lateral * (x1 - x0) / size
    return Released(x, y, sample)
