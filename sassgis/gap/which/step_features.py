"""Single steps of motion against what the base model makes of the same step.

From the state before an impact, at the start of a flight or at a station the base model foresees,
on the average, the state after it. What it foresees is learned from its own campaigns by least
squares; what is left over of each step, observed or simulated, shows an effect where it acts, and
not what it has done to the rocks further up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.observations.campaign import Campaign, ImpactRows
from sassgis.gap.observations.case import Case
from sassgis.gap.which.features import GRAVITY, JUMP, Covariates, correlations
from sassgis.model.grid import FloatArray, IntArray

#: Impacts below these speeds, in all and towards the ground, count as rolling (m/s).
_HARD_MPS, _APPROACH_MPS = 3.0, 1.0
#: A flight is what leaves the ground faster than this and goes further than that (m/s, m).
_LEAVING_MPS, _FLOWN_M = 0.5, 1.0
#: Rows below which a regression is not made.
_FEWEST_ROWS = 50

_HIT = ("v", "vt", "vn", "spin", "turn")
_FLIGHT = ("loss", "jump", "spin")
_LEG = ("speed", "spin", "height", "aside", "passed")
_LAST_LEG = ("end", "_", "_", "end_aside", "_")
_OF_ROCKS = ("size", "flat", "long", "order")
#: Shares of rocks or steps: their scatter says nothing that their mean does not.
_SHARES = ("jump", "passed")


@dataclass(frozen=True, slots=True)
class _Rows:
    """Steps of one campaign: what came out, what it depends on, and what trends are sought with.

    ``y`` float64, shape (n, q); ``x`` shape (n, p); ``trend`` shape (n, t); ``rock`` int64 and
    ``s`` float64, shape (n,).
    """

    y: FloatArray
    x: FloatArray
    trend: FloatArray
    rock: IntArray
    s: FloatArray


Coefficients = tuple[FloatArray | None, ...]


@dataclass(frozen=True, slots=True)
class Steps:
    """What the base model foresees of each kind of step.

    Attributes
    ----------
    soft : frozenset of int
        The softer ground classes of the profiles, the lowest third by their greatest restitution.
    hit, flight : tuple of coefficients or None
    leg : mapping of leg to tuple of coefficients
    """

    soft: frozenset[int]
    hit: Coefficients | None
    flight: Coefficients | None
    leg: Mapping[int, Coefficients]


def steps_of(
    case: Case,
    given: Covariates,
    samples: Sequence[Campaign],
    quantities: Sequence[Mapping[str, FloatArray]],
) -> Steps:
    """Learn what the base model foresees from its campaigns.

    Parameters
    ----------
    case : Case
    given : Covariates
    samples : sequence of Campaign
        Campaigns of the base model, its ground calibrated anew in each draw.
    quantities : sequence of dict
        Of each sample, as ``features.rock_quantities`` returns them.
    """
    hit = flight = None
    impacts = [s.impacts for s in samples if s.impacts is not None]
    if impacts:
        hit = _fitted([_hits(case, rows, given) for rows in impacts])
        flight = _fitted([_flights(rows, given) for rows in impacts])
    legs: dict[int, Coefficients] = {}
    if samples and samples[0].passages is not None:
        last = int(samples[0].deposits is not None)
        for k in range(len(case.station_names) + last):
            legs[k] = _fitted([_legs(q, given, k) for q in quantities])
    return Steps(_soft(case), hit, flight, legs)


def step_features(
    case: Case,
    given: Covariates,
    steps: Steps,
    sample: Campaign,
    quantities: Mapping[str, FloatArray],
) -> dict[str, float]:
    """What is left over of the steps of a campaign, in means, scatters and correlations.

    Parameters
    ----------
    case : Case
    given : Covariates
    steps : Steps
    sample : Campaign
    quantities : mapping
        As ``features.rock_quantities`` returns them.

    Returns
    -------
    dict of name to float
        "step_hit:..." and "step_fly:...", also on soft and hard ground and by reach;
        "leg<k>:step:..." of rocks from one station to the next.
    """
    out: dict[str, float] = {}
    if steps.hit is not None and steps.flight is not None and sample.impacts is not None:
        hits = _hits(case, sample.impacts, given)
        _tell_steps(case, "step_hit", hits, steps.hit, steps.soft, _HIT, "approach", out)
        flights = _flights(sample.impacts, given)
        _tell_steps(case, "step_fly", flights, steps.flight, steps.soft, _FLIGHT, "dist", out)
    for k, foreseen in steps.leg.items():
        rows = _legs(quantities, given, k)
        names = _LEG if k < len(case.station_names) else _LAST_LEG
        left = _left_over(rows, foreseen)
        _tell(f"leg{k}:step", left, rows.trend, names, ("speed", *_OF_ROCKS), out, fewest=5)
    return out


def _soft(case: Case) -> frozenset[int]:
    present = np.unique(case.profiles.ground)
    kept = np.array([case.table.classes[k].eta_max for k in present.tolist()], np.float64)
    limit = np.sort(kept)[max(0, present.size // 3 - 1)]
    return frozenset(present[kept <= limit].tolist())


def _hits(case: Case, rows: ImpactRows, given: Covariates) -> _Rows:
    speed = np.hypot(rows.vt_in, rows.vn_in)
    hard = (speed > _HARD_MPS) & (rows.vn_in < -_APPROACH_MPS)
    rock, v = rows.rock[hard], speed[hard]
    r = case.radius_m[rock]
    spin, spin_out = rows.spin_in[hard] * r / v, rows.spin_out[hard] * r / v
    n = rows.vn_in[hard] / v
    after = np.hypot(rows.vt_out, rows.vn_out)[hard]
    y = np.column_stack(
        [
            np.log(np.clip(after / v, 0.05, 2.0)),
            rows.vt_out[hard] / v,
            rows.vn_out[hard] / v,
            spin_out,
            np.abs(rows.turn_deg[hard]),
        ]
    )
    # Where no spin was measured at all it cannot be asked for; single gaps are left out.
    known = spin if np.isfinite(spin).any() else np.zeros_like(spin)
    size, flat, long, order = (given.values[rock, k] for k in range(4))
    log_v = np.log(v)
    x = np.column_stack(
        [
            np.ones_like(v), n, n**2, n**3, known, known**2, known * n, log_v, log_v * n,
            log_v**2, size, flat, long, flat * n, long * n,
        ]
    )  # fmt: skip
    approach = np.log(-rows.vn_in[hard])
    trend = np.column_stack([approach, log_v, size, flat, long, order])
    return _Rows(y, x, trend, rock, rows.s[hard])


def _flights(rows: ImpactRows, given: Covariates) -> _Rows:
    """From one impact to the next, where the rock left the ground."""
    a = np.flatnonzero(rows.rock[1:] == rows.rock[:-1])
    b = a + 1
    leaving = np.hypot(rows.vt_out[a], rows.vn_out[a])
    far = rows.s[b] - rows.s[a]
    fall = rows.z[a] - rows.z[b]
    flew = (leaving > 2.0) & (rows.vn_out[a] > _LEAVING_MPS) & (far > _FLOWN_M) & np.isfinite(fall)
    a, b, leaving, far, fall = a[flew], b[flew], leaving[flew], far[flew], fall[flew]
    arriving = np.hypot(rows.vt_in[b], rows.vn_in[b])
    energy = 0.5 * leaving**2 + GRAVITY * np.maximum(fall, 0.0) + 1.0
    lost = (0.5 * leaving**2 + GRAVITY * fall - 0.5 * arriving**2) / energy
    spins = np.abs(rows.spin_in[b]) / np.maximum(np.abs(rows.spin_out[a]), 0.2)
    loss = np.clip(lost, -0.6, 1.0)
    jump = np.where(np.isfinite(loss), loss > JUMP, np.nan)
    y = np.column_stack([loss, jump, np.log(np.clip(spins, 0.05, 5.0))])
    size, flat, long, order = (given.values[rows.rock[a], k] for k in range(4))
    log_v, log_far, up = np.log(leaving), np.log(far), rows.vn_out[a] / leaving
    steep = fall / (np.maximum(fall, 0.0) + 2.0)
    x = np.column_stack(
        [
            np.ones_like(up), log_v, log_far, up, log_far * log_v, up**2, steep, size, flat, long,
        ]
    )  # fmt: skip
    trend = np.column_stack([log_far, log_v, size, flat, long, order])
    return _Rows(y, x, trend, rows.rock[a], 0.5 * (rows.s[a] + rows.s[b]))


def _legs(quantities: Mapping[str, FloatArray], given: Covariates, k: int) -> _Rows:
    """From a station, or the release for ``k`` of 0, to the next one or to rest."""
    n = given.values.shape[0]
    nothing = np.full(n, np.nan)
    if f"S{k}:speed" in quantities:
        columns = [quantities[f"S{k}:{what}"] for what in ("speed", "spin_ratio", "height")]
        columns += [np.abs(quantities[f"S{k}:aside"]), quantities[f"S{k}:passed"]]
    else:
        lateral = np.abs(quantities["stop:aside"])
        columns = [quantities["stop:runout"], nothing, nothing, lateral, nothing]
    y = np.column_stack(columns)
    size, flat, long, order = (given.values[:, j] for j in range(4))
    x = [np.ones(n), size, flat, long]
    speed = np.zeros(n)
    if k > 0:
        seen = {
            what: quantities[f"S{k - 1}:{what}"]
            for what in ("speed", "spin_ratio", "height", "aside")
        }
        was_there = np.isfinite(seen["speed"])
        y = np.where(was_there[:, None], y, np.nan)
        speed = np.where(was_there, seen["speed"], 0.0)
        spin, height, lateral = (
            seen[what] if np.isfinite(seen[what]).any() else np.zeros(n)
            for what in ("spin_ratio", "height", "aside")
        )
        x = [*x, speed, speed**2, spin, height, np.abs(lateral)]
        x = [np.where(was_there, column, 0.0) for column in x]
    trend = np.column_stack([speed, size, flat, long, order])
    return _Rows(y, np.column_stack(x), trend, np.arange(n, dtype=np.int64), np.zeros(n))


def _fitted(parts: Sequence[_Rows]) -> Coefficients:
    """Least squares of each outcome over the steps of all campaigns; None of too few."""
    x = np.concatenate([p.x for p in parts])
    y = np.concatenate([p.y for p in parts])
    found: list[FloatArray | None] = []
    for column in y.T:
        known = np.isfinite(column) & np.isfinite(x).all(axis=1)
        if known.sum() < _FEWEST_ROWS:
            found.append(None)
            continue
        products = x[known].T @ x[known]
        products[np.diag_indices_from(products)] += 1e-6 * np.trace(products) / len(products)
        found.append(np.linalg.solve(products, x[known].T @ column[known]))
    return tuple(found)


def _left_over(rows: _Rows, foreseen: Coefficients) -> FloatArray:
    nothing = np.full(len(rows.y), np.nan)
    left: FloatArray = np.column_stack(
        [
            nothing if c is None else column - rows.x @ c
            for column, c in zip(rows.y.T, foreseen, strict=True)
        ]
    )
    return left


def _tell_steps(
    case: Case,
    name: str,
    rows: _Rows,
    foreseen: Coefficients,
    soft: frozenset[int],
    outcomes: Sequence[str],
    first_trend: str,
    out: dict[str, float],
) -> None:
    trends = (first_trend, "speed", *_OF_ROCKS)
    left = _left_over(rows, foreseen)
    _tell(name, left, rows.trend, outcomes, trends, out)
    on_soft = np.isin(case.ground_at(rows.rock, rows.s)[0], list(soft))
    for where, mine in (("soft", on_soft), ("hard", ~on_soft)):
        _tell(f"{name}_{where}", left[mine], rows.trend[mine], outcomes, trends, out)
    leg = case.reach_of(rows.rock, rows.s)
    for k in range(len(case.reaches)):
        _tell(f"leg{k}:{name}", left[leg == k], None, outcomes, (), out)


def _tell(
    name: str,
    left: FloatArray,
    trend: FloatArray | None,
    outcomes: Sequence[str],
    trends: Sequence[str],
    out: dict[str, float],
    *,
    fewest: int = 8,
) -> None:
    z = None if trend is None else correlations(left, trend)
    for j, outcome in enumerate(outcomes):
        values = left[:, j]
        values = values[np.isfinite(values)]
        if values.size < fewest:
            continue
        out[f"{name}:{outcome}|mean"] = float(values.mean())
        if outcome not in _SHARES:
            out[f"{name}:{outcome}|sd"] = float(np.log(values.std() + 1e-3))
        if z is not None:
            for i, other in enumerate(trends):
                # Without its degrees of freedom: as strong in ten rocks as in a hundred.
                out[f"{name}:{outcome}~{other}"] = float(z[j, i] / np.sqrt(values.size - 3))
