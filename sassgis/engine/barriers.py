"""Motion of a block at stations and barriers."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.compiled.jit import inlined, kernel, lean
from sassgis.engine.ellipse import CountedRows, Record
from sassgis.engine.fork import keep_fork
from sassgis.engine.profile import segment_at
from sassgis.engine.resistance import share_gained
from sassgis.engine.roofs import move_over_roof, roof_landing
from sassgis.engine.state import (
    BARRIER,
    CROSSING_DTYPE,
    FLIGHT,
    Block,
    Output,
    Physics,
    Site,
    end,
)
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.results import Outcome

PASSED, STOPPED, OVERTOPPED, BROKE_THROUGH, HELD_BY_NET, ON_ROOF = map(int, Outcome)

# Kinds of control line: no barrier, one that stops for good, one after which a block moves on from
# rest.
STATION, STOPS, RESTARTS = 0, 1, 2


class Meeting(NamedTuple):
    """The barrier that ends a flight or a stretch on the ground, or several at one place."""

    line: int  # position in the crossings, of the last of them; -1 for none
    when: float  # time of the flight (s), or share of the stretch
    outcome: int
    speed_left: float  # share of the speed


@lean
def no_meeting() -> Meeting:
    """Return the meeting that represents no barrier."""
    return Meeting(-1, np.inf, PASSED, 1.0)


class ControlLineTable(NamedTuple):
    """Stations and barriers of the run."""

    kind: IntArray
    height: FloatArray  # (m)
    capacity: FloatArray  # (J)
    width: FloatArray  # of the roof of a gallery (m); else 0
    slope: FloatArray  # of that roof, falling (tangent)


@inlined
def set_line(crossing: Record, lines: ControlLineTable, number: int) -> None:
    """Write into a crossing which line it is of, and what that is."""
    crossing.number = number
    crossing.kind = lines.kind[number]
    crossing.height = lines.height[number]
    crossing.capacity = lines.capacity[number]
    crossing.width = lines.width[number]
    crossing.slope = lines.slope[number]


@kernel
def crossings_of(
    profile: CountedRows, chainage: FloatArray, number: IntArray, lines: ControlLineTable
) -> CountedRows:
    """Return stations and barriers on a profile (CROSSING_DTYPE).

    ``chainage`` (m) rises; ``number`` is the position of each in ``lines``.
    """
    rows = np.zeros(chainage.size, CROSSING_DTYPE)
    n = profile.n[0]
    for i in range(chainage.size):
        x = chainage[i]
        j = 0
        while j < n - 1 and profile.rows[j + 1].x <= x:
            j += 1
        under = profile.rows[j]
        row = rows[i]
        row.x = x
        row.z = under.z + (x - under.x) * under.tz / under.tx
        set_line(row, lines, number[i])
    return CountedRows(rows, np.full(1, chainage.size, np.int64))


@lean
def _write_passage(
    state: Record, output: Output, block: Block, crossings: CountedRows, crossing: Record,
    outcome: int, vx: float, vz: float, omega: float, height: float, into_roof: float,
) -> None:  # fmt: skip
    """Write the passage of a block where it first comes to a control line.

    ``into_roof`` is the speed at which it lands on a roof (m/s); 0: it does not.
    """
    for i in range(crossings.n[0]):
        # A line that is crossed twice acts twice, but is passed once.
        if crossings.rows[i].number == crossing.number:
            crossings.rows[i].seen = True
    row = output.passages[state.n_passages]
    row.control_line = crossing.number
    row.outcome = outcome
    row.chainage_m = crossing.x
    row.speed_mps = math.sqrt(vx * vx + vz * vz)
    row.vx_mps = vx
    row.vz_mps = vz
    row.rotation_hz = abs(omega) / (2.0 * math.pi)
    row.height_m = height
    row.energy_trans_kj = 0.5e-3 * block.mass * (vx * vx + vz * vz)
    row.energy_rot_kj = 0.5e-3 * block.mass * block.inertia * omega * omega
    row.roof_energy_kj = 0.5e-3 * block.mass * into_roof * into_roof
    row.roof_left_kj = 0.0
    row.mass_kg = block.mass
    # In cells: the driver knows where these lie.
    row.x_m = state.from_u + (crossing.x - state.from_x) * state.du
    row.y_m = state.from_v + (crossing.x - state.from_x) * state.dv
    state.n_passages += 1


@lean
def _at_barrier(crossing: Record, energy: float) -> tuple[int, float]:
    """Return the outcome of a block at a barrier, and the remaining share of its speed."""
    if energy > crossing.capacity:
        return BROKE_THROUGH, math.sqrt(1.0 - crossing.capacity / energy)
    if crossing.kind == RESTARTS:
        return HELD_BY_NET, 0.0
    return STOPPED, 0.0


@lean
def _over_top(
    crossing: Record, height: float, vx: float, vz: float, gravity: float
) -> tuple[int, float]:
    """Return the outcome of a block over a barrier, and its speed into a gallery's roof (m/s).

    ``height`` is the passing height (m); one that goes uphill meets no roof.
    """
    if crossing.width > 0.0 and vx > 0.0:
        above = max(height - crossing.height, 0.0)
        landing = roof_landing(above, vx, vz, crossing.slope, gravity)
        if landing.distance <= crossing.width:
            return ON_ROOF, landing.into
    return OVERTOPPED, 0.0


@lean
def _is_behind(crossings: CountedRows, met: Meeting, crossing: Record) -> bool:
    """Return whether a barrier met lies before a control line, which is then not reached.

    The remaining speed goes on to all lines at the same place. One that is stopped comes to the
    stations there, but to no other barrier.
    """
    if met.line < 0:
        return False
    here = crossings.rows[met.line].x == crossing.x
    return not here or (met.outcome == STOPPED and crossing.kind != STATION)


@lean
def _met_too(met: Meeting, line: int, when: float, outcome: int, left: float) -> Meeting:
    """Add one more control line at the same place, and the share of the speed that remains.

    A block that breaks through a net at the edge of a roof lands on that roof all the same.
    """
    if outcome in (PASSED, OVERTOPPED):
        return met
    if met.outcome == ON_ROOF and outcome == BROKE_THROUGH:
        return Meeting(met.line, when, ON_ROOF, met.speed_left * left)
    return Meeting(line, when, outcome, met.speed_left * left)


@inlined
def _comes_to(state: Record, crossing: Record, x_end: float, forward: bool) -> bool:
    """Return whether a block on its way to a chainage (m) comes to a control line.

    A block that was moved back may turn before it is back where lines were checked. Chainages along
    the new heading differ, and a line that it has not passed is then ahead.
    """
    if not forward:
        return bool(x_end <= crossing.x < state.lines_from)
    begin = state.lines_from if crossing.seen else min(state.lines_from, state.x)
    return bool(begin < crossing.x <= x_end)


@lean
def passing_height(block: Block, site: Site, crossing: Record, near: int, z: float) -> float:
    """Return the passing height (m) of a block whose centre is at height z (m) at a line."""
    here = site.profile.rows[segment_at(site.profile, crossing.x, near)]
    return float(max(z - crossing.z - block.b / here.tx, 0.0))


@lean
def control_lines_in_flight(
    state: Record, block: Block, site: Site, output: Output, gravity: float, until: float
) -> Meeting:
    """Return the stations and barriers that a flight of duration ``until`` (s) comes to, before it.

    Passages are written.
    """
    vx = state.vx
    if vx == 0.0:
        return no_meeting()
    crossings = site.crossings
    n = crossings.n[0]
    x_end = state.x + vx * until
    forward = vx > 0.0
    met = no_meeting()
    n_passages = state.n_passages
    for k in range(n):
        i = k if forward else n - 1 - k
        crossing = crossings.rows[i]
        line_x = crossing.x
        if not _comes_to(state, crossing, x_end, forward) or _is_behind(crossings, met, crossing):
            continue
        kept = met.speed_left
        t = max((line_x - state.x) / vx, 0.0)
        wz = state.vz - gravity * t
        z = state.z + (state.vz - 0.5 * gravity * t) * t
        outcome = PASSED
        left = 1.0
        into_roof = 0.0
        height = passing_height(block, site, crossing, state.segment, z)
        if crossing.kind != STATION and not state.meets_none:
            angle = state.theta - state.omega * t
            down = math.sqrt((block.a * math.sin(angle)) ** 2 + (block.b * math.cos(angle)) ** 2)
            if crossing.height > 0.0 and z - down < crossing.z + crossing.height:
                spin = block.inertia * state.omega * state.omega
                energy = 0.5 * block.mass * (vx * vx + wz * wz + spin)
                outcome, left = _at_barrier(crossing, kept * kept * energy)
            else:
                outcome, into_roof = _over_top(crossing, height, kept * vx, kept * wz, gravity)
        if forward and not crossing.seen:
            _write_passage(
                state, output, block, crossings, crossing, outcome, kept * vx, kept * wz,
                kept * state.omega, height, into_roof
            )  # fmt: skip
        met = _met_too(met, i, t, outcome, left)
    if met.line >= 0:
        keep_fork(state, site, output, n_passages)
    return met


class Stretch(NamedTuple):
    """A stretch of rolling or sliding, and what squares of speeds gain over it."""

    x: float
    x_end: float
    speed2: float  # at its start (m²/s²)
    gain: float  # over the whole stretch
    spin2: float  # (rad²/s²)
    spin_gain: float
    fading: float  # as resistance.share_gained takes it


@inlined
def up_to(stretch: Stretch, x: float, share: float) -> Stretch:
    """Return the first share of a stretch, which ends at chainage x (m)."""
    gained = share_gained(share, stretch.fading)
    return Stretch(
        stretch.x, x, stretch.speed2, stretch.gain * gained, stretch.spin2,
        stretch.spin_gain * gained, stretch.fading * share
    )  # fmt: skip


@lean
def control_lines_on_ground(
    state: Record, block: Block, site: Site, output: Output, stretch: Stretch, ux: float, uz: float,
    gravity: float,
) -> Meeting:  # fmt: skip
    """Return the stations and barriers that a stretch in the direction (ux, uz) comes to.

    Passages are written.
    """
    crossings = site.crossings
    n = crossings.n[0]
    forward = state.direction > 0
    x = stretch.x
    x_end = stretch.x_end
    chord = abs(x_end - x)
    met = no_meeting()
    n_passages = state.n_passages
    for k in range(n):
        i = k if forward else n - 1 - k
        crossing = crossings.rows[i]
        line_x = crossing.x
        if not _comes_to(state, crossing, x_end, forward) or _is_behind(crossings, met, crossing):
            continue
        kept = met.speed_left
        share = 0.0
        if chord > 0.0:
            share = min(max((line_x - x) / (x_end - x), 0.0), 1.0)
        done = share_gained(share, stretch.fading)
        speed2 = max(stretch.speed2 + stretch.gain * done, 0.0)
        spin2 = max(stretch.spin2 + stretch.spin_gain * done, 0.0)
        outcome = PASSED
        left = 1.0
        into_roof = 0.0
        speed = kept * math.sqrt(speed2)
        if crossing.kind != STATION and not state.meets_none:
            if crossing.height > 0.0:
                energy = 0.5 * block.mass * (speed2 + block.inertia * spin2)
                outcome, left = _at_barrier(crossing, kept * kept * energy)
            else:
                outcome, into_roof = _over_top(crossing, 0.0, speed * ux, speed * uz, gravity)
        if forward and not crossing.seen:
            _write_passage(
                state, output, block, crossings, crossing, outcome, speed * ux, speed * uz,
                kept * math.sqrt(spin2), 0.0, into_roof
            )  # fmt: skip
        met = _met_too(met, i, share, outcome, left)
    if met.line >= 0:
        keep_fork(state, site, output, n_passages)
    return met


@lean
def after_barrier(
    state: Record, block: Block, site: Site, output: Output, physics: Physics, met: Meeting,
    height: float,
) -> None:  # fmt: skip
    """End the motion of a block that a barrier stops; remember where a net holds one.

    On the roof of a gallery it moves on; ``height`` is its passing height at the line (m).
    """
    outcome = met.outcome
    crossing = site.crossings.rows[met.line]
    if outcome == STOPPED:
        end(state, BARRIER)
    elif outcome == ON_ROOF:
        if state.phase != FLIGHT:
            # On the ground the velocity is still that before a net at the same place.
            state.vx *= met.speed_left
            state.vz *= met.speed_left
        above = max(height - crossing.height, 0.0)
        move_over_roof(state, block, output, physics, crossing, above)
    elif outcome == HELD_BY_NET:
        state.held_x = state.x
