"""Cliffs from the distribution of slope angles: morphological units as Gaussians.

A. Loye, M. Jaboyedoff and A. Pedrazzini (2009), Identification of potential rockfall source areas
at a regional scale using a DEM-based geomorphometric analysis, Natural Hazards and Earth System
Sciences 9, 1643-1653 (not checked against the source): the distribution of the slope angles of a
terrain is the sum of Gaussians, one for each morphological unit (plains, gentle slopes, steep
slopes, rock cliffs). Where the steepest unit prevails over all others, a cell is a potential
source; outcrops of rock that the map shows in the unit of steep slopes are sources as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from sassgis.errors import InputError
from sassgis.grid import BoolArray, FloatArray

#: Bins of the distribution (degrees).
_EDGES = np.arange(0.0, 91.0)
_MIDDLES = 0.5 * (_EDGES[:-1] + _EDGES[1:])
#: Steps in which the threshold is looked for (degrees).
_STEP_DEG = 0.1
#: The units of the paper, and where the mean of each lies (degrees; our choice). Without limits the
#: skewed distributions of real terrain would be fitted by units that are no landforms.
UNITS = {
    "plains": (0.0, 12.0),
    "gentle slopes": (12.0, 28.0),
    "steep slopes": (28.0, 45.0),
    "cliffs": (45.0, 85.0),
}
#: Limits of the standard deviation of a unit (degrees; our choice).
_LEAST_SD, _LARGEST_SD = 1.0, 12.0
#: Steeper cells count with the surface of this slope: beyond, the cells of a terrain model hold the
#: height of the face rather than its slope (degrees; our choice).
_STEEPEST_SURFACE_DEG = 80.0
#: Walls, and their share from which on heights cannot be in the unit of the cells.
WALL_DEG, WALL_SHARE = 80.0, 0.02
#: Squared Hellinger distance between distribution and fit at which no further unit is needed. A
#: unit of 1 % of the surface that is left out makes up to 0.01.
_GOOD_FIT = 0.002
#: Fits that are worse than that of all units by no more than this factor are as good.
_AS_GOOD = 1.1
#: Less of the surface (share) is no unit.
_LEAST_SHARE = 5e-4
#: Fewer cells make no distribution.
LEAST_CELLS = 500


@dataclass(frozen=True, slots=True)
class SlopeUnit:
    """A morphological unit: a Gaussian of slope angles."""

    name: str  # a key of UNITS
    mean_deg: float
    sd_deg: float
    share: float  # of the surface of the terrain, as if slopes beyond 0 and 90 degrees were terrain

    @property
    def surface_share(self) -> float:
        """Return the share of the surface, between 0 and 90 degrees."""
        low, high = special.ndtr((_EDGES[[0, -1]] - self.mean_deg) / self.sd_deg)
        return float(self.share * (high - low))

    def density(self, slope_deg: FloatArray) -> FloatArray:
        """Return the share of the surface per degree."""
        t = (slope_deg - self.mean_deg) / self.sd_deg
        dense: FloatArray = self.share / (self.sd_deg * np.sqrt(2.0 * np.pi)) * np.exp(-0.5 * t * t)
        return dense


@dataclass(frozen=True, slots=True)
class SlopeUnits:
    """The distribution of slope angles, taken apart."""

    # From the flattest to the steepest, which are the cliffs; those that the distribution needs.
    units: tuple[SlopeUnit, ...]
    distribution: FloatArray  # shape (90,); share of the surface in each degree
    # Squared Hellinger distance between the distribution and the sum of the units, 0 to 1.
    misfit: float
    cliff_deg: float  # slope from which cliffs prevail over each of the others (degrees)
    steep_deg: float  # slope from which cliffs and steep slopes prevail over the others (degrees)


def slopes_deg(values: FloatArray, dx_m: float, dy_m: float) -> FloatArray:
    """Compute the slope of each cell (degrees) from central differences; NaN without neighbours."""
    down = np.asarray(np.gradient(values, dy_m, axis=0))
    right = np.asarray(np.gradient(values, dx_m, axis=1))
    slopes: FloatArray = np.degrees(np.arctan(np.hypot(down, right)))
    return slopes


def wall_share(slopes: FloatArray) -> float:
    """Compute the share of the cells that are steeper than WALL_DEG.

    More than WALL_SHARE is no terrain: heights or cells are in another unit. The limits are expert
    judgement of ours.
    """
    known = slopes[np.isfinite(slopes)]
    return float((known > WALL_DEG).mean()) if known.size else 0.0


def slope_units(slopes: FloatArray) -> SlopeUnits:
    """Take the distribution of slope angles (degrees; NaN is left out) apart.

    Each cell counts with its surface, its area in plan divided by the cosine of its slope, as steep
    ground is small on a map. The Gaussians are fitted by least squares to the roots of the shares,
    which weighs rare steep cells as their number allows. The fewest units are taken that fit about
    as well as all of them. Raises InputError if there are too few cells, or no cliffs among them.
    """
    known = slopes[np.isfinite(slopes)]
    if known.size < LEAST_CELLS:
        raise InputError(
            "has too few cells for a distribution of slopes",
            found=f"{known.size} cells with a slope",
            expected=f"{LEAST_CELLS} or more",
        )
    surface = 1.0 / np.cos(np.radians(np.minimum(known, _STEEPEST_SURFACE_DEG)))
    sums = np.histogram(known, _EDGES, weights=surface)[0]
    distribution = sums / sums.sum()
    units, misfit = _fewest_units(distribution, known.size)
    if units[-1].name != "cliffs":
        raise InputError(
            "holds no cliffs by the distribution of its slopes",
            found=f"no unit of slopes with a mean above {UNITS['cliffs'][0]:g} degrees; the "
            f"steepest cell has {known.max():.1f}",
            expected="steeper terrain, finer cells, or a threshold of your own",
        )
    top = float(np.quantile(known, 0.999))
    cliff = _prevails_from(units[-1:], units[:-1], top)
    gentle = [u for u in units if u.name in ("plains", "gentle slopes")]
    steep = _prevails_from([u for u in units if u not in gentle], gentle, top)
    return SlopeUnits(tuple(units), distribution, misfit, cliff, min(steep, cliff))


def _fewest_units(distribution: FloatArray, cells: int) -> tuple[list[SlopeUnit], float]:
    """Return the units that are needed, from the flattest on, and the misfit."""
    # Counts scatter by their root: the root of a share has the variance 1 / (4 n).
    good = max(_GOOD_FIT, 2.0 * _MIDDLES.size / (4.0 * cells))
    units, misfit = _fitted(distribution, tuple(UNITS))
    enough = max(good, _AS_GOOD * misfit)
    for count in range(1, len(UNITS)):
        fits = [_fitted(distribution, names) for names in combinations(UNITS, count)]
        fewer = min(fits, key=lambda fit: fit[1])
        if fewer[1] <= enough:
            units, misfit = fewer
            break
    return [u for u in units if u.share >= _LEAST_SHARE], misfit


def _fitted(distribution: FloatArray, names: Sequence[str]) -> tuple[list[SlopeUnit], float]:
    """Return the best fit with these units, and its squared Hellinger distance."""
    # Takes long to load, and only this needs it.
    from scipy import optimize

    root = np.sqrt(distribution)

    def residual(numbers: FloatArray) -> FloatArray:
        gap: FloatArray = np.sqrt(_shares(numbers)) - root
        return gap

    low = np.concatenate([(UNITS[name][0], _LEAST_SD, 0.0) for name in names])
    high = np.concatenate([(UNITS[name][1], _LARGEST_SD, 1.5) for name in names])
    fits = []
    for q in (0.3, 0.7):
        first = np.concatenate(
            [
                (a + q * (b - a), 5.0, max(0.01, distribution[int(a) : int(b)].sum()))
                for a, b in (UNITS[name] for name in names)
            ]
        )
        fits.append(optimize.least_squares(residual, first, bounds=(low, high), xtol=1e-9))
    best = min(fits, key=lambda fit: float(fit.cost))
    rows = best.x.reshape(-1, 3).tolist()
    return [SlopeUnit(n, *row) for n, row in zip(names, rows, strict=True)], float(best.cost)


def _shares(numbers: FloatArray) -> FloatArray:
    """Return share of each degree, of units given as mean, standard deviation and share in turn."""
    mean, sd, share = numbers.reshape(-1, 3).T[:, :, None]
    below = special.ndtr((_EDGES - mean) / sd)
    total: FloatArray = (share * np.diff(below, axis=1)).sum(axis=0)
    return np.maximum(total, 1e-12)


def _prevails_from(own: list[SlopeUnit], others: list[SlopeUnit], top: float) -> float:
    """Find the lowest slope from which to ``top`` one of ``own`` is denser than all ``others``."""
    if not others:
        return 0.0
    angles = np.arange(0.0, 90.0, _STEP_DEG)
    mine = np.max([u.density(angles) for u in own], axis=0)
    theirs = np.max([u.density(angles) for u in others], axis=0)
    beaten = np.flatnonzero((theirs >= mine) & (angles <= max(top, own[-1].mean_deg)))
    return float(angles[beaten[-1] + 1]) if beaten.size else 0.0


def cliff_patches(
    slopes: FloatArray,
    threshold_deg: float,
    least_cells: int,
    rock: BoolArray | None = None,
    rock_deg: float = 90.0,
) -> NDArray[np.int32]:
    """Number the patches of connected cells that are steep enough, from 1 by falling size.

    Cells count from ``threshold_deg`` on, those known to be ``rock`` from ``rock_deg`` on. All
    others have 0, and so have patches of less than ``least_cells``. Cells that touch at a corner
    only are in different patches.
    """
    steep = slopes >= threshold_deg
    if rock is not None:
        steep |= rock & (slopes >= rock_deg)
    labels, count = ndimage.label(steep)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes, kind="stable")
    kept = order[sizes[order] >= max(1, least_cells)]
    number = np.zeros(count + 1, np.int32)
    number[kept] = np.arange(1, kept.size + 1)
    patches: NDArray[np.int32] = number[labels]
    return patches
