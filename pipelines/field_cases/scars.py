"""Scars at Chant Sura: depth, length and energy against the ``scar`` form of soft ground."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from field_cases.contacts import plate_axes
from field_cases.figures import scars_figure
from field_cases.impact_law import State, left_out_scores, summary
from sassgis.engine.effects import soft_ground
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.ellipse import inertia
from sassgis.grid import FloatArray
from sassgis.report.figures import save

#: Rotational over translational energy before an impact (Lu et al. 2019).
SPIN_SHARE = 0.2
DEPTHS = {
    "photogrammetry": "observed_scarring_depth_m",
    "in the field": "observed_scarring_depth_ifm_m",
}


def scar_study(folder: Path, out: Path, seed: int) -> dict[str, Any]:
    """Compare scars with the form; writes ``scars.png``.

    Of the six impacts of Caviezel et al. (2019) the normal speed is what their jump height gives,
    √(2 g h), no measurement. Of the four of Lu et al. (2019) it is not known.
    """
    six = pd.read_csv(folder / "scarring_esurf2019" / "chant_sura_esurf_2019_impacts.csv")
    four = pd.read_csv(folder / "scarring_lu2019" / "lu2019_table2_impacts.csv")
    form = SoftGround(form="scar")
    numbers = soft_ground.prepare(form)
    mass = six["mass_kg"].to_numpy()
    normal = six["incoming_normal_speed_mps"].to_numpy()
    kept = six["published_energy_transition_ratio"].to_numpy()
    run = [str(s).split(".")[0] for s in six["scar_id"]]
    a, b, c = plate_axes(float(mass[0]))
    radius = (a * b * c) ** (1.0 / 3.0)
    predicted = np.array(
        [soft_ground.scar_depth(numbers, m, radius, v) for m, v in zip(mass, normal, strict=True)]
    )
    depth = {name: six[column].to_numpy() for name, column in DEPTHS.items()}
    shares = {
        name: np.array([1.0 - _left_at(form, d, m, radius) for d, m in zip(v, mass, strict=True)])
        for name, v in depth.items()
    }
    lost = 1.0 - kept
    loses = lost > 0.0
    states, seen = [], np.full((len(six), 5), np.nan)
    dip = _dip(four)
    for i, r in enumerate(six.to_dict("records")):
        spin = math.sqrt(SPIN_SHARE * r["incoming_total_speed_mps"] ** 2 / inertia(a, b))
        states.append(
            State(dip, r["incoming_tangent_speed_mps"], -r["incoming_normal_speed_mps"], spin,
                  (a, b, c), r["mass_kg"])
        )  # fmt: skip
        seen[i, 4] = r["published_energy_transition_ratio"]
    # Only the translational energy was published.
    law = left_out_scores(states, seen, run, (4,), seed)
    length = four["scar_length_m"].to_numpy()
    chord = _chord(four["scar_depth_m"].to_numpy(), radius)
    widest = _chord(four["scar_depth_m"].to_numpy(), a)
    level = np.hypot(four["vx_mps"].to_numpy(), four["vy_mps"].to_numpy())
    save(scars_figure(normal, depth, predicted, run, length, chord), out / "scars.png")
    return {
        "impacts": len(six),
        "normal_speed_mps": normal,
        "depth_m": depth,
        "depth_predicted_m": predicted,
        "depth_left_out": {name: _depth_left_out(v, predicted, run) for name, v in depth.items()},
        "rank_correlation_with_normal_speed": {
            name: float(spearmanr(normal, v).statistic) for name, v in depth.items()
        },
        "energy_kept_published": kept,
        "energy_lost_median": float(np.median(lost[loses])),
        "energy_share_of_scar_at_seen_depth": shares,
        "drag_coefficient_needed": {
            name: float(
                np.median([
                    math.log(1.0 - lo) / math.log(1.0 - sh)
                    for lo, sh in zip(lost[loses], v[loses], strict=True)
                ])
            )
            for name, v in shares.items()
        },
        "dip_taken_deg": math.degrees(dip),
        "energy_kept_left_out": {form: summary(found) for form, found in law.items()},
        "lu": {
            "impacts": len(four),
            "scar_length_m": length,
            "chord_at_seen_depth_m": chord,
            "chord_of_longest_axis_m": widest,
            "length_over_chord": length / chord,
            "horizontal_speed_kept": level[1:] / level[:-1],
            "spin_kept": four["wres_radps"].to_numpy()[1:] / four["wres_radps"].to_numpy()[:-1],
            # The speed after a contact is at least its horizontal part, constant in flight.
            "rim_over_speed_at_most": four["wres_radps"].to_numpy()[1:] * a / level[1:],
        },
    }  # fmt: skip


def _chord(depth: FloatArray, radius: float) -> FloatArray:
    """Length of the scar in the form: the chord of a circle at that depth (m)."""
    d = np.minimum(depth, radius)
    chord: FloatArray = 2.0 * np.sqrt(2.0 * radius * d - d * d)
    return chord


def _left_at(form: SoftGround, depth: float, mass: float, radius: float) -> float:
    """Share of the energy left by the form with C = 1 for a scar of a given depth."""
    # The form derives the depth from the speed: a scale that gives this depth at 1 m/s.
    one = soft_ground.prepare(form)._replace(depth_scale=1.0, drag_coefficient=1.0)
    one = one._replace(depth_scale=depth / soft_ground.scar_depth(one, mass, radius, 1.0))
    return float(soft_ground.scar_energy_left(one, mass, radius, 1.0))


def _depth_left_out(seen: FloatArray, predicted: FloatArray, run: list[str]) -> dict[str, float]:
    """Mean absolute error (m): the form with its factor from the other run, and no form at all."""
    own = np.array(run)
    scaled, level = np.empty(seen.size), np.empty(seen.size)
    for name in set(run):
        other = own != name
        scaled[~other] = predicted[~other] * np.median(seen[other] / predicted[other])
        level[~other] = np.median(seen[other])
    return {
        "as_it_comes_m": float(np.abs(predicted - seen).mean()),
        "factor_of_other_run_m": float(np.abs(scaled - seen).mean()),
        "median_of_other_run_m": float(np.abs(level - seen).mean()),
    }


def _dip(four: pd.DataFrame) -> float:
    """Mean dip of the slope between the first and the last start point of Lu et al. (rad)."""
    x, y, z = (four[c].to_numpy() for c in ("x_start_lv95", "y_start_lv95", "z_start_m"))
    return math.atan2(z[0] - z[-1], math.hypot(x[-1] - x[0], y[-1] - y[0]))
