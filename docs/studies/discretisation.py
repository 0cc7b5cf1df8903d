"""How much does the discretisation of the slope into segments affect the result?

The open question of Bozzolo and Pamini (1986).

``python docs/studies/discretisation.py -o FOLDER [--rocks N]`` writes a figure per slope,
summary.csv (pooled over the lines), lines.csv (line by line), splitting.csv and study.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator
from scipy.stats import ks_2samp
from slopes import Slope, follow, split, table_slope, valley_slopes
from study_tables import write_csv

import sassgis
from sassgis.grid import FloatArray
from sassgis.report.figures import save
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    SMALL,
    WIDTH_IN,
    head,
    house_style,
    new_figure,
    thousands_formatter,
    wrap,
)
from sassgis.settings.results import StopReason
from sassgis.terrain.prepare import LEAD_IN_M, with_lead_in

TOLERANCES = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
SEED = 1986
LINES = 16
STATIONS = {"valley": (60.0, 150.0, 250.0), "bedrina": (62.0, 118.0), "piota_negra": (70.0, 110.0)}
RUNOUT_SHARES = (0.25, 0.5, 0.95)
BOOTSTRAP = 400


def quantities(
    runout: FloatArray, energy: FloatArray, height: FloatArray, stations: tuple[float, ...]
) -> dict[str, float]:
    """Quantities compared over the tolerances; arrays of shape (..., n_rocks)."""
    out = {f"run-out {100 * q:g} % (m)": float(np.quantile(runout, q)) for q in RUNOUT_SHARES}
    for k, chainage in enumerate(stations):
        there = np.isfinite(energy[k])
        out[f"arrivals at {chainage:g} m (%)"] = 100.0 * float(there.mean())
        for name, unit, values in (("E95", "kJ", energy[k]), ("height 95 %", "m", height[k])):
            most = float(np.quantile(values[there], 0.95)) if there.any() else np.nan
            out[f"{name} at {chainage:g} m ({unit})"] = most
    return out


def study(name: str, slopes: list[Slope], rocks: int) -> tuple[list[dict], list[dict]]:
    """Run one set of lines at every tolerance; rows pooled over the lines, and line by line."""
    stations = STATIONS[name]
    n = len(slopes)
    pooled: dict[float, tuple[FloatArray, FloatArray, FloatArray]] = {}
    per_line = []
    segments = {}
    for tolerance in TOLERANCES:
        runout = np.empty((n, rocks))
        energy = np.full((len(stations), n, rocks), np.nan)
        height = np.full_like(energy, np.nan)
        segment_length = []
        for i, slope in enumerate(slopes):
            flat = slope.profile(tolerance)
            reached = [k for k, c in enumerate(stations) if c <= slope.length_m]
            table, energy[reached, i], height[reached, i] = follow(
                slope, flat, rocks, SEED, [stations[k] for k in reached]
            )
            runout[i] = table["runout_m"]
            segment_length.append(slope.length_m / (flat.s.size - 1))
            per_line.append(
                {
                    "slope": slope.name,
                    "tolerance_m": tolerance,
                    "segments": flat.s.size - 1,
                    "left_profile_percent": 100.0
                    * float((table["reason"] == StopReason.LEFT_PROFILE).mean()),
                    **quantities(runout[i], energy[:, i], height[:, i], stations),
                }
            )
        segments[tolerance] = float(np.mean(segment_length))
        pooled[tolerance] = (runout, energy, height)
        print(name, tolerance, f"{segments[tolerance]:.1f} m a segment", flush=True)

    # The same draws of rocks for all tolerances, so that differences are between like and like.
    rng = np.random.default_rng(SEED)
    values = {t: quantities(*pooled[t], stations) for t in TOLERANCES}
    names = list(values[TOLERANCES[0]])
    drawn = {t: {q: np.empty(BOOTSTRAP) for q in names} for t in TOLERANCES}
    rows_of_lines = np.arange(n)[:, None]
    for b in range(BOOTSTRAP):
        pick = rng.integers(0, rocks, (n, rocks))
        for t in TOLERANCES:
            again = quantities(*(part[..., rows_of_lines, pick] for part in pooled[t]), stations)
            for q in names:
                drawn[t][q][b] = again[q]
    summary = []
    finest = TOLERANCES[0]
    for q in names:
        for t in TOLERANCES:
            low, high = np.quantile(drawn[t][q], (0.025, 0.975))
            gap = drawn[t][q] - drawn[finest][q]
            gap_low, gap_high = np.quantile(gap, (0.025, 0.975))
            summary.append(
                {
                    "slope": name,
                    "quantity": q,
                    "tolerance_m": t,
                    "segment_length_m": segments[t],
                    "value": values[t][q],
                    "low_95": low,
                    "high_95": high,
                    "minus_finest": values[t][q] - values[finest][q],
                    "minus_finest_low_95": gap_low,
                    "minus_finest_high_95": gap_high,
                }
            )
    return summary, per_line


def draw(summary: list[dict], name: str, count: int, out: Path) -> None:
    """A figure of one slope; quantities that do not change have no panel."""
    shown = {}
    for q in dict.fromkeys(r["quantity"] for r in summary if r["slope"] == name):
        rows = [r for r in summary if r["slope"] == name and r["quantity"] == q]
        arrays = tuple(
            np.array([float(r[k]) for r in rows]) for k in ("value", "low_95", "high_95")
        )
        if np.ptp(np.concatenate(arrays)) > 1e-9 and not q.startswith("arrivals"):
            shown[q] = arrays
    tolerances = np.array([float(r["tolerance_m"]) for r in rows])
    title = f"{name}: {count} rocks for each tolerance"
    save(convergence_figure(tolerances, shown, title=title), out / f"{name}.png")


def splitting(slopes: list[Slope], rocks: int) -> list[dict]:
    """Divide the segments of given polylines; the ground is unchanged."""
    rows = []
    for slope in slopes:
        # With the ground behind the start: added to a cut profile, it would lie a rounding off.
        flat = with_lead_in(slope.profile(0.25), LEAD_IN_M)
        whole, _, _ = follow(slope, flat, rocks, SEED, lead_in=False)
        other, _, _ = follow(slope, flat, rocks, SEED + 1, lead_in=False)
        for parts in (2, 8):
            cut, _, _ = follow(slope, split(flat, parts), rocks, SEED, lead_in=False)
            gap = cut["runout_m"] - whole["runout_m"]
            same = gap == 0.0
            fresh, _, _ = follow(slope, split(flat, parts), rocks, SEED + 1, lead_in=False)
            rows.append(
                {
                    "slope": slope.name,
                    "parts": parts,
                    "rocks": rocks,
                    "same_rocks_percent": 100.0 * float(same.mean()),
                    "mean_change_m": float(gap.mean()),
                    "standard_error_m": float(gap.std(ddof=1) / np.sqrt(rocks)),
                    "D_same_seed": ks_2samp(whole["runout_m"], cut["runout_m"]).statistic,
                    "p_other_seed": ks_2samp(whole["runout_m"], fresh["runout_m"]).pvalue,
                    "p_other_seed_unsplit": ks_2samp(whole["runout_m"], other["runout_m"]).pvalue,
                }
            )
    return rows


@house_style()
def convergence_figure(
    tolerances: FloatArray,
    series: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]],
    *,
    title: str = "Effect of the cutting of the slope into segments",
) -> Figure:
    """Draw results against the tolerance of the segments, with their statistical range.

    Parameters
    ----------
    tolerances : float, shape (n,)
        Largest distance between terrain and segment (m).
    series : by name with unit, (values, lower, upper) of float, shape (n,)
        One panel each; lower and upper are the limits of the confidence interval.
    """
    order = np.argsort(tolerances)
    x, finest = tolerances[order], order[0]
    columns = min(len(series), 3)
    rows = -(-len(series) // columns)
    figure = new_figure(WIDTH_IN, 0.55 + 2.35 * rows)
    axes: Sequence[Axes] = figure.subplots(rows, columns, squeeze=False).ravel()
    head(figure, title)
    for ax in axes[len(series) :]:
        ax.set_visible(False)
    for ax, (name, (values, lower, upper)) in zip(axes, series.items(), strict=False):
        ax.set_title(wrap(name, WIDTH_IN / columns - 0.4, SMALL + 1.0), size=SMALL + 1.0)
        ax.axhspan(lower[finest], upper[finest], color=BLUE, alpha=0.1, lw=0, gid="finest")
        gaps = np.vstack([values - lower, upper - values])[:, order]
        ax.errorbar(
            x, values[order], yerr=np.maximum(gaps, 0.0), fmt="o-", color=BLUE, ms=3.5, lw=1.2,
            elinewidth=0.9, capsize=2.0,
        )  # fmt: skip
        low, high = np.nanmin(lower), np.nanmax(upper)
        span = high - low
        ax.set(xscale="log", xticks=x, xlabel="segment tolerance (m)")
        ax.set_ylim(low - 0.15 * (span or 1.0), high + 0.15 * (span or 1.0))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.xaxis.set_major_formatter("{x:g}")
        # As many decimals as the range needs.
        ax.yaxis.set_major_formatter(
            thousands_formatter(0 if span >= 5.0 else 1 if span >= 0.5 else 2)
        )
    figure.supxlabel(
        "band: confidence interval at the finest tolerance",
        size=SMALL,
        color=GREY,
        x=0.01,
        ha="left",
    )
    return figure


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--rocks", type=int, default=2000, help="rocks on each line")
    options = parser.parse_args()
    out: Path = options.output
    out.mkdir(parents=True, exist_ok=True)
    sets = {
        "valley": valley_slopes(LINES),
        "bedrina": [table_slope("bedrina", "config_before.toml")],
        "piota_negra": [table_slope("piota_negra", "config.toml")],
    }
    summary, lines = [], {}
    for name, slopes in sets.items():
        rows, per_line = study(name, slopes, options.rocks)
        summary += rows
        lines[name] = per_line
    write_csv(out / "summary.csv", summary)
    draw(summary, "valley", LINES * options.rocks, out)
    for name, rows in lines.items():
        write_csv(out / f"lines_{name}.csv", rows)
    cut = splitting(
        [sets["bedrina"][0], sets["piota_negra"][0], sets["valley"][0], sets["valley"][LINES // 2]],
        options.rocks,
    )
    write_csv(out / "splitting.csv", cut)
    facts = {
        "program": f"sassgis {sassgis.__version__}",
        "rocks_per_line": options.rocks,
        "seed": SEED,
        "lines": {name: len(slopes) for name, slopes in sets.items()},
        "bootstrap_draws": BOOTSTRAP,
    }
    (out / "study.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
