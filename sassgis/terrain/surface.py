"""A smooth surface through the heights of a grid, and smoothing that leaves planes as they are.

The surface is a cubic B-spline through the cell centres (M. Unser, 1999, Splines: a perfect fit
for signal and image processing, IEEE Signal Processing Magazine 16(6), 22-38): twice
continuously differentiable, so that directions of descent do not jump from cell to cell.

Kernels work in *cell units*: ``u`` counts cells eastward and ``v`` southward from the outer corner
(west, north), so that ``floor(u)`` and ``floor(v)`` are column and row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from sassgis.compiled.jit import kernel, lean
from sassgis.errors import InputError
from sassgis.grid import BoolArray, FloatArray, Grid
from sassgis.settings.results import LineEnd

# The mirror condition that the prefilter sets at the rim decays by 0.268 per cell: after 24 cells
# it is below the rounding of a double.
PAD = 24
# Nodata is filled along the slope of the nearest valid cell, but not farther than this.
_FILL_REACH = 3.0
#: Standard deviations at which the Gaussian of the smoothing ends.
GAUSSIAN_ENDS = 4.0
#: Standard deviation of the Gaussian over the diameter of the block: that of a mean over the disk
#: which the block covers. Waves as long as the diameter keep 29 % of their height, half as long
#: 0.7 %, four times as long 93 %.
SD_PER_DIAMETER = 0.25
_VALID = -1
_LEFT_DEM = int(LineEnd.LEFT_DEM)
_NODATA = int(LineEnd.NODATA)


@dataclass(frozen=True, slots=True)
class Surface:
    """A cubic B-spline through the cell centres of a grid."""

    # Shape (n_rows + 2 * PAD, n_cols + 2 * PAD); spline coefficients (m), with a rim so that the
    # surface is defined beyond its edge.
    coefficients: FloatArray
    valid: BoolArray  # shape (n_rows, n_cols); cells whose height is known
    # As in Grid (m).
    west: float
    north: float
    cell_size: float


def surface(grid: Grid) -> Surface:
    """Interpolate a grid by a cubic B-spline.

    Nodata is filled, and the rim extrapolated, so that a plane stays a plane up to the last cell;
    points in cells without a height are nevertheless invalid. Raises InputError if no cell has a
    height.
    """
    valid = np.isfinite(grid.values)
    n_rows, n_cols = grid.shape
    heights = grid.values
    if not valid.all():
        trend = _plane(heights, valid)
        # Known heights go in as they are: they must not depend on how far the grid extends.
        heights = np.where(valid, heights, _filled(heights - trend, valid) + trend)
    padded = _pad_odd(_pad_odd(heights, axis=0), axis=1)
    coefficients = ndimage.spline_filter(padded, order=3, mode="mirror", output=np.float64)
    assert coefficients.shape == (n_rows + 2 * PAD, n_cols + 2 * PAD)
    return Surface(
        coefficients=np.ascontiguousarray(coefficients),
        valid=np.ascontiguousarray(valid),
        west=grid.west,
        north=grid.north,
        cell_size=grid.cell_size,
    )


def smoothed(grid: Grid, scale_m: float) -> Grid:
    """Smooth a grid with a Gaussian that stops at its edges and at nodata.

    Each height becomes the value, at the cell, of the plane fitted to its surroundings with
    Gaussian weights (local linear regression: W. S. Cleveland, 1979, J. Am. Stat. Assoc. 74,
    829-836). Where the surroundings are complete this is the ordinary Gaussian mean; at an edge it
    is not drawn towards the inside, and a plane is returned as it was. The result is NaN where
    ``grid`` is NaN, and nowhere else. ``scale_m`` is the standard deviation (m); 0 returns the grid
    itself. Raises InputError if no cell has a height.
    """
    valid = np.isfinite(grid.values)
    trend = _plane(grid.values, valid)
    if scale_m == 0.0:
        return grid
    general = (_step(trend, axis=0), _step(trend, axis=1))
    return replace(
        grid, values=_local_linear(grid.values, valid, scale_m / grid.cell_size, general)
    )


def block_scale_grid(grid: Grid, scale_m: float) -> Grid:
    """Smooth away what is smaller than a block of a diameter (m); planes stay as they are.

    A block that bridges a bump does not feel its flanks as slopes; the slope variation of the
    ground class represents them. With cells as wide as the block or wider the grid holds no such
    detail, and is returned itself.
    """
    return grid if scale_m <= grid.cell_size else smoothed(grid, SD_PER_DIAMETER * scale_m)


def evaluate(surface: Surface, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Compute height (m) and gradient (m per m, eastward and northward) of a surface at points.

    NaN where the cell that holds the point has no height, and outside the grid.
    """
    u = (np.asarray(x, np.float64).ravel() - surface.west) / surface.cell_size
    v = (surface.north - np.asarray(y, np.float64).ravel()) / surface.cell_size
    out = np.full((3, u.size), np.nan)
    _evaluate_many(surface.coefficients, surface.valid, u, v, out)
    return out[0], out[1] / surface.cell_size, -out[2] / surface.cell_size


def _plane(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Fit the least-squares plane through the valid heights, on the whole grid."""
    count = int(valid.sum())
    if count == 0:
        raise InputError("the grid has no height at all", field="DEM", found="nodata only")
    # Sums over rows and columns, in place of a list of all cells.
    known = valid.astype(np.float64)
    in_row, in_col = known.sum(axis=1), known.sum(axis=0)
    row, col = (np.arange(n, dtype=np.float64) for n in values.shape)
    row_mean, col_mean = float(in_row @ row) / count, float(in_col @ col) / count
    z_mean = float(np.sum(values, where=valid)) / count
    z = np.where(valid, values - z_mean, 0.0)
    r, c = row - row_mean, col - col_mean
    across = r @ known @ c
    normal = np.array([[in_row @ (r * r), across], [across, in_col @ (c * c)]])
    # The pseudo-inverse copes with valid cells that lie on one line.
    slope = np.linalg.pinv(normal, hermitian=True) @ np.array(
        [r @ z.sum(axis=1), z.sum(axis=0) @ c]
    )
    plane: FloatArray = z_mean + slope[0] * r[:, None] + slope[1] * c[None, :]
    return plane


def _filled(residual: FloatArray, valid: BoolArray) -> FloatArray:
    """Fill invalid cells from the nearest valid one, along its slope."""
    known = np.where(valid, residual, np.nan)
    slopes = [_one_sided_slope(known, axis) for axis in (0, 1)]
    distance, nearest = ndimage.distance_transform_edt(~valid, return_indices=True)
    reach = np.minimum(1.0, _FILL_REACH / np.maximum(distance, 1.0))
    filled: FloatArray = known[nearest[0], nearest[1]]
    for axis in (0, 1):
        step = np.indices(valid.shape, sparse=True)[axis] - nearest[axis]
        filled = filled + slopes[axis][nearest[0], nearest[1]] * step * reach
    return filled


def _one_sided_slope(known: FloatArray, axis: int) -> FloatArray:
    """Return the mean of the forward and backward differences that exist; 0 where neither does."""
    steps = np.diff(known, axis=axis)
    backward, forward = (np.insert(steps, k, np.nan, axis) for k in (0, steps.shape[axis]))
    count = np.isfinite(backward).astype(np.float64) + np.isfinite(forward)
    total = np.nan_to_num(backward) + np.nan_to_num(forward)
    slope: FloatArray = total / np.maximum(count, 1.0)
    return slope


def _pad_odd(values: FloatArray, axis: int) -> FloatArray:
    """Continue an array by odd reflection: lines stay lines."""
    width = [(PAD, PAD) if k == axis else (0, 0) for k in (0, 1)]
    if values.shape[axis] == 1:
        return np.pad(values, width, mode="edge")
    return np.pad(values, width, mode="reflect", reflect_type="odd")


def _step(plane: FloatArray, axis: int) -> float:
    """Return the rise of a plane from one row or column to the next."""
    return float(np.diff(plane[:2, :2], axis=axis)[0, 0]) if plane.shape[axis] > 1 else 0.0


def _local_linear(
    heights: FloatArray, valid: BoolArray, scale: float, general: tuple[float, float]
) -> FloatArray:
    """Compute Gaussian-weighted local linear regression; NaN where invalid.

    ``scale`` in cells; ``general`` is the rise per row and per column where the surroundings carry
    no separate slope. What a cell gets depends only on its surroundings, to the last bit, except
    where ``general`` is used.
    """
    radius = max(1, int(np.ceil(GAUSSIAN_ENDS * scale)))
    offset = np.arange(-radius, radius + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (offset / scale) ** 2)
    weight /= weight.sum()
    moments = tuple(weight * (offset / scale) ** power for power in (0, 1, 2))
    if not valid.all() or min(valid.shape) <= 4 * radius:
        return _regressed(heights, valid, moments, scale, general)
    # Without nodata surroundings are incomplete only near the edges.
    result = _correlated(heights, moments[0], moments[0])
    ends = (slice(radius), slice(2 * radius)), (slice(-radius, None), slice(-2 * radius, None))
    for both in ends:
        for order in (1, -1):
            edge, around = ((own, slice(None))[::order] for own in both)
            strip = _regressed(heights[around], valid[around], moments, scale, general)
            result[edge] = strip[edge]
    return result


def _correlated(values: FloatArray, by_row: FloatArray, by_col: FloatArray) -> FloatArray:
    """Return weighted sums over the surroundings of each cell, without what is beyond the edges."""
    once = ndimage.correlate1d(values, by_row, axis=0, mode="constant")
    twice: FloatArray = ndimage.correlate1d(once, by_col, axis=1, mode="constant")
    return twice


def _regressed(
    heights: FloatArray,
    valid: BoolArray,
    moments: tuple[FloatArray, ...],
    scale: float,
    general: tuple[float, float],
) -> FloatArray:
    """Return local linear regression with these weights, and their first and second moments."""
    mask = valid.astype(np.float64)
    known = np.where(valid, heights, 0.0)

    def correlate(values: FloatArray, row_power: int, col_power: int) -> FloatArray:
        return _correlated(values, moments[row_power], moments[col_power])

    share = correlate(mask, 0, 0)
    mean = correlate(known, 0, 0)
    partial = valid & (share < 1.0 - 1e-12)
    result = np.where(valid, mean, np.nan)
    if not partial.any():
        return result
    # Only cells with incomplete surroundings need the regression: elsewhere the weights are
    # symmetric and the slope terms drop out.
    s00, t00 = share[partial], mean[partial]
    s10, s01 = correlate(mask, 1, 0)[partial], correlate(mask, 0, 1)[partial]
    s20, s02 = correlate(mask, 2, 0)[partial], correlate(mask, 0, 2)[partial]
    s11 = correlate(mask, 1, 1)[partial]
    t10, t01 = correlate(known, 1, 0)[partial], correlate(known, 0, 1)[partial]
    # Centred moments: the regression at the cell is the weighted mean less slope times lever.
    rr, cc, rc = s20 - s10 * s10 / s00, s02 - s01 * s01 / s00, s11 - s10 * s01 / s00
    rz, cz = t10 - s10 * t00 / s00, t01 - s01 * t00 / s00
    determinant = rr * cc - rc * rc
    # Too few or too ill-placed neighbours carry no slope; that of the whole grid then serves.
    sound = determinant > 1e-3 * s00 * s00
    safe = np.where(sound, determinant, 1.0)
    slope_row = np.where(sound, (rz * cc - cz * rc) / safe, scale * general[0])
    slope_col = np.where(sound, (cz * rr - rz * rc) / safe, scale * general[1])
    result[partial] = (t00 - slope_row * s10 - slope_col * s01) / s00
    return result


@lean
def standing(valid: BoolArray, u: float, v: float) -> int:
    """Return -1 where the cell at (u, v) has a height, else the LineEnd of what is missing."""
    if not (u >= 0.0 and v >= 0.0 and u < valid.shape[1] and v < valid.shape[0]):
        return _LEFT_DEM
    if valid[int(v), int(u)]:
        return _VALID
    return _NODATA


@lean
def slope_at(coefficients: FloatArray, u: float, v: float) -> tuple[float, float]:
    """Return the gradient of the spline in metres per cell, along u and v."""
    _, gu, gv, _, _, _ = shape_at(coefficients, u, v)
    return gu, gv


@lean
def shape_at(
    coefficients: FloatArray, u: float, v: float
) -> tuple[float, float, float, float, float, float]:
    """Return height, gradient (u, v) and second derivatives (uu, uv, vv) of the spline by cell."""
    a, b = u - 0.5 + PAD, v - 0.5 + PAD
    col, row = int(np.floor(a)), int(np.floor(b))
    t, r = a - col, b - row
    q, p = 1.0 - t, 1.0 - r
    wt0, wt3 = q * q * q / 6.0, t * t * t / 6.0
    wt1 = (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0
    wt2 = 1.0 - wt0 - wt1 - wt3
    dt0, dt1, dt3 = -0.5 * q * q, 1.5 * t * t - 2.0 * t, 0.5 * t * t
    dt2 = -dt0 - dt1 - dt3
    wr0, wr3 = p * p * p / 6.0, r * r * r / 6.0
    wr1 = (3.0 * r * r * r - 6.0 * r * r + 4.0) / 6.0
    wr2 = 1.0 - wr0 - wr1 - wr3
    dr0, dr1, dr3 = -0.5 * p * p, 1.5 * r * r - 2.0 * r, 0.5 * r * r
    dr2 = -dr0 - dr1 - dr3
    z, gu, gv, huu, huv, hvv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        m = row - 1 + k
        c0, c1 = coefficients[m, col - 1], coefficients[m, col]
        c2, c3 = coefficients[m, col + 1], coefficients[m, col + 2]
        wr = wr0 if k == 0 else wr1 if k == 1 else wr2 if k == 2 else wr3
        dr = dr0 if k == 0 else dr1 if k == 1 else dr2 if k == 2 else dr3
        er = p if k == 0 else 3.0 * r - 2.0 if k == 1 else 1.0 - 3.0 * r if k == 2 else r
        value = wt0 * c0 + wt1 * c1 + wt2 * c2 + wt3 * c3
        first = dt0 * c0 + dt1 * c1 + dt2 * c2 + dt3 * c3
        second = q * c0 + (3.0 * t - 2.0) * c1 + (1.0 - 3.0 * t) * c2 + t * c3
        z += wr * value
        gu += wr * first
        gv += dr * value
        huu += wr * second
        huv += dr * first
        hvv += er * value
    return z, gu, gv, huu, huv, hvv


@kernel
def _evaluate_many(
    coefficients: FloatArray, valid: BoolArray, u: FloatArray, v: FloatArray, out: FloatArray
) -> None:
    for i in range(u.size):
        if standing(valid, u[i], v[i]) == _VALID:
            z, gu, gv, _, _, _ = shape_at(coefficients, u[i], v[i])
            out[0, i], out[1, i], out[2, i] = z, gu, gv
