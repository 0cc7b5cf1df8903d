"""The least share of energy kept in an impact: Fig. 9 of Bozzolo and Pamini (1986).

``python docs/studies/fig9.py -o FOLDER`` writes fig9.png, fig9.csv and fig9.json.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from pathlib import Path

import numpy as np

from sassgis.engine.ellipse import contact_frame, inertia
from sassgis.engine.impact import energy_kept
from sassgis.report.figures import fig9_figure, save

ALPHAS = (0, 30, 60, 90)

#: η_min in % from the closed form R²/(R² + I) sin²(α ∓ δ), to two decimals: rows γ, columns α.
#: γ: angle between OP and the major semi-axis; R = |OP|; tan φ = (a²/b²) tan γ; δ = φ − γ; minus
#: where P leads the centre (γ < 90°). Table for b/a = 0.76, then 0.40.
CLOSED_FORM = {
    0.76: {
        0: (0.0, 19.00, 57.01, 76.02),
        30: (4.87, 4.89, 36.43, 67.95),
        60: (2.70, 6.72, 37.62, 64.48),
        90: (0.0, 16.17, 48.50, 64.67),
        120: (2.70, 29.56, 60.46, 64.48),
        150: (4.87, 36.40, 67.94, 67.95),
        180: (0.0, 19.00, 57.01, 76.02),
    },
    0.40: {
        0: (0.0, 20.29, 60.88, 81.17),
        30: (31.99, 4.09, 4.64, 33.10),
        60: (8.15, 0.39, 15.55, 38.46),
        90: (0.0, 10.20, 30.61, 40.82),
        120: (8.15, 31.06, 46.21, 38.46),
        150: (31.99, 60.44, 61.00, 33.10),
        180: (0.0, 20.29, 60.88, 81.17),
    },
}


def eta_min(ratio: float, gamma_deg: float, alpha_deg: float) -> float:
    """η_min of the engine without spin, for an ellipse of semi-axes 1 and ``ratio``.

    Parameters
    ----------
    ratio : float
        b/a.
    gamma_deg : float
        Angle between the radius to the point of contact and the major semi-axis.
    alpha_deg : float
        Angle of incidence from the normal.
    """
    gamma = math.radians(gamma_deg)
    # The normal at P stands at phi to the major axis; P below the centre puts the axis at theta.
    phi = math.atan2(math.sin(gamma), ratio * ratio * math.cos(gamma))
    theta = phi - 0.5 * math.pi
    x, y, _ = contact_frame(1.0, ratio, theta)
    alpha = math.radians(alpha_deg)
    return float(energy_kept(x, y, inertia(1.0, ratio), math.sin(alpha), -math.cos(alpha), 0.0))


def main() -> None:
    """Write figure, table and summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    out = parser.parse_args().output
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for ratio, table in CLOSED_FORM.items():
        for gamma, values in table.items():
            for alpha, expected in zip(ALPHAS, values, strict=True):
                computed = 100.0 * eta_min(ratio, gamma, alpha)
                rows.append((ratio, gamma, alpha, expected, computed, computed - expected))
    with (out / "fig9.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(
            [
                "b_over_a",
                "gamma_deg",
                "alpha_deg",
                "closed_form_percent",
                "engine_percent",
                "difference",
            ]
        )
        writer.writerows((*r[:4], f"{r[4]:.4f}", f"{r[5]:.4f}") for r in rows)
    largest = max(abs(r[5]) for r in rows)
    gamma, alpha = np.linspace(0.0, 180.0, 61), np.linspace(0.0, 90.0, 31)
    surfaces = [
        (ratio, np.array([[100.0 * eta_min(ratio, g, a) for g in gamma] for a in alpha]))
        for ratio in CLOSED_FORM
    ]
    save(fig9_figure(gamma, alpha, surfaces), out / "fig9.png")
    highest = {f"{ratio:g}": round(float(values.max()), 2) for ratio, values in surfaces}
    summary = {
        "values": len(rows),
        "largest_difference_percent": round(largest, 4),
        "highest_percent": highest,
    }
    (out / "fig9.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
