"""Single impacts at Chant Sura against the impact law of a ground class."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from field_cases.contacts import plate_axes, read_contacts
from sassgis.engine.ellipse import frame_of, inertia, mean_radius
from sassgis.engine.impact import RESTITUTION, impact
from sassgis.engine.rolling import rolling_friction
from sassgis.gap.residuals.impact_step import orientation_at_contact
from sassgis.model.ground import GroundClass

FloatArray = NDArray[np.float64]

DRAWS = 400
#: Slower impacts along the normal are not compared (m/s).
FAST_MPS = 3.0


def after_impact(
    ground: GroundClass,
    axes: tuple[float, float, float],
    dip: float,
    vt: float,
    vn: float,
    omega: float,
    rng: np.random.Generator,
) -> FloatArray:
    """v_t, v_n and spin after an impact, in random orientations; shape (DRAWS, 3).

    ``dip`` of the ground along the travel (rad); orientation and slope are drawn as the engine
    draws them.
    """
    a, b, c = axes
    inert = inertia(a, b)
    size = float(np.cbrt(a * b * c))
    mu_r = rolling_friction(ground.mu_0, ground.k, ground.d_star_m, size)
    resistance = mu_r * (1.0 + inert / mean_radius(a, b) ** 2)
    made = np.empty((DRAWS, 3))
    for k in range(DRAWS):
        theta = orientation_at_contact(a, b, rng.uniform(0.0, math.pi), vn, omega)
        u = rng.uniform(ground.dp_min, ground.dp_max)
        turn = dip - math.atan(math.tan(dip) * (1.0 - u)) if dip > 0.0 else 0.0
        cosine, sine = math.cos(turn), math.sin(turn)
        x, y, _ = frame_of(a, b, math.sin(theta - turn), math.cos(theta - turn))
        wt, wn, spin = impact(
            x, y, inert, vt * cosine + vn * sine, vn * cosine - vt * sine, omega, ground.eta_max,
            RESTITUTION, ground.mu_f, ground.restitution, ground.restitution_speed_mps, resistance,
        )  # fmt: skip
        made[k] = wt * cosine - wn * sine, wn * cosine + wt * sine, spin
    return made


def contacts(folder: Path, ground: GroundClass, seed: int = 1986) -> dict[str, Any]:
    """Medians of R_n, R_t and of the share of the energy kept, over fast contacts."""
    events, rocks = read_contacts(folder)
    axes = rocks.set_index("rock_id")[[f"semi_axis_{c}_m" for c in "abc"]]
    known = events["omega_in_radps"].notna() & events["omega_out_radps"].notna()
    fast = events[known & (events["vn_in_mps"] < -FAST_MPS)]
    seen, made = [], []
    for i, row in enumerate(fast.to_dict("records")):
        a, b, c = (float(v) for v in axes.loc[row["rock_id"]])
        inert = inertia(a, b)
        vt, vn, omega = (
            row[f"{q}_in_{u}"] for q, u in (("vt", "mps"), ("vn", "mps"), ("omega", "radps"))
        )
        before = vt**2 + vn**2 + inert * omega**2
        out = after_impact(
            ground, (a, b, c), math.radians(row["slope_deg"]), vt, vn, omega,
            np.random.default_rng([seed, i]),
        )  # fmt: skip
        own = np.array([[row["vt_out_mps"], row["vn_out_mps"], row["omega_out_radps"]]])
        for rows, found in ((out, made), (own, seen)):
            energy = rows[:, 0] ** 2 + rows[:, 1] ** 2 + inert * rows[:, 2] ** 2
            found.append(
                np.median(np.c_[rows[:, 1] / -vn, rows[:, 0] / vt, energy / before], axis=0)
            )
    names = ("r_n", "r_t", "energy_kept")
    return {
        "contacts": len(fast),
        "observed_median": dict(zip(names, np.median(seen, axis=0), strict=True)),
        "simulated_median": dict(zip(names, np.median(made, axis=0), strict=True)),
    }


def grazing(folder: Path, ground: GroundClass, seed: int = 1986) -> dict[str, Any]:
    """Horizontal speed after over before fast grazing impacts (G. Lu et al. 2019, Table 2).

    The slope is that from one impact to the next; the last row has no flight after it.
    """
    table = pd.read_csv(folder / "scarring_lu2019" / "lu2019_table2_impacts.csv")
    level = np.hypot(table["vx_mps"], table["vy_mps"]).to_numpy()
    run = np.hypot(np.diff(table["x_start_lv95"]), np.diff(table["y_start_lv95"]))
    dips = np.arctan2(-np.diff(table["z_start_m"]), run)
    axes = plate_axes(780.0)
    seen, made = [], []
    for i, dip in enumerate(dips.tolist()):
        down = -float(table["vz_mps"][i])
        vt = level[i] * math.cos(dip) + down * math.sin(dip)
        vn = level[i] * math.sin(dip) - down * math.cos(dip)
        if vn >= 0.0:
            continue
        out = after_impact(
            ground,
            axes,
            dip,
            vt,
            vn,
            float(table["wres_radps"][i]),
            np.random.default_rng([seed, i]),
        )
        after = out[:, 0] * math.cos(dip) + out[:, 1] * math.sin(dip)
        made.append(float(np.median(after)) / level[i])
        seen.append(float(level[i + 1] / level[i]))
    return {"observed": seen, "simulated_median": made}
