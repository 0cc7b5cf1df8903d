"""The observed rocks released again with a class table: what a calibration compares with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.gap.observations.campaign import (
    Campaign,
    PassageRows,
    main_blocks,
    observed_campaign,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.projection import PROLONG_M, prolonged
from sassgis.gap.replicas.campaigns import campaigns, passages_followed
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, LateralWalk
from sassgis.gap.replicas.rock_lines import RockLines
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable
from sassgis.model.map_run import MapRun
from sassgis.model.profiles import ReleasePoints
from sassgis.model.results import ControlLine, StopReason
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
    case: Case,
    rock_lines: RockLines,
    terrain: PathTerrain | None,
    table: GroundTable,
    *,
    count: int,
    seed: int,
    number: int,
) -> list[Released]:
    """Release the rocks of a case ``count`` times with a class table, as configured else.

    Campaigns of other numbers are other draws. The stated errors of measurement are in them.

    Parameters
    ----------
    terrain : PathTerrain or None
        What paths are followed on, with the stations of the case; None: rocks keep to their fall
        lines.
    """
    if terrain is not None:
        return _followed(case, rock_lines, terrain, table, count, seed, number)
    return _on_lines(case, rock_lines, table, count, seed, number)


def terrain_of(case: Case, run: MapRun) -> PathTerrain | None:
    """What the paths of the rocks of a case are followed on; None if they keep to fall lines."""
    if not run.followed:
        return None
    stations = case.observations.stations
    lines = [
        (ControlLine(name, "station"), prolonged(stations.vertices[row], PROLONG_M))
        for name, row in zip(case.station_names, case.station_order.tolist(), strict=True)
    ]
    return PathTerrain(run.heights, run.ground, run.segment_tolerance_m, lines, run.forest)


def _followed(
    case: Case,
    rock_lines: RockLines,
    terrain: PathTerrain,
    table: GroundTable,
    count: int,
    seed: int,
    number: int,
) -> list[Released]:
    """Each rock along the path that it takes over the terrain."""
    n = case.n_rocks
    first = case.traces.offset[case.line]
    points = ReleasePoints(
        case.traces.x[first],
        case.traces.y[first],
        np.arange(n, dtype=np.int64),
        rock_lines.keys,
        case.observations.rock_names,
    )
    result = follow(
        terrain,
        points,
        table,
        case.blocks,
        case.engine,
        seed=seed,
        rocks_per_point=count,
        point_keys=rock_lines.keys,
        first_rock=number * 64,
        effects=case.effects,
    )
    rng = np.random.default_rng([seed, number, 78])
    ended = np.concatenate([result.rocks, result.pieces])
    whole = ended["reason"] != StopReason.BROKEN
    error = rock_lines.errors.position_m
    x, y = (v + error * rng.standard_normal(v.size) for v in (result.x, result.y))
    at = np.full((2, count, n), np.nan)
    # Written last: the largest block that is left of each rock.
    for i in np.flatnonzero(whole)[np.argsort(ended["mass_kg"][whole], kind="stable")].tolist():
        at[:, ended["rock"][i] - number * 64, ended["line"][i]] = x[i], y[i]
    passages: list[PassageRows] | list[None] = [None] * count
    if len(case.observations.passages) and case.station_names:
        passages = passages_followed(case, rock_lines, result, count=count, rng=rng)
    return [
        Released(at[0, k], at[1, k], Campaign(n, own, None, None)) for k, own in enumerate(passages)
    ]


def _on_lines(
    case: Case, rock_lines: RockLines, table: GroundTable, count: int, seed: int, number: int
) -> list[Released]:
    """Each rock on its fall line."""
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
