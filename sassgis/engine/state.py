"""Data of the kernels: the block, its state, the profile under it, and its records.

Records (rows of structured arrays) are passed by reference: a kernel that takes the state of a
block changes it in place, and what it does not name stays as it is. NamedTuples are passed by
value and never change. The same rows can be read in plain Python, with numba switched off.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine.ellipse import CountedRows, Record, Records, record_type
from sassgis.engine.recording import CellWork
from sassgis.grid import FloatArray
from sassgis.settings.results import StopReason

# Phases, as they are written to the event log.
FLIGHT, IMPACT, ROLLING, SLIDING, END = range(5)

REST, BARRIER, LEFT_PROFILE, STEP_LIMIT, NEVER_STARTED, BROKEN = map(int, StopReason)

# Effects cut a flight or a stretch of rolling into so many steps at most, on average.
_STEPS_PER_EVENT = 50

_F, _I = np.float64, np.int64

#: Vertices of a profile, each with the segment that starts there; the last has none.
VERTEX_DTYPE = record_type(
    ("x", _F),  # chainage (m)
    ("z", _F),  # height (m)
    ("tx", _F),  # unit tangent of the segment
    ("tz", _F),
    ("length", _F),  # of the segment (m)
    ("angle", _F),  # of the segment (rad); NaN where it has not been asked for yet
    ("ground", _I),  # position in the ground table
)

#: Stations and barriers on a profile, by rising chainage.
CROSSING_DTYPE = record_type(
    ("x", _F),  # chainage (m)
    ("z", _F),  # height of the ground (m)
    ("height", _F),  # of the top above it (m)
    ("capacity", _F),  # energy that it takes (J)
    ("width", _F),  # of the roof of a gallery beyond it (m); 0: no roof
    ("slope", _F),  # by which that roof falls (tangent)
    ("kind", _I),
    ("number", _I),  # of the control line in the run
    ("seen", np.bool_),  # whether the block has been here
)

#: Where a block is, how it moves, and how it ended.
STATE_FIELDS: tuple[tuple[str, Any], ...] = (
    ("spawned", np.bool_),  # by an impact of another block
    ("phase", _I),
    ("reason", _I),  # stopping reason
    ("began", _F),  # since the release, when a spawned block came into being (s)
    ("t", _F),  # since its start (s)
    ("x", _F),  # centre: chainage (m)
    ("z", _F),  # height (m)
    ("vx", _F),
    ("vz", _F),  # (m/s)
    ("theta", _F),  # angle of the major axis (rad)
    ("omega", _F),  # spin (rad/s)
    ("segment", _I),  # of the profile, under or near the block
    ("stretch", _I),  # stretch of a cell under the centre
    ("speed", _F),  # along the ground, while it rolls or slides (m/s)
    ("direction", _I),  # along the ground: 1 to the right, -1 to the left
    ("nx", _F),  # normal of the ground that it has come to
    ("nz", _F),
    ("as_circle", np.bool_),  # whether it meets that ground as the circle that rolls
    ("by_core", np.bool_),  # whether it meets that ground as its round core
    ("skip_to", _I),  # segments that a flight has just left; see next_contact
    ("clear_from", _F),  # time of the flight before which no contact counts (s)
    ("spot_x", _F),  # place of the last contacts (m)
    ("spot_z", _F),
    ("crowded", _I),  # contacts there
    ("events", _I),
    ("steps", _I),  # into which effects have cut events
    ("impacts", _I),
    ("slope_draws", _I),
    ("moved", np.bool_),
    ("held_x", _F),  # where a net held it; infinite if none has (m)
    ("lines_from", _F),  # chainage up to which control lines have been dealt with (m)
    ("roof_end", _F),  # chainage (m) at which it leaves the roof that it is on; else minus infinity
    ("roof_z", _F),  # its height there (m)
    ("roof_vx", _F),
    ("roof_vz", _F),  # (m/s)
    ("meets_none", np.bool_),  # whether it moves as if there were no barriers
    ("resumed", np.bool_),  # whether it is in an event that has been prepared before (fork.py)
    ("hindered", np.bool_),  # whether a barrier has changed its motion, or that of its parent
    ("n_passages", _I),
    ("n_touched", _I),  # cells
    ("furthest", _F),  # chainage (m)
    ("top_speed", _F),  # (m/s)
    ("top_height", _F),  # (m)
    ("top_energy", _F),  # (J/kg)
    # On a followed path (ground_ahead.py, heading.py):
    ("open", np.bool_),  # whether the ground goes on where the profile ends
    ("reach", _F),  # chainage at which a stretch on the ground ends at the latest (m)
    ("from_x", _F),  # chainage and place (cells) from which the heading holds
    ("from_u", _F),
    ("from_v", _F),
    ("du", _F),  # heading, in cells per metre
    ("dv", _F),
    ("sampled", _F),  # chainage up to which the ground ahead is known (m)
    ("near", np.uint64),  # stations and barriers near what was sampled last; see Path.near
    ("on_plane", np.bool_),  # whether the plane goes on on which the profile began
    ("plane_at", _I),  # segment of the profile that it is
    ("plane_z", _F),  # its height where the heading holds from (m)
    ("plane_slope", _F),
    ("ahead_z", _F),  # height of the profile where it is sampled to (m)
    ("before_z", _F),  # of the terrain there
    ("vertex_z", _F),  # of the terrain at the last vertex
    ("gap", _F),  # between plane and terrain at the last sample (m)
    ("low", _F),  # limits of the slope of the last segment
    ("high", _F),
    ("about", _F),  # 1, or -1 where it has turned about an odd number of times
    ("drift", _F),  # angle by which it drifts sideways of the descent (rad)
    ("drift_cos", _F),
    ("drift_sin", _F),
    ("steep2", _F),  # before the present stretch on the ground: slope of the terrain, squared,
    ("descent", _F),  # angle from the heading to the descent (rad),
    ("set_out", _F),  # chainage (m), and horizontal speed (m/s)
    ("level", _F),
    ("stuck_x", _F),  # chainage at which its last stretches on the ground ended (m)
    ("stuck", _I),  # how many of them ended there
    ("turn", _F),  # turn of the heading that is still to come, to the right on the map (rad)
)

#: One event of a block: its phase and state as the phase begins. (ux, uz) is the direction of the
#: ground that is met or followed, 0 in flight.
EVENT_DTYPE = record_type(
    ("phase", np.uint8),
    ("t_s", _F),
    ("x_m", _F),
    ("z_m", _F),
    ("vx_mps", _F),
    ("vz_mps", _F),
    ("theta_rad", _F),
    ("omega_radps", _F),
    ("segment", np.int32),
    ("ux", _F),
    ("uz", _F),
    ("u", _F),  # place in plan, on a path that is followed (cells)
    ("v", _F),
)

#: A block that an impact of another has spawned, in flight.
SPAWNED_DTYPE = record_type(
    ("x", _F),
    ("z", _F),
    ("vx", _F),
    ("vz", _F),
    ("theta", _F),
    ("omega", _F),
    ("a", _F),
    ("b", _F),
    ("c", _F),
    ("mass", _F),
    ("t", _F),  # since the release (s)
    ("aside", _F),  # angle to the heading of its parent, to the right on the map (rad)
    ("u", _F),  # place in plan, on a path that is followed (cells)
    ("v", _F),
    ("du", _F),  # heading (cells per metre)
    ("dv", _F),
    ("about", _F),  # -1 where its parent has turned about an odd number of times, else 1
)


class Block(NamedTuple):
    """A block: semi-axes a >= b in the plane of motion, c across; what follows from them."""

    a: float
    b: float
    c: float
    density: float
    mass: float
    key: np.uint64  # identity for random draws
    inertia: float  # per unit mass (m²)
    radius: float  # of the sphere of equal volume (m)
    roll_radius: float  # (m)
    roll_share: float  # kinetic energy of rolling over that of its translation
    drag: float  # its rolling friction over that of the ground class


class Physics(NamedTuple):
    """EngineSettings.resolved() for the kernel; the rolling threshold is with the ground."""

    gravity: float
    eta_rule: int
    slope_variation: bool
    as_ellipse: bool
    tipping: bool
    corner_as_circle: bool
    end_sliding: bool
    tolerance: float
    max_events: int
    rolling_friction_sd: float  # of the logarithm
    outline_edges: float
    outline_share: float
    point: bool  # whether blocks are mass points: they slide and rebound, and do not turn


class Site(NamedTuple):
    """Ground over which a block moves."""

    profile: CountedRows  # VERTEX_DTYPE
    grounds: Records  # ground_switch.GROUND_DTYPE
    crossings: CountedRows  # CROSSING_DTYPE
    stretches: CountedRows  # recording.STRETCH_DTYPE


class Fork(NamedTuple):
    """A block as it was at the first barrier that changed its motion."""

    state: Records  # (1,), as the state; (0,): not kept
    ahead: Site  # the ground ahead, on a path that is followed; else without room
    cells: CellWork  # as work, but in the order of ``touched``


class Output(NamedTuple):
    """Records of a block as it moves."""

    passages: Records  # PASSAGE_DTYPE, those of this block from the top
    work: CellWork
    log: CountedRows  # EVENT_DTYPE, as far as there are rows
    # SPAWNED_DTYPE, by the released block and those that it has spawned; counted beyond the rows.
    spawned: CountedRows
    fork: Fork


@fused
def log_event(log: CountedRows, state: Record, ux: float, uz: float) -> None:
    """Write the state to the event log, with the direction of the ground."""
    i = log.n[0]
    if i < log.rows.shape[0]:
        row = log.rows[i]
        row.phase = state.phase
        row.t_s = state.t
        row.x_m = state.x
        row.z_m = state.z
        row.vx_mps = state.vx
        row.vz_mps = state.vz
        row.theta_rad = state.theta
        row.omega_radps = state.omega
        row.segment = state.segment if state.phase != FLIGHT else -1
        row.ux = ux
        row.uz = uz
        row.u = state.from_u + (state.x - state.from_x) * state.du
        row.v = state.from_v + (state.x - state.from_x) * state.dv
        log.n[0] = i + 1


@inlined
def end(state: Record, reason: int) -> None:
    """End the motion of a block."""
    state.phase = END
    state.reason = reason


@lean
def end_at_rest(state: Record, block: Block) -> None:
    """End the motion of a block that lies still, at a barrier if one has held it here."""
    end(state, BARRIER if abs(state.x - state.held_x) < block.a else REST)


@inlined
def same_event(state: Record, physics: Physics) -> None:
    """Count a step of an event that goes on: it is no further event, unless there are too many."""
    state.steps += 1
    if state.steps < _STEPS_PER_EVENT * physics.max_events:
        state.events -= 1


def trajectory(
    log: NDArray[np.void], gravity: float, step_s: float = 0.02
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the path of the centre of a block: times (s), chainage and height (m), from its log.

    A point each ``step_s`` (s) of a flight, straight lines on the ground.
    """
    if log.size == 0:
        return np.empty(0), np.empty(0), np.empty(0)
    duration = np.append(np.diff(log["t_s"]), 0.0)
    duration[log["phase"] != FLIGHT] = 0.0
    points = np.maximum(np.ceil(duration / step_s), 1.0).astype(np.int64)
    of = np.repeat(np.arange(log.size), points)
    number = np.arange(of.size) - np.repeat(np.cumsum(points) - points, points)
    t = number * (duration / points)[of]
    s = log["x_m"][of] + log["vx_mps"][of] * t
    z = log["z_m"][of] + (log["vz_mps"][of] - 0.5 * gravity * t) * t
    return log["t_s"][of] + t, s, z
