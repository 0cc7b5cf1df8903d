"""Contacts at Chant Sura: measured velocities, resolved along the ground and its normal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import rasterio

from sassgis.grid import FloatArray

#: Radius of the ground about a contact to which a plane is fitted (m).
REACH_M = 0.5
#: A contact farther from the terrain than this was not on the surveyed ground (m).
OFF_GROUND_M = 0.3
#: Axes of the EOTA 221 block of 780 kg (G. Lu et al. 2019, Table 2), scaled to other masses.
PLATE_M, PLATE_KG = (0.93, 0.93, 0.47), 780.0


def read_contacts(folder: Path, reach_m: float = REACH_M) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Contacts and rocks in the columns of tables of observations.

    Parameters
    ----------
    reach_m : float
        Radius of the ground about a contact to which a plane is fitted (m).

    Returns
    -------
    contacts : DataFrame
        A row for each contact; ``left_out`` is the reason why one cannot be used,
        ``above_ground_m`` the height of its first point above the terrain.
    rocks : DataFrame
        A row for each run.
    """
    events = pd.read_csv(folder / "observed_contact_events_extended.csv")
    flights = pd.read_csv(folder / "observed_trajectories_contact_extended.csv")
    starts = pd.read_csv(folder / "release_points_contact_extended.csv")
    spin = np.linalg.norm(flights[[f"omega_{c}_radps" for c in "xyz"]].to_numpy(), axis=1)
    by_flight = flights.assign(spin=spin).groupby("trajectory_id")["spin"]
    ground = Ground(folder / "terrain_rf16_contact_extended.asc", reach_m)
    rows = []
    for event in events.to_dict("records"):
        into = np.array([event[f"incoming_v{c}_mps"] for c in "xyz"])
        out = np.array([event[f"outgoing_v{c}_mps"] for c in "xyz"])
        normal, height = ground.plane(event["x_m"], event["y_m"])
        azimuth = [math.degrees(math.atan2(v[0], v[1])) for v in (into, out)]
        ahead = into[:2] / np.hypot(*into[:2])
        number = int(event["event_id"].rsplit("_", 1)[1])
        row: dict[str, Any] = {
            "rock_id": event["source_trajectory_id"],
            "impact": number,
            "x": event["x_m"],
            "y": event["y_m"],
            "slope_deg": math.degrees(math.atan(float(normal[:2] @ ahead) / normal[2])),
            "vt_in_mps": float(np.linalg.norm(into - (into @ normal) * normal)),
            "vn_in_mps": float(into @ normal),
            "omega_in_radps": float(by_flight.last()[event["source_segment_id"]]),
            "vt_out_mps": float(np.linalg.norm(out - (out @ normal) * normal)),
            "vn_out_mps": float(out @ normal),
            "omega_out_radps": float(by_flight.first()[event["next_segment_id"]]),
            "turn_deg": (azimuth[1] - azimuth[0] + 180.0) % 360.0 - 180.0,
            "mass_kg": event["mass_kg"],
            "above_ground_m": event["raw_z_m"] - height,
        }
        row["left_out"] = _why_left_out(row, number)
        rows.append(row)
    first = starts.groupby("source_trajectory_id", sort=False).first()
    axes = [plate_axes(m) for m in first["mass_kg"]]
    rocks = pd.DataFrame(
        {
            "rock_id": first.index.to_numpy(),
            "x": first["x_m"].to_numpy(),
            "y": first["y_m"].to_numpy(),
            "mass_kg": first["mass_kg"].to_numpy(),
            **{f"semi_axis_{c}_m": [a[i] for a in axes] for i, c in enumerate("abc")},
        }
    )
    # An EOTA 111 block (e) is a cube: its axes follow from its mass.
    cube = rocks["rock_id"].str.contains("e").to_numpy()
    side = np.cbrt(rocks["mass_kg"] / 2670.0 / (4.0 / 3.0 * math.pi))
    for c in "abc":
        rocks.loc[cube, f"semi_axis_{c}_m"] = side[cube]
    return pd.DataFrame(rows), rocks


def _why_left_out(row: Mapping[str, Any], number: int) -> str:
    if number == 0:
        return (
            "the flight before it starts at one nominal point for all runs, at speeds up to 6 m/s "
            "up or down: not measured"
        )
    if row["vn_in_mps"] >= 0.0:
        return "its incoming velocity points away from the ground: the terrain there differs"
    if abs(row["above_ground_m"]) > OFF_GROUND_M:
        return f"{row['above_ground_m']:+.2f} m off the terrain, which was surveyed in another year"
    return ""


def plate_axes(mass_kg: float) -> tuple[float, float, float]:
    """Semi-axes of an EOTA 221 block (m)."""
    scale = 0.5 * (mass_kg / PLATE_KG) ** (1.0 / 3.0)
    a, b, c = (scale * side for side in PLATE_M)
    return a, b, c


class Ground:
    """Planes through a terrain model."""

    def __init__(self, file: Path, reach_m: float = REACH_M) -> None:
        self._reach = reach_m
        with rasterio.open(file) as source:
            self._z = source.read(1).astype(np.float64)
            rows, cols = np.indices(self._z.shape)
            x, y = rasterio.transform.xy(source.transform, rows.ravel(), cols.ravel())
        self._x, self._y = np.asarray(x).reshape(rows.shape), np.asarray(y).reshape(rows.shape)

    def plane(self, x: float, y: float) -> tuple[FloatArray, float]:
        """Outward normal and height of the plane through the ground about a point."""
        near = np.hypot(self._x - x, self._y - y) < self._reach
        dx, dy = self._x[near] - x, self._y[near] - y
        fit = np.linalg.lstsq(np.c_[np.ones(dx.size), dx, dy], self._z[near], rcond=None)[0]
        normal = np.array([-fit[1], -fit[2], 1.0])
        return normal / np.linalg.norm(normal), float(fit[0])
