"""Made slopes: heights, zones of ground, and the frame that counts metres down the slope."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CELL_M = 2.0
CLASSES = ("rock", "debris", "talus", "soft_meadow", "forest_soil", "overgrown_slope")

# Each slope from top to foot: (length in plan, dip in degrees, ground) with ranges to draw from.
# Rocks start at the lower end of the first stretch.
_Stretch = tuple[tuple[float, float], tuple[float, float], str]
_SLOPES: dict[str, tuple[_Stretch, ...]] = {
    "cliff_talus_meadow": (
        ((12.0, 18.0), (36.0, 42.0), "rock"),
        ((9.0, 15.0), (56.0, 64.0), "rock"),
        ((35.0, 60.0), (36.0, 39.0), "debris"),
        ((50.0, 80.0), (31.0, 35.0), "talus"),
    ),
    "stepped_benches": (
        ((12.0, 18.0), (38.0, 44.0), "rock"),
        ((7.0, 11.0), (54.0, 62.0), "rock"),
        ((10.0, 16.0), (22.0, 28.0), "debris"),
        ((8.0, 12.0), (50.0, 58.0), "rock"),
        ((12.0, 20.0), (24.0, 30.0), "debris"),
        ((60.0, 85.0), (35.0, 38.0), "debris"),
    ),
    "gully": (
        ((12.0, 18.0), (40.0, 45.0), "rock"),
        ((9.0, 15.0), (54.0, 61.0), "rock"),
        ((55.0, 85.0), (35.0, 38.0), "debris"),
        ((40.0, 60.0), (28.0, 32.0), "talus"),
    ),
    "talus_fan": (
        ((12.0, 18.0), (40.0, 45.0), "rock"),
        ((9.0, 15.0), (54.0, 61.0), "rock"),
        ((60.0, 90.0), (37.0, 40.0), "talus"),
        ((50.0, 70.0), (32.0, 35.0), "talus"),
    ),
    "forested_slope": (
        ((12.0, 18.0), (40.0, 45.0), "rock"),
        ((8.0, 14.0), (52.0, 60.0), "rock"),
        ((80.0, 120.0), (30.0, 32.5), "forest_soil"),
        ((35.0, 55.0), (25.0, 28.0), "forest_soil"),
    ),
    "grass_slope": (
        ((12.0, 18.0), (36.0, 40.0), "soft_meadow"),
        ((15.0, 25.0), (35.0, 38.0), "soft_meadow"),
        ((40.0, 60.0), (33.0, 36.0), "soft_meadow"),
        ((8.0, 12.0), (8.0, 14.0), "soft_meadow"),
        ((45.0, 65.0), (32.0, 35.0), "soft_meadow"),
    ),
    "quarry": (
        ((12.0, 18.0), (36.0, 41.0), "overgrown_slope"),
        ((25.0, 40.0), (37.0, 41.0), "overgrown_slope"),
        ((4.0, 6.0), (64.0, 70.0), "rock"),
        ((7.0, 10.0), (6.0, 12.0), "rock"),
        ((5.0, 8.0), (64.0, 70.0), "rock"),
        ((12.0, 20.0), (14.0, 20.0), "debris"),
    ),
    "carved_slope": (
        ((12.0, 18.0), (38.0, 42.0), "debris"),
        ((20.0, 30.0), (33.0, 36.0), "debris"),
        ((35.0, 55.0), (36.0, 39.0), "debris"),
        ((25.0, 40.0), (39.0, 43.0), "talus"),
        ((30.0, 45.0), (24.0, 29.0), "talus"),
    ),
}
SLOPE_TYPES = tuple(_SLOPES)
# All end in a meadow that is long enough for the rocks to stop on it.
_FOOT: _Stretch = ((220.0, 270.0), (0.0, 3.0), "soft_meadow")
_HALF_WIDTH = 75.0
_MARGIN = 30.0


@dataclass(frozen=True, slots=True)
class Frame:
    """Metres down the slope (s) and to the left of it (c), as seen going down."""

    # Origin: the middle of the upper end (m).
    x0: float
    y0: float
    # Unit vector of the general direction of descent.
    ux: float
    uy: float

    def s(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Distance down the slope (m)."""
        return (np.asarray(x) - self.x0) * self.ux + (np.asarray(y) - self.y0) * self.uy

    def c(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Distance to the left (m)."""
        return -(np.asarray(x) - self.x0) * self.uy + (np.asarray(y) - self.y0) * self.ux

    def xy(self, s: FloatArray | float, c: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Coordinates of points given by s and c (m)."""
        s_, c_ = np.asarray(s, float), np.asarray(c, float)
        return self.x0 + s_ * self.ux - c_ * self.uy, self.y0 + s_ * self.uy + c_ * self.ux


@dataclass(frozen=True, slots=True)
class Surface:
    """Heights at the centres of square cells, the first row in the north."""

    z: FloatArray  # shape (n_rows, n_cols) (m)
    west: float  # edges of the grid (m)
    north: float
    cell_m: float = CELL_M

    def centres(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates of the centres of the cells, each of shape (n_rows, n_cols) (m)."""
        n_rows, n_cols = self.z.shape
        east = self.west + self.cell_m * (np.arange(n_cols) + 0.5)
        x, y = np.meshgrid(east, self.north - self.cell_m * (np.arange(n_rows) + 0.5))
        return x, y

    def cells(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Row and column of points, counted from the centre of the first cell."""
        col = (np.asarray(x) - self.west) / self.cell_m - 0.5
        return (self.north - np.asarray(y)) / self.cell_m - 0.5, col

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Heights of points (m), bilinear."""
        at = np.array(self.cells(x, y))
        found: FloatArray = ndimage.map_coordinates(
            self.z, at.reshape(2, -1), order=1, mode="nearest"
        )
        return found.reshape(at.shape[1:])

    def gradient_at(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient (dz/dx, dz/dy) at points, over a cell."""
        d = 0.5 * self.cell_m
        east = self.at(x + d, y) - self.at(x - d, y)
        return east / self.cell_m, (self.at(x, y + d) - self.at(x, y - d)) / self.cell_m


@dataclass(frozen=True, slots=True)
class Relief:
    """A made slope."""

    surface: Surface
    ground: IntArray  # position in CLASSES of each cell; shape of the surface
    frame: Frame
    #: Distances down the slope at which one stretch ends and the next begins, (n_stretches + 1,).
    breaks_m: FloatArray
    stretches: tuple[str, ...]  # ground of each stretch

    @property
    def release_s(self) -> tuple[float, float]:
        """Belt in which rocks start (m down the slope)."""
        return float(self.breaks_m[1]) - 6.0, float(self.breaks_m[1])

    def s_of_cells(self) -> FloatArray:
        """Distance of each cell down the slope (m), shape of the surface."""
        return self.frame.s(*self.surface.centres())


def make_relief(kind: str, seed: int) -> Relief:
    """Draw a slope of one of SLOPE_TYPES; KeyError if there is no such type."""
    rng = np.random.default_rng([seed, 101])
    limits_m, limits_deg, grounds = zip(*_SLOPES[kind], _FOOT, strict=True)
    lengths = np.array([rng.uniform(*limits) for limits in limits_m])
    dips = np.radians([rng.uniform(*limits) for limits in limits_deg])
    breaks = np.concatenate(([0.0], np.cumsum(lengths)))
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    x0 = 2_600_000.0 + 2.0 * rng.integers(0, 30_000)
    y0 = 1_150_000.0 + 2.0 * rng.integers(0, 30_000)
    frame = Frame(float(x0), float(y0), math.sin(azimuth), math.cos(azimuth))
    surface = _empty(frame, breaks)
    x, y = surface.centres()
    s, c = frame.s(x, y), frame.c(x, y)
    heights = _fall(s, breaks, dips) + _across(kind, s, c, breaks, rng)
    if kind == "carved_slope":
        heights += _fractal(s.shape, rng.uniform(0.9, 1.6), rng)
    for sd_m, amplitude in ((14.0, rng.uniform(0.15, 0.35)), (4.0, rng.uniform(0.02, 0.05))):
        field = ndimage.gaussian_filter(rng.standard_normal(s.shape), sd_m / CELL_M)
        heights += amplitude * field / field.std()
    heights += 900.0 + rng.uniform(0.0, 600.0) - heights.min()
    wavy = s + 3.0 * np.sin(c / rng.uniform(9.0, 16.0) + rng.uniform(0.0, 6.0))
    which = np.clip(np.searchsorted(breaks, wavy, side="right") - 1, 0, len(grounds) - 1)
    ground = np.array([CLASSES.index(name) for name in grounds], np.int64)[which]
    return Relief(replace(surface, z=heights), ground, frame, breaks, grounds)


def _empty(frame: Frame, breaks: FloatArray) -> Surface:
    """Cells that hold the whole slope, all at height zero."""
    ends = np.array([-_MARGIN, -_MARGIN, breaks[-1] + _MARGIN, breaks[-1] + _MARGIN])
    x, y = frame.xy(ends, np.array([-1.0, 1.0, -1.0, 1.0]) * (_HALF_WIDTH + _MARGIN))
    west, north = CELL_M * math.floor(x.min() / CELL_M), CELL_M * math.ceil(y.max() / CELL_M)
    shape = math.ceil((north - y.min()) / CELL_M), math.ceil((x.max() - west) / CELL_M)
    return Surface(np.zeros(shape), west, north)


def _fall(s: FloatArray, breaks: FloatArray, dips: FloatArray) -> FloatArray:
    """Height of the mean profile, with its corners rounded over a few metres (m)."""
    fine = np.arange(breaks[0] - 200.0, breaks[-1] + 400.0, 0.5)
    which = np.clip(np.searchsorted(breaks, fine, side="right") - 1, 0, len(dips) - 1)
    slope = ndimage.gaussian_filter1d(np.tan(dips)[which], 2.0 / 0.5)
    rounded: FloatArray = np.interp(s, fine, -np.cumsum(slope) * 0.5)
    return rounded


def _across(
    kind: str, s: FloatArray, c: FloatArray, breaks: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """What the slope does across: a channel, a fan, or long waves (m)."""
    down = (s - breaks[0]) / (breaks[-1] - breaks[0])
    if kind in ("gully", "carved_slope"):
        axis = rng.uniform(3.0, 8.0) * np.sin(s / rng.uniform(35.0, 55.0) + rng.uniform(0.0, 6.0))
        depth = rng.uniform(0.25, 0.4) * np.clip(1.15 - 1.2 * down, 0.0, 1.0)
        channel: FloatArray = depth * (np.sqrt((c - axis) ** 2 + 18.0**2) - 18.0)
        return channel
    if kind == "talus_fan":
        return -rng.uniform(0.0005, 0.0009) * np.clip(1.5 * down, 0.0, 1.0) * c**2
    wave: FloatArray = rng.uniform(0.4, 1.2) * np.sin(
        c / rng.uniform(14.0, 24.0) + rng.uniform(0.0, 6.0)
    )
    return wave


def _fractal(shape: tuple[int, ...], standard_m: float, rng: np.random.Generator) -> FloatArray:
    """A self-affine surface with a Hurst exponent of 0.8, of waves up to 120 m (m)."""
    fy, fx = np.meshgrid(
        np.fft.fftfreq(shape[0], CELL_M), np.fft.rfftfreq(shape[1], CELL_M), indexing="ij"
    )
    frequency = np.maximum(np.hypot(fx, fy), 1.0 / 120.0)
    # The spectrum of a surface falls with the frequency to the power of 2 (H + 1).
    waves = np.fft.rfft2(rng.standard_normal(shape)) * frequency**-1.8
    surface: FloatArray = np.fft.irfft2(waves, shape)
    surface -= surface.mean()
    return surface * standard_m / surface.std()


def surveyed(surface: Surface, rng: np.random.Generator) -> Surface:
    """A terrain model with a fault of real ones or none: smoothed, shifted, or of 6 m cells."""
    fault = int(rng.integers(4))
    z = surface.z
    if fault == 1:
        z = ndimage.gaussian_filter(z, rng.uniform(2.0, 5.0) / CELL_M, mode="nearest")
    elif fault == 2:
        angle, way = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(1.0, 2.0) / CELL_M
        z = ndimage.shift(
            z, (way * math.sin(angle), way * math.cos(angle)), order=1, mode="nearest"
        )
    elif fault == 3:
        coarse = ndimage.uniform_filter(z, 3, mode="nearest")[1::3, 1::3]
        rows, cols = ((np.arange(n) - 1.0) / 3.0 for n in z.shape)
        at = np.meshgrid(rows, cols, indexing="ij")
        z = ndimage.map_coordinates(coarse, at, order=1, mode="nearest")
    return replace(surface, z=z)
