"""From settings to what the kernel reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects import (
    air_drag,
    entrainment,
    fragmentation,
    rock_shape,
    roughness,
    soft_ground,
    trees,
)
from sassgis.engine.effects.registry import in_motion
from sassgis.engine.effects.state import BIRTH_COLUMNS, Effects, Spawned
from sassgis.model.effects import EffectSettings
from sassgis.model.errors import ConfigError
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable

#: Longest flight between two turns of drag (s): halving it moves nothing that matters.
DRAG_STEP_S = 0.05


def classes_on(names: Sequence[str], table: GroundTable, family: str) -> NDArray[np.bool_]:
    """Whether each ground class is among the names; no names are all classes.

    Raises
    ------
    ConfigError
        A name is no ground class.
    """
    known = table.names
    for name in names:
        if name not in known:
            raise ConfigError(
                "unknown ground class",
                field=f"effects.{family}.classes",
                found=repr(name),
                expected="one of " + ", ".join(known),
            )
    return np.array([not names or name in names for name in known], np.bool_)


def effects_of(
    settings: EffectSettings, table: GroundTable, stems: FloatArray, diameter: FloatArray
) -> Effects | None:
    """Effects for the kernel; None if none is on.

    Parameters
    ----------
    settings : EffectSettings
    table : GroundTable
    stems, diameter : float64, shape (n_cells,)
        Stems per square metre and their diameter at breast height (m) on the cells of the chunk.
    """
    if not in_motion(settings):
        return None
    off = np.zeros(len(table.names), np.bool_)
    none = np.zeros(0)
    drag, wood = settings.get(air_drag.AirDrag), settings.get(trees.Trees)
    soft = settings.get(soft_ground.SoftGround)
    rough, shape = settings.get(roughness.Roughness), settings.get(rock_shape.RockShape)
    breaking = settings.get(fragmentation.Fragmentation)
    loose = settings.get(entrainment.Entrainment)
    return Effects(
        air_drag.Drag(air_drag.OFF, 0.0, 0.0, np.inf)
        if drag is None or drag.drag_coefficient == 0.0 or drag.air_density_kgm3 == 0.0
        else air_drag.Drag(
            {"constant": air_drag.CONSTANT, "sphericity": air_drag.SPHERICITY}[drag.form],
            float(drag.drag_coefficient),
            float(drag.air_density_kgm3),
            DRAG_STEP_S,
        ),
        trees.Stand(trees.OFF, 0.0, 0.0, 0.0, none, none)
        if wood is None or not wood.takes_anything or not (stems > 0.0).any()
        else trees.Stand(
            {"stems": trees.STEMS, "full_stems": trees.FULL_STEMS, "viscous": trees.VISCOUS}[
                wood.form
            ],
            float(wood.efficiency),
            float(wood.drag_kgps),
            float(wood.height_m),
            np.ascontiguousarray(stems, np.float64),
            np.ascontiguousarray(diameter, np.float64),
        ),
        soft_ground.Soft(soft_ground.OFF, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, off)
        if soft is None
        else soft_ground.Soft(
            {
                "velocity_scaled": soft_ground.VELOCITY_SCALED,
                "scar": soft_ground.SCAR,
                "slip": soft_ground.SLIP,
            }[soft.form],
            float(soft.reference_speed_mps),
            float(soft.modulus_mpa),
            float(soft.depth_factor),
            float(soft.drag_coefficient),
            float(soft.soil_density_kgm3),
            float(soft.friction),
            classes_on(soft.classes, table, "soft_ground"),
        ),
        roughness.Rough(roughness.OFF, 0.0, 1.0, off)
        if rough is None or rough.obstacle_m == 0.0
        else roughness.Rough(
            {"uniform": roughness.UNIFORM, "wave": roughness.WAVE}[rough.form],
            float(rough.obstacle_m),
            float(rough.wavelength_m),
            classes_on(rough.classes, table, "roughness"),
        ),
        rock_shape.Shape(rock_shape.OFF, 0.0)
        if shape is None
        else rock_shape.Shape(
            {"flat_landing": rock_shape.FLAT_LANDING, "mean_inertia": rock_shape.MEAN_INERTIA}[
                shape.form
            ],
            float(shape.strength),
        ),
        fragmentation.Breaking(fragmentation.OFF, 0.0, 1.0, 0.5, 2, 0.0, 0.0, 0.0)
        if breaking is None
        else fragmentation.Breaking(
            {"fractal": fragmentation.FRACTAL, "threshold": fragmentation.THRESHOLD}[breaking.form],
            float(breaking.energy_jkg),
            float(breaking.shape),
            float(breaking.survival),
            int(breaking.pieces),
            float(breaking.loss),
            float(np.radians(breaking.cone_deg)),
            float(breaking.smallest_m3),
        ),
        entrainment.SetOff(entrainment.OFF, 0.0, 1.0, 1.0, 0.0, off)
        if loose is None or loose.number == 0.0
        else entrainment.SetOff(
            {"poisson": entrainment.POISSON, "energy": entrainment.ENERGY}[loose.form],
            float(loose.number),
            1e3 * float(loose.energy_kj),
            float(loose.size_ratio),
            float(loose.share),
            classes_on(loose.classes, table, "entrainment"),
        ),
    )


def room_for_spawned(most: int, settings: EffectSettings) -> Spawned:
    """Working space for the pieces and blocks set in motion in the course of one rock."""
    spawning = (fragmentation.Fragmentation, entrainment.Entrainment)
    rows = most if any(settings.get(kind) for kind in spawning) else 1
    return Spawned(
        np.zeros((rows, BIRTH_COLUMNS)), np.zeros(1, np.int64), np.zeros(32), np.zeros(32)
    )
