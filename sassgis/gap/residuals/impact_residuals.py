"""One impact from an observed state: what the model makes of it, whatever is not observed drawn.

One impact at a time: what the model makes of each observed state before an impact.

Nothing is carried on from one impact to the next, so that an error in the law of impacts shows
where it is made, and no other error shows at all. What is not observed, the orientation of the rock
and the slope that it met, is drawn as the engine draws it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import kernel
from sassgis.engine.draws import block_of, with_outline
from sassgis.engine.effects import hooks
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.ellipse import Records, frame_of
from sassgis.engine.impact import impact
from sassgis.engine.rolling import growth
from sassgis.engine.simulate import physics_of
from sassgis.engine.state import Physics
from sassgis.gap.constants import (
    ALONG_MPS,
    CHORD_M,
    COMPARED_TURNS,
    CONTACT_STEPS,
    FLIGHT_REACH,
    FLIGHT_REACH_M,
    IMPACT_FALL_M,
    LINE_TURN_ERROR,
    REBOUND_DRAWS,
    REBOUND_MPS,
)
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import Case, ImpactRows, errors_of
from sassgis.gap.observations.observed import stated_or
from sassgis.gap.observations.tables import Impacts
from sassgis.gap.residuals.rock_residuals import (
    Residual,
    mean_of_draws,
    only_above,
    per_rock,
    rows_per_rock,
    spread,
)
from sassgis.gap.residuals.stop_residuals import FreeRun
from sassgis.grid import FloatArray, IntArray
from sassgis.terrain.flatten import chainage_to_xy


@kernel
def orientation_at_contact(a: float, b: float, phase: float, vn: float, omega: float) -> float:
    """Return the orientation in which a turning ellipse that comes down first strikes (rad).

    A tumbling rock does not land in every orientation alike: its long axis strikes first. Its
    centre is let down from the height of the longer semi-axis ``a`` (m), where the major axis has
    the angle ``phase`` to the ground, at the normal speed ``vn`` < 0 (m/s), turning with ``omega``
    (rad/s).
    """
    last = (a - b) / -vn
    before = 0.0
    for i in range(1, CONTACT_STEPS + 1):
        t = last * i / CONTACT_STEPS
        angle = phase - omega * t
        _, y, _ = frame_of(a, b, math.sin(angle), math.cos(angle))
        if a + vn * t <= y:
            for _ in range(20):
                middle = 0.5 * (before + t)
                angle = phase - omega * middle
                _, y, _ = frame_of(a, b, math.sin(angle), math.cos(angle))
                if a + vn * middle <= y:
                    t = middle
                else:
                    before = middle
            return phase - omega * t
        before = t
    return phase - omega * last


@kernel
def impact_draws(
    states: FloatArray,
    kinds: IntArray,
    axes: FloatArray,
    draws: FloatArray,
    keys: NDArray[np.uint64],
    density: FloatArray,
    grounds: Records,
    scratch: Records,
    physics: Physics,
    effects: hooks.Effects | None,
    out: FloatArray,
) -> None:
    """Compute what the engine makes of observed states before impacts.

    ``states``: dip of the ground along the travel (rad), v_t, v_n, ω before (m/s, rad/s), (n, 4);
    ``kinds``: ground class, (n,); ``axes``: semi-axes, longest first (m), (n, m, 3); ``draws``:
    phase (rad) and relative variation of the slope, and the orientation at contact (rad), which is
    written, (n, m, 3); ``keys``: for what effects draw, (n, m); ``density`` (kg/m³), (n,); ``out``:
    v_t, v_n, ω after, along the ground as it was surveyed, (n, m, 3), NaN where the model would not
    have the rock rebound but roll.
    """
    state = scratch[0]
    for i in range(states.shape[0]):
        dip, vt, vn, omega = states[i]
        ux, uz, nx, nz = math.cos(dip), -math.sin(dip), math.sin(dip), math.cos(dip)
        ground = grounds[kinds[i]]
        for k in range(axes.shape[1]):
            a, b, c = axes[i, k]
            mass = 4.0 / 3.0 * math.pi * a * b * c * density[i]
            stated = block_of(a, b, c, density[i], mass, keys[i, k])
            block = hooks.on_block(effects, with_outline(stated, physics))
            a, b = block.a, block.b
            out[i, k, :] = np.nan
            low = 2.0 * physics.gravity * nz * ground.rolling_threshold * block.radius
            if vn >= 0.0 or vn * vn < low:
                continue
            theta = orientation_at_contact(a, b, draws[i, k, 0], vn, omega)
            draws[i, k, 2] = theta
            state.impacts = 1
            state.vx, state.vz = vt * ux + vn * nx, vt * uz + vn * nz
            mx, mz = nx, nz
            if physics.slope_variation and dip > 0.0 and vt > 0.0:
                # tan β' = tan β (1 − u), Bozzolo and Pamini (1986), Table 1.
                met = math.atan(math.tan(dip) * (1.0 - draws[i, k, 1]))
                mx, mz = math.sin(met), math.cos(met)
            mx, mz, rule, friction = hooks.on_contact(
                effects, state, block, ground, mx, mz, physics.eta_rule, ground.mu_f
            )
            turn = theta - dip + math.atan2(mx, mz)
            x, y, _ = frame_of(a, b, math.sin(turn), math.cos(turn))
            into = state.vx * mx + state.vz * mz
            wt, wn, spin = impact(
                x, y, block.inertia, state.vx * mz - state.vz * mx, into, omega, ground.eta_max,
                rule, friction, ground.restitution, ground.restitution_speed_mps,
                1.0 - ground.eta_max, growth(block, ground, physics),
            )  # fmt: skip
            wt, wn, spin = hooks.after_impact(effects, state, block, ground, -into, wt, wn, spin)
            vx, vz = wt * mz + wn * mx, wn * mz - wt * mx
            out[i, k, 0] = vx * ux + vz * uz
            out[i, k, 1] = vx * nx + vz * nz
            out[i, k, 2] = spin


def impact_residuals(
    case: Case, run: FreeRun, edges: FloatArray, *, rng: np.random.Generator
) -> list[Residual]:
    """Return residuals of single impacts by reach and by class of ground.

    Where blocks of the model leave the fall line on profiles, turns are left out. ``edges``: limits
    of the reaches (m), (n_reaches, 2).
    """
    impacts = case.observations.impacts
    if not len(impacts):
        return []
    rock = case.observations.whole_of("impacts")
    s = case.projected["impacts"].s
    turn_deg = case.turns(rock, impacts.turn_deg, impacts.vt_out_mps, impacts.vn_out_mps)
    use = usable_impacts(case, run.axes_m)
    turned = (rock >= 0) & (case.line[rock] >= 0) & np.isfinite(s) & np.isfinite(turn_deg)
    found: list[Residual] = []
    if use.any():
        found += _rebounds(case, run, edges, np.flatnonzero(use), rng)
    if turned.any() and (
        case.terrain is not None or run.model.effects.get(LateralDeflection) is None
    ):
        found += _turns(case, edges, rock[turned], s[turned], turn_deg[turned], run.impacts)
    return found


@dataclass(frozen=True, slots=True)
class ImpactsInFlight:
    """Observed impacts after flights, made ready for one step of the model; shape (n,)."""

    impacts: Impacts
    rock: IntArray
    s: FloatArray  # chainage (m)
    kind: IntArray  # class of the ground
    dip: FloatArray  # of the ground along the travel (rad)
    axes: FloatArray  # semi-axes for each draw (m)
    radius: FloatArray  # of the sphere of equal volume (m), mean over the draws
    inertia: FloatArray  # per unit mass (m²), mean over the draws
    spin: FloatArray  # before; that of rolling where none was measured (rad/s)
    has_spin: NDArray[np.bool_]

    def take(self, rows: IntArray) -> ImpactsInFlight:
        """Select some of the rows."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "impacts"}
        chosen = {name: values[rows] for name, values in columns.items()}
        return ImpactsInFlight(self.impacts.take(rows), **chosen)


def all_impacts_in_flight(case: Case, axes_m: FloatArray, m: int) -> ImpactsInFlight | None:
    """Return the usable impacts of a case after a flight, as ``impacts_in_flight`` does."""
    if not len(case.observations.impacts):
        return None
    rows = np.flatnonzero(usable_impacts(case, axes_m))
    return impacts_in_flight(case, axes_m, rows, m) if rows.size else None


def impacts_in_flight(
    case: Case, axes_m: FloatArray, rows: IntArray, m: int
) -> ImpactsInFlight | None:
    """Return impacts after flights among rows of whole rocks with velocities; None without.

    ``axes_m``: semi-axes of each rock, longest first, (n_rocks, k, 3); ``m``: draws of each impact.
    """
    impacts = case.observations.impacts.take(rows)
    rock = case.observations.rock_of("impacts")[rows]
    s = case.projected["impacts"].s[rows]
    kind, dip = case.ground_at(rock, s)
    dip = np.where(np.isfinite(impacts.slope_deg), np.radians(impacts.slope_deg), dip)
    longer, shorter = axes_m[rock, :, 0].mean(axis=1), axes_m[rock, :, 1].mean(axis=1)
    fall = impacts.vn_in_mps**2 / (2.0 * case.engine.gravity_mps2 * np.cos(dip))
    flown = fall > np.maximum(IMPACT_FALL_M, 2.0 * (longer - shorter))
    flown &= _from_flight(impacts, rock, s, dip, case.engine.gravity_mps2)
    if not flown.any():
        return None
    impacts, rock, s, kind, dip = (impacts.take(flown), *(v[flown] for v in (rock, s, kind, dip)))
    axes = np.ascontiguousarray(axes_m[rock][:, np.arange(m) % axes_m.shape[1]])
    radius = np.cbrt(axes.prod(axis=2)).mean(axis=1)
    inertia = 0.2 * (axes[:, :, 0] ** 2 + axes[:, :, 1] ** 2).mean(axis=1)
    has_spin = np.isfinite(impacts.omega_in_radps)
    spin = np.where(has_spin, impacts.omega_in_radps, impacts.vt_in_mps / radius)
    return ImpactsInFlight(
        impacts=impacts, rock=rock, s=s, kind=kind, dip=dip, axes=axes, radius=radius,
        inertia=inertia, spin=spin, has_spin=has_spin,
    )  # fmt: skip


def rebound_draws(
    case: Case, model: HypothesisModel, observed: ImpactsInFlight, rng: np.random.Generator
) -> FloatArray:
    """Return v_t, v_n, ω after impacts, with errors, (n, m, 3); NaN where rocks roll on."""
    impacts, axes = observed.impacts, observed.axes
    settings = case.engine.resolved()
    table = model.table.with_rolling_threshold(settings.rolling_threshold)
    grounds = hooks.ground_of(model.effects, table)
    n, m = axes.shape[:2]
    meta = case.observations.metadata
    speed_error, spin_error = (
        stated_or(own, 0.0) for own in (meta.speed_error_rel, meta.rotation_error_rel)
    )
    errors = (speed_error, math.hypot(spin_error, model.measurement.spin_noise))
    law = grounds[observed.kind]
    drawn = np.empty((n, m, 3))
    drawn[..., 0] = rng.uniform(0.0, math.pi, (n, m))
    low, high = law["dp_min"][:, None], law["dp_max"][:, None]
    drawn[..., 1] = low + (high - low) * rng.uniform(size=(n, m))
    out = np.empty((n, m, 3))
    # Of measurements with a relative error, kept above zero.
    factors = [np.maximum(1.0 + error * rng.standard_normal((n, m)), 0.1) for error in errors]
    impact_draws(
        np.column_stack([observed.dip, impacts.vt_in_mps, impacts.vn_in_mps, observed.spin]),
        observed.kind, axes, drawn, rng.integers(2**64, size=(n, m), dtype=np.uint64),
        np.array([0.5 * sum(case.blocks[i].density_kgm3) for i in observed.rock.tolist()]),
        grounds, np.zeros(1, hooks.BLOCK_DTYPE), physics_of(settings),
        hooks.prepare(model.effects, has_stems=False), out,
    )  # fmt: skip
    out[..., :2] *= factors[0][..., None]
    out[..., 2] *= factors[1]
    return out


def usable_impacts(case: Case, axes_m: FloatArray) -> NDArray[np.bool_]:
    """Return impacts of whole rocks of known size with velocities before and after, row by row."""
    impacts = case.observations.impacts
    rock = case.observations.whole_of("impacts")
    states = impacts.vt_in_mps + impacts.vn_in_mps + impacts.vt_out_mps + impacts.vn_out_mps
    placed = np.isfinite(case.projected["impacts"].s) & (case.line[rock] >= 0)
    has_axes = np.asarray(np.isfinite(axes_m).all(axis=(1, 2)), np.bool_)[rock]
    return (rock >= 0) & placed & has_axes & np.isfinite(states) & (impacts.vn_in_mps < 0.0)


def _rebounds(
    case: Case, run: FreeRun, edges: FloatArray, rows: IntArray, rng: np.random.Generator
) -> list[Residual]:
    observed = impacts_in_flight(case, run.axes_m, rows, REBOUND_DRAWS)
    if observed is None:
        return []
    out = rebound_draws(case, run.model, observed, rng)
    impacts, rock, s = observed.impacts, observed.rock, observed.s
    radius, inertia, spin = observed.radius, observed.inertia, observed.spin
    before = impacts.vt_in_mps**2 + impacts.vn_in_mps**2 + inertia * spin**2
    after = (impacts.vt_out_mps, impacts.vn_out_mps, impacts.omega_out_radps)
    seen = _after_rebound(after, radius, inertia, before)
    seen["energy_kept"] = np.where(observed.has_spin, seen["energy_kept"], np.nan)
    after = (out[..., 0], out[..., 1], out[..., 2])
    drawn = _after_rebound(after, radius[:, None], inertia[:, None], before[:, None])
    columns: list[tuple[str, FloatArray, FloatArray, FloatArray | None]] = [
        (name, seen[name], mean_of_draws(drawn[name], least=3), None) for name in seen
    ]
    angle = "rebound_angle_deg"
    columns.append((f"{angle}_spread", *spread(seen[angle], drawn[angle])))
    found = []
    for place, inside, s0, s1 in (
        *_reach_places(case, edges, rock, s),
        *_ground_places(s, observed.kind, run.model.table.names),
    ):
        for name, value, predicted, score in columns:
            own = np.where(inside & np.isfinite(value) & np.isfinite(predicted), rock, -1)
            mean, by_model = (per_rock(v, own, case.n_rocks) for v in (value, predicted))
            scored = None if score is None else per_rock(score, own, case.n_rocks)
            count = rows_per_rock(value, own, case.n_rocks)
            found.append(
                Residual(
                    place=place, phase="impact", quantity=name, test="one step", observed=mean,
                    predicted=by_model, s0_m=s0, s1_m=s1, score=scored, weight=count,
                    steps=int(count.sum()),
                )
            )  # fmt: skip
    return found


def _after_rebound(
    after: tuple[FloatArray, FloatArray, FloatArray],
    radius: FloatArray,
    inertia: FloatArray,
    before: FloatArray,
) -> dict[str, FloatArray]:
    """Compute the compared quantities of v_t, v_n, ω; ``before``: twice the energy per mass."""
    vt, vn, omega = (np.where(after[1] > REBOUND_MPS, v, np.nan) for v in after)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(vt > ALONG_MPS, radius * omega / vt, np.nan)
    return {
        "tangential_speed_mps": vt,
        "normal_speed_mps": vn,
        "spin_out_radps": omega,
        "energy_kept": (vt**2 + vn**2 + inertia * omega**2) / before,
        "spin_ratio": ratio,
        "rebound_angle_deg": np.degrees(np.arctan2(vn, vt)),
    }


def _from_flight(
    impacts: Impacts, rock: IntArray, s: FloatArray, dip: FloatArray, gravity: float
) -> NDArray[np.bool_]:
    """Return whether a rock can have flown to an impact from the one before: no farther off."""
    order = np.lexsort((s, rock))
    before, after = order[:-1], order[1:]
    fall, rise = gravity * np.cos(dip[before]), np.maximum(impacts.vn_out_mps[before], 0.0)
    time = 2.0 * rise / fall
    along = impacts.vt_out_mps[before] + 0.5 * gravity * np.sin(dip[before]) * time
    reach = FLIGHT_REACH * along * time * np.cos(dip[before]) + FLIGHT_REACH_M
    can = np.ones(s.size, np.bool_)
    can[after] = (rock[before] != rock[after]) | (s[after] - s[before] <= reach)
    return can


def turn_of_lines(case: Case, rock: IntArray, s: FloatArray) -> FloatArray:
    """Return turns at impacts of rocks that fly straight and come down on their fall line (°).

    From the chords of the line before and after, positive to the right; zero at the first and the
    last impact of a rock, and where chords are short.
    """
    turn = np.zeros(s.size)
    order = np.lexsort((s, rock))
    x, y = chainage_to_xy(case.traces, case.line[rock[order]], s[order])
    dx, dy, same = np.diff(x), np.diff(y), np.diff(rock[order]) == 0
    azimuth = np.arctan2(dy, dx)
    known = same & (np.hypot(dx, dy) > CHORD_M)
    both = np.flatnonzero(known[:-1] & known[1:])
    change = np.angle(np.exp(1j * (azimuth[both + 1] - azimuth[both])))
    turn[order[both + 1]] = -np.degrees(change)
    return turn


def turn_error(case: Case, line_turn: FloatArray) -> FloatArray:
    """Return the standard deviation of measured turns about those of the fall lines (°)."""
    return np.hypot(errors_of(case).turn_deg, LINE_TURN_ERROR * line_turn)


def _turns(
    case: Case,
    edges: FloatArray,
    rock: IntArray,
    s: FloatArray,
    turn_deg: FloatArray,
    made: Sequence[ImpactRows],
) -> list[Residual]:
    """Compare turns in plan with those of simulated paths, or of fall lines, on the same reach."""
    n_rocks = case.n_rocks
    line = turn_of_lines(case, rock, s)
    usual = math.sqrt(2.0 / math.pi) * turn_error(case, line)
    reach = [case.reach_of(rows.rock, rows.s) for rows in made]
    found = []
    for k, (place, inside, s0, s1) in enumerate(_reach_places(case, edges, rock, s)):
        of = np.where(inside, rock, -1)
        count = rows_per_rock(turn_deg, of, n_rocks)
        if case.terrain is None:
            away = np.abs(turn_deg - line)
            values = [turn_deg, line, away, usual, away - usual]
        else:
            turns = [rows.turn_deg[at == k] for rows, at in zip(made, reach, strict=True)]
            drawn = np.concatenate([np.empty(0), *turns])
            drawn = drawn[:: max(1, drawn.size // COMPARED_TURNS)]
            draws = np.where(inside[:, None], drawn, np.nan)
            values = [turn_deg, mean_of_draws(draws, least=3), *spread(turn_deg, draws)]
        mean, by_model, size, expected, score = (per_rock(v, of, n_rocks) for v in values)
        turned = Residual(
            place=place, phase="impact", quantity="turn_deg", test="one step", observed=mean,
            predicted=by_model, s0_m=s0, s1_m=s1, weight=count, steps=int(count.sum()),
        )  # fmt: skip
        score = only_above(score) if case.terrain is None else score
        found += [
            turned,
            replace(
                turned, quantity="turn_deg_spread", observed=size, predicted=expected, score=score
            ),
        ]
    return found


def _reach_places(
    case: Case, edges: FloatArray, rock: IntArray, s: FloatArray
) -> Iterator[tuple[str, NDArray[np.bool_], float, float]]:
    """Yield name, rows and limits of each reach."""
    reach = case.reach_of(rock, s)
    for k, name in enumerate(case.reaches):
        yield name, reach == k, float(edges[k, 0]), float(edges[k, 1])


def _ground_places(
    s: FloatArray, kind: IntArray, names: Sequence[str]
) -> Iterator[tuple[str, NDArray[np.bool_], float, float]]:
    """Yield name, rows and limits of each class of ground."""
    for k, name in enumerate(names):
        inside = kind == k
        if inside.any():
            low, high = np.quantile(s[inside], (0.05, 0.95)).tolist()
            yield f"ground:{name}", inside, low, high
