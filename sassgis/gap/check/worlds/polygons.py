"""Rocks as polygons in the rigid-body library pymunk: a law of motion that is nobody's here.

Each rock moves in the vertical plane over its fall line, in a library that knows bodies, friction
and restitution and nothing of rockfall. Deviations of the heading are kept in plan: the ground that
is met is that of the fall line. Only sites of this law need pymunk.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np

from sassgis.gap.check.worlds import contact_laws as laws
from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.forces import Forces
from sassgis.gap.check.worlds.law import GRAVITY
from sassgis.gap.check.worlds.motion_state import (
    MAX_PIECES,
    N_STATE,
    PHI,
    SPIN,
    VX,
    VY,
    VZ,
    A,
    B,
    Field,
    KeyArray,
    Tables,
    X,
    Y,
    Z,
    mass_of,
)
from sassgis.gap.check.worlds.polygon_steps import (
    APART_M,
    BACK,
    CHANGED,
    ENDED,
    PACE_M,
    RIDE,
    Paths,
    Rides,
    into_plane,
    lane_of,
    watch,
)
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray

#: Steps of the library in one of what is recorded and of the effects.
_SUBSTEPS = 2
#: Effects that this law knows.
SUPPORTED = frozenset(
    {
        "lateral_deflection", "fragmentation", "soft_ground", "entrainment", "trees", "air_drag",
        "roughness", "release_error", "measurement_error", "wind", "terrace", "magnus",
        "collisions",
    }
)  # fmt: skip
#: Points of a path.
_LONGEST_PATH = 500
#: Height of a corner of rough ground over the magnitude of the effect.
_CORNER = 0.3


def library() -> ModuleType:
    """The rigid-body library.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import pymunk
        import pymunk.batch
    except ImportError:
        raise InputError(
            "sites of this law need pymunk",
            field="law",
            found="polygons",
            expected='pip install "sassgis[check]"',
        ) from None
    found: ModuleType = pymunk
    return found


def corners(a: float, b: float, key: np.uint64) -> list[tuple[float, float]]:
    """Corners of a convex block about the ellipse of semi-axes a and b, of the same area (m).

    Eight to twelve, unevenly spaced on the ellipse; the centroid is the origin.
    """
    u = np.array([draws.uniform(key, draws.POLYGON, k) for k in range(13)])
    n = 8 + int(5.0 * u[12])
    # Points of an ellipse are corners of a convex polygon, whatever their spacing.
    angle = 2.0 * math.pi * (np.arange(n) + 0.8 * u[:n]) / n
    x, y = a * np.cos(angle), b * np.sin(angle)
    cross = x * np.roll(y, -1) - y * np.roll(x, -1)
    area = 0.5 * cross.sum()
    middle = [((v + np.roll(v, -1)) * cross).sum() / (6.0 * area) for v in (x, y)]
    points = np.column_stack([x - middle[0], y - middle[1]]) * math.sqrt(math.pi * a * b / area)
    return [(px, py) for px, py in points.tolist()]


def run_rocks(
    f: Field, forces: Forces, starts: FloatArray, keys: KeyArray, dt: float, tables: Tables
) -> None:
    """Release all rocks, with the pieces and loosened blocks that they make.

    Parameters and records are those of ``motion.run_rocks``.
    """
    _, first, lanes = np.unique(
        np.round(starts[:, [X, Y]], 6), axis=0, return_index=True, return_inverse=True
    )
    lines = [lane_of(f, starts[k], _LONGEST_PATH) for k in first.tolist()]
    paths = Paths(*(np.ascontiguousarray(v) for v in np.stack(lines, axis=1)))
    rides = np.zeros(len(starts), RIDE)
    rides["lane"], rides["p"], rides["z"] = lanes.ravel(), BACK * PACE_M, starts[:, Z]
    rides["u"], rides["w"] = np.hypot(starts[:, VX], starts[:, VY]), starts[:, VZ]
    rides["omega"], rides["since"], rides["obstacle"] = -starts[:, SPIN], -1.0, -1
    rides["s"] = (starts[:, X] - f.x0) * f.ux + (starts[:, Y] - f.y0) * f.uy
    blocks = _Blocks(f, paths, forces)
    blocks.add(starts, rides, keys, np.arange(len(starts)))
    made = np.ones(len(starts), np.int64)
    stack, stack_keys = np.empty((MAX_PIECES, N_STATE)), np.empty(MAX_PIECES, np.uint64)
    parents = np.empty(MAX_PIECES, np.int64)
    while len(blocks.rock):
        waiting = watch(
            f, forces, paths, blocks.moved(dt), blocks.state, blocks.ride, blocks.keys,
            blocks.rock, dt, tables, stack, stack_keys, parents, made, blocks.fate,
        )  # fmt: skip
        if waiting:
            of = parents[:waiting]
            new, rides, rock = stack[:waiting], blocks.ride[of], blocks.rock[of]
            rides["z"] = new[:, Z] - rides["lift"]
            rides["since"], rides["obstacle"], rides["still"] = -1.0, -1, 0.0
            for k in range(waiting):
                into_plane(paths, rides[k], new[k])
        blocks.settle()
        if waiting:
            blocks.add(new, rides, stack_keys[:waiting], rock)


class _Blocks:
    """Moving blocks: their state here, and their bodies in the library."""

    def __init__(self, f: Field, paths: Paths, forces: Forces) -> None:
        self._munk = library()
        self._space: Any = self._munk.Space()
        self._space.gravity = (0.0, -GRAVITY)
        # Made for pixels: a tenth of a length would be a decimetre here.
        self._space.collision_slop = 0.005
        self._fields: Any = self._munk.batch.BodyFields
        self._speeds = self._fields.VELOCITY | self._fields.ANGULAR_VELOCITY
        for lane in range(len(paths.x)):
            self._space.add(*self._ground(f, paths, forces, lane))
        self._bodies: list[Any] = []
        self._rows: IntArray | None = None
        self._asked: Any = None
        self._listed = 0
        self.state, self.ride = np.empty((0, N_STATE)), np.empty(0, RIDE)
        self.keys, self.rock = np.empty(0, np.uint64), np.empty(0, np.int64)
        self.fate = np.empty(0, np.int64)

    def _ground(self, f: Field, paths: Paths, forces: Forces, lane: int) -> list[Any]:
        """The profile of a fall line as segments with friction and restitution."""
        x, y, z = paths.x[lane], paths.y[lane], paths.z[lane]
        col, row = (x - f.west) / f.cell, (f.north - y) / f.cell
        n_rows, n_cols = f.ground.shape
        outside = (col < 0) | (row < 0) | (col >= n_cols) | (row >= n_rows)
        # One point beyond the terrain, which ends a block before it gets there.
        n = 1 + int(np.argmax(outside)) if outside.any() else len(x)
        p, bumps = PACE_M * np.arange(n), forces.bumps
        if bumps.q > 0.0:
            # Rough ground has corners at half the distance.
            p = 0.5 * PACE_M * np.arange(2 * n - 1)
        x, y, z = (np.interp(p, PACE_M * np.arange(n), v[:n]) for v in (x, y, z))
        if bumps.q > 0.0:
            s = (x - f.x0) * f.ux + (y - f.y0) * f.uy
            key = np.uint64(draws.mix(np.uint64(abs(int(100.0 * (x[0] + y[0]))))))
            off = np.array([draws.uniform(key, draws.BUMP, k) - 0.5 for k in range(len(x))])
            z += np.where((s >= bumps.s0) & (s <= bumps.s1), _CORNER * bumps.q * off, 0.0)
        points = list(zip((APART_M * lane + p).tolist(), z.tolist(), strict=True))
        row = np.clip(((f.north - y) / f.cell).astype(int), 0, n_rows - 1)
        col = np.clip(((x - f.west) / f.cell).astype(int), 0, n_cols - 1)
        law = f.law[f.ground[row, col]]
        segments = []
        for k in range(len(x) - 1):
            segment = self._munk.Segment(self._space.static_body, points[k], points[k + 1], 0.0)
            segment.set_neighbors(points[max(k - 1, 0)], points[min(k + 2, len(x) - 1)])
            segment.friction, segment.elasticity = float(law[k, laws.MU_F]), float(law[k, laws.E])
            segments.append(segment)
        return segments

    def add(self, states: FloatArray, rides: Rides, keys: KeyArray, rocks: IntArray) -> None:
        """Put blocks into the library; their corners come from their keys."""
        for st, ride, key in zip(states, rides, keys, strict=True):
            mass = float(mass_of(st))
            body = self._munk.Body(mass, mass * float(st[A] ** 2 + st[B] ** 2) / 5.0)
            body.position = (APART_M * float(ride["lane"]) + float(ride["p"]), float(ride["z"]))
            body.angle, body.velocity = float(st[PHI]), (float(ride["u"]), float(ride["w"]))
            body.angular_velocity = float(ride["omega"])
            shape = self._munk.Poly(body, corners(float(st[A]), float(st[B]), key))
            shape.friction, shape.elasticity = 1.0, 1.0
            # Blocks do not meet each other.
            shape.filter = self._munk.ShapeFilter(group=1)
            self._space.add(body, shape)
            self._bodies.append(body)
        rides = rides.copy()
        for name in ("u", "w", "omega"):
            rides[f"{name}_last"] = rides[name]
        self.state, self.ride = np.vstack([self.state, states]), np.append(self.ride, rides)
        self.keys, self.rock = np.append(self.keys, keys), np.append(self.rock, rocks)
        self.fate = np.zeros(len(self.rock), np.int64)
        self._forget()

    def moved(self, dt: float) -> FloatArray:
        """Let the library move all bodies: place, angle, velocity and turning of each then."""
        for _ in range(_SUBSTEPS):
            self._space.step(dt / _SUBSTEPS)
        buffer = self._munk.batch.Buffer()
        self._munk.batch.get_space_bodies(self._space, self._asked, buffer)
        if self._rows is None:
            # The library lists the ground among its bodies.
            ids = np.frombuffer(buffer.int_buf(), np.uintp).tolist()
            self._rows = np.array([ids.index(body.id) for body in self._bodies], np.int64)
            self._asked &= ~self._fields.BODY_ID
        listed = np.frombuffer(buffer.float_buf(), float).reshape(-1, 6)
        self._listed = len(listed)
        found: FloatArray = listed[self._rows]
        return found

    def settle(self) -> None:
        """Hand changed velocities to the library; take out bodies that have ended."""
        if (self.fate == CHANGED).any():
            speeds = np.zeros((self._listed, 3))
            speeds[self._rows] = np.column_stack([self.ride[v] for v in ("u", "w", "omega")])
            buffer = self._munk.batch.Buffer()
            buffer.set_float_buf(speeds.ravel())
            self._munk.batch.set_space_bodies(self._space, self._speeds, buffer)
        ended = self.fate == ENDED
        if ended.any():
            for k in np.flatnonzero(ended).tolist():
                self._space.remove(self._bodies[k], *self._bodies[k].shapes)
            self._bodies = [
                b for b, end in zip(self._bodies, ended.tolist(), strict=True) if not end
            ]
            self.state, self.ride = self.state[~ended], self.ride[~ended]
            self.keys, self.rock = self.keys[~ended], self.rock[~ended]
            self.fate = self.fate[~ended]
            self._forget()

    def _forget(self) -> None:
        """Ask anew in which order the library lists its bodies."""
        self._rows = None
        self._asked = self._speeds | self._fields.POSITION | self._fields.ANGLE
        self._asked |= self._fields.BODY_ID
