"""Words, numbers and names in the form in which files and reports show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sassgis.model.profiles import LineEnd
from sassgis.model.results import StopReason

LINE_END_TEXT = {
    LineEnd.LEFT_DEM: "edge of the terrain model",
    LineEnd.NODATA: "nodata",
    LineEnd.ENERGY_LINE: "energy line",
    LineEnd.MAX_LENGTH: "greatest length",
    LineEnd.CLOSED_LOOP: "closed loop",
}
STOP_TEXT = {
    StopReason.REST: "rest",
    StopReason.BARRIER: "barrier",
    StopReason.LEFT_PROFILE: "left the profile",
    StopReason.STEP_LIMIT: "step limit",
    StopReason.NEVER_STARTED: "never started",
    StopReason.BROKEN: "broke into fragments",
}


def rounded(value: Any, digits: int = 3) -> Any:
    """A number for a table, to so many digits; None for none."""
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def file_stem(name: str) -> str:
    """A name as part of a file name."""
    return "".join(c if c.isalnum() else "_" for c in name).strip("_").lower() or "unnamed"


def file_stems(names: Sequence[str]) -> list[str]:
    """Names as parts of file names, no two the same."""
    taken: set[str] = set()
    stems = []
    for name in names:
        stem = base = file_stem(name)
        number = 1
        while stem in taken:
            number += 1
            stem = f"{base}_{number}"
        taken.add(stem)
        stems.append(stem)
    return stems
