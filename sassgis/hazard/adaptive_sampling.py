"""Adaptive sampling: how many more blocks a map needs, and at which release points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.errors import ConfigError
from sassgis.grid import FloatArray
from sassgis.hazard.assess import Rules, curves_of
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.sampling_error import LevelChances, level_chances, worth_of_places
from sassgis.hazard.sources import sampled_sources
from sassgis.settings.hazard_rules import BlockBudget
from sassgis.settings.map_run import Config, MapRun, Round, Worth
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.accumulators import Progress
from sassgis.terrain.prepare import Plan

#: Each point has at least an eighth of the blocks of any other: few blocks may mislead.
_MOST_HALVINGS = 3
#: Growth of the number of blocks: at least, so that the search ends; at most, because the need is
#: poorly known from few blocks.
_LEAST_GROWTH, _MOST_GROWTH = 1.25, 4.0
#: Factor on the need computed from the present share, which is uncertain.
_MARGIN = 1.05


@dataclass(frozen=True, slots=True)
class MoreBlocks:
    """Decides after each repetition whether another one is needed, and which.

    ``seconds`` is the part of the time of the budget that the simulation may take. Without ``adds``
    the blocks stay those of an earlier result, so that both differ by their barriers only.
    """

    rules: Rules
    budget: BlockBudget
    seconds: float
    tell: Callable[[str], None]
    adds: bool = True

    def __call__(self, run: MapRun, planned: Plan, progress: Progress) -> Round | None:
        """Return the next repetition, None for enough; set what the progress records in it."""
        sampled = sampled_sources(run, progress, self.rules.frequencies)
        curves = curves_of(sampled, bins_of(run).threshold)
        known = np.isfinite(run.grid.values)
        level = hazard_level(curves, self.rules.preset)
        chances = level_chances(curves, level, self.rules.preset, known)
        share = chances.target_share
        # A state that was saved after the last repetition is asked once more.
        if not progress.history or progress.history[-1][0] < progress.simulated:
            progress.history.append((progress.simulated, share))
        self.tell(
            f"{progress.simulated} blocks: with another random seed, "
            f"{100 * chances.changed_share:.1f} % of the zoned area changes level; "
            f"target {100 * self.budget.changed_share:.3g} %, now {100 * share:.1f} % (larger of "
            f"this and the mean of the levels{_least_certain(chances, self.rules)})"
        )
        if share <= self.budget.changed_share or not self.adds:
            return None
        growth = _MARGIN * (share / self.budget.changed_share) ** 2
        growth = min(max(growth, _LEAST_GROWTH), _MOST_GROWTH)
        wanted = math.ceil((growth - 1.0) * run.repetitions)
        halvings = halvings_of(self._open(run, planned, progress), planned)
        more = round_within(run, planned, wanted, halvings, self._blocks_left(progress))
        if more is not None and run.followed:
            columns = [curves.column(e) for e in self.rules.preset.thresholds_kj]
            of_cell = np.zeros((run.grid.values.size, len(columns)), np.float32)
            of_cell[curves.places] = worth_of_places(curves, self.rules.preset)
            progress.worth = Worth(np.array(columns, np.int64), of_cell)
            progress.scores = np.zeros((len(planned.points), len(run.blocks)))
        return more

    def _blocks_left(self, progress: Progress) -> int:
        """Count the blocks that the budget still allows for."""
        left = self.budget.blocks - progress.simulated
        if progress.seconds > 0.0:
            pace = progress.simulated / progress.seconds
            left = min(left, int(pace * (self.seconds - progress.seconds)))
        return max(left, 0)

    def _open(self, run: MapRun, planned: Plan, progress: Progress) -> FloatArray | None:
        """Return the uncertainty after a repetition at each point, by scenario; None if unknown."""
        if progress.worth is None:
            return None
        last = run.rounds[-1]
        halved = np.zeros(progress.scores.shape, np.int64)
        if last.halvings is not None:
            halved += last.halvings
        repeated = last.repetitions >> halved
        found: FloatArray = progress.scores / np.maximum(repeated, 1)
        out = np.zeros_like(found)
        for (area, k), tally in progress.sources.items():
            of = planned.points.area == area
            name = run.areas[area].name, run.blocks[k].name
            started = max(tally.rocks - tally.never_started, 1)
            # One repetition says little about one point: the mean of all points counts as one more.
            own, n = found[of, k], repeated[of, k]
            smooth = (n * own + own.mean()) / (n + 1)
            out[of, k] = (self.rules.frequencies[name] / started) ** 2 * smooth
        return out


def _least_certain(chances: LevelChances, rules: Rules) -> str:
    """Name the level of which most changes, which may be a small one; empty without any level."""
    of_levels = chances.changed_by_level
    if not np.isfinite(of_levels).any():
        return ""
    worst = int(np.nanargmax(of_levels))
    return f"; most: {rules.preset.levels[worst].label}, {100 * of_levels[worst]:.1f} %"


def halvings_of(left_open: FloatArray | None, planned: Plan) -> NDArray[np.uint8] | None:
    """Count how often each point's blocks are halved, so that all of them cost the least.

    Neyman (1934): where a stratum adds v/n to the variance, n proportional to the root of v gives
    the least variance of all samples of one size; here to the nearest power of 2, within an eighth
    of the most. ``left_open`` is v of each stratum, shape (n_points, n_scenarios), as the result;
    None if all have the same number.
    """
    if left_open is None or not (left_open > 0.0).any():
        return None
    simulated = np.zeros(left_open.shape, bool)
    for area, scenarios in enumerate(planned.scenarios):
        simulated[np.ix_(planned.points.area == area, scenarios)] = True
    own = left_open[simulated]
    with np.errstate(divide="ignore"):
        steps = 0.5 * np.log2(own.max() / own)
    best, least = None, 1.0
    # The largest value may be chance: points are not halved from somewhat below it on.
    for top in np.arange(0.0, 2.0 * _MOST_HALVINGS, 0.5):
        halved = np.clip(np.rint(steps - top), 0, _MOST_HALVINGS)
        cost = np.mean(0.5**halved) * np.sum(own * 2.0**halved) / own.sum()
        if cost < least - 1e-9:
            best, least = halved, float(cost)
    if best is None:
        return None
    out = np.zeros(left_open.shape, np.uint8)
    out[simulated] = best
    return out


def round_within(
    run: MapRun, planned: Plan, wanted: int, halvings: NDArray[np.uint8] | None, blocks: int
) -> Round | None:
    """Return the next repetition, of at most so many blocks; None if there are too few for one.

    ``wanted`` are the repetitions of points that are not halved.
    """
    first, n = run.repetitions, wanted
    while n > 0:
        own = halvings
        if own is not None:
            # Few repetitions cannot be halved that often.
            most = min(int(math.log2(n)), _MOST_HALVINGS)
            n, own = n >> most << most, np.minimum(own, most).astype(np.uint8)
        more = Round(first, n, own if own is not None and own.any() else None)
        taken = int(planned.blocks_of_round(run, more).sum())
        if taken <= blocks:
            return more
        n = min(n - 1, n * blocks // taken)
    return None


def check_budget(config: Config, run: MapRun, blocks: int) -> None:
    """Raise ConfigError if the budget is below one repetition (``blocks``) or has no effect."""
    budget, release = config.hazard.budget, run.release
    if budget is None:
        return
    at_random = release.placement == "random"
    if at_random or release.rocks_per_point < 2:
        raise ConfigError(
            'does not go with hazard.blocks = "auto"',
            file=config.file,
            field="release.placement" if at_random else "release.rocks_per_point",
            found="random" if at_random else release.rocks_per_point,
            expected="grid: more blocks at the same points say nothing of other points"
            if at_random
            else "2 or more: one block shows nothing of chance",
        )
    if budget.blocks < blocks:
        raise ConfigError(
            "is less than one repetition at each release point",
            file=config.file,
            field="hazard.blocks_max",
            found=budget.blocks,
            expected=f"{blocks} or more, or a smaller release.rocks_per_point",
        )
