"""Numbers that distinguish campaigns: first one row per rock, then one row per campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.observations.campaign import LOOSE, PIECE, WHOLE, Campaign, ImpactRows, main_blocks
from sassgis.gap.observations.case import Case
from sassgis.model.grid import FloatArray, IntArray

GRAVITY = 9.81
#: Impacts below this speed are too gentle to be distinguished from rolling (m/s).
_GENTLE_MPS = 2.0
#: Share of the energy whose loss between two impacts is a jump: a stem, or rolling.
JUMP = 0.35


@dataclass(frozen=True, slots=True)
class Covariates:
    """What is known of the rocks beforehand, standardised, shape (n_rocks, k); 0 where unknown."""

    names: tuple[str, ...]
    values: FloatArray


def covariates_of(case: Case) -> Covariates:
    """Size, shape and place in the table of each rock."""
    axes = case.semi_axes_m
    columns = {
        "size": np.log(case.radius_m),
        "flatness": np.log(axes[:, 1] / axes[:, 2]),
        "length": np.log(axes[:, 0] / axes[:, 1]),
        "order": np.arange(case.n_rocks, dtype=float),
    }
    values = np.column_stack([_standard(v) for v in columns.values()])
    return Covariates(tuple(columns), values)


def _standard(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    sd = float(np.std(values[known])) if known.sum() > 1 else 0.0
    if sd < 1e-9:
        return np.zeros(values.size)
    return np.where(known, (values - np.mean(values[known])) / sd, 0.0)


def rock_quantities(
    case: Case, sample: Campaign, table: Mapping[str, FloatArray] | None = None
) -> dict[str, FloatArray]:
    """One number per rock and quantity, NaN where there is none.

    Parameters
    ----------
    case : Case
    sample : Campaign
    table : mapping, optional
        ``impact_table`` of the sample, where it has been made already.

    Returns
    -------
    dict of name to float64, shape (n_rocks,)
        "stop:..." of the largest block left, "S<k>:..." of the passage at station k,
        "leg<k>:..." between stations, "hit...:..." of impacts.
    """
    found: dict[str, FloatArray] = {}
    if sample.deposits is not None:
        found |= _stops(sample)
    if sample.passages is not None:
        found |= _passages(case, sample)
    if sample.impacts is not None:
        found |= _impacts(case, sample.impacts, table or impact_table(case, sample.impacts))
    return found


def _stops(sample: Campaign) -> dict[str, FloatArray]:
    rows, n = sample.deposits, sample.n_rocks
    assert rows is not None
    main = main_blocks(rows, n)
    has = main >= 0
    out = {name: np.full(n, np.nan) for name in ("runout", "aside", "mass", "pieces_apart")}
    out["runout"][has] = rows.s[main[has]]
    out["aside"][has] = rows.lateral_m[main[has]]
    out["mass"][has] = rows.mass_kg[main[has]]
    own = rows.rock >= 0
    out["blocks"] = np.bincount(rows.rock[own], minlength=n).astype(np.float64)
    apart = np.zeros(n)
    np.add.at(apart, rows.rock[own], np.abs(rows.s[own] - out["runout"][rows.rock[own]]))
    several = out["blocks"] > 1
    out["pieces_apart"][several] = apart[several] / (out["blocks"][several] - 1)
    return {f"stop:{k}": v for k, v in out.items()}


def _passages(case: Case, sample: Campaign) -> dict[str, FloatArray]:
    rows, n = sample.passages, sample.n_rocks
    assert rows is not None
    out: dict[str, FloatArray] = {}
    radius = case.radius_m
    n_stations = len(case.station_names)
    for k in range(n_stations):
        here = np.flatnonzero((rows.station == k) & (rows.rock >= 0))
        # The heaviest of a rock's blocks represents it.
        here = here[np.argsort(np.nan_to_num(rows.mass_kg[here]), kind="stable")]
        first = np.full(n, -1, np.int64)
        first[rows.rock[here]] = here
        passed = first >= 0

        def column(values: FloatArray, first: IntArray = first, passed=passed) -> FloatArray:  # type: ignore[no-untyped-def]
            filled = np.full(n, np.nan)
            filled[passed] = values[first[passed]]
            return filled

        name = f"S{k}"
        speed, rotation = column(rows.speed_mps), column(rows.rotation_hz)
        out[f"{name}:passed"] = passed.astype(float)
        out[f"{name}:speed"] = np.log(np.maximum(speed, 0.1))
        out[f"{name}:rotation"] = rotation
        out[f"{name}:spin_ratio"] = 2.0 * np.pi * rotation * radius / np.maximum(speed, 0.5)
        out[f"{name}:height"] = column(rows.height_m)
        out[f"{name}:aside"] = column(rows.lateral_m)
        out[f"{name}:mass"] = column(rows.mass_kg)
        pieces = rows.rock[(rows.station == k) & (rows.kind == PIECE) & (rows.rock >= 0)]
        out[f"{name}:pieces"] = np.bincount(pieces, minlength=n).astype(float)
    for k in range(1, n_stations):
        out[f"leg{k}:speed_change"] = out[f"S{k}:speed"] - out[f"S{k - 1}:speed"]
        out[f"leg{k}:turned_aside"] = out[f"S{k}:aside"] - out[f"S{k - 1}:aside"]
        arrived = out[f"S{k}:passed"]
        out[f"leg{k}:passed"] = np.where(out[f"S{k - 1}:passed"] > 0, arrived, np.nan)
    return out


def _impacts(
    case: Case, rows: ImpactRows, table: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    n = case.n_rocks
    out: dict[str, FloatArray] = {"hit:number": np.bincount(rows.rock, minlength=n).astype(float)}
    for key in _TREND_OF:
        values = table[key]
        known = np.isfinite(values)
        out[f"hit:{key}"] = _per_rock(rows.rock[known], values[known], n)
    # Energy given up for each metre of fall, from impact to impact: g for a true time base.
    fall, gain = table["fall"], table["gain"]
    known = np.isfinite(fall) & np.isfinite(gain)
    falls = np.bincount(rows.rock[known], fall[known], minlength=n)
    gains = np.bincount(rows.rock[known], gain[known], minlength=n)
    out["hit:g"] = np.where(falls > 3.0, gains / np.maximum(falls, 3.0), np.nan)
    first = np.full(n, -1, np.int64)
    first[rows.rock[::-1]] = np.arange(rows.rock.size)[::-1]
    has = first >= 0
    for name, values in (("first_s", rows.s), ("first_speed", np.hypot(rows.vt_in, rows.vn_in))):
        column = np.full(n, np.nan)
        column[has] = values[first[has]]
        out[f"hit:{name}"] = column
    return out


def _per_rock(rock: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Mean of values over each rock; NaN of none."""
    count = np.bincount(rock, minlength=n)
    sums = np.bincount(rock, values, minlength=n)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)


def impact_table(case: Case, rows: ImpactRows) -> dict[str, FloatArray]:
    """What each impact did, and what happened between it and the one before.

    Parameters
    ----------
    case : Case
    rows : ImpactRows

    Returns
    -------
    dict of name to float64, shape (n,)
        "leg" (number), "kept" (logarithm of the share of kinetic energy kept), "restitution" (v_n
        after over before), "scatter" (its distance from the median), "along" (v_t after over
        before), "spin_ratio" (ω r / v_t after), "no_spin" (whether it is below a quarter), "turn"
        (degrees, absolute), "lost_between" (share of the energy lost between the impact before and
        this one), "fall", "gain" (m, m²/s²: drop since the impact before and kinetic energy
        gained), "approach", "speed" (m/s).
    """
    axes = case.semi_axes_m
    inertia = 0.2 * (axes[:, 0] ** 2 + axes[:, 1] ** 2)
    scale = case.radius_m / np.cbrt(axes.prod(axis=1))
    inertia = (inertia * scale**2)[rows.rock]
    radius = case.radius_m[rows.rock]
    v2_in = rows.vt_in**2 + rows.vn_in**2
    v2_out = rows.vt_out**2 + rows.vn_out**2
    spin_in = np.where(np.isfinite(rows.spin_in + rows.spin_out), rows.spin_in, 0.0)
    spin_out = np.where(np.isfinite(rows.spin_in + rows.spin_out), rows.spin_out, 0.0)
    before = v2_in + inertia * spin_in**2
    after = v2_out + inertia * spin_out**2
    hard = np.sqrt(v2_in) > _GENTLE_MPS
    with np.errstate(invalid="ignore", divide="ignore"):
        kept = np.where(hard, np.log(np.clip(after / before, 0.01, 2.0)), np.nan)
        approach = np.maximum(-rows.vn_in, 0.3)
        restitution = np.where(hard & (rows.vn_in < -0.5), rows.vn_out / approach, np.nan)
        restitution = np.clip(restitution, -1.0, 4.0)
        along = np.where(
            hard & (rows.vt_in > 1.0), rows.vt_out / np.maximum(rows.vt_in, 0.5), np.nan
        )
        ratio = np.where(
            hard & (rows.vt_out > 1.0),
            rows.spin_out * radius / np.maximum(rows.vt_out, 0.5),
            np.nan,
        )
    same = np.concatenate([[False], rows.rock[1:] == rows.rock[:-1]])
    fall = np.where(same, np.concatenate([[0.0], rows.z[:-1] - rows.z[1:]]), np.nan)
    gain = np.where(same, 0.5 * (v2_in - np.concatenate([[0.0], v2_out[:-1]])), np.nan)
    # Where impacts follow each other slowly, errors of position swamp what is gained.
    gain = np.where(hard, gain, np.nan)
    energy = 0.5 * np.concatenate([[np.nan], v2_out[:-1]]) + np.maximum(GRAVITY * fall, 0.0)
    lost = (GRAVITY * fall - gain) / np.maximum(energy, 2.0)
    return {
        "leg": case.reach_of(rows.rock, rows.s).astype(float),
        "kept": kept,
        "restitution": restitution,
        "scatter": np.abs(restitution - _median(restitution)),
        "along": np.clip(along, -1.0, 3.0),
        "spin_ratio": np.clip(ratio, -2.0, 4.0),
        "no_spin": np.where(np.isfinite(ratio), (ratio < 0.25).astype(float), np.nan),
        "turn": np.where(hard, np.abs(rows.turn_deg), np.nan),
        "lost_between": np.clip(lost, -1.0, 1.0),
        "fall": np.where(hard, fall, np.nan),
        "gain": gain,
        "approach": np.where(hard, np.maximum(-rows.vn_in, 0.0), np.nan),
        "speed": np.where(hard, np.sqrt(v2_in), np.nan),
    }


def summary(
    case: Case, sample: Campaign, given: Covariates
) -> tuple[dict[str, float], dict[str, FloatArray]]:
    """One row of numbers for a campaign.

    Parameters
    ----------
    case : Case
    sample : Campaign
    given : Covariates

    Returns
    -------
    features : dict of name to float
        NaN where a number cannot be had.
    quantities : dict
        As ``rock_quantities`` returns them.
    """
    table = impact_table(case, sample.impacts) if sample.impacts is not None else None
    quantities = rock_quantities(case, sample, table)
    out: dict[str, float] = {}
    names = list(quantities)
    if names:
        values = np.column_stack([quantities[k] for k in names])
        _moments(names, values, given, out)
    if sample.deposits is not None:
        rows = sample.deposits
        loose = rows.kind == LOOSE
        out["loose:number"] = _log_share(float(loose.sum()) / sample.n_rocks)
        out["stop:more_blocks"] = _log_share(float(np.mean(quantities["stop:blocks"])) - 1.0)
        out["stop:none_left"] = _log_share(float(np.mean(quantities["stop:blocks"] < 1)))
        out["loose:s"] = float(np.mean(rows.s[loose])) if loose.any() else np.nan
        out["loose:mass"] = _log_mean(rows.mass_kg[loose])
        pieces = rows.kind == PIECE
        out["pieces:mass"] = _log_mean(rows.mass_kg[pieces])
        lateral = quantities["stop:aside"]
        out |= _lateral_shape("stop", lateral, quantities["stop:runout"], given)
    if sample.passages is not None:
        passed = sample.passages
        for k in range(len(case.station_names)):
            here = passed.station == k
            loose_here = float((here & (passed.kind == LOOSE)).sum()) / sample.n_rocks
            out[f"S{k}:loose"] = _log_share(loose_here)
            pieces_here = float((here & (passed.kind == PIECE)).sum()) / sample.n_rocks
            out[f"S{k}:pieces_per_rock"] = _log_share(pieces_here)
            out |= _lateral_shape(
                f"S{k}", quantities[f"S{k}:aside"], quantities[f"S{k}:speed"], given
            )
            whole = here & (passed.kind == WHOLE)
            out[f"S{k}:whole"] = float(whole.sum()) / max(float((here).sum()), 1.0)
    _links(quantities, out)
    if table is not None and sample.impacts is not None:
        out |= _impact_trends(case, sample.impacts, table, given)
    return out, quantities


def _log_share(share: float) -> float:
    """Numbers per rock on a scale on which few and none are apart."""
    return float(np.log(max(share, 0.0) + 0.02))


def _log_mean(values: FloatArray) -> float:
    known = values[np.isfinite(values) & (values > 0.0)]
    return float(np.log(known).mean()) if known.size else float("nan")


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0


def correlations(y: FloatArray, x: FloatArray) -> FloatArray:
    """Correlations of the columns of ``y`` with those of ``x`` as z values, NaN left out.

    Parameters
    ----------
    y : float64, shape (n, p)
    x : float64, shape (n, q)

    Returns
    -------
    float64, shape (p, q)
        Fisher's z times the root of its degrees of freedom; NaN of fewer than five pairs.
    """
    know_y, know_x = np.isfinite(y), np.isfinite(x)
    # Centred first, so that little is lost in the differences of squares.
    y0 = np.where(know_y, y - _middle(y, know_y), 0.0)
    x0 = np.where(know_x, x - _middle(x, know_x), 0.0)
    ky, kx = know_y.astype(float), know_x.astype(float)
    n = ky.T @ kx
    few = n < 5
    n = np.maximum(n, 1.0)
    sy, sx = y0.T @ kx, ky.T @ x0
    yy = (y0**2).T @ kx - sy**2 / n
    xx = ky.T @ x0**2 - sx**2 / n
    size = np.sqrt(np.maximum(yy, 0.0) * np.maximum(xx, 0.0))
    r = np.where(size > 1e-9, (y0.T @ x0 - sy * sx / n) / np.maximum(size, 1e-9), 0.0)
    z: FloatArray = np.arctanh(np.clip(r, -0.99, 0.99)) * np.sqrt(np.maximum(n - 3.0, 0.0))
    return np.where(few, np.nan, z)


def _middle(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    middle: FloatArray = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return middle


#: Quantities of which only the mean is a feature: counts and shares.
_COUNTS = (":passed", ":number", ":blocks", ":pieces", ":no_spin")
#: Quantities that are given on a scale of their own in ``summary``.
_APART = (":blocks", ":pieces")


def _moments(
    names: list[str], values: FloatArray, given: Covariates, out: dict[str, float]
) -> None:
    """Mean and scatter of every quantity over the rocks, and its trends with what is known."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean = _middle(values, known)
    centred = np.where(known, values - mean, 0.0)
    sd = np.sqrt((centred**2).sum(axis=0) / np.maximum(count - 1, 1))
    z = correlations(values, given.values)
    for i, name in enumerate(names):
        if count[i] and not name.endswith(_APART):
            out[f"{name}|mean"] = float(mean[i])
        if count[i] < 4 or sd[i] < 1e-9:
            continue
        if not name.endswith(_COUNTS):
            out[f"{name}|sd"] = float(np.log(sd[i]))
        for j, other in enumerate(given.names):
            out[f"{name}~{other}"] = float(z[i, j])


def _lateral_shape(
    name: str, lateral: FloatArray, along: FloatArray, given: Covariates
) -> dict[str, float]:
    known = np.isfinite(lateral)
    if known.sum() < 5:
        return {}
    values = np.abs(lateral[known] - np.median(lateral[known]))
    tail = np.sort(values)[int(0.95 * (values.size - 1))]
    out = {
        f"{name}:aside|spread": float(np.log(np.mean(values) + 0.02)),
        f"{name}:aside|tails": float(tail / (np.mean(values) + 0.02)),
    }
    x = np.column_stack([given.values[known], along[known]])
    z = correlations(values[:, None], x)[0]
    for j, other in enumerate((*given.names, "along")):
        out[f"{name}:aside|spread~{other}"] = float(z[j])
    return out


def _links(quantities: Mapping[str, FloatArray], out: dict[str, float]) -> None:
    """How quantities go together: along the path, and at one place."""
    pairs = []
    k = 0
    while f"S{k}:speed" in quantities:
        pairs += [(f"S{k}:speed", f"S{k}:rotation"), (f"S{k}:speed", f"S{k}:height")]
        if "stop:runout" in quantities:
            pairs += [(f"S{k}:speed", "stop:runout"), (f"S{k}:aside", "stop:aside")]
        if k:
            pairs += [
                (f"S{k}:speed", f"S{k - 1}:speed"),
                (f"leg{k}:speed_change", f"S{k - 1}:speed"),
                (f"S{k}:aside", f"S{k - 1}:aside"),
            ]
        k += 1
    names = sorted({name for pair in pairs for name in pair})
    if not names:
        return
    place = {name: i for i, name in enumerate(names)}
    values = np.column_stack([quantities[name] for name in names])
    z = correlations(values, values)
    for one, other in pairs:
        out[f"{one}~{other}"] = float(z[place[one], place[other]])


_TREND_OF = (
    "kept", "restitution", "along", "spin_ratio", "no_spin", "turn", "lost_between", "scatter",
)  # fmt: skip
_TREND_WITH = ("approach", "speed", "size", "flatness")


def _impact_trends(
    case: Case, rows: ImpactRows, table: Mapping[str, FloatArray], given: Covariates
) -> dict[str, float]:
    """Means over impacts and their trends: all together, on each kind of ground, in each reach."""
    ground = case.ground_at(rows.rock, rows.s)[0]
    y = np.column_stack([table[key] for key in _TREND_OF])
    x = np.column_stack(
        [table["approach"], table["speed"], given.values[rows.rock, 0], given.values[rows.rock, 1]]
    )
    out: dict[str, float] = {}
    _group("hit", y, x, out)
    for k in np.unique(case.profiles.ground).tolist():
        mask = ground == k
        _group(f"hit@{case.table.names[k]}", y[mask], x[mask], out)
    for k in range(len(case.reaches)):
        mask = table["leg"] == k
        _group(f"hit{k}", y[mask], None, out)
    return out


def _group(name: str, y: FloatArray, x: FloatArray | None, out: dict[str, float]) -> None:
    known = np.isfinite(y)
    count = known.sum(axis=0)
    mean = _middle(y, known)
    sd = np.sqrt(np.where(known, (y - mean) ** 2, 0.0).sum(axis=0) / np.maximum(count, 1))
    z = correlations(y, x) if x is not None else None
    for i, key in enumerate(_TREND_OF):
        if count[i] < 8:
            continue
        out[f"{name}:{key}|all_mean"] = float(mean[i])
        if key != "no_spin":
            out[f"{name}:{key}|all_sd"] = float(np.log(sd[i] + 1e-3))
        if z is not None:
            for j, other in enumerate(_TREND_WITH):
                out[f"{name}:{key}~{other}"] = float(z[i, j])
    i = _TREND_OF.index("lost_between")
    if count[i] >= 8:
        lost = y[known[:, i], i]
        out[f"{name}:lost_between|jumps"] = float(np.mean(lost > JUMP))
        out[f"{name}:lost_between|small"] = float(np.mean(lost > 0.1))


__all__ = [
    "GRAVITY",
    "JUMP",
    "Covariates",
    "correlations",
    "covariates_of",
    "impact_table",
    "rock_quantities",
    "summary",
]
