"""A case in which a simulated campaign stands in the place of what was observed."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from sassgis.gap.observations.case import LOOSE, PIECE, Campaign, Case
from sassgis.gap.observations.projection import Projected, project
from sassgis.gap.observations.tables import Deposits, Impacts, Passages, TextArray, Trajectories
from sassgis.grid import FloatArray, IntArray
from sassgis.terrain.flatten import chainage_to_xy


def with_campaign(case: Case, made: Campaign) -> Case:
    """Return the case with what a campaign of a model shows in the place of what was observed.

    Pieces bear the name of their rock with a number, blocks that were set in motion none.
    """
    names, stations = np.array(case.observations.rock_names), np.array(case.station_names)
    put = dict(case.projected)
    tables: dict[str, Any] = {"trajectories": Trajectories.of()}

    def place(table: str, rock: IntArray, s: FloatArray, aside: FloatArray) -> None:
        blank = np.full(rock.size, math.nan)
        put[table] = Projected(case.line[rock], s, aside, blank, blank, np.zeros(rock.size, "i1"))

    if (rows := made.passages) is not None:
        tables["passages"] = Passages.of(
            rock_id=_named(names, rows.rock, rows.kind), station=stations[rows.station],
            speed_mps=rows.speed_mps, rotation_hz=rows.rotation_hz, height_m=rows.height_m,
            mass_kg=rows.mass_kg,
        )  # fmt: skip
        place("passages", rows.rock, case.station_s[rows.rock, rows.station], rows.lateral_m)
    if (left := made.deposits) is not None:
        named = _named(names, left.rock, left.kind)
        tables["deposits"] = Deposits.of(rock_id=named, mass_kg=left.mass_kg)
        place("deposits", left.rock, left.s, left.lateral_m)
    if (hit := made.impacts) is not None:
        x, y = chainage_to_xy(case.traces, case.line[hit.rock], hit.s)
        x, y = np.where(np.isfinite(hit.x), hit.x, x), np.where(np.isfinite(hit.y), hit.y, y)
        tables["impacts"] = Impacts.of(
            rock_id=names[hit.rock], impact=np.arange(hit.rock.size).astype(np.str_), x=x, y=y,
            z=hit.z, slope_deg=hit.slope_deg, turn_deg=hit.turn_deg, vt_in_mps=hit.vt_in,
            vn_in_mps=hit.vn_in, omega_in_radps=hit.spin_in, vt_out_mps=hit.vt_out,
            vn_out_mps=hit.vn_out, omega_out_radps=hit.spin_out,
        )  # fmt: skip
        place("impacts", hit.rock, hit.s, np.zeros(hit.rock.size))
    if (film := made.paths) is not None:
        tables["trajectories"] = Trajectories.of(
            rock_id=names[film.rock], t_s=film.t_s, x=film.x, y=film.y, z=film.z,
            speed_mps=film.speed_mps, rotation_hz=film.rotation_hz,
        )  # fmt: skip
        put["trajectories"] = project(
            case.traces, case.line[film.rock], film.x, film.y, film.z, grid=case.grid,
            prolonged=case.terrain is not None,
        )  # fmt: skip
    return replace(case, observations=replace(case.observations, **tables), projected=put)


def _named(names: TextArray, rock: IntArray, kind: IntArray) -> TextArray:
    """Return the name that each block bears."""
    pieces = np.char.add(np.char.add(names[rock], "."), np.arange(1, rock.size + 1).astype(np.str_))
    return np.select([kind == LOOSE, kind == PIECE], [np.str_(""), pieces], names[rock])
