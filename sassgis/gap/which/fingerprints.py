"""What each cause leaves behind, as numbers whose mean is zero where the cause is absent.

A fingerprint is one number per rock (or per group of rocks); its z is that of the mean over the
groups, with the errors of measurement, of the comparison, and of stated errors that may be wrong
taken off before. No synthetic site is needed for it. The p values are those of Student's t over
groups, adjusted for the number of fingerprints (Holm 1979).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.inference.rock_tests import holm_adjusted, t_statistics
from sassgis.gap.observations.campaign import errors_of
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.free_run import side_error
from sassgis.gap.residuals.residuals import Residual, mean_of_draws, per_rock
from sassgis.gap.residuals.steps import StepTable
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import FloatArray, IntArray

#: Density of air (kg/m³), and the drag coefficient beyond which it is not air that brakes a rock.
_AIR_KGM3, MOST_DRAG = 1.2, 2.0
#: A fingerprint rests on at least this many rocks or groups.
LEAST = 5
#: Errors of the comparison itself, as a drag coefficient: what is more than that can be seen.
_LEAST_DRAG = 0.8
#: A flight that kept its length to this share was free of anything but air.
_FREE = 0.15
#: How far paths leave their fall line by flying straight, where they are still near it (m per m).
_STRAIGHT = 0.02
#: Most distance of a stop below the last station, for its offset to be one of the instruments (m).
_SOON_M = 30.0
#: Least error of a mass, share of the released mass below which nothing is said, and draws of the
#: errors.
_LEAST_MASS_ERROR, _LEAST_MASS, _MASS_DRAWS = 0.02, 0.004, 200
#: Share of the median rock up to which a block is a chip, which says nothing.
_CHIP = 0.01
#: Share of the released mass that must lack before rocks are looked for that left the ground.
_LOST = 0.01
#: Shift, in standard deviations, up to which a comparison may be off by itself; product of
#: neighbouring residuals that restarts from slightly wrong states make.
_SHIFT, _MADE_UP = 0.15, 0.1
#: Loss of the energy of a flight, and in standard deviations, from which something was struck.
_STRUCK_SHARE, _STRUCK_SD = 0.15, 3.5
#: The same far above the ground, in standard deviations, and share of flights that seem so without.
_STRUCK_ALOFT_SD, _SEEM_STRUCK = 5.0, 0.004
#: Errors as they scatter are exceeded by this; median of the size of a standard normal number.
_MORE, _MEDIAN_OF_NORMAL = 1.25, 0.6745
#: Stated errors of measurement may be wrong by this share of themselves.
_MISSTATED = 0.5
#: Time between two points of a path whose distance gives a speed (s), and least speed (m/s).
_LAG_S, _FAST_MPS = 0.5, 5.0
#: Ground on which nothing yields and no block lies loose.
_HARD = ("rock", "asphalt")


@dataclass(frozen=True, slots=True)
class _Scores:
    effect: str
    statistic: str
    scores: FloatArray  # shape (n_rocks,); or (1,): a z that has its own null
    value: float
    #: Chance of each rock to score above zero where the cause is absent, shape (n_rocks,); scores
    #: then are 0 or 1.
    chance: FloatArray | None = None


_Maker = Callable[[Case, ResidualTable], list[_Scores]]


def fingerprints(
    case: Case, residuals: ResidualTable, *, group: IntArray | None = None
) -> tuple[Fingerprint, ...]:
    """Test every fingerprint on the residuals of a case.

    Parameters
    ----------
    case : Case
    residuals : ResidualTable
        Of the calibrated base.
    group : int64, shape (n_rocks,), optional
        What is resampled together (block, day, source); default: every rock by itself.

    Returns
    -------
    tuple of Fingerprint
        The most certain first; those that cannot be seen last.
    """
    cluster = np.arange(case.n_rocks) if group is None else group
    number = np.unique(cluster, return_inverse=True)[1]
    found: dict[str, tuple[_Scores, float, float, int]] = {}
    for one in (f for make in _MAKERS for f in make(case, residuals)):
        z, p, n = _tested(one, number)
        if math.isfinite(z):
            found[one.statistic] = one, z, p, n
    if _SCATTER in found and _TURN in found:
        # The less certain of the two, so that both must be seen.
        least = max((found[_SCATTER], found[_TURN]), key=lambda own: own[2])
        found[_BOTH] = _score(_BOTH, least[0].scores, least[0].value), *least[1:]
    adjusted = holm_adjusted(np.array([p for _, _, p, _ in found.values()]))
    out = [
        Fingerprint(one.effect, name, one.value, z, float(p), True, n)
        for (name, (one, z, _, n)), p in zip(found.items(), adjusted, strict=True)
    ]
    for name, effect in STATISTICS.items():
        if name not in found:
            out.append(Fingerprint(effect, name, math.nan, math.nan, math.nan, False, 0))
    return tuple(sorted(out, key=lambda f: (not f.observable, f.p_adjusted, -f.z)))


def _tested(one: _Scores, group: IntArray) -> tuple[float, float, int]:
    """Z of the mean over groups, one-sided p, and groups that have a value."""
    groups = int(group.max()) + 1
    own_null = one.scores.size == 1
    values = np.zeros(groups) if own_null else per_rock(one.scores, group, groups)
    n = int(np.isfinite(values).sum())
    if n < LEAST:
        return math.nan, math.nan, n
    if one.chance is not None:
        # So few score that their mean is not normal.
        none = np.ones(groups)
        np.multiply.at(none, group, 1.0 - one.chance)
        seem = stats.poisson(float((1.0 - none).sum()))
        hit = int((np.nan_to_num(values) > 0.0).sum())
        p = float(np.clip(seem.sf(hit) + 0.5 * seem.pmf(hit), 1e-30, 1.0 - 1e-9))
        return float(stats.norm.isf(p)), p, n
    if own_null:
        return float(one.scores[0]), float(stats.norm.sf(one.scores[0])), n
    t = float(np.clip(np.nan_to_num(t_statistics(values)[0], posinf=40.0, neginf=-40.0), -40, 40))
    p = float(stats.t.sf(t, n - 1))
    # The normal deviate of the same chance: a t of five rocks is not one of a hundred.
    z = float(np.clip(stats.norm.isf(p), -12.0, 12.0)) if 0.0 < p < 1.0 else math.copysign(12.0, t)
    return z, p, n


#: Rough ground tilts the contact in both directions; what scatters the rebound alone may be edges
#: of the rock.
_SCATTER, _TURN = "scatter of the rebound", "turn of the heading at impacts"
_BOTH = "scatter of the rebound, and turn of the heading"
_GROWTH = "growth of the lateral offset between the first two stations"
_ASIDE = "offset of stops, soon below a station that was passed without"
#: Every fingerprint, and the cause that it speaks for.
STATISTICS: Mapping[str, str] = {
    "speeds against distances in time, all rocks alike": "measurement_error",
    "speeds against distances in time, each rock by its own share": "measurement_error",
    "what is off at one station is made up for at the next": "measurement_error",
    _ASIDE: "measurement_error",
    "first point of the path against the stated start": "release_error",
    "offset at the first station, not growing to the second": "release_error",
    "speed on the first reach, right on the others": "release_error",
    "energy lost in flight, over path and size, on every flight": "air_drag",
    "energy lost at once, on few flights": "trees",
    "energy lost at once, far above the ground": "trees",
    "speed lost on one reach, right on the others": "trees",
    "mass of whole rocks that is missing, and lies in pieces": "fragmentation",
    "mass that lies beyond what was released": "entrainment",
    _TURN: "lateral_deflection",
    _GROWTH: "lateral_deflection",
    "rebound lost with the normal speed, on one ground alone": "soft_ground",
    "large rocks stop early at the foot": "soft_ground",
    _SCATTER: "roughness",
    _BOTH: "roughness",
    "scatter of the rebound, the more the smaller the rock": "roughness",
    "small rocks slow on all reaches": "roughness",
    "rebound against the flatness of the rock": "rock_shape",
    "flat rocks slow and early to stop": "rock_shape",
    "shift of the normal speed after impacts": "contact_law",
    "shift of the tangential speed after impacts": "contact_law",
    "shift of the spin after impacts": "contact_law",
    "shift of the speed on reaches, for all sizes": "contact_law",
    "shift of the height on reaches, for all sizes": "contact_law",
}


def _score(statistic: str, scores: FloatArray, value: float) -> _Scores:
    return _Scores(STATISTICS[statistic], statistic, scores, float(value))


# ---------------------------------------------------------------------------------------------
# Instruments and start


def _paths(case: Case) -> dict[int, IntArray]:
    """Rows of the points of whole rocks by time."""
    track = case.observations.trajectories
    if not len(track):
        return {}
    rock = case.observations.rock_of("trajectories")
    own = (rock >= 0) & ~case.observations.is_piece("trajectories")
    own &= np.isfinite(track.t_s + track.x + track.y + track.z + track.speed_mps)
    order = np.lexsort((track.t_s, rock))
    order = order[own[order]]
    edges = np.flatnonzero(np.diff(rock[order])) + 1
    return {int(rock[rows[0]]): rows for rows in np.split(order, edges) if rows.size}


def _measurement(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Speeds as stated over those from positions and times: their mean, and their scatter."""
    track = case.observations.trajectories
    error = errors_of(case)
    n = case.n_rocks
    ratio, usual = np.full(n, np.nan), np.full(n, np.nan)
    for rock, rows in _paths(case).items():
        t = track.t_s[rows]
        ahead = np.searchsorted(t, t + _LAG_S - 1e-6)
        first = np.flatnonzero(ahead < rows.size)
        last = ahead[first]
        lag = t[last] - t[first]
        way = [getattr(track, c)[rows] for c in "xyz"]
        distance = np.sqrt(sum((c[last] - c[first]) ** 2 for c in way))
        sums = np.concatenate([[0.0], np.cumsum(track.speed_mps[rows])])
        stated = (sums[last + 1] - sums[first]) / (last + 1 - first)
        # A distance of two points with errors is too long by them.
        clean = np.sqrt(np.maximum(distance**2 - 4.0 * error.position_m**2, 1e-6))
        fast = (stated > _FAST_MPS) & (lag < 2.0 * _LAG_S) & (clean > 1.0)
        if fast.sum() >= 5:
            ratio[rock] = np.median(np.log(stated[fast] * lag[fast] / clean[fast]))
            spread = math.hypot(error.speed_rel, 1.5 * error.position_m / np.median(clean[fast]))
            usual[rock] = 2.0 * spread / math.sqrt(float(fast.sum()) / 5.0)
    if np.isfinite(ratio).sum() < LEAST:
        return []
    middle = float(np.nanmedian(ratio))
    scale = np.abs(middle) - 0.05
    sign = math.copysign(1.0, middle)
    return [
        _score(
            "speeds against distances in time, all rocks alike",
            sign * ratio - 0.05,
            scale,
        ),
        _score(
            "speeds against distances in time, each rock by its own share",
            np.abs(ratio - middle) - (1.0 + _MISSTATED) * usual,
            float(np.nanstd(ratio)),
        ),
    ]


def _offsets(case: Case, steps: StepTable) -> tuple[StepTable, FloatArray]:
    """Lateral offsets at stations (m): rows, and the same as shape (n_rocks, n_stations)."""
    rows = steps.of("run", "lateral_m")
    at = np.full((case.n_rocks, len(case.station_names)), np.nan)
    at[rows.rock, rows.station] = rows.observed
    return rows, at


def _usual_offset(case: Case) -> float:
    """Mean size of offsets (m) that errors make, were they larger than stated."""
    return math.sqrt(2.0 / math.pi) * (1.0 + _MISSTATED) * side_error(case)


def _base_size(draws: FloatArray) -> FloatArray:
    """Mean size of what the base makes, shape (n_rocks,); 0 in the plane of a fall line."""
    return np.nan_to_num(mean_of_draws(np.abs(draws), least=1))


def _position_error(case: Case, paths: Mapping[int, IntArray]) -> float:
    """Standard error of a coordinate (m), as stated or, if more, as paths in time scatter.

    Third differences of a flight are those of the errors alone, with variance 20 σ².
    """
    track = case.observations.trajectories
    jumps = [np.abs(np.diff(getattr(track, c)[rows], n=3)) for rows in paths.values() for c in "xy"]
    seen = np.concatenate([np.empty(0), *jumps])
    found = float(np.median(seen)) / (_MEDIAN_OF_NORMAL * math.sqrt(20.0)) if seen.size else 0.0
    return max(found, errors_of(case).position_m)


def _release(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Where a rock is at first, against where it is said to have been released."""
    rocks = case.observations.rocks
    n = case.n_rocks
    off = np.full(n, np.nan)
    place = {name: i for i, name in enumerate(rocks.rock_id.tolist())}
    names = case.observations.rock_names
    track = case.observations.trajectories
    paths = _paths(case)
    usual = _MORE * _position_error(case, paths) * math.sqrt(0.5 * math.pi)
    for rock, rows in paths.items():
        i = place.get(names[rock])
        if i is not None and track.t_s[rows[0]] < 0.05:
            off[rock] = math.hypot(
                float(track.x[rows[0]] - rocks.x[i]), float(track.y[rows[0]] - rocks.y[i])
            )
    found = []
    if np.isfinite(off).sum() >= LEAST:
        found.append(
            _score(
                "first point of the path against the stated start",
                off - usual,
                float(np.nanmean(off)),
            )
        )
    # An error of the start is seen at the first station, and does not grow from there.
    seen, at = _offsets(case, residuals.steps)
    if len(seen) and at.shape[1] >= 2:
        growth = np.abs(at[:, 1] - at[:, 0])
        made = _usual_offset(case) + _base_size(residuals.run.at.lateral_m[:, :, 0])
        found.append(
            _score(
                "offset at the first station, not growing to the second",
                np.abs(at[:, 0]) - np.maximum(growth, made),
                _mean(np.abs(at[:, 0])),
            )
        )
    return found


def _mean(values: FloatArray) -> float:
    """Mean of what is known; NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


# ---------------------------------------------------------------------------------------------
# Along the way


def _flight(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Losses in flight: on every flight with path over size (air), at once on few (stems)."""
    rows = residuals.steps.of("flight", "energy_jpkg")
    if len(rows) < 2 * LEAST:
        return []
    n = case.n_rocks
    mean = 0.5 * (rows.observed + rows.predicted)
    # 3 ρ C v² L/(8 ρ_s r) per unit mass, for C = 1.
    pull = 0.75 * _AIR_KGM3 / (2700.0 * rows.radius_m) * mean * rows.way_m
    loss = rows.predicted - rows.observed
    share = loss / np.maximum(rows.predicted, 1.0)
    usual = loss / rows.sd
    free = np.abs(rows.reach - 1.0) < _FREE
    kept = free & (np.abs(usual - np.median(usual[free] if free.any() else usual)) < 2.5)
    weight = pull / rows.sd**2
    scale = max(float((weight * pull)[kept].sum()), 1e-12)
    drag = float((weight * loss)[kept].sum()) / scale
    middle = float(np.median(usual))
    # Stated errors may be too small: what flights scatter by themselves counts as well.
    scatter = max(float(np.median(np.abs(usual - middle))) / _MEDIAN_OF_NORMAL, 1.0)
    struck = (share > _STRUCK_SHARE) & (usual - max(middle, 0.0) > _STRUCK_SD * scatter)
    found = [
        _score(
            "energy lost at once, on few flights",
            per_rock(struck.astype(np.float64) - 0.01, rows.rock, n),
            float(struck.mean()),
        )
    ]
    if kept.sum() >= 2 * LEAST and drag <= MOST_DRAG:
        left = weight * (loss - _LEAST_DRAG * pull)
        found.append(
            _score(
                "energy lost in flight, over path and size, on every flight",
                per_rock(np.where(kept, left, np.nan), np.where(kept, rows.rock, -1), n),
                drag,
            )
        )
    return found


def _aloft(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Speed lost at one point far above the ground: no contact, and no air."""
    rows = residuals.steps.of("aloft", "energy_jpkg")
    if len(rows) < 2 * LEAST:
        return []
    share = 1.0 - rows.observed / np.maximum(rows.predicted, 1.0)
    struck = (share > _STRUCK_SHARE) & (-rows.z > _STRUCK_ALOFT_SD)
    flights = np.bincount(rows.rock, minlength=case.n_rocks)
    hit = per_rock(struck.astype(np.float64), rows.rock, case.n_rocks) > 0.0
    name = "energy lost at once, far above the ground"
    scores = np.where(flights > 0, hit.astype(np.float64), np.nan)
    chance: FloatArray = 1.0 - np.power(1.0 - _SEEM_STRUCK, flights)
    return [replace(_score(name, scores, float(struck.mean())), chance=chance)]


def _lateral(case: Case, residuals: ResidualTable) -> list[_Scores]:
    n, steps = case.n_rocks, residuals.steps
    rows = steps.of("impact", "turn_deg")
    found = []
    if len(rows) >= LEAST:
        size = np.abs(rows.observed - rows.predicted)
        usual = (1.0 + _MISSTATED) * rows.sd * math.sqrt(2.0 / math.pi) + 0.5
        usual = usual + residuals.run.turn_deg[rows.rock]
        found.append(
            _score(
                _TURN,
                per_rock(size - usual, rows.rock, n),
                float(size.mean()),
            )
        )
    rows, at = _offsets(case, steps)
    if len(rows) and at.shape[1] >= 2:
        # Further down fall lines part, and offsets grow by themselves.
        growth = np.abs(at[:, 1] - at[:, 0])
        apart = case.station_s[:, 1] - case.station_s[:, 0]
        made = residuals.run.at.lateral_m
        usual = _usual_offset(case) + _base_size(made[:, :, 1] - made[:, :, 0])
        if case.terrain is None:
            usual = usual + _STRAIGHT * apart
        found.append(_score(_GROWTH, growth - usual, _mean(growth)))
    return found


def _aside(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Offset of stops where the rock was on its fall line shortly before."""
    rows = residuals.steps.of("stop", "lateral_m")
    _, at = _offsets(case, residuals.steps)
    if not len(rows) or not at.shape[1]:
        return []
    passed = np.isfinite(at[rows.rock])
    last = at.shape[1] - 1 - np.argmax(passed[:, ::-1], axis=1)
    beyond = rows.way_m - case.station_s[rows.rock, last]
    near = passed.any(axis=1) & (beyond < _SOON_M)
    near &= np.abs(at[rows.rock, last]) < 0.5 * side_error(case)
    run = residuals.run
    made = run.ends.lateral_m[rows.rock] - run.at.lateral_m[rows.rock, :, last]
    usual = _usual_offset(case) + _base_size(made)
    if case.terrain is None:
        usual = usual + _STRAIGHT * np.maximum(beyond, 0.0)
    size = np.where(near, np.abs(rows.observed) - usual, np.nan)
    return [_score(_ASIDE, per_rock(size, rows.rock, case.n_rocks), _mean(size + usual))]


# ---------------------------------------------------------------------------------------------
# Mass budget


def _masses(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Mass of the blocks that lie against that of the rocks, whatever they are called.

    Rocks and blocks are ranked by mass. Where rocks broke the blocks of their ranks are too light,
    and what they lack lies in blocks beyond the number of rocks. Where blocks were set off there is
    more mass than came down. The null is that of the errors of the masses alone.
    """
    blocks, rocks = observed_blocks(case), case.mass_kg
    if blocks is None or not np.isfinite(rocks).all() or not np.isfinite(blocks).all():
        return []
    blocks = blocks[blocks > _CHIP * np.median(rocks)]
    if blocks.sum() < (1.0 - _LOST) * rocks.sum():
        rocks = rocks[~_gone(case)]
    if rocks.size < LEAST:
        return []
    error = max(errors_of(case).mass_rel * (1.0 + _MISSTATED), _LEAST_MASS_ERROR)
    rng = np.random.default_rng(1986)
    drawn = rocks * np.exp(error * rng.standard_normal((_MASS_DRAWS, rocks.size)))
    null = np.array([mass_budget(rocks, one) for one in drawn])
    middle, spread = null.mean(axis=0), null.std(axis=0) + _LEAST_MASS
    value = mass_budget(rocks, blocks)
    z = np.clip((np.array(value) - middle) / spread, -12.0, 12.0)
    return [
        _score("mass of whole rocks that is missing, and lies in pieces", z[:1], value[0]),
        _score("mass that lies beyond what was released", z[1:], value[1]),
    ]


def observed_blocks(case: Case) -> FloatArray | None:
    """Masses of all blocks that lie, rocks and others alike (kg); None if none were weighed."""
    table = case.observations.deposits
    if not len(table):
        return None
    mass: FloatArray = np.where(np.isfinite(table.mass_kg), table.mass_kg, 2700.0 * table.volume_m3)
    return mass


def _gone(case: Case) -> NDArray[np.bool_]:
    """Rocks that passed the last station whole and lie nowhere: they left the surveyed ground."""
    gone = np.zeros(case.n_rocks, bool)
    seen = case.observations
    if not case.station_names or not len(seen.passages):
        return gone
    tolerance = 3.0 * math.sqrt(2.0) * max(errors_of(case).mass_rel, _LEAST_MASS_ERROR)

    def whole(table: str, mass: FloatArray) -> IntArray:
        rock = seen.rock_of(table)
        with np.errstate(invalid="ignore", divide="ignore"):
            same = np.abs(np.log(mass / case.mass_kg[np.maximum(rock, 0)])) < tolerance
        return np.where((rock >= 0) & (same | ~np.isfinite(mass)), rock, -1)

    last = seen.passages.station == case.station_names[-1]
    passed = whole("passages", seen.passages.mass_kg)[last]
    lying = whole("deposits", seen.deposits.mass_kg)
    gone[passed[passed >= 0]] = True
    gone[lying[lying >= 0]] = False
    return gone


def mass_budget(rocks: FloatArray, blocks: FloatArray) -> tuple[float, float]:
    """Shares of the released mass that are missing and lie in pieces, and that came in addition.

    Parameters
    ----------
    rocks, blocks : float64
        Masses (kg), in any order.
    """
    if blocks.size <= rocks.size:
        return 0.0, 0.0
    n, total = rocks.size, float(rocks.sum())
    released, lying = np.sort(rocks)[::-1], np.sort(blocks)[::-1]
    lacking = float(np.maximum(released - lying[:n], 0.0).sum())
    more = float(blocks.sum()) - total
    # Of rocks that were not found the ranks lack as much as all blocks together. Five chips of a
    # kilogram are no pieces of them.
    broken = max(lacking - max(-more, 0.0), min(lacking, float(lying[n:].sum())))
    return broken / total, more / total


# ---------------------------------------------------------------------------------------------
# Contact


def _contact(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """What is left of impacts after a smooth function of the state before them."""
    n, steps = case.n_rocks, residuals.steps
    normal = steps.of("impact", "normal_speed_mps")
    if len(normal) < 4 * LEAST:
        return []
    found = []
    for quantity, name in (
        ("normal_speed_mps", "normal speed"),
        ("tangential_speed_mps", "tangential speed"),
        ("spin_out_radps", "spin"),
    ):
        rows = steps.of("impact", quantity)
        if len(rows) < 4 * LEAST:
            continue
        z = np.clip(rows.z, -4.0, 4.0)
        mean = float(z.mean())
        shifted = math.copysign(1.0, mean) * z - _SHIFT
        found.append(
            _score(f"shift of the {name} after impacts", per_rock(shifted, rows.rock, n), mean)
        )
    along = steps.of("impact", "tangential_speed_mps")
    z = np.clip(along.z, -4.0, 4.0)
    flat = _standardised(along.flatness)
    left = (z - _smooth(along, z)) * flat
    found.append(
        _score(
            "rebound against the flatness of the rock", per_rock(left, along.rock, n), left.mean()
        )
    )
    z = np.clip(normal.z, -4.0, 4.0)
    left = z - _smooth(normal, z)
    scatter = left**2 - 1.0
    small = -_standardised(np.log(normal.radius_m))
    found += [
        _score(_SCATTER, per_rock(scatter - 0.3, normal.rock, n), scatter.mean()),
        _score(
            "scatter of the rebound, the more the smaller the rock",
            per_rock((left**2 - np.mean(left**2)) * small, normal.rock, n),
            float(np.mean(left**2 * small)),
        ),
    ]
    return [*found, *_softer(case, normal, z)]


def _softer(case: Case, normal: StepTable, z: FloatArray) -> list[_Scores]:
    """On one yielding ground alone: lost rebound that grows with the normal speed."""
    best: _Scores | None = None
    for k in np.unique(normal.ground).tolist():
        on = normal.ground == k
        if k < 0 or case.table.names[k] in _HARD or on.sum() < 3 * LEAST or on.all():
            continue
        fast = np.log(np.maximum(normal.vn_mps, 0.2))
        score = -(z - float(np.mean(z[~on]))) * np.exp(fast - fast[on].mean())
        own = np.where(on, normal.rock, -1)
        lost = per_rock(np.where(on, score, np.nan), own, case.n_rocks) - 0.3
        one = _score(
            "rebound lost with the normal speed, on one ground alone", lost, score[on].mean()
        )
        if best is None or np.nan_to_num(t_statistics(one.scores)[0]) > np.nan_to_num(
            t_statistics(best.scores)[0]
        ):
            best = one
    return [best] if best else []


def _standardised(values: FloatArray) -> FloatArray:
    spread = float(np.nanstd(values))
    result: FloatArray = (values - np.nanmean(values)) / spread if spread > 0.0 else 0.0 * values
    return result


def _smooth(rows: StepTable, z: FloatArray) -> FloatArray:
    """Mean residual as a smooth function of speed and ground: what a law of contact could do."""
    columns = [np.ones(len(rows)), np.log(np.maximum(rows.vn_mps, 0.2)), rows.predicted / 10.0]
    for k in np.unique(rows.ground).tolist()[1:]:
        columns.append((rows.ground == k).astype(np.float64))
    design = np.column_stack(columns)
    ridge = 1.0 * np.eye(design.shape[1])
    fitted: FloatArray = design @ np.linalg.solve(design.T @ design + ridge, design.T @ z)
    return fitted


# ---------------------------------------------------------------------------------------------
# Reaches


def _reaches(case: Case, residuals: ResidualTable) -> list[_Scores]:
    """Runs that start again at each station: what they lack there, and on which rocks."""
    legs = [r for r in residuals.rows if r.test == "reach" and r.phase != "release"]
    # Relative, so that fast reaches do not outweigh the others.
    speed = _table(legs, "speed_mps", relative=True)
    height = _table(legs, "height_m", relative=False)
    foot = _table(legs, "runout_m", relative=False)
    size = _standardised(np.log(residuals.run.radius_m))
    axes = residuals.run.axes_m.mean(axis=1)
    flat = -_standardised(axes[:, 2] / np.sqrt(axes[:, 0] * axes[:, 1]))
    found: list[_Scores] = []
    if speed.shape[1]:
        own = speed / np.maximum(np.nanstd(speed, axis=0), 0.05)
        mean = mean_of_draws(own, least=1)
        slow = mean_of_draws(own - np.nanmean(own, axis=0), least=1) * size
        shift = float(np.nanmean(speed))
        found += [
            _score(
                "shift of the speed on reaches, for all sizes",
                math.copysign(1.0, shift) * mean - _SHIFT,
                shift,
            ),
            _score(
                "small rocks slow on all reaches",
                slow,
                float(np.nanmean(slow)),
            ),
        ]
        found += _one_reach(own, size)
        found += _made_up(speed)
    if height.shape[1]:
        own = height / np.maximum(np.nanstd(height, axis=0), 0.05)
        shift = float(np.nanmean(own))
        found.append(
            _score(
                "shift of the height on reaches, for all sizes",
                math.copysign(1.0, shift) * mean_of_draws(own, least=1) - _SHIFT,
                shift,
            )
        )
    both = [t / np.maximum(np.nanstd(t, axis=0), 1e-3) for t in (speed, foot) if t.shape[1]]
    # Stops alone say nothing of the shape: flat rocks are also those that start or break otherwise.
    if speed.shape[1]:
        all_ = np.column_stack(both)
        late = mean_of_draws(all_ - np.nanmean(all_, axis=0), least=1)
        found.append(
            _score(
                "flat rocks slow and early to stop", -late * flat, float(-np.nanmean(late * flat))
            )
        )
    if foot.shape[1]:
        late = mean_of_draws(foot / np.maximum(np.nanstd(foot, axis=0), 1.0), least=1)
        late = (late - np.nanmean(late)) * size
        found.append(_score("large rocks stop early at the foot", -late, float(-np.nanmean(late))))
    return found


def _table(rows: Sequence[Residual], quantity: str, *, relative: bool) -> FloatArray:
    """Gaps of one quantity, shape (n_rocks, n_reaches), where enough rocks have one."""
    own = [r for r in rows if r.quantity == quantity]
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = [r.gap / r.predicted if relative else r.gap for r in own]
    columns = [np.clip(c, -2.0, 2.0) if relative else c for c in columns]
    columns = [c for c in columns if np.isfinite(c).sum() >= LEAST]
    return np.column_stack(columns) if columns else np.zeros((0, 0))


def _one_reach(speed: FloatArray, size: FloatArray) -> list[_Scores]:
    """Speed that is lost on one reach alone; the first is that of the release."""
    if speed.shape[1] < 2:
        return []
    found = []
    best: tuple[float, FloatArray] | None = None
    for k in range(speed.shape[1]):
        others = mean_of_draws(np.delete(speed, k, axis=1), least=1)
        contrast = speed[:, k] - others
        if k == 0:
            sign = math.copysign(1.0, float(np.nanmean(contrast)))
            found.append(
                _score(
                    "speed on the first reach, right on the others",
                    sign * contrast - _SHIFT,
                    float(np.nanmean(contrast)),
                )
            )
            continue
        t = float(np.nan_to_num(t_statistics(-contrast)[0]))
        if best is None or t > best[0]:
            best = t, -contrast - _SHIFT
    if best is not None:
        value = float(np.nanmean(best[1]))
        found.append(_score("speed lost on one reach, right on the others", best[1], value))
    return found


def _made_up(gap: FloatArray) -> list[_Scores]:
    """An error of the measurement at a station is one of the start of the next reach as well."""
    if gap.shape[1] < 2:
        return []
    own = gap - np.nanmean(gap, axis=0)
    own = own / np.maximum(np.nanstd(own, axis=0), 0.02)
    product = mean_of_draws(-own[:, :-1] * own[:, 1:], least=1)
    return [
        _score(
            "what is off at one station is made up for at the next",
            product - _MADE_UP,
            float(np.nanmean(product)),
        )
    ]


_MAKERS: Sequence[_Maker] = (
    _measurement,
    _release,
    _flight,
    _aloft,
    _lateral,
    _aside,
    _masses,
    _contact,
    _reaches,
)
