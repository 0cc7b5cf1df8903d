"""The least share of energy kept in an impact: Fig. 9 of Bozzolo and Pamini (1986).

``python docs/studies/fig9.py -o FOLDER`` writes fig9.png, fig9.csv and fig9.json.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from sassgis.engine.ellipse import contact_frame, inertia
from sassgis.engine.impact import energy_kept
from sassgis.grid import FloatArray
from sassgis.report.figures import save
from sassgis.report.figures.style import INK, SMALL, TEXT, TITLE, WIDTH_IN, house_style, new_figure

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

    γ is the angle between the radius to the point of contact and the major semi-axis, α the angle
    of incidence from the normal.
    """
    gamma = math.radians(gamma_deg)
    # The normal at P stands at phi to the major axis; P below the centre puts the axis at theta.
    phi = math.atan2(math.sin(gamma), ratio * ratio * math.cos(gamma))
    theta = phi - 0.5 * math.pi
    x, y, _ = contact_frame(1.0, ratio, theta)
    alpha = math.radians(alpha_deg)
    return float(energy_kept(x, y, inertia(1.0, ratio), math.sin(alpha), -math.cos(alpha), 0.0))


@house_style()
def fig9_figure(
    gamma_deg: FloatArray, alpha_deg: FloatArray, surfaces: Sequence[tuple[float, FloatArray]]
) -> Figure:
    """Draw η_min over position angle and incidence, one surface for each shape.

    Parameters
    ----------
    gamma_deg : float, shape (n,)
        Angle between the radius to the contact point and the major semi-axis (degrees, 0 to 180).
    alpha_deg : float, shape (m,)
        Angle of incidence from the normal (degrees, 0 to 90).
    surfaces : (b/a, η_min)
        Ratio of the semi-axes and the coefficient in %, shape (m, n): rows follow alpha.
    """
    figure = new_figure(WIDTH_IN, 3.5, constrained=False)
    title = "Least share of kinetic energy kept in an impact without spin"
    figure.text(0.02, 0.975, title, size=TITLE, weight="bold", va="top", gid="title")
    width = 1.0 / len(surfaces)
    for i, (ratio, eta) in enumerate(surfaces):
        ax: Axes3D = figure.add_axes(
            (i * width + 0.1 * width, -0.01, width * 0.9, 0.9),
            projection="3d",
            label=f"b/a = {ratio:g}",
        )
        ax.plot_surface(
            *np.meshgrid(gamma_deg, alpha_deg),
            eta,
            rcount=alpha_deg.size,
            ccount=gamma_deg.size,
            cmap="Blues",
            vmin=-30.0,
            vmax=110.0,
            edgecolor=INK,
            linewidth=0.25,
            antialiased=True,
            gid="surface",
        )
        ax.view_init(elev=28.0, azim=-122.0)
        ax.set_proj_type("ortho")
        ax.set_box_aspect((1.5, 1.0, 0.85), zoom=0.92)
        ax.set(xlim=(0.0, 180.0), ylim=(0.0, 90.0), zlim=(0.0, 100.0))
        ax.set(xticks=range(0, 181, 45), yticks=range(0, 91, 30), zticks=range(0, 101, 25))
        ax.tick_params(labelsize=SMALL, pad=-1)
        ax.set_xlabel("γ (°)", labelpad=-1, size=TEXT)
        ax.set_ylabel("α (°)", labelpad=-1, size=TEXT)
        ax.set_zlabel(r"$\eta_{min}$ (%)", labelpad=-1, size=TEXT)
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.pane.set_facecolor("white")
            axis.pane.set_edgecolor("#cccccc")
        figure.text(
            (i + 0.05) * width,
            0.86,
            f"{'abcdefgh'[i % 8]}  b/a = {ratio:.2f}",
            size=TEXT,
            weight="bold",
            gid="panel",
        )
    return figure


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
        names = "b_over_a gamma_deg alpha_deg closed_form_percent engine_percent difference"
        writer.writerow(names.split())
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
