"""Make the observations of the sample valley: ``python sample_dem/observed/make.py [FOLDER]``.

Nobody released these rocks. They are blocks of the model of ``valley/config.toml`` on its
terrain, on ground of which one class differs from what that file says. Errors of measurement
are added, and the tables are rounded as one writes in the field.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sassgis.engine.ellipse import mean_radius
from sassgis.engine.simulate import Simulated, moving_axes
from sassgis.engine.simulate_paths import follow
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import ControlLine, ReleasePoints
from sassgis.simulation.loop import path_terrain
from sassgis.terrain.cells import heights_at
from sassgis.terrain.prepare import plan
from sassgis.terrain.release import take

AREA, SCENARIO, ROCKS = "Sued", "rare", 40
#: Further south some rocks would leave the terrain model.
NORTH_OF_M = 1_120_280.0
#: What the ground is made with; ``config.toml`` has the built-in debris, 0.90 and 0.45.
TRUE_GROUND, TRUE_VALUES = "debris", {"eta_max": 0.80, "mu_0": 0.39}
#: Ends of the stations (m), across the scree and at its end.
STATIONS = {
    "S1": ((2_700_336.0, 1_120_150.0), (2_700_392.0, 1_120_366.0)),
    "S2": ((2_700_468.0, 1_120_116.0), (2_700_524.0, 1_120_332.0)),
}
#: Standard errors: two shares, two lengths (m).
ERRORS = {"speed_error_rel": 0.05, "height_error_m": 0.15, "position_error_m": 0.5}
MASS_ERROR_REL = 0.03
SEED = 41


def true_ground(table: GroundTable) -> GroundTable:
    """The ground that the rocks meet."""
    return GroundTable(
        tuple(replace(c, **TRUE_VALUES) if c.name == TRUE_GROUND else c for c in table.classes)
    )


def released(run: MapRun) -> tuple[ReleasePoints, Simulated]:
    """Places all over the north of the release area, and a rock from each."""
    points = plan(run).points
    own = np.flatnonzero((points.area == points.area_names.index(AREA)) & (points.y > NORTH_OF_M))
    chosen = take(points, own[np.linspace(0, own.size - 1, ROCKS).round().astype(int)])
    # The places are known: each rock starts at its point.
    chosen = replace(chosen, sides=None)
    done = follow(
        path_terrain(run),
        chosen,
        true_ground(run.table),
        next(b for b in run.blocks if b.name == SCENARIO),
        run.engine,
        seed=SEED,
        rocks_per_point=1,
        point_keys=chosen.key,
    )
    return chosen, done


def dips(grid: Grid, places: FloatArray) -> FloatArray:
    """Dip of the ground (rad), over two cells."""
    step = grid.cell_size
    (x, y) = places.T
    east = heights_at(grid, x + step, y) - heights_at(grid, x - step, y)
    north = heights_at(grid, x, y + step) - heights_at(grid, x, y - step)
    return np.arctan(np.hypot(east, north) / (2.0 * step))


def write_table(file: Path, header: str, rows: Sequence[Sequence[object]]) -> None:
    """Write a CSV file; numbers have been rounded."""
    lines = [header, *(",".join(str(v) for v in row) for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def make(folder: Path, config: Path) -> None:
    """Write the tables."""
    stations = [(ControlLine(name, "station"), np.array(ends)) for name, ends in STATIONS.items()]
    run = replace(read_map_run(load_config(config), [AREA]), control_lines=stations)
    points, done = released(run)
    rng = np.random.default_rng(SEED)

    def off(values: FloatArray, relative: float) -> FloatArray:
        wrong: FloatArray = values * (1.0 + relative * rng.standard_normal(values.shape))
        return wrong

    def placed(places: FloatArray) -> list[list[float]]:
        error = ERRORS["position_error_m"] * rng.standard_normal(places.shape)
        found: list[list[float]] = (places + error).round(1).tolist()
        return found

    rocks, passages = done.rocks, np.sort(done.passages, order=("line", "control_line"))
    names = [f"R{k + 1:02d}" for k in range(ROCKS)]
    axes = np.column_stack([rocks[f"{c}_m"] for c in "abc"]).round(2)
    mass = off(rocks["mass_kg"], MASS_ERROR_REL)
    folder.mkdir(parents=True, exist_ok=True)
    write_table(
        folder / "rocks.csv",
        "rock_id,x,y,mass_kg,semi_axis_a_m,semi_axis_b_m,semi_axis_c_m",
        [
            (name, *xy, 10 * round(kg / 10), *own)
            for name, xy, kg, own in zip(
                names,
                placed(np.column_stack([points.x, points.y])),
                mass.tolist(),
                axes.tolist(),
                strict=True,
            )
        ],
    )
    write_table(
        folder / "stations.csv",
        "station,x0,y0,x1,y1",
        [(name, *first, *last) for name, (first, last) in STATIONS.items()],
    )
    own = passages["line"]
    places = np.column_stack([passages["x_m"], passages["y_m"]])
    # The engine counts heights from that of a lying block; a rock that rolls lies on no axis.
    axes = moving_axes(np.column_stack([rocks["a_m"], rocks["b_m"]])[own], run.engine)
    rolling = np.array([mean_radius(*pair) for pair in axes])
    height = passages["height_m"]
    height = height + np.where(height > 0.0, axes[:, 1], rolling) / np.cos(
        dips(run.heights, places)
    )
    height += ERRORS["height_error_m"] * rng.standard_normal(height.size)
    write_table(
        folder / "passages.csv",
        "rock_id,station,x,y,speed_mps,height_m,mass_kg",
        [
            (names[k], station, *xy, round(v, 1), max(round(h, 1), 0.0), 10 * round(kg / 10))
            for k, station, xy, v, h, kg in zip(
                own.tolist(),
                np.array(list(STATIONS))[passages["control_line"]].tolist(),
                placed(places),
                off(passages["speed_mps"], ERRORS["speed_error_rel"]).tolist(),
                height.tolist(),
                off(passages["mass_kg"], MASS_ERROR_REL).tolist(),
                strict=True,
            )
        ],
    )
    write_table(
        folder / "deposits.csv",
        "rock_id,x,y,mass_kg",
        [
            (names[k], *xy, 10 * round(kg / 10))
            for k, xy, kg in zip(
                rocks["line"].tolist(),
                placed(np.column_stack([done.x, done.y])),
                off(rocks["mass_kg"], MASS_ERROR_REL).tolist(),
                strict=True,
            )
        ],
    )
    write_table(folder / "metadata.csv", "key,value", list(ERRORS.items()))


if __name__ == "__main__":
    here = Path(__file__).resolve().parent
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else here, here.parent / "valley" / "config.toml")
