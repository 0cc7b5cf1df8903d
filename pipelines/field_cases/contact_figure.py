"""Rebound, tangential speed and energy kept by normal speed, observed and simulated."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from sassgis.model.grid import FloatArray
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    SMALL,
    WIDTH_IN,
    house_style,
    new_figure,
)

_NAMES = ("$R_n$", "$R_t$", "energy kept")
_BINS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0])
_FEWEST = 10


@house_style()
def contact_figure(
    films: pd.DataFrame,
    seen: FloatArray,
    made: FloatArray,
    program: pd.DataFrame,
    program_seen: FloatArray,
    program_made: FloatArray,
) -> Figure:
    """Each filmed contact, and medians of the program's, beside those of the model.

    Parameters
    ----------
    films, program : DataFrame
        Contacts.
    seen, program_seen : float64, shape (n, 4)
        R_n, R_t, energy kept, spin over that of rolling.
    made, program_made : float64, shape (n, m, 4)
    """
    figure = new_figure(WIDTH_IN, 4.6)
    axes = figure.subplots(2, 3)
    speed = -films["vn_in_mps"].to_numpy()
    for k, ax in enumerate(axes[0]):
        low, middle, high = np.nanquantile(made[..., k], [0.1, 0.5, 0.9], axis=1)
        ax.vlines(speed, low, high, color=BLUE, lw=3)
        ax.plot(speed, middle, "_", color=INK, ms=9)
        ax.plot(speed, seen[:, k], "D", mfc=ORANGE, mec=INK, mew=0.4, ms=5)
        ax.set_title(f"{_NAMES[k]}: films")
    for k, ax in enumerate(axes[1]):
        for name, style in (("overgrown_slope", "-"), ("rock", "--")):
            own = (program["ground"] == name).to_numpy()
            for values, colour in (
                (program_seen[:, None, k], ORANGE),
                (program_made[..., k], BLUE),
            ):
                x, y = _medians(-program["vn_in_mps"].to_numpy()[own], values[own])
                ax.plot(x, y, style, marker="o", ms=3, color=colour)
        ax.set_title(f"{_NAMES[k]}: program")
    for ax in axes.ravel():
        ax.set_xlabel("normal speed before (m/s)")
        ax.set_ylim(0.0)
    figure.supxlabel(
        "orange: observed (above), discrete-element program (below); blue: simulated, above 10 to "
        "90 %. Full: soil; dashed: rock",
        size=SMALL, color=GREY, x=0.01, ha="left",
    )  # fmt: skip
    return figure


def _medians(speed: FloatArray, values: FloatArray) -> tuple[list[float], list[float]]:
    """Median by normal speed, where there are enough contacts."""
    x, y = [], []
    for low, high in pairwise(_BINS.tolist()):
        own = (speed >= low) & (speed < high)
        if own.sum() >= _FEWEST:
            x.append(float(np.median(speed[own])))
            y.append(float(np.nanmedian(values[own])))
    return x, y
