"""A slope with a configuration, a case on it, and diagnoses made by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from helpers.observed_slope import LV95, NORTH, WEST, at

from sassgis.engine.effects.trees import Trees
from sassgis.gap.diagnosis import (
    Advice,
    Comparison,
    Diagnosis,
    GapFinding,
    GroundSetting,
    Hypothesis,
    ModelGap,
    Rung,
    Shrinkage,
    Verdict,
)
from sassgis.gap.forward.released_rocks import ForestStand, HypothesisModel
from sassgis.gap.observations.case import Case
from sassgis.grid import Grid
from sassgis.outputs.raster import write_raster
from sassgis.runs.calibrate import read_case
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.results import Band, RasterLayer

CONFIG = """\
# A slope in the files beside it.
[project]
name = "Test slope"

[terrain]
dem = "files/dem.tif"
path = "fall_line"
smoothing_m = 2.0

[release]
file = "files/release.gpkg"
name_field = "name"
spacing_m = 10.0
rocks_per_point = 4

[ground]
default = "debris"

[[blocks]]
name = "0.2 m3"
axis_1_m = [0.40, 0.44]
axis_2_m = 0.36
axis_3_m = 0.32

[[stations]]
name = "road"
line = [[2700020.0, 1149880.0], [2700180.0, 1149880.0]]

[engine]
readings = "1986"
max_events = 20000

[run]
seed = 3
jobs = 1
"""


def write_slope(folder: Path, grid: Grid, *, config: str = CONFIG) -> Path:
    """The configuration with its files."""
    band = Band("height", "Height", "m", grid.values.astype(np.float32))
    write_raster(RasterLayer("dem", "DEM", "", (band,), (), "hillshade"), grid, folder / "files")
    frame = gpd.GeoDataFrame(
        {"name": ["top"]},
        geometry=[shapely.box(WEST + 85.0, NORTH - 25.0, WEST + 115.0, NORTH - 15.0)],
        crs=LV95 if grid.crs else None,
    )
    frame.to_file(folder / "files" / "release.gpkg", driver="GPKG", layer="release")
    path = folder / "config.toml"
    path.write_text(config)
    return path


def write_observations(
    folder: Path, rocks: int, *, passages: bool = True, stops: bool = True
) -> Path:
    """Rocks that go down the slope: faster at the second station, some to the side."""
    rng = np.random.default_rng(rocks)
    folder.mkdir(parents=True)
    aside = rng.uniform(-12.0, 12.0, rocks)
    lines = ["rock_id,x,y,z,mass_kg,volume_m3"]
    for i in range(rocks):
        x, y, z = at(aside[i], 20.0)
        lines.append(f"R{i},{x},{y},{z},{rng.uniform(300, 800):.0f},0.2")
    (folder / "rocks.csv").write_text("\n".join(lines) + "\n")
    if passages:
        lines = ["station,x0,y0,x1,y1"]
        for name, down in (("S1", 100.0), ("S2", 190.0)):
            (x0, y, _), (x1, _, _) = at(-60.0, down), at(60.0, down)
            lines.append(f"{name},{x0},{y},{x1},{y}")
        (folder / "stations.csv").write_text("\n".join(lines) + "\n")
        lines = ["rock_id,station,x,y,z,speed_mps,rotation_hz,height_m"]
        for i in range(rocks):
            for name, down, mean in (("S1", 100.0, 12.0), ("S2", 190.0, 9.0)):
                x, y, z = at(aside[i] + rng.normal(0, 3), down)
                v = mean + rng.normal(0, 2)
                lines.append(f"R{i},{name},{x},{y},{z + 0.8},{v:.3f},{v / 5:.3f},0.8")
        (folder / "passages.csv").write_text("\n".join(lines) + "\n")
        lines = [
            "rock_id,impact,x,y,z,slope_deg,vt_in_mps,vn_in_mps,omega_in_radps,vt_out_mps,"
            "vn_out_mps,omega_out_radps,turn_deg"
        ]
        for i in range(0, rocks, 2):
            x, y, z = at(aside[i], 60.0)
            lines.append(f"R{i},1,{x},{y},{z},35,10,-5,12,{7 + rng.normal():.3f},2,16,3")
        (folder / "impacts.csv").write_text("\n".join(lines) + "\n")
    if stops:
        lines = ["rock_id,x,y,z,mass_kg,volume_m3"]
        for i in range(rocks):
            x, y, z = at(aside[i] + rng.normal(0, 6), rng.uniform(205, 270))
            name = f"R{i}" if i else "R0.1"
            lines.append(f"{name},{x},{y},{z},250,0.1")
        x, y, z = at(30.0, 150.0)
        lines.append(f",{x},{y},{z},20,0.01")
        (folder / "deposits.csv").write_text("\n".join(lines) + "\n")
    return folder


def made_case(
    folder: Path, grid: Grid, rocks: int = 40, *, config: str = CONFIG, **tables: bool
) -> tuple[Path, Case]:
    """Configuration and case."""
    path = write_slope(folder, grid, config=config)
    return path, read_case(path, write_observations(folder / "observed", rocks, **tables))


def calibrated(table: GroundTable, **changes: float) -> GroundTable:
    """The table with other numbers for debris."""
    return GroundTable(
        tuple(replace(c, **changes) if c.name == "debris" else c for c in table.classes)
    )


def finding(place: str, phase: str, quantity: str, gap: float, **changes: Any) -> GapFinding:
    """A finding, sure unless it is said otherwise."""
    unit = {"speed_mps": "m/s", "rotation_hz": "1/s", "height_m": "m", "energy_kept": "",
            "runout_m": "m", "lateral_m": "m"}[quantity]  # fmt: skip
    spread = 0.3 * abs(gap) + 0.02
    s = {"S1": (80.0, 80.0), "S2": (170.0, 170.0), "release-S1": (0.0, 80.0),
         "S1-S2": (80.0, 170.0), "S2-end": (170.0, 250.0)}.get(place, (0.0, 250.0))  # fmt: skip
    x, y, _ = at(0.0, 20.0 + 0.5 * sum(s))
    values: dict[str, Any] = {
        "place": place, "phase": phase, "quantity": quantity, "gap": gap, "unit": unit,
        "ci95": (gap - spread, gap + spread), "p_adjusted": 0.002, "q_value": 0.001, "rocks": 38,
        "observed": 9.0, "predicted": 9.0 - gap, "test": "free run", "s0_m": s[0], "s1_m": s[1],
        "x": x, "y": y,
    }  # fmt: skip
    return GapFinding(**{**values, **changes})


FINDINGS = (
    finding("S2", "flight", "speed_mps", -2.1),
    finding("S1-S2", "flight", "speed_mps", -1.6, test="reach", p_adjusted=0.004),
    finding("S2-end", "stopping", "runout_m", -21.0, p_adjusted=0.03),
    finding("S2", "flight", "rotation_hz", -0.4, p_adjusted=0.09, q_value=0.03),
    finding("S1", "flight", "speed_mps", -0.2, p_adjusted=0.9, q_value=0.6, ci95=(-0.9, 0.5)),
    finding("release-S1", "flight", "speed_mps", 0.1, p_adjusted=1.0, q_value=0.8,
            ci95=(-0.6, 0.8), test="reach"),
    finding("S2-end", "rolling", "speed_mps", 0.9, p_adjusted=0.2, q_value=0.04, test="reach"),
    finding("all", "impact", "energy_kept", 0.01, p_adjusted=1.0, q_value=0.9, ci95=(-0.02, 0.04),
            test="one step", rocks=20),
    finding("ground:debris", "impact", "energy_kept", 0.02, p_adjusted=1.0, q_value=0.9,
            ci95=(-0.02, 0.06), test="one step", rocks=20, x=float("nan"), y=float("nan"),
            s0_m=float("nan"), s1_m=float("nan")),
    finding("S1", "flight", "height_m", 0.1, p_adjusted=1.0, q_value=0.7, ci95=(-0.1, 0.3)),
    finding("all", "stopping", "lateral_m", 4.0, p_adjusted=0.6, q_value=0.3, ci95=(-2.0, 10.0)),
)  # fmt: skip


def comparisons(case: Case, effect: bool) -> tuple[Comparison, ...]:
    """Observed values, and models around them."""
    rng = np.random.default_rng(5)
    out = []

    def add(place: str, quantity: str, unit: str, seen: Any, shift: float, spread: float) -> None:
        seen = seen[np.isfinite(seen)]
        if seen.size:
            base = rng.normal(seen.mean() + shift, spread, 20 * seen.size)
            after = rng.normal(seen.mean() + 0.2 * shift, spread, 20 * seen.size)
            before = base + shift
            values = (
                seen.tolist(),
                base.tolist(),
                after.tolist() if effect else [],
                before.tolist(),
            )
            out.append(Comparison(place, quantity, unit, *map(tuple, values)))

    passages = case.observations.passages
    for station, shift in (("S1", 0.2), ("S2", 2.1)):
        add(station, "speed_mps", "m/s", passages.speed_mps[passages.station == station], shift, 2)
    add("all", "runout_m", "m", case.projected["deposits"].s, 21.0, 25.0)
    return tuple(out)


def _hypotheses(*ranked: tuple[str, str, float, float]) -> tuple[Hypothesis, ...]:
    return tuple(
        Hypothesis(
            effect, form, 1.2 - gain, gain, (gain - 0.08, gain + 0.07), share,
            {"efficiency": 0.8, "stems_per_ha": 420.0} if effect == "trees" else {},
            {"efficiency": (0.5, 1.2)} if effect == "trees" else {},
        )
        for effect, form, gain, share in ranked
    )  # fmt: skip


LONG = ModelGap(
    "stop", "runout_m", "median", "m", 180.0, 201.0, -21.0, (-27.0, -15.0), 9.0, 40, "safe"
)


def with_trees(case: Case) -> Diagnosis:
    """Trees are named; soft ground may be it as well."""
    table = calibrated(case.table, eta_max=0.61234567, mu_f=0.75)
    which = _hypotheses(
        ("trees", "stems", 0.31, 0.71), ("soft_ground", "scar", 0.24, 0.19),
        ("trees+air_drag", "stems, constant", 0.28, 0.06), ("roughness", "wave", 0.02, 0.02),
        ("none", "", 0.0, 0.01), ("air_drag", "sphericity", -0.01, 0.004),
        ("unknown", "", 0.1, 0.006),
    )  # fmt: skip
    effect = HypothesisModel(
        table, EffectSettings(Trees("stems", efficiency=0.8)), ForestStand(90.0, 160.0, 420.0, 31.5)
    )
    return Diagnosis(
        verdict=Verdict(
            "trees", 0.71, ("trees", "soft_ground"), "flight", ("S1-S2",),
            "losses lie between S1 and S2 only and are greatest for small rocks",
            {"trees": 0.71, "soft_ground": 0.19, "unknown": 0.09, "none": 0.008, "air_drag": 0.002},
        ),
        where=FINDINGS,
        which=which,
        shrinkage=Shrinkage(
            "trees", 0.74, (0.6, 0.85), 1.0, 0.3, 0.05,
            {
                "speed_mps": {"base": 0.6, "effect": 0.12, "floor": 0.04, "shrinkage": 0.86},
                "runout_m": {"base": 0.3, "effect": 0.1, "floor": 0.06, "shrinkage": 0.83},
                "rotation_hz": {"base": 0.05, "effect": 0.05, "floor": 0.05, "shrinkage": None},
            },
        ),
        rocks=case.n_rocks,
        tables={name: len(t) for name, t in case.observations.tables.items() if len(t)},
        not_identifiable=("No turns in plan: lateral deflection is told by stops alone.",),
        measure_next=("Speeds of rocks of different mass in the stand.", "Scars on stems."),
        comparisons=comparisons(case, True),
        base=HypothesisModel(calibrated(case.table, eta_max=0.5), EffectSettings()),
        effect=effect,
        settings_hash="0" * 64,
        seed=1,
        ladder=(
            Rung("configured", 1.6),
            Rung("ground", 1.0, 0.39, (0.2, 0.5)),
            Rung("contact_law", 0.9, 0.45, (0.3, 0.6)),
            Rung("trees", 0.3, 0.84, (0.7, 0.95)),
            Rung("floor", 0.05),
        ),
        advice=Advice(
            LONG,
            (), 1.0,
            (GroundSetting("debris", "eta_max", 0.55, 0.612, (0.58, 0.65), True),),
            (("debris.eta_max", "debris.mu_f", 0.8),),
            (LONG,), (replace(LONG, gap=1.0, ci95=(-3.0, 5.0), side=""),), "trees",
        ),
        first_sentence="In the run-out simulated blocks stop 12 % too far.",
        where_configured=tuple(replace(f, gap=2.0 * f.gap) for f in FINDINGS),
    )  # fmt: skip


def unnamed(case: Case, effect: str) -> Diagnosis:
    """Nothing is named: "none" or "unknown"."""
    base = HypothesisModel(calibrated(case.table, eta_max=0.5), EffectSettings())
    where = () if effect == "none" else FINDINGS
    quiet = tuple(replace(f, p_adjusted=0.7, q_value=0.5) for f in FINDINGS)
    return replace(
        with_trees(case),
        verdict=Verdict(
            effect,
            0.62,
            (effect, "roughness"),
            reason="margin not reached",
            probabilities={effect: 0.8, "roughness": 0.2},
        ),
        where=where or quiet,
        which=_hypotheses((effect, "", 0.0, 0.8), ("roughness", "wave", 0.01, 0.2)),
        shrinkage=Shrinkage(effect, None, None, 0.08, 0.08, 0.06, {}, "base near the floor"),
        comparisons=comparisons(case, False),
        base=base,
        effect=base,
        advice=replace(with_trees(case).advice, recommended="ground"),
    )
