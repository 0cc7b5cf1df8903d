"""How another sample of as many blocks would change the hazard levels."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from sassgis.grid import BoolArray, FloatArray, IntArray
from sassgis.hazard.curves import at_energies, wide_variance
from sassgis.hazard.levels import limits_of_levels, window_of
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset

#: Upper limits of estimates from few places: shapes of the gamma distribution stay above 0, and no
#: unreached place is certain to be reached.
_MOST_BETA, _MOST_CHANCE = 0.95, 0.9
#: Number of prior places with β = 0: few places are a poor estimate.
_AT_FIRST = 20.0
#: So many blocks are not expected where none came.
_FEW_BLOCKS = 8
#: If more than this many times the blocks are needed, no sample decides the cell.
MAX_FACTOR = 2.0**20


@dataclass(frozen=True)
class LevelChances:
    """Levels that another sample of as many blocks would give the places of a sample."""

    # Shape (n,); as in HazardCurves, ascending; also some that no block of this sample reached.
    places: IntArray
    level: NDArray[np.int16]  # shape (n,); hazard level of this sample
    # Shape (n, n_levels + 2); column k: probability of level k or a higher one, 0 being none; the
    # first is 1, the last 0. One half where the sample does not give the variance.
    at_least: FloatArray
    in_part: bool = False  # whether these are places of a part of the map

    @property
    def lowered(self) -> FloatArray:
        """Return the probability of a lower level, shape (n,)."""
        return 1.0 - self._at_least_level(0)

    @property
    def raised(self) -> FloatArray:
        """Return the probability of a higher level, shape (n,)."""
        return self._at_least_level(1)

    def _at_least_level(self, more: int) -> FloatArray:
        column = self.level.astype(np.int64)[:, None] + more
        return np.take_along_axis(self.at_least, column, 1)[:, 0]

    @property
    def changed(self) -> FloatArray:
        """Return the probability of another level, shape (n,)."""
        return self.lowered + self.raised

    @property
    def changed_share(self) -> float:
        """Return the expected area on which two samples differ, over the area that has a level.

        The sum of the shares of the levels, weighted by their areas, and of what is newly zoned.
        Above 1 where more changes than has a level; 0 without any.
        """
        return self._of_zoned(self.changed)

    @property
    def newly_zoned_share(self) -> float:
        """Return the expected area without a level that gets one, over the area that has one."""
        return self._of_zoned(self.changed[self.level == 0])

    def _of_zoned(self, chance: FloatArray) -> float:
        zoned = int((self.level > 0).sum())
        return float(chance.sum()) / zoned if zoned else 0.0

    @property
    def changed_by_level(self) -> FloatArray:
        """Return the expected share of the area of each level that would change, shape (n_levels,).

        NaN of a level without area.
        """
        n = self.at_least.shape[1] - 1
        cells = np.bincount(self.level, minlength=n)[1:]
        changed = np.bincount(self.level, self.changed, minlength=n)[1:]
        return np.divide(changed, cells, out=np.full(n - 1, np.nan), where=cells > 0)

    @property
    def target_share(self) -> float:
        """Return the share that adaptive sampling reduces, so that each level counts.

        That of the zoned area, or the mean over the levels with an area if it is larger.
        """
        of_levels = self.changed_by_level
        mean = float(np.nanmean(of_levels)) if np.isfinite(of_levels).any() else 0.0
        return max(self.changed_share, mean)

    def interval(self, confidence: float) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        """Return the lowest and highest level between which another sample would put each place.

        ``confidence`` is the probability of each end: that the level is not lower, and that it is
        not higher. The level of this sample lies between them.
        """
        lowest = (self.at_least[:, 1:] >= confidence).sum(axis=1)
        highest = (self.at_least[:, 1:] > 1.0 - confidence).sum(axis=1)
        return (
            np.minimum(lowest, self.level).astype(np.int16),
            np.maximum(highest, self.level).astype(np.int16),
        )

    def uncertain(self, confidence: float) -> BoolArray:
        """Return whether another sample might give a place another level, shape (n,).

        These are, first, the places with another level in the interval. The most probable others
        follow until all hold a share ``confidence`` of the changes by another sample; none is five
        times less probable than the interval requires. In a part of the map only the first are
        returned.
        """
        lowest, highest = self.interval(confidence)
        if self.in_part:
            beyond: BoolArray = lowest != highest
            return beyond
        changed = self.changed
        falling = np.sort(changed)[::-1]
        held = np.cumsum(falling)
        last = np.searchsorted(held, confidence * held[-1]) if held.size else 0
        least = max(float(falling[last]) if held.size else 0.0, 0.2 * (1.0 - confidence))
        out: BoolArray = (lowest != highest) | (changed >= least)
        return out


def level_chances(
    curves: HazardCurves,
    level: NDArray[np.int16],
    preset: HazardPreset,
    known: BoolArray | None = None,
    in_part: bool = False,
) -> LevelChances:
    """Return levels that another sample of as many blocks would give.

    With one weight w of all blocks a place has n = λ/w of them, with several w = v/λ, for which λ
    has its variance v. The expected number m, given n, depends on how many places have each m. If
    this is proportional to m^(−1−β), m has a gamma distribution with shape n − β. Another sample
    then has a number N with P(N >= k) = I(k, n − β) at one half, the negative binomial. β follows
    from the numbers of places with one and with two blocks, f₁ and f₂: the mean of m is 1 − β at
    the former, and 2 f₂/f₁ by Good (1953, Biometrika 40: 237-264).

    So another sample reaches f₁ (2^β − 1)/β places that have no block. Their distances to places
    with any block are taken as those from places with one block to places with several.

    The classes of intensity are counted on the same blocks: the most probable of those that give a
    level decides.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies. Its places are cells, if any are
        known.
    level : int16, shape (n,)
        Of the places, by `levels.hazard_level`.
    known : bool, shape (n_rows, n_cols), optional
        Cells of the terrain with a height; without them places that no block reached are left out.
    in_part : bool
        Whether this is a part of a map. What is counted over all places is left out, so that the
        result does not depend on the part: β is 0, and no place that no block reached is looked at.
    """
    known = None if in_part else known
    few = at_energies(curves, preset.thresholds_kj)
    limits = limits_of_levels(preset)
    reached = few.rate > 0.0
    weight = np.divide(wide_variance(few), few.rate, out=np.zeros_like(few.rate), where=reached)
    with np.errstate(divide="ignore", invalid="ignore"):
        blocks = np.where(reached, few.rate / weight, 0.0)
    betas = [0.0 if in_part else _beta(blocks[:, i]) for i in range(blocks.shape[1])]

    def again(i: int) -> list[tuple[int, FloatArray]]:
        """Return the chance of each level, by the energies of one class, where blocks came."""
        rates, weights = few.rate[:, i].copy(), weight[:, i].copy()
        alike = _alike(weights, blocks[:, i])
        return [
            (k, _chance_of_rate(rates, weights, alike, betas[i], float(limits[k, i])))
            for k in np.flatnonzero(np.isfinite(limits[:, i])).tolist()
        ]

    with ThreadPoolExecutor(1) as pool:
        # As long as the chances of the places with blocks take.
        looked_for = pool.submit(_first_reached, few.places, blocks, weight[:, 0], limits, known)
        of_classes = [again(i) for i in range(blocks.shape[1])]
        places, first, weight_of_first = looked_for.result()
    own = np.searchsorted(places, few.places)
    chance = np.zeros((len(limits) + 2, places.size))
    chance[0] = 1.0
    for i, of_class in enumerate(of_classes):
        for k, once_more in of_class:
            one = np.zeros(places.size)
            one[own] = once_more
            new = _chance_of_new(first[:, i], weight_of_first, betas[i], float(limits[k, i]))
            chance[k + 1] = np.maximum.reduce([chance[k + 1], one, new])
    # A level that is reached is reached by the lower ones too, whatever the rounding.
    np.maximum.accumulate(chance[::-1], out=chance[::-1])
    chance = chance.T
    of_all = np.zeros(places.size, np.int16)
    of_all[own] = level
    return LevelChances(places, of_all, chance, in_part)


def _beta(blocks: FloatArray) -> float:
    """Estimate the exponent of the number of places by expected number, from blocks per place."""
    one, two = (int(((blocks >= k - 0.5) & (blocks < k + 0.5)).sum()) for k in (1, 2))
    beta = 1.0 - (2.0 * two + _AT_FIRST) / (one + _AT_FIRST)
    return float(np.clip(beta, -1.0, _MOST_BETA))


def _chance_of_rate(
    rate: FloatArray,
    weight: FloatArray,
    alike: tuple[FloatArray, FloatArray, IntArray],
    beta: float,
    limit: float,
) -> FloatArray:
    """Return the probability that another sample gives at least a rate ``limit``."""
    out = ((rate > 0.0) & (rate >= limit * (1.0 - 1e-12))).astype(np.float64)
    out[np.isnan(weight)] = 0.5
    some = np.flatnonzero((weight > 1e-12 * limit) & (rate > 0.0))
    weights, counts, of = alike
    heavy = weights > 1e-12 * limit
    shape = np.maximum(counts[heavy] - beta, 1.0 - _MOST_BETA)
    chance = np.zeros(weights.size)
    chance[heavy] = special.betainc(_fewest(limit, weights[heavy]), shape, 0.5)
    out[some] = chance[of[some]]
    return out


def _alike(weight: FloatArray, blocks: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the different pairs of weight and number of blocks, and the pair of each place."""
    weights, of_weight = np.unique(weight, return_inverse=True)
    counts, of_count = np.unique(blocks, return_inverse=True)
    pairs, of = np.unique(of_weight * counts.size + of_count, return_inverse=True)
    of_weight, of_count = np.divmod(pairs, max(counts.size, 1))
    return weights[of_weight], counts[of_count], of


def _fewest(limit: float, weight: FloatArray) -> FloatArray:
    """Return fewest blocks of a weight that make a rate."""
    return np.maximum(np.ceil(limit / weight - 1e-6), 1.0)


def _first_reached(
    places: IntArray,
    blocks: FloatArray,
    weight: FloatArray,
    limits: FloatArray,
    known: BoolArray | None,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return places and neighbours, and the chance that another sample is first to reach each.

    ``blocks`` of a rate ``weight`` came to the places, by the class of their energy. The chance is
    by class as well; the weight of a neighbour is that of the nearest place. There are no
    neighbours if few blocks cannot reach one of the ``limits``, or no cell of the terrain is
    ``known``.
    """
    alone = places, np.zeros(blocks.shape), weight
    least = np.where(np.isfinite(limits), limits, np.inf).min(axis=0)
    heaviest = float(weight[np.isfinite(weight)].max(initial=0.0))
    asked = np.flatnonzero(least < _FEW_BLOCKS * heaviest)
    if known is None or not (asked.size and places.size):
        return alone
    window = window_of(places, known.shape)
    several = window.map_of(blocks[:, 0] >= 1.5)
    single = window.map_of((blocks[:, 0] > 0.0) & (blocks[:, 0] < 1.5))
    if not (several.any() and single.any()):
        return alone
    # No new place is farther from the others than a place with one block from those with several.
    margin = math.ceil(float(distance(~several)[0][single].max())) + 1
    window = window_of(places, known.shape, margin)
    chances, before = [], known[window.rows, window.cols]
    for i in range(blocks.shape[1]):
        some = window.map_of(blocks[:, i] > 0.0)
        found = np.zeros(some.shape)
        if i in asked:
            several = window.map_of(blocks[:, i] >= 1.5)
            found = _chance_of_first(some, several, before & ~some, _beta(blocks[:, i]))
        chances.append(found)
        # A block above a high threshold is above the lower ones.
        before = some
    near = distance(~window.map_of(weight > 0.0))[1]
    row, col = np.nonzero(np.any([c > 0.0 for c in chances], axis=0))
    cells = (row + window.rows.start) * known.shape[1] + col + window.cols.start
    every = np.union1d(places, cells)
    at = np.searchsorted(every, cells)
    chance, weights = np.zeros((every.size, blocks.shape[1])), np.zeros(every.size)
    chance[at] = np.stack([c[row, col] for c in chances], axis=1)
    weights[np.searchsorted(every, places)] = weight
    weights[at] = window.map_of(weight)[tuple(near)][row, col]
    return every, chance, weights


def _chance_of_new(first: FloatArray, weight: FloatArray, beta: float, limit: float) -> FloatArray:
    """Return probability of at least a rate ``limit`` where no block came with such an energy."""
    out = np.zeros(first.size)
    some = np.flatnonzero((first > 0.0) & (weight > 0.0))
    fewest = np.minimum(_fewest(limit, weight[some]), _FEW_BLOCKS).astype(np.int64)
    out[some] = first[some] * _of_first(beta)[fewest]
    return out


def _of_first(beta: float) -> FloatArray:
    """Compute the chance of k or more blocks where another sample comes first, k to _FEW_BLOCKS."""
    # That of j is Γ(j − β)/(j! 2^(j − β)) over its sum, with as many places as m^(−1−β).
    j = np.arange(1.0, 200.0)
    some = np.exp(special.gammaln(j - beta) - special.gammaln(j + 1.0) - (j - beta) * math.log(2.0))
    tail = np.cumsum(some[::-1])[::-1] / some.sum()
    tail[_FEW_BLOCKS - 1 :] = 0.0
    return np.concatenate([[1.0], tail])


def _chance_of_first(
    some: BoolArray, several: BoolArray, asked: BoolArray, beta: float
) -> FloatArray:
    """Return the chance that another sample is the first to come to each cell that is asked for."""
    out = np.zeros(some.shape)
    single = some & ~several
    if not (single.any() and several.any() and asked.any()):
        return out
    from_several = _steps(distance(~several)[0][single])
    from_some = _steps(distance(~some)[0][asked])
    size = int(max(from_several.max(), from_some.max())) + 1
    gone = np.bincount(from_several, minlength=size)
    there = np.bincount(from_some, minlength=size)
    new = math.log(2.0) if abs(beta) < 1e-9 else (2.0**beta - 1.0) / beta
    out[asked] = np.minimum(new * gone / np.maximum(there, 1), _MOST_CHANCE)[from_some]
    return out


def _steps(cells: FloatArray) -> IntArray:
    """Return classes of distance, two to each doubling."""
    classes: IntArray = np.floor(2.0 * np.log2(np.maximum(cells, 1.0))).astype(np.int64)
    return classes


def distance(beyond: BoolArray) -> tuple[FloatArray, IntArray]:
    """Find distance (cells) and identity of the nearest cell that is not beyond, shape (2, ...)."""
    found, nearest = ndimage.distance_transform_edt(beyond, return_indices=True)
    return found, nearest


def worth_of_places(curves: HazardCurves, preset: HazardPreset) -> FloatArray:
    """Compute how much less area another sample changes per unit less of variance.

    The change along a limit L grows with the standard error s of the rates there; cells within
    about two errors of L count. With d = (λ − L)/s, the change by s² is the sum of exp(−d²/2)/s²
    over cells. The thresholds of the preset are among the energies; shape (n, n_intensities),
    scaled to 1 at most.
    """
    few = at_energies(curves, preset.thresholds_kj)
    limits = limits_of_levels(preset)
    out = np.zeros_like(few.rate)
    some = few.variance > 0.0
    spread = np.where(some, 2.0 * few.variance, 1.0)
    for of_level in limits:
        given = few.rate >= of_level
        for i in np.flatnonzero(np.isfinite(of_level)).tolist():
            # Where another class gives the level in any case, this one does not decide.
            open_ = some[:, i] & ~np.delete(given, i, axis=1).any(axis=1)
            apart = (few.rate[:, i] - of_level[i]) ** 2 / spread[:, i]
            out[:, i] += np.where(open_, np.exp(-0.5 * apart) / spread[:, i], 0.0)
    return out / max(float(out.max(initial=0.0)), np.finfo(np.float64).tiny)


def rocks_factor(
    curves: HazardCurves, preset: HazardPreset, chances: LevelChances, confidence: float
) -> FloatArray:
    """Estimate how many times the blocks it would take to decide the level of each place, (n,).

    With g times the blocks of every source, the rates being as they are, the variance falls to v/g.
    Two such samples differ with a variance of 2 v/g; taken as normal, a limit is out of reach from
    g = 2 z² v / (λ − limit)² on. 1 where the level is decided; infinite where the rate lies on a
    limit of the matrix, so that no sample decides; NaN where the sample does not give its variance.
    """
    few = at_energies(curves, preset.thresholds_kj)
    own = np.searchsorted(chances.places, few.places)
    lowest, highest = (k[own] for k in chances.interval(confidence))
    not_certain, level = lowest != highest, chances.level[own]
    limits = np.vstack(
        [np.zeros(few.rate.shape[1]), limits_of_levels(preset), np.full(few.rate.shape[1], np.inf)]
    )
    spread = 2.0 * special.ndtri(confidence) ** 2 * wide_variance(few)
    with np.errstate(divide="ignore", invalid="ignore"):
        below = few.rate - limits[level]
        above = limits[level + 1] - few.rate
        # Kept by any class that gives the level; a higher one must be given by none.
        kept = np.where(below >= 0.0, spread / below**2, np.inf).min(axis=1)
        out_of_reach = np.where(np.isinf(above), 0.0, spread / above**2).max(axis=1)
    needed = np.maximum(np.where(level > 0, kept, 0.0), out_of_reach)
    needed = np.where(needed > MAX_FACTOR, np.inf, np.maximum(needed, 1.0))
    out = np.where(not_certain, needed, 1.0)
    out[not_certain & np.isnan(few.variance).any(axis=1)] = np.nan
    return out
