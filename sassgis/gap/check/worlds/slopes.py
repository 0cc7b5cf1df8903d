"""Made slopes: heights, zones of ground, and the frame that counts metres down the slope."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid, IntArray
from sassgis.model.jit import kernel

CELL_M = 2.0
# Width of the Gaussian that smooths the terrain for directions of descent (m).
GUIDE_SD_M = 5.0
# Below this slope a path keeps part of its heading.
_FLAT = math.tan(math.radians(8.0))

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
# All end in a meadow that is long enough for the rocks to stop on it.
_FOOT: _Stretch = ((200.0, 250.0), (4.0, 9.0), "soft_meadow")
SLOPE_TYPES = tuple(_SLOPES)
CLASSES = ("rock", "debris", "talus", "soft_meadow", "forest_soil", "overgrown_slope")
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
class Relief:
    """A made slope."""

    grid: Grid  # heights at 2 m (m)
    ground: IntArray  # position in CLASSES of each cell; shape of the grid
    frame: Frame
    #: Distances down the slope at which one stretch ends and the next begins, (n_stretches + 1,).
    breaks_m: FloatArray
    stretches: tuple[str, ...]  # ground of each stretch
    release_s: tuple[float, float]  # belt in which rocks start (m down the slope)


def make_relief(kind: str, seed: int) -> Relief:
    """Draw a slope of a given type.

    Raises
    ------
    InputError
        If there is no such type.
    """
    if kind not in _SLOPES:
        raise InputError(
            "unknown slope type", field="slope", found=kind, expected="one of " + str(SLOPE_TYPES)
        )
    rng = np.random.default_rng([seed, 101])
    limits_m, limits_deg, grounds = zip(*_SLOPES[kind], _FOOT, strict=True)
    lengths = np.array([rng.uniform(*limits) for limits in limits_m])
    dips = np.radians([rng.uniform(*limits) for limits in limits_deg])
    breaks = np.concatenate(([0.0], np.cumsum(lengths)))
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    x0 = 2_600_000.0 + 2.0 * rng.integers(0, 30_000)
    y0 = 1_150_000.0 + 2.0 * rng.integers(0, 30_000)
    frame = Frame(float(x0), float(y0), math.sin(azimuth), math.cos(azimuth))

    corner_s = np.array([-_MARGIN, -_MARGIN, breaks[-1] + _MARGIN, breaks[-1] + _MARGIN])
    corner_c = np.array([-1.0, 1.0, -1.0, 1.0]) * (_HALF_WIDTH + _MARGIN)
    cx, cy = frame.xy(corner_s, corner_c)
    west = CELL_M * math.floor(cx.min() / CELL_M)
    north = CELL_M * math.ceil(cy.max() / CELL_M)
    n_cols = math.ceil((cx.max() - west) / CELL_M)
    n_rows = math.ceil((north - cy.min()) / CELL_M)
    x, y = np.meshgrid(
        west + CELL_M * (np.arange(n_cols) + 0.5), north - CELL_M * (np.arange(n_rows) + 0.5)
    )
    s, c = frame.s(x, y), frame.c(x, y)
    heights = _fall(s, breaks, dips) + _across(kind, s, c, breaks, rng)
    if kind == "carved_slope":
        heights += _fractal((n_rows, n_cols), rng.uniform(0.9, 1.6), rng)
    for sd_m, amplitude in ((14.0, rng.uniform(0.15, 0.35)), (4.0, rng.uniform(0.02, 0.05))):
        field = ndimage.gaussian_filter(rng.standard_normal((n_rows, n_cols)), sd_m / CELL_M)
        heights += amplitude * field / field.std()
    heights += 900.0 + rng.uniform(0.0, 600.0) - heights.min()
    wavy = s + 3.0 * np.sin(c / rng.uniform(9.0, 16.0) + rng.uniform(0.0, 6.0))
    which = np.clip(np.searchsorted(breaks, wavy, side="right") - 1, 0, len(grounds) - 1)
    ground = np.array([CLASSES.index(name) for name in grounds], np.int64)[which]
    grid = Grid(heights, west, north, CELL_M, crs="EPSG:2056", vertical_datum="LN02")
    release_s = float(breaks[1]) - 6.0, float(breaks[1])
    return Relief(grid, ground, frame, breaks, grounds, release_s)


def _fall(s: FloatArray, breaks: FloatArray, dips: FloatArray) -> FloatArray:
    """Height of the mean profile, with its corners rounded over a few metres (m)."""
    fine = np.arange(breaks[0] - 200.0, breaks[-1] + 400.0, 0.5)
    which = np.clip(np.searchsorted(breaks, fine, side="right") - 1, 0, len(dips) - 1)
    slope = ndimage.gaussian_filter1d(np.tan(dips)[which], 2.0 / 0.5)
    height = -np.cumsum(slope) * 0.5
    rounded: FloatArray = np.interp(s, fine, height)
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
        spread = rng.uniform(0.0010, 0.0018) * np.clip(1.5 * down, 0.0, 1.0)
        fan: FloatArray = -spread * c**2
        return fan
    wave: FloatArray = rng.uniform(0.4, 1.2) * np.sin(
        c / rng.uniform(14.0, 24.0) + rng.uniform(0.0, 6.0)
    )
    return wave


def _fractal(shape: tuple[int, int], standard_m: float, rng: np.random.Generator) -> FloatArray:
    """A self-affine surface with a Hurst exponent of 0.8, of waves up to 120 m (m)."""
    fy, fx = np.meshgrid(
        np.fft.fftfreq(shape[0], CELL_M), np.fft.rfftfreq(shape[1], CELL_M), indexing="ij"
    )
    frequency = np.maximum(np.hypot(fx, fy), 1.0 / 120.0)
    # The spectrum of a surface falls with the frequency to the power of 2 (H + 1).
    waves = np.fft.rfft2(rng.standard_normal(shape)) * frequency**-1.8
    surface: FloatArray = np.fft.irfft2(waves, shape)
    surface -= surface.mean()
    surface *= standard_m / surface.std()
    return surface


def surveyed(grid: Grid, rng: np.random.Generator) -> Grid:
    """A terrain model of a slope with one of the faults of real ones, or with none.

    Smoothed over some metres, shifted by one or two, or measured on cells of 6 m.
    """
    fault = int(rng.integers(4))
    z = grid.values
    if fault == 1:
        z = ndimage.gaussian_filter(z, rng.uniform(2.0, 5.0) / grid.cell_size, mode="nearest")
    elif fault == 2:
        angle, way = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(1.0, 2.0) / grid.cell_size
        z = ndimage.shift(
            z, (way * math.sin(angle), way * math.cos(angle)), order=1, mode="nearest"
        )
    elif fault == 3:
        coarse = ndimage.uniform_filter(z, 3, mode="nearest")[1::3, 1::3]
        rows, cols = ((np.arange(n) - 1.0) / 3.0 for n in z.shape)
        at = np.meshgrid(rows, cols, indexing="ij")
        z = ndimage.map_coordinates(coarse, at, order=1, mode="nearest")
    return replace(grid, values=z)


def guide(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Gradient (dz/dx, dz/dy) of the terrain smoothed over GUIDE_SD_M."""
    smooth = ndimage.gaussian_filter(grid.values, GUIDE_SD_M / grid.cell_size, mode="nearest")
    d_row, d_col = np.gradient(smooth, grid.cell_size)
    return np.ascontiguousarray(d_col), np.ascontiguousarray(-d_row)


@kernel
def surface_at(
    z: FloatArray, west: float, north: float, cell: float, x: float, y: float
) -> tuple[float, float, float]:
    """Height (m) and gradient (dz/dx, dz/dy) of the bilinear surface."""
    u = (x - west) / cell - 0.5
    v = (north - y) / cell - 0.5
    # Upper left of the four cell centres around the point.
    j = min(max(math.floor(u), 0), z.shape[1] - 2)
    i = min(max(math.floor(v), 0), z.shape[0] - 2)
    p, q = u - j, v - i
    upper = z[i, j] + p * (z[i, j + 1] - z[i, j])
    lower = z[i + 1, j] + p * (z[i + 1, j + 1] - z[i + 1, j])
    east = (1.0 - q) * (z[i, j + 1] - z[i, j]) + q * (z[i + 1, j + 1] - z[i + 1, j])
    return upper + q * (lower - upper), east / cell, -(lower - upper) / cell


@kernel
def height_at(z: FloatArray, west: float, north: float, cell: float, x: float, y: float) -> float:
    """Height of the bilinear surface (m)."""
    return surface_at(z, west, north, cell, x, y)[0]


@kernel
def descent(
    gx: FloatArray,
    gy: FloatArray,
    west: float,
    north: float,
    cell: float,
    x: float,
    y: float,
    hx: float,
    hy: float,
) -> tuple[float, float]:
    """Unit vector of steepest descent of the smoothed terrain; on flat ground the heading lasts."""
    px = -height_at(gx, west, north, cell, x, y)
    py = -height_at(gy, west, north, cell, x, y)
    steep = math.sqrt(px * px + py * py)
    if steep < 1e-9:
        return hx, hy
    weight = min(1.0, steep / _FLAT)
    dx = weight * px / steep + (1.0 - weight) * hx
    dy = weight * py / steep + (1.0 - weight) * hy
    length = math.sqrt(dx * dx + dy * dy)
    if length < 1e-9:
        return hx, hy
    return dx / length, dy / length
