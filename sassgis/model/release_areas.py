"""Where blocks start, and how the lines are traced on which they move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sassgis.model.errors import ConfigError


@dataclass(frozen=True, slots=True)
class ReleaseArea:
    """A place from which blocks start.

    Attributes
    ----------
    name : str
        Unique in the run; random draws hang on it.
    geometry : shapely geometry
        Polygons, lines or points in the coordinates of the DEM (m).
    scenarios : tuple of str
        Names of the block scenarios that start here.
    """

    name: str
    geometry: Any
    scenarios: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FallLineSettings:
    """How fall lines are traced.

    Attributes
    ----------
    smoothing_m : float
        Standard deviation of the Gaussian by which the terrain is smoothed for tracing (m): a block
        does not answer to every dent. Heights of the profiles are never smoothed.
    flat_slope_deg : float
        Below this slope the line tends to keep its heading (degrees). The default is well below the
        20° or so on which blocks still roll on, so that whatever arrives there arrives with speed,
        and above the slope of valley floors and most debris fans.
    turning_length_m : float
        L above (m): on ground of the flat slope a coasting line turns towards the descent over this
        length; over four times as much on ground half as steep, half as much on ground twice as
        steep. The default is about the radius v² / (g sin) on which gravity bends the path of a
        body that moves across a slope of 8° at 8 m/s.
    energy_line_angle_deg : float
        Angle below the horizontal of the line that, drawn from the release point over the plan
        length of the fall line, no block is expected to reach beyond (degrees). Where the terrain
        rises above it the fall line ends. The idea of one overall friction angle from source to
        stop is A. Heim's (1932, Bergsturz und Menschenleben).
    energy_line_free_m : float
        The energy line is not tested over this first part (m): a release point on the gentle
        shoulder above a cliff is not cut off before the cliff.
    max_length_m : float
        Plan length at which a line ends in any case (m).
    """

    smoothing_m: float = 5.0
    flat_slope_deg: float = 8.0
    turning_length_m: float = 50.0
    energy_line_angle_deg: float = 20.0
    energy_line_free_m: float = 25.0
    max_length_m: float = 5000.0

    def __post_init__(self) -> None:
        limits = {
            "smoothing_m": (0.0, 200.0),
            "flat_slope_deg": (0.0, 30.0),
            "turning_length_m": (0.1, 1e5),
            "energy_line_angle_deg": (0.0, 60.0),
            "energy_line_free_m": (0.0, 1000.0),
            "max_length_m": (1.0, 1e5),
        }
        for field, (low, high) in limits.items():
            if not low <= getattr(self, field) <= high:
                raise ConfigError(
                    "value out of range",
                    field=f"fall_lines.{field}",
                    found=getattr(self, field),
                    expected=f"{low:g} to {high:g}",
                )
