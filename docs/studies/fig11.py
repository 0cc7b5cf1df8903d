"""Observed over computed paths of rocks at Tschamut, as Fig. 11 of Bozzolo and Pamini (1986).

``python docs/studies/fig11.py DATA -o FOLDER`` writes fig11.png and fig11.json. DATA is the folder
with ``tschamut2014`` (EnviDat): contacts with their times. Between two contacts a rock flies on the
parabola through both that takes the time between them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pandas as pd
from field_cases.sites import tschamut
from field_cases.tables import fresh
from matplotlib.figure import Figure

from sassgis import profile
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.tiles import read_terrain
from sassgis.report.figures import save
from sassgis.report.figures.style import INK, TEXT, WIDTH_IN, house_style, new_figure
from sassgis.terrain.cells import heights_at

GRAVITY = 9.81
#: Rocks with so many contacts that are drawn, and blocks that are simulated for each.
FEWEST, DRAWN, BLOCKS = 8, 12, 60
#: Hops shorter than this are rolling (s), and their hops no higher than a contact's error.
SHORTEST_S = 0.05


def hops(contacts: pd.DataFrame, axis: FloatArray, grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Chainage and height above the ground of a rock along its way (m)."""
    place = contacts[["x", "y"]].to_numpy()
    chainage = (place - axis[0]) @ axis[1]
    out: list[FloatArray] = []
    rows = contacts[["t_start_s", "t_end_s", "z"]].to_numpy()
    for k in range(len(rows) - 1):
        began, ended = rows[k, 1], rows[k + 1, 0]
        time = ended - (rows[k, 0] if np.isnan(began) else began)
        if not time > SHORTEST_S:
            continue
        t = np.linspace(0.0, 1.0, 12)
        xy = place[k] + t[:, None] * (place[k + 1] - place[k])
        rise = rows[k, 2] + t * (rows[k + 1, 2] - rows[k, 2])
        flight = rise + 0.5 * GRAVITY * time**2 * t * (1.0 - t)
        ground = heights_at(grid, *xy.T)
        # Contacts lie on the ground: what their heights are off is taken along the hop.
        ends = (1.0 - t) * (rise[0] - ground[0]) + t * (rise[-1] - ground[-1])
        out.append(np.stack([chainage[k] + t * (chainage[k + 1] - chainage[k]),
                             flight - ground - ends]))  # fmt: skip
    s, height = np.concatenate(out, axis=1) if out else np.empty((2, 0))
    return s, height


def draw(
    ground: tuple[FloatArray, FloatArray], seen: list[FloatArray], made: list[FloatArray]
) -> Figure:
    """Draw the slope with both above it, and their heights by chainage."""
    with house_style():
        figure = new_figure(WIDTH_IN, 5.6)
        section, heights = figure.subplots(2, 1, height_ratios=(3.0, 2.0), sharex=True)
        s, z = ground
        section.fill_between(s, z, z.min() - 4.0, color="#d9d2c3", linewidth=0.0)
        for paths, colour, text in ((made, "#1f77b4", "computed"), (seen, "#d9480f", "observed")):
            for k, (x, h) in enumerate(paths):
                label = text if k == 0 else None
                section.plot(x, np.interp(x, s, z) + h, color=colour, lw=0.6, alpha=0.7)
                heights.plot(x, h, color=colour, lw=0.6, alpha=0.7, label=label)
        section.set(ylabel="height (m)", xlim=(s[0], s[-1]))
        heights.set(xlabel="chainage (m)", ylabel="above the ground (m)", ylim=(0.0, 4.0))
        heights.legend(loc="upper right", labelcolor=INK, fontsize=TEXT)
    return figure


def main(argv: list[str] | None = None) -> None:
    """Draw both, and write how high and how far rocks hop."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args(argv)
    out = fresh(given.output)
    observed = tschamut(given.data, fresh(out / "site")).case.observations["all"]
    rocks = pd.read_csv(observed / "rocks.csv").set_index("rock_id")
    contacts = pd.read_csv(observed / "contacts.csv").dropna(subset=["x", "y", "z"])
    grid = read_terrain(out / "site" / "dem.tif", "local")
    ends = pd.read_csv(observed / "deposits.csv")[["x", "y"]].to_numpy().mean(axis=0)
    start = rocks[["x", "y"]].to_numpy().mean(axis=0)
    ahead = (ends - start) / np.hypot(*(ends - start))
    length = 1.25 * float(np.hypot(*(ends - start)))
    s = np.linspace(0.0, length, 200)
    z = heights_at(grid, *(start + s[:, None] * ahead).T)
    s, z = s[np.isfinite(z)], z[np.isfinite(z)]
    often = contacts["rock_id"].value_counts()
    chosen = sorted(often[often >= FEWEST].index)[:DRAWN]
    seen = [
        np.stack(hops(contacts[contacts["rock_id"] == name], np.stack([start, ahead]), grid))
        for name in chosen
    ]
    first = pd.read_csv(given.data / "tschamut2014" / "release_points.csv")
    speeds = np.hypot(first["vx_mps"], first["vy_mps"]).quantile([0.1, 0.9]).tolist()
    blocks = [
        {
            "name": name,
            **{f"axis_{k}_m": rocks.loc[name, f"semi_axis_{c}_m"] for k, c in enumerate("abc", 1)},
            "speed_mps": speeds,
            "density_kgm3": rocks.loc[name, "density_kgm3"],
        }
        for name in chosen
    ]
    line = pd.DataFrame({"s_m": s, "z_m": z})
    tables = profile(line, blocks=blocks, ground="soft_meadow", n_blocks=BLOCKS // len(chosen))
    made = [
        np.stack([own["s_m"], own["z_m"] - np.interp(own["s_m"], s, z)])
        for _, own in tables.paths.groupby("path")
    ]
    # Of centres; contacts are at the ground.
    made = [np.stack([x, h - h.min()]) for x, h in made]
    save(draw((s, z), seen, made[: len(chosen)]), out / "fig11.png")
    numbers: dict[str, float] = {"rocks": len(chosen), "blocks": len(made)}
    for name, paths in (("observed", seen), ("computed", made)):
        tops = np.array([h.max() for _, h in paths])
        ends = np.array([x.max() for x, _ in paths])
        numbers |= {
            f"{name}_highest_median_m": round(float(np.median(tops)), 2),
            f"{name}_highest_q90_m": round(float(np.quantile(tops, 0.9)), 2),
            f"{name}_end_median_m": round(float(np.median(ends)), 1),
        }
    (out / "fig11.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    print(numbers)


if __name__ == "__main__":
    main()
