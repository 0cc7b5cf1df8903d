"""On which ground classes an effect acts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sassgis.model.errors import ConfigError
from sassgis.model.ground import GroundTable


def classes_on(names: Sequence[str], table: GroundTable, effect: str) -> NDArray[np.bool_]:
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
                field=f"effects.{effect}.classes",
                found=repr(name),
                expected="one of " + ", ".join(known),
            )
    return np.array([not names or name in names for name in known], np.bool_)


def nowhere(table: GroundTable) -> NDArray[np.bool_]:
    """No ground class at all."""
    return np.zeros(len(table.names), np.bool_)
