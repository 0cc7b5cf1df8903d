"""On which ground classes an effect acts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.ellipse import Records, record_type
from sassgis.errors import ConfigError
from sassgis.settings.ground import PARAMETERS, GroundTable

#: Effects with ground classes, by the name of their settings.
SWITCHED = ("soft_ground", "roughness", "entrainment")

#: Parameters of a ground class, and whether each of these effects acts there.
GROUND_DTYPE = record_type(
    *((name, np.float64) for name in PARAMETERS), *((name, np.bool_) for name in SWITCHED)
)


def ground_rows(table: GroundTable, classes: dict[str, Sequence[str]]) -> Records:
    """Return the ground table as the kernel reads it: GROUND_DTYPE, shape (n_classes,).

    ``classes`` are those of each effect that acts, as classes_on takes them.
    """
    parameters = table.rows()
    rows = np.zeros(parameters.size, GROUND_DTYPE)
    for name in PARAMETERS:
        rows[name] = parameters[name]
    for effect, names in classes.items():
        rows[effect] = classes_on(names, table, effect)
    return rows


def classes_on(names: Sequence[str], table: GroundTable, effect: str) -> NDArray[np.bool_]:
    """Return whether each ground class is among the names; no names are all classes.

    ConfigError: a name is no ground class.
    """
    known = table.names
    for name in names:
        if name not in known:
            raise ConfigError(
                "unknown ground class",
                field=f"effects.{effect}.classes",
                found=repr(name),
                expected="one of " + ", ".join(known),
            )
    return np.array([not names or name in names for name in known], np.bool_)
