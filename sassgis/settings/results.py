"""Results of a run, profiles, layers for the map, and the form in which numbers are shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.languages import Phrase, in_english, named, phrase

#: Run-outs among the counts of a result (whole metres), and the shares of blocks within them.
RUNOUT_COUNTS = {
    "runout_q50_m": 0.5, "runout_q95_m": 0.95, "runout_q99_m": 0.99, "runout_max_m": 1.0,
}  # fmt: skip


#: What manifests call the share of an area that another sample of blocks would change.
CHANGED_SHARE = "changed_share"


class StopReason(IntEnum):
    """Why the simulation of a block stops."""

    REST = 0
    BARRIER = 1
    LEFT_PROFILE = 2
    STEP_LIMIT = 3
    NEVER_STARTED = 4
    BROKEN = 5


class Outcome(IntEnum):
    """Outcome of a block at a station or barrier."""

    PASSED = 0
    STOPPED = 1
    OVERTOPPED = 2
    BROKE_THROUGH = 3
    HELD_BY_NET = 4
    ON_ROOF = 5  # of a gallery


#: One row per block, and per fragment or entrained block: ``piece`` is 0 for the
#: block itself. Chainages in m along the profile; ``line`` counts the profiles of the run.
ROCK_DTYPE = np.dtype(
    [
        ("line", np.int64),
        ("rock", np.int32),
        ("piece", np.int32),
        ("reason", np.uint8),
        ("start_m", np.float64),
        ("runout_m", np.float64),
        ("runout_z_m", np.float64),
        ("furthest_m", np.float64),
        ("time_s", np.float64),
        ("impacts", np.int32),
        ("a_m", np.float64),
        ("b_m", np.float64),
        ("c_m", np.float64),
        ("density_kgm3", np.float64),
        ("mass_kg", np.float64),
        ("max_speed_mps", np.float64),
        ("max_height_m", np.float64),
        ("max_energy_kj", np.float64),
    ]
)


class ContactKind(IntEnum):
    """How a block is in contact with the ground."""

    IMPACT = 0
    ROLLING = 1
    SLIDING = 2


#: One row per contact of a block with the ground: its state as it begins (in) and ends (out).
#: Velocities along the ground are positive downhill, those normal to it away from it.
CONTACT_DTYPE = np.dtype(
    [
        ("rock", np.int32),
        ("contact", np.int32),
        ("kind", np.uint8),
        ("t_s", np.float64),
        ("duration_s", np.float64),
        ("chainage_m", np.float64),
        ("z_m", np.float64),
        ("slope_deg", np.float64),
        *(
            (f"{name}_{side}_{unit}", np.float64)
            for side in ("in", "out")
            for name, unit in (("vt", "mps"), ("vn", "mps"), ("rotation", "hz"), ("energy", "kj"))
        ),
    ]
)

#: One row per block and station or barrier: the first time that the block reaches it downhill.
#: ``height_m`` is the vertical distance from the ground to the centre, less the resting height.
PASSAGE_DTYPE = np.dtype(
    [
        ("control_line", np.int32),
        ("line", np.int64),
        ("rock", np.int32),
        ("outcome", np.uint8),
        ("chainage_m", np.float64),
        ("speed_mps", np.float64),
        ("vx_mps", np.float64),
        ("vz_mps", np.float64),
        ("rotation_hz", np.float64),
        ("height_m", np.float64),
        ("energy_trans_kj", np.float64),
        ("energy_rot_kj", np.float64),
        ("mass_kg", np.float64),
        ("roof_energy_kj", np.float64),  # of the motion into a gallery's roof, 0 without
        ("roof_left_kj", np.float64),  # as it leaves that roof; 0 if it ends there, or without
        ("x_m", np.float64),  # place on the map where a path is followed; on given lines NaN
        ("y_m", np.float64),
    ]
)


@dataclass(frozen=True, slots=True)
class ControlLine:
    """A station or a barrier."""

    name: str
    kind: Literal["station", "wall", "net", "gallery"]
    height_m: float = 0.0  # height of the top above the ground, vertical (m); unused for a station
    # Energy that the barrier takes (kJ); infinite if it stops every block that meets it.
    capacity_kj: float = float("inf")
    # Whether a block that the barrier takes is only brought to zero speed there and then moves on,
    # as the paper saw nets do, instead of being stopped for good.
    restarts_from_rest: bool = False
    # Roof of a gallery, from its uphill edge on, which is the line.
    width_m: float = 0.0  # downslope, in plan (m)
    roof_slope_deg: float = 0.0
    cushion_kpa: float = 0.0  # modulus of the cushion

    @property
    def described(self) -> str:
        """The name of a station; that of a barrier with its kind and height."""
        if self.kind == "station":
            return named(self.name)
        texts = {"net": "{} (net, {} m)", "gallery": "{} (gallery, {} m)"}
        text = texts.get(self.kind, "{} (wall, {} m)")
        return phrase(text, self.name, f"{self.height_m:g}")


@dataclass(frozen=True, slots=True)
class Histogram:
    """Counts between edges; the first and the last bin also hold what lies beyond them."""

    edges: NDArray[np.float64]  # shape (n_bins + 1,)
    counts: NDArray[np.int64]  # shape (..., n_bins)
    unit: str


@dataclass(frozen=True, slots=True)
class Band:
    """One band of a map: float32, shape (n_rows, n_cols), NaN where there is nothing."""

    name: str
    description: str
    unit: str
    values: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class RasterClass:
    """Meaning of a whole number on a map of classes; ``hatched`` asks for lines in the colour."""

    value: int
    label: str
    colour: str
    hatched: bool = False


@dataclass(frozen=True, slots=True)
class RasterLayer:
    """A map to be written as one file."""

    stem: str  # file name without suffix, also the key of its style
    title: str  # name in the legend, with the unit
    note: str  # what the numbers mean: denominator, resolution, reference width
    bands: tuple[Band, ...]  # the first is the one shown
    # Class limits for the legend, ascending; empty: a continuous ramp over the data's range.
    breaks: tuple[float, ...]
    ramp: str  # of :mod:`sassgis.settings.styles`
    # For a map of classes: the values of the first band are theirs; ``breaks`` is empty.
    classes: tuple[RasterClass, ...] = ()


class LineEnd(IntEnum):
    """Why a fall line ends where it does."""

    LEFT_DEM = 0
    NODATA = 1
    ENERGY_LINE = 2
    MAX_LENGTH = 3
    CLOSED_LOOP = 4


@dataclass(frozen=True, slots=True)
class ReleasePoints:
    """Points from which fall lines start."""

    # Shape (n,); coordinates (m).
    x: FloatArray
    y: FloatArray
    area: IntArray  # shape (n,); position of the release area in ``area_names``
    # Shape (n,); identity of the point for random draws. Made from the name of its area and its
    # place in it, never from what else is in the run.
    key: NDArray[np.uint64]
    area_names: tuple[str, ...]
    # Shape (n, 2, 2); two sides (east, north; m) of the parallelogram around each point that it
    # represents, in which blocks start whose paths are followed. None: all start at the points.
    sides: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.x.size)


@dataclass(frozen=True, slots=True)
class TraceSet:
    """Fall lines as they lie on the map, densely sampled."""

    offset: IntArray  # shape (n + 1,)
    # Shape (offset[-1],); coordinates (m); each line starts at its release point.
    x: FloatArray
    y: FloatArray
    s: FloatArray  # shape (offset[-1],); chainage: plan length from the release point (m)
    point: IntArray  # shape (n,); the release point of each line
    end: NDArray[np.uint8]  # shape (n,); a LineEnd

    def __len__(self) -> int:
        return int(self.offset.size - 1)


@dataclass(frozen=True, slots=True)
class ProfileSet:
    """Fall lines unrolled into a vertical plane and made of straight segments."""

    offset: IntArray  # shape (n + 1,); of the vertices of each profile
    # Shape (offset[-1],); chainage and height of the vertices (m); chainage rises strictly.
    s: FloatArray
    z: FloatArray
    # Shape (offset[-1],); ground class of the segment that *starts* at the vertex; the last of a
    # profile is unused.
    ground: NDArray[np.int32]
    cell_offset: IntArray  # shape (n + 1,); of the cell stretches of each profile
    # Shape (cell_offset[-1] + n,); borders between the stretches: profile ``i`` has one more border
    # than stretches, and they start at ``cell_offset[i] + i``. First border = first vertex, last =
    # last vertex.
    cell_s: FloatArray
    # Shape (cell_offset[-1],); flat index of the grid cell under each stretch; -1 where there is
    # none.
    cell: IntArray
    # Shape (cell_offset[-1] + n, 2), or None; borders between the stretches on the map, laid out as
    # ``cell_s``: columns from the west edge of the grid and rows from its north edge, in cells.
    # None: not on a map.
    on_map: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.offset.size - 1)

    def vertices(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Return the chainage and height of the vertices of profile ``i`` (m)."""
        own = slice(int(self.offset[i]), int(self.offset[i + 1]))
        return self.s[own], self.z[own]


@dataclass(frozen=True, slots=True)
class ControlLineCrossings:
    """Where profiles cross stations and barriers."""

    control_lines: tuple[ControlLine, ...]
    offset: IntArray  # shape (n_lines + 1,)
    chainage: FloatArray  # shape (offset[-1],); rising within a line (m)
    control_line: IntArray  # shape (offset[-1],); position in ``control_lines``

    @classmethod
    def none(cls, n_lines: int) -> ControlLineCrossings:
        """Return control lines without stations or barriers."""
        return cls((), np.zeros(n_lines + 1, np.int64), np.empty(0), np.empty(0, np.int64))

    @classmethod
    def same_for_all(
        cls, control_lines: Sequence[ControlLine], chainages: Sequence[float], n_lines: int
    ) -> ControlLineCrossings:
        """Return same control lines at the same chainages (m) on each of ``n_lines`` profiles."""
        order = np.argsort(np.asarray(chainages, float), kind="stable")
        sorted_chainage = np.asarray(chainages, float)[order]
        return cls(
            tuple(control_lines), np.arange(n_lines + 1, dtype=np.int64) * len(control_lines),
            np.tile(sorted_chainage, n_lines), np.tile(order.astype(np.int64), n_lines),
        )  # fmt: skip


LINE_END_TEXT = {
    LineEnd.LEFT_DEM: "edge of the terrain model",
    LineEnd.NODATA: "nodata",
    LineEnd.ENERGY_LINE: "energy line",
    LineEnd.MAX_LENGTH: "greatest length",
    LineEnd.CLOSED_LOOP: "closed loop",
}
#: Reasons of blocks that came to a halt, and of those whose run-out would be longer.
HALTED = (StopReason.REST, StopReason.BARRIER)
STILL_MOVING = (StopReason.LEFT_PROFILE, StopReason.STEP_LIMIT)
STOP_TEXT = {
    StopReason.REST: "rest",
    StopReason.BARRIER: "barrier",
    StopReason.LEFT_PROFILE: "left the profile",
    StopReason.STEP_LIMIT: "aborted",
    StopReason.NEVER_STARTED: "never started",
    StopReason.BROKEN: "broke into fragments",
}


#: Built-in ground classes, by what represents their name in other languages than English.
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


class SetUp(Phrase):
    """A warning that describes the set-up and does not mean that a map is wrong."""


#: Warnings at the top of a page.
_FIRST = 5


def first_warnings(warnings: Sequence[str]) -> tuple[str, ...]:
    """Choose the few warnings for the top of a page: those that may make a result wrong."""
    return tuple(text for text in warnings if not isinstance(text, SetUp))[:_FIRST]
