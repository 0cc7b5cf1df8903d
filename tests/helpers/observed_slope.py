"""A plane slope with rocks that slide down it, as observations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

LV95 = "EPSG:2056"
WEST, NORTH = 2_700_000.0, 1_150_000.0
TOP = 1000.0
#: Tangent of the slope, falling to the south.
TAN = 0.7


def ground(down: Any) -> Any:
    return TOP - TAN * np.asarray(down, float)


def at(aside: float, down: float) -> tuple[float, float, float]:
    """x, y, z on the ground, from the middle of the upper edge."""
    return WEST + 100.0 + aside, NORTH - down, float(ground(down))


TABLES: dict[str, tuple[str, list[list[object]]]] = {
    "rocks": (
        "rock_id,x,y,z,mass_kg,volume_m3,semi_axis_a_m,semi_axis_b_m,semi_axis_c_m,release_speed_mps",
        [[f"R{i}", *at(2.0 * i, 20.0), 540.0, 0.2, 0.42, 0.36, 0.32, 0.0] for i in range(1, 6)],
    ),
    "stations": (
        "station,x0,y0,x1,y1",
        [
            ["S1", at(-60, 100)[0], at(0, 100)[1], at(60, 0)[0], at(0, 100)[1]],
            ["S2", at(-60, 0)[0], at(0, 200)[1], at(60, 0)[0], at(0, 200)[1]],
        ],
    ),
    "passages": (
        "rock_id,station,x,y,z,speed_mps,rotation_hz,height_m",
        [
            [f"R{i}", s, *at(2.5 * i, down)[:2], at(0, down)[2] + 0.8, v + 0.3 * i, 2.5, 0.8]
            for i in range(1, 6)
            for s, down, v in (("S1", 100.0, 14.0), ("S2", 200.0, 17.0))
        ],
    ),
    "impacts": (
        "rock_id,impact,x,y,z,slope_deg,vt_in_mps,vn_in_mps,omega_in_radps,vt_out_mps,vn_out_mps,omega_out_radps,turn_deg",
        [[f"R{i}", 1, *at(2.0 * i, 60.0), 35, 10, -5, 12, 8, 2, 16, 3 - i] for i in range(1, 6)],
    ),
    "deposits": (
        "rock_id,x,y,z,mass_kg,volume_m3",
        [
            *([f"R{i}", *at(3.0 * i, 250.0 + i), 540.0, 0.2] for i in range(1, 5)),
            ["R5.1", *at(20.0, 240.0), 300.0, 0.11],
            ["R5.2", *at(25.0, 245.0), 200.0, 0.075],
            ["", *at(-20.0, 200.0), 50.0, 0.02],
        ],
    ),
    "trajectories": (
        "rock_id,t_s,x,y,z,speed_mps",
        [
            ["R1", t, at(2.0, 0)[0], NORTH - 40.0 - 5.0 * t, ground(40 + 5.0 * t) + 0.5, 6.1033]
            for t in np.arange(0.0, 4.0, 0.25).tolist()
        ],
    ),
    "metadata": (
        "key,value",
        [["fps", 25], ["speed_error_rel", 0.05], ["position_error_m", 0.5], ["place", "made up"]],
    ),
}


def setting(column: str, value: Any, rows: Any = slice(None)) -> Callable[[Any], Any]:
    """A change: a value, or a function of the old one, in a column of some rows."""

    def change(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
        chosen = [records[i] for i in rows] if isinstance(rows, list) else records[rows]
        for record in chosen:
            record[column] = value(record[column]) if callable(value) else value
        return records

    return change
