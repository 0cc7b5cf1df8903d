"""What each cause leaves behind and no adjustment of the contact can imitate.

A fingerprint is one number per rock (or per group of rocks) whose mean is zero where its cause is
absent. All are tested together by flips of the signs of whole groups, which needs no synthetic
site; the p values are those of the largest among them (Westfall and Young 1993). Before that the
ground and the contact have taken what they can: residuals of impacts are left over from a smooth
function of the state before the impact, ground by ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.inference.rock_tests import max_t_adjusted, t_statistics
from sassgis.gap.observations.campaign import errors_of
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residuals import per_rock
from sassgis.gap.residuals.steps import StepTable
from sassgis.model.grid import FloatArray, IntArray

#: Density of air (kg/m³), and the drag coefficient beyond which it is not air that brakes a rock.
_AIR_KGM3, MOST_DRAG = 1.2, 2.0
#: A fingerprint rests on at least this many rocks or groups.
LEAST = 5
#: Errors of the comparison itself, as a drag coefficient: what is more than that can be seen.
_LEAST_DRAG = 1.0
#: A flight that kept its length to this share was free of anything but air.
_FREE = 0.15
#: Turn of the path that fall lines and straight flights make by themselves (m per m).
_STRAIGHT = 0.06
#: Share of rocks that may be missing, and extra blocks for each rock, that say nothing; blocks
#: lighter than this share of a rock are chips, which do not count.
_FEW_MISSING, _FEW_CHIPS, _CHIP = 0.03, 0.15, 0.005
#: Loss of the energy of a flight, and in standard deviations, from which something was struck.
_STRUCK_SHARE, _STRUCK_SD = 0.15, 3.5
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
    scores: FloatArray  # shape (n_rocks,)
    value: float


_Maker = Callable[[Case, StepTable], list[_Scores]]


def fingerprints(
    case: Case,
    steps: StepTable,
    *,
    rng: np.random.Generator,
    group: IntArray | None = None,
    draws: int = 999,
) -> tuple[Fingerprint, ...]:
    """Test every fingerprint on a table of residuals.

    Parameters
    ----------
    case : Case
    steps : StepTable
    rng : numpy.random.Generator
    group : int64, shape (n_rocks,), optional
        What is resampled together (block, day, source); default: every rock by itself.
    draws : int

    Returns
    -------
    tuple of Fingerprint
        The most certain first; those that cannot be seen last.
    """
    found = [one for make in _MAKERS for one in make(case, steps)]
    cluster = np.arange(case.n_rocks) if group is None else group
    number = np.unique(cluster, return_inverse=True)[1]
    columns = [per_rock(f.scores, number, int(number.max()) + 1) for f in found]
    usable = [f for f, c in zip(found, columns, strict=True) if np.isfinite(c).sum() >= LEAST]
    columns = [c for c in columns if np.isfinite(c).sum() >= LEAST]
    out: list[Fingerprint] = []
    if usable:
        values = np.column_stack(columns)
        z = np.nan_to_num(t_statistics(values), posinf=99.0, neginf=-99.0)
        adjusted = _one_sided(values, z, draws, rng)
        out = [
            Fingerprint(
                f.effect,
                f.statistic,
                f.value,
                float(z[i]),
                float(adjusted[i]),
                True,
                int(np.isfinite(values[:, i]).sum()),
            )
            for i, f in enumerate(usable)
        ]
    seen = {f.effect for f in out}
    for effect, what in STATISTICS.items():
        if effect not in seen:
            out.append(Fingerprint(effect, what, math.nan, math.nan, math.nan, False, 0))
    return tuple(sorted(out, key=lambda f: (not f.observable, f.p_adjusted, -f.z)))


def _one_sided(
    values: FloatArray, z: FloatArray, draws: int, rng: np.random.Generator
) -> FloatArray:
    """P values of the largest z, by flips of the signs of whole groups."""
    signs = rng.choice((-1.0, 1.0), size=(draws, len(values)))
    null = np.array([t_statistics(values * s[:, None]) for s in signs])
    return max_t_adjusted(z, np.nan_to_num(null, nan=-np.inf))


#: What each effect is seen by.
STATISTICS: Mapping[str, str] = {
    "measurement_error": "speeds against the distances between points of the path",
    "release_error": "start, or first impact, against the stated start",
    "air_drag": "energy lost in flight, over path and size, on every flight",
    "trees": "energy lost at once, on few flights",
    "fragmentation": "mass of whole rocks that is missing, and lies in pieces",
    "entrainment": "mass that lies beyond what was released",
    "lateral_deflection": "turn of the heading at impacts, or growth of the lateral offset",
    "soft_ground": "rebound that is lost with the normal speed, on one ground alone",
    "roughness": "scatter of the rebound, the more the smaller the rock",
    "rock_shape": "energy kept, against the flatness of the rock",
    "contact_law": "the same shift of the rebound for all sizes",
}


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


def _measurement(case: Case, steps: StepTable) -> list[_Scores]:
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
    scores = [
        _Scores(
            "measurement_error",
            "speeds against distances in time, all rocks alike",
            sign * ratio - 0.05,
            scale,
        ),
        _Scores(
            "measurement_error",
            "speeds against distances in time, each rock by its own share",
            np.abs(ratio - middle) - (1.0 + _MISSTATED) * usual,
            float(np.nanstd(ratio)),
        ),
    ]
    return scores


def _release(case: Case, steps: StepTable) -> list[_Scores]:
    """Where a rock is at first, against where it is said to have been released."""
    rocks = case.observations.rocks
    n, error = case.n_rocks, errors_of(case)
    off = np.full(n, np.nan)
    usual = (1.0 + _MISSTATED) * error.position_m * math.sqrt(0.5 * math.pi)
    place = {name: i for i, name in enumerate(rocks.rock_id.tolist())}
    names = case.observations.rock_names
    track = case.observations.trajectories
    for rock, rows in _paths(case).items():
        i = place.get(names[rock])
        if i is not None and track.t_s[rows[0]] < 0.05:
            off[rock] = math.hypot(
                float(track.x[rows[0]] - rocks.x[i]), float(track.y[rows[0]] - rocks.y[i])
            )
    found = []
    if np.isfinite(off).sum() >= LEAST:
        found.append(
            _Scores(
                "release_error",
                "first point of the path against the stated start",
                off - usual,
                float(np.nanmean(off)),
            )
        )
    # Offset at the first station, and how it grows from there: an error of the start does not.
    seen = steps.of("run", "lateral_m")
    at = np.full((n, len(case.station_names)), np.nan)
    at[seen.rock, seen.station] = seen.observed
    if at.shape[1] >= 2:
        side = float(seen.sd[0]) if len(seen) else math.nan
        growth = np.nanmax(np.abs(at[:, 1:] - at[:, :1]), axis=1, initial=0.0)
        first = np.abs(at[:, 0]) - np.maximum(growth, 0.8 * (1.0 + _MISSTATED) * side)
        if np.isfinite(first).sum() >= LEAST:
            found.append(
                _Scores(
                    "release_error",
                    "offset at the first station, not growing below",
                    first,
                    float(np.nanmean(np.abs(at[:, 0]))),
                )
            )
    return found


# ---------------------------------------------------------------------------------------------
# Along the way


def _flight(case: Case, steps: StepTable) -> list[_Scores]:
    """Losses in flight: on every flight with path over size (air), at once on few (stems)."""
    rows = steps.of("flight", "energy_jpkg")
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
    middle = float(np.median(loss / rows.sd))
    struck = (share > _STRUCK_SHARE) & (usual - max(middle, 0.0) > _STRUCK_SD)
    found = [
        _Scores(
            "trees",
            STATISTICS["trees"],
            per_rock(struck.astype(np.float64) - 0.01, rows.rock, n),
            float(struck.mean()),
        )
    ]
    if kept.sum() >= 2 * LEAST and drag <= MOST_DRAG:
        left = weight * (loss - _LEAST_DRAG * pull)
        found.append(
            _Scores(
                "air_drag",
                STATISTICS["air_drag"],
                per_rock(np.where(kept, left, np.nan), np.where(kept, rows.rock, -1), n),
                drag,
            )
        )
    return found


def _lateral(case: Case, steps: StepTable) -> list[_Scores]:
    n = case.n_rocks
    rows = steps.of("impact", "turn_deg")
    found = []
    if len(rows) >= LEAST:
        size = np.abs(rows.observed)
        usual = (1.0 + _MISSTATED) * rows.sd * math.sqrt(2.0 / math.pi) + 0.5
        found.append(
            _Scores(
                "lateral_deflection",
                "turn of the heading at impacts",
                per_rock(size - usual, rows.rock, n),
                float(size.mean()),
            )
        )
    rows = steps.of("run", "lateral_m")
    at = np.full((n, len(case.station_names)), np.nan)
    at[rows.rock, rows.station] = rows.observed
    if at.shape[1] >= 2 and not found:
        # Between stations a path leaves its fall line also by flying straight.
        apart = np.diff(case.station_s, axis=1)
        step = np.maximum(np.abs(np.diff(at, axis=1)) - _STRAIGHT * apart, 0.0)
        side = float(rows.sd[0]) if len(rows) else math.nan
        mean = np.nanmean(np.where(np.isfinite(step), step, np.nan), axis=1) if step.size else step
        found.append(
            _Scores(
                "lateral_deflection",
                "growth of the lateral offset between stations",
                mean - 0.8 * math.sqrt(2.0) * (1.0 + _MISSTATED) * side,
                float(np.nanmean(mean)),
            )
        )
    rows = steps.of("stop", "lateral_m")
    if len(rows) and at.shape[1] == 0:
        size = np.abs(rows.observed) - 0.8 * (1.0 + _MISSTATED) * rows.sd
        found.append(
            _Scores(
                "lateral_deflection",
                "lateral offset of stops",
                per_rock(size, rows.rock, n),
                float(np.abs(rows.observed).mean()),
            )
        )
    return found


# ---------------------------------------------------------------------------------------------
# Mass budget


def _masses(case: Case, steps: StepTable) -> list[_Scores]:
    """Mass of the blocks that lie against that of the rocks, whatever they are called.

    Blocks are matched with rocks by their masses alone, the largest first. A rock that finds no
    block of its mass is missing; blocks that find no rock are extra. Pieces are extra mass up to
    what is missing; beyond that, mass came from the slope.
    """
    rows = observed_blocks(case)
    mass = case.mass_kg
    if rows is None or not np.isfinite(mass).all() or not np.isfinite(rows).all():
        return []
    error = 3.0 * math.sqrt(2.0) * errors_of(case).mass_rel * (1.0 + _MISSTATED)
    missing, extra = matched(mass, rows, error)
    gone, loose = float(mass[missing].sum()), float(extra.sum())
    # Pieces can explain a rock that is missing only if their masses are of its order.
    in_pieces = min(1.0, loose / gone) if gone > 0.0 else 0.0
    broken: FloatArray = missing * float(in_pieces) - _FEW_MISSING
    # Of the extra blocks the largest ones may be what is left of missing rocks.
    large = np.sort(extra[extra > _CHIP * float(np.median(mass))])[::-1]
    spare = int((np.cumsum(large) > gone).sum())
    added: FloatArray = (np.arange(case.n_rocks) < spare).astype(np.float64) - _FEW_CHIPS
    return [
        _Scores("fragmentation", STATISTICS["fragmentation"], broken, float(missing.mean())),
        _Scores(
            "entrainment", STATISTICS["entrainment"], added, (loose - gone) / float(mass.sum())
        ),
    ]


def observed_blocks(case: Case) -> FloatArray | None:
    """Masses of all blocks that lie, rocks and others alike (kg); None if none were weighed."""
    table = case.observations.deposits
    if not len(table):
        return None
    mass: FloatArray = np.where(np.isfinite(table.mass_kg), table.mass_kg, 2700.0 * table.volume_m3)
    return mass


def matched(rocks: FloatArray, blocks: FloatArray, error: float) -> tuple[np.ndarray, FloatArray]:
    """Match blocks with rocks by mass.

    Parameters
    ----------
    rocks, blocks : float64
        Masses (kg).
    error : float
        Largest difference of the logarithms of two masses that are the same.

    Returns
    -------
    missing : bool, shape (n_rocks,)
        Rocks without a block of their mass.
    extra : float64
        Masses of blocks without a rock (kg).
    """
    missing = np.ones(rocks.size, bool)
    order = np.argsort(-rocks)
    free = np.sort(blocks)[::-1].tolist()
    extra = []
    k = 0
    for block in free:
        while k < order.size and math.log(rocks[order[k]] / block) > error:
            k += 1
        if k < order.size and abs(math.log(rocks[order[k]] / block)) <= error:
            missing[order[k]] = False
            k += 1
        else:
            extra.append(block)
    return missing, np.array(extra)


# ---------------------------------------------------------------------------------------------
# Contact


def _contact(case: Case, steps: StepTable) -> list[_Scores]:
    """What is left of impacts after a smooth function of the state before them."""
    n = case.n_rocks
    found = []
    normal = steps.of("impact", "normal_speed_mps")
    if len(normal) < 4 * LEAST:
        return []
    for name in ("normal_speed_mps", "tangential_speed_mps", "spin_out_radps"):
        rows = steps.of("impact", name)
        if len(rows) < 4 * LEAST:
            continue
        z = np.clip(rows.z, -4.0, 4.0)
        mean = float(z.mean())
        found.append(
            _Scores(
                "contact_law",
                f"shift of {name.rsplit('_', 1)[0].replace('_', ' ')}",
                per_rock(math.copysign(1.0, mean) * z - 0.15, rows.rock, n),
                mean,
            )
        )
    own = steps.of("impact", "tangential_speed_mps")
    z = np.clip(own.z, -4.0, 4.0)
    left = z - _smooth(own, z)
    flat = own.flatness - own.flatness.mean()
    found.append(
        _Scores(
            "rock_shape",
            STATISTICS["rock_shape"],
            per_rock(left * flat / max(flat.std(), 1e-9), own.rock, n),
            float(np.mean(left * flat) / max(flat.std(), 1e-9)),
        )
    )
    own = normal
    z = np.clip(own.z, -4.0, 4.0)
    left = z - _smooth(own, z)
    scatter = left**2 - 1.0
    found.append(
        _Scores(
            "roughness",
            STATISTICS["roughness"],
            per_rock(scatter - 0.3, own.rock, n),
            float(scatter.mean()),
        )
    )
    # On one yielding ground alone: lost rebound that grows with the normal speed.
    best: _Scores | None = None
    for k in np.unique(own.ground).tolist():
        on = own.ground == k
        if k < 0 or case.table.names[k] in _HARD or on.sum() < 3 * LEAST or on.all():
            continue
        fast = np.log(np.maximum(own.vn_mps, 0.2))
        fast = fast - fast[on].mean()
        elsewhere = float(np.mean(z[~on])) if (~on).any() else 0.0
        score = -(z - elsewhere)
        lost = per_rock(np.where(on, score * np.exp(fast), np.nan), np.where(on, own.rock, -1), n)
        one = _Scores(
            "soft_ground",
            f"lost rebound on {case.table.names[k]} alone",
            lost - 0.3,
            float(np.nanmean(score[on])),
        )
        if best is None or one.value > best.value:
            best = one
    return [*found, *([best] if best else [])]


def _smooth(rows: StepTable, z: FloatArray) -> FloatArray:
    """Mean residual as a smooth function of speed and ground: what a law of contact could do."""
    columns = [np.ones(len(rows)), np.log(np.maximum(rows.vn_mps, 0.2)), rows.predicted / 10.0]
    for k in np.unique(rows.ground).tolist()[1:]:
        columns.append((rows.ground == k).astype(np.float64))
    design = np.column_stack(columns)
    ridge = 1.0 * np.eye(design.shape[1])
    fitted: FloatArray = design @ np.linalg.solve(design.T @ design + ridge, design.T @ z)
    return fitted


_MAKERS: Sequence[_Maker] = (_measurement, _release, _flight, _lateral, _masses, _contact)
