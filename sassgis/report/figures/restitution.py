"""The least share of energy kept in an impact (as Bozzolo and Pamini 1986, Fig. 9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.report.figures.style import (
    INK,
    SMALL,
    TEXT,
    TITLE,
    WIDTH_IN,
    new_figure,
    styled,
)


@styled
def fig9_figure(
    gamma_deg: FloatArray,
    alpha_deg: FloatArray,
    surfaces: Sequence[tuple[float, FloatArray]],
    *,
    title: str = "Least share of kinetic energy kept in an impact without spin",
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
    title : str

    Raises
    ------
    InputError
        A surface does not fit the angles, or there is none.
    """
    gamma = np.asarray(gamma_deg, float)
    alpha = np.asarray(alpha_deg, float)
    if not surfaces:
        raise InputError("the figure of the restitution needs at least one surface", found=0)
    figure = new_figure(WIDTH_IN, 3.5, constrained=False)
    figure.text(0.02, 0.975, title, size=TITLE, weight="bold", va="top", gid="title")
    width = 1.0 / len(surfaces)
    for i, (ratio, values) in enumerate(surfaces):
        eta = np.asarray(values, float)
        if eta.shape != (alpha.size, gamma.size):
            raise InputError(
                f"the surface for b/a = {ratio:g} does not fit the angles",
                found=f"shape {eta.shape}",
                expected=f"({alpha.size}, {gamma.size})",
            )
        ax: Axes3D = figure.add_axes(
            (i * width + 0.1 * width, -0.01, width * 0.9, 0.9),
            projection="3d",
            label=f"b/a = {ratio:g}",
        )
        g, a = np.meshgrid(gamma, alpha)
        ax.plot_surface(
            g,
            a,
            eta,
            rcount=alpha.size,
            ccount=gamma.size,
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
        ax.set_xlim(0.0, 180.0)
        ax.set_ylim(0.0, 90.0)
        ax.set_zlim(0.0, 100.0)
        ax.set_xticks([0, 45, 90, 135, 180])
        ax.set_yticks([0, 30, 60, 90])
        ax.set_zticks([0, 25, 50, 75, 100])
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
