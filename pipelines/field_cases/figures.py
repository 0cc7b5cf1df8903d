"""Figures of the field cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sassgis.grid import FloatArray
from sassgis.report.figures.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    ORANGE,
    SKY,
    SMALL,
    VERMILION,
    WIDTH_IN,
    house_style,
    new_figure,
)

_FORM_COLOURS = {"base": INK, "velocity_scaled": BLUE, "scar": GREEN, "slip": VERMILION}
_PANELS = ("v_t after (m/s)", "v_n after (m/s)", "spin after (rad/s)", "energy kept")


@house_style()
def contacts_figure(
    seen: FloatArray, left_out: Mapping[str, Mapping[str, Any]], names: Sequence[str]
) -> Figure:
    """Observed states after the contacts, and the held-out predictions of each form.

    Parameters
    ----------
    seen : float64, shape (n, 5)
    left_out : mapping of form to its predictions
        "mean", "q05", "q95", each of shape (n, 5).
    names : sequence of str
        Of the contacts.
    """
    figure = new_figure(WIDTH_IN, 2.9)
    at = np.arange(len(seen))
    for q, ax in enumerate(figure.subplots(1, 4)):
        for f, (form, found) in enumerate(left_out.items()):
            colour = _FORM_COLOURS[form]
            x = at - 0.25 + 0.14 * f
            low, middle, high = (np.array(found[k])[:, q] for k in ("q05", "mean", "q95"))
            ax.vlines(x, low, high, color=colour, lw=1.2)
            ax.plot(x, middle, "o", ms=3, color=colour, ls="none", label=form)
        ax.plot(
            at + 0.34, seen[:, q], "D", ms=4, mfc=ORANGE, mec=INK, mew=0.4, ls="none",
            label="observed",
        )  # fmt: skip
        ax.set_title(_PANELS[q])
        ax.set_xticks(at)
        ax.set_xticklabels([n.replace(" ", " / ") for n in names], rotation=90)
        ax.set_xlim(-0.5, len(seen) - 0.4)
        ax.axhline(0.0, color=GREY, lw=0.6)
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    figure.suptitle(
        "Chant Sura: contacts predicted from the observed state before", x=0.01, ha="left",
        weight="bold",
    )  # fmt: skip
    return figure


@house_style()
def scars_figure(
    normal: FloatArray,
    depth: Mapping[str, FloatArray],
    predicted: FloatArray,
    run: Sequence[str],
    length: FloatArray,
    chord: FloatArray,
) -> Figure:
    """Depth of scars over the normal speed, and their length against the chord of the form."""
    figure = new_figure(WIDTH_IN, 3.3)
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    order = np.argsort(normal)
    left.plot(normal[order], predicted[order], color=GREEN, label="scar form, default")
    for (name, values), mark, colour in zip(depth.items(), "os", (ORANGE, SKY), strict=True):
        for number, filled in zip(sorted(set(run)), (True, False), strict=True):
            own = np.array(run) == number
            left.plot(
                normal[own], values[own], mark, ms=4.5, mec=INK if filled else colour, mew=0.8,
                mfc=colour if filled else "white", ls="none", label=f"{name}, run {number}",
            )  # fmt: skip
    left.set_xlabel("normal speed from the jump height (m/s)")
    left.set_ylabel("depth of the scar (m)")
    left.set_ylim(0.0, None)
    at = np.arange(length.size)
    right.bar(at - 0.18, length, 0.34, color=ORANGE, label="observed")
    right.bar(at + 0.18, chord, 0.34, color=GREEN, label="chord at the observed depth")
    right.set_xticks(at)
    right.set_xticklabels([f"impact {i + 1}" for i in at])
    right.set_ylabel("length of the scar (m)")
    for ax, columns in ((left, 2), (right, 1)):
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=columns)
    figure.suptitle("Chant Sura: scars of the block of 780 kg", x=0.01, ha="left", weight="bold")
    return figure


@house_style()
def field_figure(sites: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]]) -> Figure:
    """Shares of rocks that stop within a distance: observed, before and now; and their offsets.

    Parameters
    ----------
    sites : mapping of name to (observed, before, now)
        Each float64, shape (n, 2): run-out and lateral offset (m).
    """
    figure = new_figure(WIDTH_IN, 2.6 * len(sites))
    for axes, (name, samples) in zip(
        figure.subplots(len(sites), 2, squeeze=False), sites.items(), strict=True
    ):
        marks = ((INK, "observed"), (GREY, "assumptions and classes of 1986"), (BLUE, "built-in"))
        for rows, (colour, label) in zip(samples, marks, strict=True):
            for ax, values in zip(axes, rows.T, strict=True):
                share = (np.arange(values.size) + 0.5) / values.size
                ax.step(np.sort(values), 100.0 * share, color=colour, lw=1.4, label=label)
        axes[0].set_title(name, loc="left")
        axes[0].set_xlabel("run-out in plan (m)")
        axes[1].set_xlabel("lateral offset (m)")
        axes[0].set_ylabel("rocks (%)")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


_RATIOS = ("$R_n$", "$R_t$", "energy kept")
_SPEED_BINS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0])
_FEWEST_IN_BIN = 10


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
        ax.set_title(f"{_RATIOS[k]}: films")
    for k, ax in enumerate(axes[1]):
        for name, style in (("overgrown_slope", "-"), ("rock", "--")):
            own = (program["ground"] == name).to_numpy()
            for values, colour in (
                (program_seen[:, None, k], ORANGE),
                (program_made[..., k], BLUE),
            ):
                x, y = _medians(-program["vn_in_mps"].to_numpy()[own], values[own])
                ax.plot(x, y, style, marker="o", ms=3, color=colour)
        ax.set_title(f"{_RATIOS[k]}: program")
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
    for low, high in pairwise(_SPEED_BINS.tolist()):
        own = (speed >= low) & (speed < high)
        if own.sum() >= _FEWEST_IN_BIN:
            x.append(float(np.median(speed[own])))
            y.append(float(np.nanmedian(values[own])))
    return x, y


@house_style()
def kinematics_figure(seen: Mapping[str, FloatArray], made: Mapping[str, FloatArray]) -> Figure:
    """Distributions of speeds, heights and contacts of all rocks, observed and simulated.

    Both by quantity, values of shape (n,).
    """
    shown = (n for n in seen if not n.startswith("energy") and not n.endswith("kg"))
    seen = {name: seen[name] for name in shown}
    units = {"speed": "m/s", "greatest speed": "m/s", "height": "m", "run-out": "m", "hop": "m"}
    figure = new_figure(WIDTH_IN, 5.4)
    axes = figure.subplots(3, 4)
    for ax, (name, values) in zip(axes.flat, seen.items(), strict=False):
        for own, colour, label in ((values, INK, "observed"), (made[name], BLUE, "simulated")):
            ordered = np.sort(own)
            ax.plot(ordered, np.linspace(0.0, 1.0, ordered.size), color=colour, label=label)
        unit = next((u for key, u in units.items() if name.startswith(key)), "")
        ax.set_xlabel(f"{name} ({unit})" if unit else name)
        ax.set_xlim(0.0, 1.25 * float(np.quantile(np.concatenate([values, made[name]]), 0.98)))
        ax.set_ylim(0.0, 1.0)
    for ax in axes.flat[len(seen) :]:
        ax.set_axis_off()
    axes[0, 0].legend(loc="lower right", fontsize=SMALL)
    for row in axes:
        row[0].set_ylabel("share of rocks")
    return figure


#: Models of the figure of the steps, with their colours.
_BEFORE_AFTER = {"former": VERMILION, "resistance": SKY, "everything": BLUE}
_BY_DISTANCE = {"speed": "m/s", "energy": "kJ", "height": "m"}


@house_style()
def steps_figure(results: Mapping[str, Any]) -> Figure:
    """Held-out rocks before and after by distance, and what each step closes of the gap.

    Parameters
    ----------
    results : mapping
        As of added_steps.
    """
    motion = results["left_out"]
    shown = {name: motion[name] for name in _BEFORE_AFTER}
    places = [name.split(" ", 1)[1] for name in motion["former"] if name.startswith("speed ")]
    figure = new_figure(WIDTH_IN, 4.6)
    above, below = figure.subfigures(2, 1, height_ratios=(1.0, 0.9))
    for ax, (what, unit) in zip(above.subplots(1, 3), _BY_DISTANCE.items(), strict=True):
        rows = [f"{what} {place}" for place in places]
        _quantile_bars(ax, rows, shown)
        ax.set_xticks(range(len(rows)), places)
        ax.set_title(f"{what} ({unit})")
        ax.set_ylim(0.0)
    left, middle, right = below.subplots(1, 3, width_ratios=(0.7, 0.7, 1.0))
    _quantile_bars(left, ["contacts"], shown)
    left.set_xticks([])
    left.set_title("contacts")
    left.set_ylim(0.0)
    cliff = results["chant_sura"]
    published = np.divide(cliff["former"]["speed"], 1.0 + np.array(cliff["former"]["speed_error"]))
    speeds = {"observed": published, **{name: cliff[name]["speed"] for name in shown}}
    for x, (name, quartiles) in enumerate(speeds.items()):
        colour = _BEFORE_AFTER.get(name, INK)
        middle.vlines(x, quartiles[0], quartiles[2], color=colour, lw=1.6)
        middle.plot(x, quartiles[1], "o", ms=4, color=colour)
    middle.set_xticks([])
    middle.set_xlim(-1.0, len(speeds))
    middle.set_title("Chant Sura: speed (m/s)")
    middle.set_ylim(0.0)
    rungs = [r for r in results["tschamut"] if r["share"] is not None]
    for y, rung in enumerate(reversed(rungs)):
        colour = _BEFORE_AFTER.get(rung["rung"], LIGHT)
        right.barh(y, 100.0 * rung["share"], color=colour, height=0.6)
        if rung["ci95"] is not None:
            right.plot([100.0 * v for v in rung["ci95"]], [y, y], color=INK, lw=1.0)
    right.set_yticks(range(len(rungs)), [r["rung"] for r in reversed(rungs)])
    right.set_title("gap closed (%)")
    right.axvline(0.0, color=GREY, lw=0.6)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _quantile_bars(
    ax: Axes, rows: Sequence[str], models: Mapping[str, Mapping[str, Mapping[str, Any]]]
) -> None:
    """Median and 10 to 90 % of rocks and blocks, side by side."""
    seen = next(iter(models.values()))
    columns = {"observed": (INK, [seen[row]["observed"] for row in rows])}
    for name, own in models.items():
        columns[name] = _BEFORE_AFTER[name], [own[row]["simulated"] for row in rows]
    for k, (label, (colour, values)) in enumerate(columns.items()):
        x = np.arange(len(rows)) + 0.18 * (k - 0.5 * (len(columns) - 1))
        low, middle, high = np.array(values).T
        ax.vlines(x, low, high, color=colour, lw=1.6)
        ax.plot(x, middle, "o", ms=4, color=colour, label=label)
    ax.set_xlim(-0.5, len(rows) - 0.5)
