"""Words, numbers and names in the form in which files and reports show them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sassgis.settings.languages import Phrase, in_english, named, phrase
from sassgis.settings.profiles import LineEnd
from sassgis.settings.results import StopReason

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
    StopReason.STEP_LIMIT: "contact limit",
    StopReason.NEVER_STARTED: "never started",
    StopReason.BROKEN: "broke into fragments",
}


#: Built-in ground classes, by what stands for their name in other languages than English.
_GROUND_NAMES = {
    "rock": "rock (ground class)",
    "debris": "debris (ground class)",
    "talus": "talus (ground class)",
    "soft_meadow": "soft_meadow (ground class)",
    "forest_soil": "forest_soil (ground class)",
    "asphalt": "asphalt (ground class)",
    "overgrown_slope": "overgrown_slope (ground class)",
}

#: Bytes of a name within a file name, of which systems take 255.
_LONGEST_STEM = 120
#: Names of devices of Windows.
_RESERVED = {"con", "prn", "aux", "nul", *(f"{d}{i}" for d in ("com", "lpt") for i in range(10))}


def rounded(value: Any, digits: int = 3) -> Any:
    """Return a number for a table, to so many digits; None for none."""
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def short(value: float, sign: str = "") -> str:
    """Return a number in two digits, with all before the point: 0.012, 1.5, 1700; ``sign`` may be
    "+".
    """
    return f"{value:{sign}.0f}" if abs(value) >= 10.0 else f"{value:{sign}.2g}"


def ground_name(name: str) -> Phrase:
    """Name a ground class: built-in ones are explained in other languages, others stay."""
    if name not in _GROUND_NAMES:
        return named(name)
    return in_english(name, phrase(_GROUND_NAMES[name]))


def some_of(names: Sequence[str], shown_as: Callable[[str], str] = repr) -> str:
    """Return the first four names, and how many more there are."""
    shown = ", ".join(map(shown_as, names[:4]))
    return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def file_stem(name: str) -> str:
    """Return a name as part of a file name that every system takes: letters, digits, "_"."""
    plain = "".join(c if c.isalnum() else "_" for c in name).strip("_").lower()
    short = plain.encode()[:_LONGEST_STEM].decode(errors="ignore") or "unnamed"
    return f"{short}_" if short in _RESERVED else short


def file_stems(names: Sequence[str]) -> list[str]:
    """Return names as parts of file names, no two the same."""
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


def thousands(value: float, decimals: int = 0) -> str:
    """Write a number with a narrow space between thousands, at which no line breaks."""
    return f"{value:,.{decimals}f}".replace(",", "\u202f").replace("-", "\u2212")


def power_of_ten(exponent: int) -> str:
    """Write a power of ten, as '10⁻⁶'."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
