"""Blocks in three dimensions in the rigid-body library pybullet, a script in a process of its own.

    python rigid_bodies.py < job.npz > tables.npz

It shares nothing with the rest of the package but the columns of the tables. A block is the convex
hull of points about its ellipsoid; the ground is a height field of 1 m with bumps of its own. What
is recorded is read from the motion: a contact is where the velocity changes by more than gravity.
"""

from __future__ import annotations

import io
import math
import os
import sys
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pybullet as bullet
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]

GRAVITY = 9.81
#: Time between samples of the motion (s); the library makes several steps in each.
SAMPLE_S = 0.004
FINE_M = 1.0
_LONGEST_S = 120.0
#: A block that is slower than this for so long has come to rest.
_STILL_MPS, _STILL_S = 0.15, 0.5
_TRACK_EVERY = 25
#: Longer contacts are rolling and sliding, and softer ones no blow.
_LONGEST_CONTACT_S, _SOFTEST_MPS = 0.1, 0.05
_MAX_PIECES = 64
_ROCK, _FRAGMENT, _LOOSENED = range(3)
#: Columns of what a contact with a class of ground is like; the two frictions that resist turning
#: are shares of the radius, ``softness_s`` is half a period of soft ground as a spring, 0 for hard.
RESTITUTION, FRICTION, ROLLING, SPINNING, SOFTNESS_S, BUMPS_M = range(6)
_ICE_FRICTION, _LENS_M = 0.1, 5.0
_MARGIN_M = 0.05
#: Side of squares (m): a block touches nothing that stands beyond the squares next to its own.
_SQUARE_M = 2.5
#: Stiffness of hard ground per mass (1/s²), and the share of a penetration that a step takes back;
#: damping of soft ground.
_HARD, _TAKEN_BACK, _DAMPED = 1e9, 0.05, 0.4


@dataclass(frozen=True)
class ActingEffect:
    """An effect of strength q between s0 and s1 (m down the slope)."""

    q: float = 0.0
    s0: float = -math.inf
    s1: float = math.inf
    seed: int = 0

    def at(self, s: float) -> float:
        """Its strength at a place."""
        return self.q if self.s0 <= s <= self.s1 else 0.0


@dataclass(frozen=True)
class RigidBlock:
    """A block as it is set in motion: place, velocity and spin in space (m, m/s, rad/s)."""

    rock: int
    key: tuple[int, ...]
    place: Vector
    velocity: Vector
    axes: Vector
    density: float
    campaign: float = 0.0
    spin: Vector = (0.0, 0.0, 0.0)
    time: float = 0.0
    piece: int = 0
    kind: int = _ROCK

    @property
    def volume(self) -> float:
        """Volume of its ellipsoid, and of its hull (m³)."""
        return 4.0 / 3.0 * math.pi * math.prod(self.axes)

    @property
    def mass(self) -> float:
        """Mass (kg)."""
        return self.density * self.volume

    @property
    def radius(self) -> float:
        """Radius of the sphere of its volume (m)."""
        return math.prod(self.axes) ** (1.0 / 3.0)


def mass_properties(points: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Volume, centroid and second moments (∫ x xᵀ dV about it) of the convex hull of points."""
    hull = ConvexHull(points)
    inside = points.mean(axis=0)
    corners = points[hull.simplices] - inside
    determinant = np.abs(np.linalg.det(corners))
    volume = determinant.sum() / 6.0
    total = corners.sum(axis=1)
    centre = (determinant[:, None] * total).sum(axis=0) / (24.0 * volume)
    squares = np.einsum("nki,nkj->nij", corners, corners) + np.einsum("ni,nj->nij", total, total)
    moments = (determinant[:, None, None] * squares).sum(axis=0) / 120.0
    return float(volume), inside + centre, moments - volume * np.outer(centre, centre)


def hull_of(axes: Vector, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Corners of a convex block about an ellipsoid, and its moments of inertia per unit mass.

    The centroid is the origin, the principal axes are those of space, and the volume is that of the
    ellipsoid.
    """
    directions = rng.standard_normal((int(rng.integers(12, 25)), 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # One corner near each end of the axes: no block is a splinter by chance.
    directions = np.vstack([directions, np.eye(3), -np.eye(3)])
    points = directions * rng.uniform(0.85, 1.15, (len(directions), 1)) * np.array(axes)
    _, centre, moments = mass_properties(points)
    _, frame = np.linalg.eigh(moments)
    if np.linalg.det(frame) < 0.0:
        frame[:, 0] = -frame[:, 0]
    points = (points - centre) @ frame
    volume, _, _ = mass_properties(points)
    points *= (4.0 / 3.0 * math.pi * math.prod(axes) / volume) ** (1.0 / 3.0)
    volume, _, moments = mass_properties(points)
    second = np.diag(moments) / volume
    return points[ConvexHull(points).vertices], second.sum() - second


def _square(x: float, y: float) -> tuple[int, int]:
    """The square in which a place lies."""
    return int(x // _SQUARE_M), int(y // _SQUARE_M)


def turned(rng: np.random.Generator) -> list[float]:
    """A quaternion, all orientations alike."""
    four = rng.standard_normal(4)
    return [float(v) for v in four / np.linalg.norm(four)]


class Ground:
    """Heights, classes and contacts; places are counted from the middle of the grid."""

    def __init__(self, job: Mapping[str, NDArray[Any]], bumps: ActingEffect) -> None:
        heights, codes = job["heights"], job["ground"]
        west, north, self._cell = (float(v) for v in job["corner"])
        n_rows, n_cols = heights.shape
        # The height field lies between the centres of the outer cells.
        self.x0 = west + 0.5 * n_cols * self._cell
        self.y0 = north - 0.5 * n_rows * self._cell
        self._half = (0.5 * n_cols * self._cell, 0.5 * n_rows * self._cell)
        self.codes, self.law = codes, job["law"]
        self._frame = [float(v) for v in job["frame"]]
        # Rows from the south, as the library counts them.
        self._smooth = np.ascontiguousarray(heights[::-1])
        fine = round(self._cell / FINE_M)
        rows = np.linspace(0.0, n_rows - 1.0, fine * (n_rows - 1) + 1)
        cols = np.linspace(0.0, n_cols - 1.0, fine * (n_cols - 1) + 1)
        at = np.meshgrid(rows, cols, indexing="ij")
        self.fine = ndimage.map_coordinates(self._smooth, at, order=1)
        height = self.law[codes[::-1], BUMPS_M][
            np.round(at[0]).astype(int), np.round(at[1]).astype(int)
        ]
        if bumps.q > 0.0:
            x, y = ((at[k] + 0.5) * self._cell - self._half[1 - k] for k in (1, 0))
            s = self.down(x, y)
            height = height + 0.35 * bumps.q * ((s >= bumps.s0) & (s <= bumps.s1))
        rng = np.random.default_rng(job["seed"].tolist())
        rough = rng.standard_normal(self.fine.shape)
        # Single stones, and swells of a few of them.
        rough += 3.0 * ndimage.gaussian_filter(rng.standard_normal(self.fine.shape), 1.5)
        self.fine = self.fine + height * rough / rough.std()
        # The library puts the middle between lowest and highest at zero.
        self.z0 = 0.5 * float(self.fine.min() + self.fine.max())

    def down(self, x: Any, y: Any) -> Any:
        """Distance down the slope (m)."""
        ox, oy, ux, uy = self._frame
        return (x + self.x0 - ox) * ux + (y + self.y0 - oy) * uy

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Row from the north and column of a place."""
        return int((self._half[1] - y) / self._cell), int((x + self._half[0]) / self._cell)

    def within(self, x: float, y: float) -> bool:
        """Whether a place is far enough from the edge."""
        edge = 1.5 * self._cell
        return bool(abs(x) < self._half[0] - edge and abs(y) < self._half[1] - edge)

    def surface(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Height (above ``z0``) and gradient of the ground without its bumps, bilinear."""
        u = (np.asarray(x) + self._half[0]) / self._cell - 0.5
        v = (np.asarray(y) + self._half[1]) / self._cell - 0.5
        n_rows, n_cols = self._smooth.shape
        j = np.clip(np.floor(u).astype(int), 0, n_cols - 2)
        i = np.clip(np.floor(v).astype(int), 0, n_rows - 2)
        p, q, z = u - j, v - i, self._smooth
        low = z[i, j] + p * (z[i, j + 1] - z[i, j])
        high = z[i + 1, j] + p * (z[i + 1, j + 1] - z[i + 1, j])
        east = (1.0 - q) * (z[i, j + 1] - z[i, j]) + q * (z[i + 1, j + 1] - z[i + 1, j])
        return low + q * (high - low) - self.z0, east / self._cell, (high - low) / self._cell

    def rough_height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height of the ground with its bumps, above ``z0``."""
        n_rows, n_cols = self.fine.shape
        at = [y / FINE_M + 0.5 * (n_rows - 1), x / FINE_M + 0.5 * (n_cols - 1)]
        found: FloatArray = ndimage.map_coordinates(self.fine, at, order=1, mode="nearest")
        return found - self.z0


class RigidSite:
    """The ground and what stands on it, in the library; one block moves at a time."""

    def __init__(self, job: Mapping[str, NDArray[Any]]) -> None:
        values = job["effect_values"].tolist()
        self.effects = defaultdict(ActingEffect)
        for name, (q, s0, s1, seed) in zip(job["effects"], values, strict=True):
            self.effects[str(name)] = ActingEffect(q, s0, s1, int(seed))
        self.loss = float(job["speed_loss"])
        self.ground = Ground(job, self.effects["roughness"])
        self._stations = job["stations"]
        steps = math.ceil(SAMPLE_S / float(job["dt"]) - 1e-9)
        self._step_s = SAMPLE_S / steps
        if not bullet.isConnected():
            bullet.connect(bullet.DIRECT)
        bullet.resetSimulation()
        bullet.setGravity(0.0, 0.0, -GRAVITY)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=SAMPLE_S, numSubSteps=steps if steps > 1 else 0,
            restitutionVelocityThreshold=0.1, deterministicOverlappingPairs=1,
        )  # fmt: skip
        n_rows, n_cols = self.ground.fine.shape
        shape = bullet.createCollisionShape(
            bullet.GEOM_HEIGHTFIELD, meshScale=[FINE_M, FINE_M, 1.0],
            heightfieldData=self.ground.fine.ravel().tolist(),
            numHeightfieldRows=n_cols, numHeightfieldColumns=n_rows,
        )  # fmt: skip
        # Within its margin a block meets triangles from above alone, not their common edges.
        body = bullet.createMultiBody(
            0.0, shape, basePosition=[0.0, 0.0, -_MARGIN_M], useMaximalCoordinates=True
        )
        # Products of both bodies count: the blocks have the values of the ground.
        bullet.changeDynamics(
            body, -1, lateralFriction=1.0, restitution=1.0, collisionMargin=_MARGIN_M
        )
        self._stems: list[list[float]] = job["obstacles"].tolist()
        self._shapes: dict[int, int] = {}
        self._near: dict[tuple[int, int], list[int]] = {}
        for k, row in enumerate(self._stems):
            i, j = _square(row[0] - self.ground.x0, row[1] - self.ground.y0)
            for square in ((i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)):
                self._near.setdefault(square, []).append(k)
        #: Bodies of what stands near the block, and what it has broken, by their numbers.
        self._standing: dict[int, int] = {}
        self._broken: set[int] = set()
        self._square: tuple[int, int] | None = None
        self.tables: dict[str, list[Any]] = defaultdict(list)

    def clear(self) -> None:
        """Take away what stood near the block before, and forget what that has broken."""
        for body in self._standing.values():
            bullet.removeBody(body)
        self._standing.clear()
        self._broken.clear()
        self._square = None

    def stand_near(self, x: float, y: float) -> None:
        """Put up the stems and lying blocks near a place, and take away all others.

        In each step the library looks at every body that there is, however far away.
        """
        square = _square(x, y)
        if square == self._square:
            return
        self._square = square
        near = self._near.get(square, [])
        for k in [k for k in self._standing if k not in near]:
            bullet.removeBody(self._standing.pop(k))
        for k in near:
            if k not in self._standing and k not in self._broken:
                self._standing[k] = self._stand(k)

    def _stand(self, k: int) -> int:
        """Put up a stem or a lying block as a cylinder."""
        x, y, radius, _, height, _ = self._stems[k]
        x, y, height = x - self.ground.x0, y - self.ground.y0, min(height, 12.0)
        z = float(self.ground.surface(x, y)[0])
        if k not in self._shapes:
            self._shapes[k] = bullet.createCollisionShape(
                bullet.GEOM_CYLINDER, radius=radius, height=height
            )
        body: int = bullet.createMultiBody(
            0.0, self._shapes[k], basePosition=[x, y, z + 0.5 * height], useMaximalCoordinates=True
        )
        bullet.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.8)
        return body

    def release(self, block: RigidBlock) -> None:
        """Let a block move, and all that it makes."""
        waiting, made = [block], 1
        while waiting:
            moved = _Motion(self, waiting.pop(), made)
            children = moved.run()
            made += len(children)
            waiting += children
            moved.write(self.tables, self._stations)

    def surface_values(self, code: int, on_ice: bool, block: RigidBlock) -> dict[str, float]:
        """What the library is told of a block on a class of ground."""
        e, friction, rolling, spinning, soft = self.ground.law[code, :BUMPS_M].tolist()
        dry = 1.0 - self.effects["wetting"].q * (0.3 + 0.7 * block.campaign)
        # Hard ground rebounds in one step, with its coefficient; soft ground as a damped spring.
        stiffness, damping = _HARD, _HARD * self._step_s * (1.0 / _TAKEN_BACK - 1.0)
        if soft > 0.0:
            natural = math.pi / soft
            e, stiffness, damping = 0.0, natural**2, 2.0 * _DAMPED * natural
        return {
            "restitution": e * max(dry, 0.0),
            "lateralFriction": _ICE_FRICTION if on_ice else friction * (0.6 + 0.4 * dry),
            "rollingFriction": (0.02 if on_ice else rolling) * block.radius,
            "spinningFriction": (0.02 if on_ice else spinning) * block.radius,
            "contactStiffness": block.mass * stiffness,
            "contactDamping": block.mass * damping,
        }

    def on_ice(self, x: float, y: float, s: float) -> bool:
        """Whether a place lies on a lens of ice."""
        ice = self.effects["ice"]
        lens = [int(x // _LENS_M) + 4096, int(y // _LENS_M) + 4096, ice.seed]
        return bool(np.random.default_rng(lens).random() < ice.at(s))

    def meet_stems(self, block: RigidBlock, x: float, y: float, z: float, v: Any) -> Any:
        """Velocity beyond a stem that gives way, or as it is; others the library lets it hit."""
        for k in self._near.get(_square(x, y), ()):
            sx, sy, radius, capacity, height, _ = self._stems[k]
            ex, ey = x + self.ground.x0 - sx, y + self.ground.y0 - sy
            distance, longest = math.hypot(ex, ey), max(block.axes)
            approach = -(v[0] * ex + v[1] * ey) / max(distance, 1e-9)
            energy = 0.5 * block.mass * approach * approach
            if energy <= capacity or not (
                0.0 < approach >= (distance - radius - longest) / (2.0 * SAMPLE_S)
            ):
                continue
            if z - longest > float(self.ground.surface(x, y)[0]) + height:
                continue
            # It breaks, and is no longer in the way of this block.
            self._broken.add(k)
            if k in self._standing:
                bullet.removeBody(self._standing.pop(k))
            if distance < radius + block.radius:
                taken = approach * (1.0 - math.sqrt(1.0 - capacity / energy)) / distance
                v = (v[0] + taken * ex, v[1] + taken * ey, v[2])
        return v


class _Motion:
    """One block on its way, with its samples."""

    def __init__(self, site: RigidSite, block: RigidBlock, made: int) -> None:
        self._site, self._block, self._made = site, block, made
        self._rng = np.random.default_rng(block.key)
        self._points, inertia = hull_of(block.axes, self._rng)
        quaternion = turned(self._rng)
        #: Specific energy at which it breaks, over that of the weakest (J/kg).
        self._strength = math.exp(0.4 * self._rng.standard_normal())
        self._side = 1.0 if self._rng.random() < 0.5 else -1.0
        x, y, z = block.place
        matrix = np.array(bullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
        corners = self._points @ matrix.T + np.array([x, y, z])
        sunk = site.ground.rough_height(corners[:, 0], corners[:, 1]) - corners[:, 2]
        z += max(0.0, float(sunk.max()) + 0.02)
        shape = bullet.createCollisionShape(bullet.GEOM_MESH, vertices=self._points.tolist())
        self._body = bullet.createMultiBody(
            block.mass, shape, basePosition=[x, y, z], baseOrientation=quaternion,
            useMaximalCoordinates=True,
        )  # fmt: skip
        bullet.changeDynamics(
            self._body, -1, mass=block.mass, localInertiaDiagonal=(block.mass * inertia).tolist(),
            linearDamping=0.0, angularDamping=0.0,
            activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        )  # fmt: skip
        bullet.resetBaseVelocity(self._body, block.velocity, block.spin)
        self._on: tuple[int, bool] | None = None
        first = (block.time, x, y, z, *block.velocity, *block.spin, 0.0)
        self._rows: list[tuple[float, ...]] = [first]
        self._stopped = False

    def run(self) -> list[RigidBlock]:
        """Move until it stops, breaks or leaves the terrain; blocks that come of it."""
        site, block, ground = self._site, self._block, self._site.ground
        children: list[RigidBlock] = []
        t, still, touched = block.time, 0.0, False
        before = block.velocity
        site.clear()
        site.stand_near(*block.place[:2])
        airs = [site.effects[name].q > 0.0 for name in ("air_drag", "wind", "magnus")]
        standing, snow, ice = bool(len(site._stems)), site.effects["snow"], site.effects["ice"]
        while t < _LONGEST_S:
            bullet.stepSimulation()
            (x, y, z), quaternion = bullet.getBasePositionAndOrientation(self._body)
            found, turning = bullet.getBaseVelocity(self._body)
            t += SAMPLE_S
            v, w = found, turning
            s = ground.down(x, y)
            pushed = abs(v[0] - before[0]) + abs(v[1] - before[1]) > 1e-6 or (
                abs(v[2] - before[2] + GRAVITY * SAMPLE_S) > 1e-6
            )
            if pushed and not touched:
                v, w, new = self._meet((x, y, z), before, v, w, s, t)
                children += new
            elif pushed and snow.q > 0.0:
                held = max(0.0, 1.0 - 0.1 * snow.at(s) * GRAVITY * SAMPLE_S)
                v = (held * v[0], held * v[1], v[2])
            if any(airs):
                v = self._in_air(quaternion, v, w)
            if standing:
                v = site.meet_stems(block, x, y, z, v)
                site.stand_near(x, y)
            if v is not found or w is not turning:
                bullet.resetBaseVelocity(self._body, v, w)
            self._rows.append((t, x, y, z, *v, *w, float(pushed)))
            if children and children[-1].kind == _FRAGMENT:
                break
            touched, before = pushed, v
            if not ground.within(x, y):
                break
            i, j = ground.cell_of(x, y)
            on = (int(ground.codes[i, j]), ice.q > 0.0 and site.on_ice(x, y, s))
            if on != self._on:
                self._on = on
                bullet.changeDynamics(self._body, -1, **site.surface_values(*on, block))
            slow = math.hypot(*v) + block.radius * math.hypot(*w) < _STILL_MPS
            still = still + SAMPLE_S if slow else 0.0
            if still > _STILL_S:
                self._stopped = True
                break
        self._stopped = self._stopped or t >= _LONGEST_S
        bullet.removeBody(self._body)
        return children

    def _in_air(self, quaternion: Any, v: Vector, w: Vector) -> Vector:
        """Velocity after what air does in one sample: drag, wind, lift."""
        site, block = self._site, self._block
        speed = math.hypot(*v)
        drag, wind, lift = (site.effects[name] for name in ("air_drag", "wind", "magnus"))
        out = np.array(v)
        if drag.q > 0.0 and speed > 0.0:
            # The shadow of the ellipsoid along the path.
            frame = np.array(bullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
            a, b, c = np.sort(block.axes)
            u = np.array(v) / speed @ frame
            shadow = math.pi * math.sqrt(
                (b * c * u[2]) ** 2 + (a * c * u[1]) ** 2 + (a * b * u[0]) ** 2
            )
            out *= max(0.0, 1.0 - 0.5 * 1.2 * 0.8 * drag.q * shadow * speed / block.mass * SAMPLE_S)
        if wind.q > 0.0:
            # ``s0`` is its direction in plan (rad).
            push = wind.q * 0.3 / block.radius * SAMPLE_S
            out += push * np.array([math.cos(wind.s0), math.sin(wind.s0), 0.0])
        if lift.q > 0.0:
            out += 0.02 * lift.q * SAMPLE_S * np.cross(w, v)
        x, y, z = out.tolist()
        return x, y, z

    def _meet(
        self, place: Vector, before: Vector, v: Vector, w: Vector, s: float, t: float
    ) -> tuple[Vector, Vector, list[RigidBlock]]:
        """Velocity and spin after what effects do at a contact, and new blocks."""
        site, block = self._site, self._block
        _, gx, gy = site.ground.surface(place[0], place[1])
        size = math.sqrt(1.0 + gx * gx + gy * gy)
        into = (float(gx) * before[0] + float(gy) * before[1] - before[2]) / size
        new: list[RigidBlock] = []
        if into < 0.3:
            return v, w, new
        # Work on the dent that the block leaves: deep for fast and heavy ones.
        dent = (
            0.02 * site.effects["soft_ground"].at(s) * into * (block.mass / 1000.0) ** (1.0 / 3.0)
        )
        held = math.exp(-dent) / (1.0 + site.loss * sum(c * c for c in v) / 100.0)
        if held < 1.0:
            v = (held * v[0], held * v[1], held * v[2])
            w = (held * w[0], held * w[1], held * w[2])
        q = site.effects["lateral_deflection"].at(s)
        if q > 0.0:
            # Each block has a side to which it tends.
            angle = q * (0.4 * self._side + 0.8 * self._rng.standard_normal()) * into / (into + 2.0)
            c, d = math.cos(angle), math.sin(angle)
            v = (c * v[0] - d * v[1], d * v[0] + c * v[1], v[2])
        q = site.effects["entrainment"].at(s)
        if q > 0.0 and block.kind == _ROCK and self._made < _MAX_PIECES:
            change = math.dist(v, before)
            if self._rng.random() < 1.0 - math.exp(-0.5 * q * change):
                loose, v = self._loosened(place, v, t)
                new.append(loose)
                self._made += 1
        q = site.effects["fragmentation"].at(s)
        weak = 200.0 / max(q, 1e-9) * self._strength * (0.5 / block.volume) ** 0.25
        if q > 0.0 and block.volume > 0.01 and 0.5 * into * into > weak:
            new += self._pieces(place, v, w, t)
        return v, w, new

    def _loosened(self, place: Vector, v: Vector, t: float) -> tuple[RigidBlock, Vector]:
        """A smaller block that takes some of the momentum, and what is left."""
        block, rng = self._block, self._rng
        share, given = float(rng.uniform(0.25, 0.65)), float(rng.uniform(0.1, 0.5))
        axes = tuple(share * a for a in rng.permutation(block.axes).tolist())
        speed = (given * v[0], given * v[1], given * v[2])
        x, y, z = (c - share**3 * d for c, d in zip(v, speed, strict=True))
        beside = math.copysign(0.5, rng.random() - 0.5)
        start = (place[0] + beside, place[1] + beside, place[2] - 0.5 * block.radius)
        loose = replace(
            block, key=(*block.key, self._made), place=start, velocity=speed, axes=axes,
            spin=(0.0, 0.0, 0.0), time=t, piece=self._made, kind=_LOOSENED,
        )  # fmt: skip
        return loose, (x, y, z)

    def _pieces(self, place: Vector, v: Vector, w: Vector, t: float) -> list[RigidBlock]:
        """Pieces of a block: its volume and its momentum, each with the velocity of its place."""
        block, rng = self._block, self._rng
        count = 2 + int(rng.poisson(1.2))
        if self._made + count > _MAX_PIECES:
            return []
        share = rng.dirichlet(np.full(count, 1.5))
        share = np.maximum(share, 0.03) / np.maximum(share, 0.03).sum()
        offset = rng.standard_normal((count, 3)) * 0.4 * np.array(block.axes)
        offset -= share @ offset
        apart = 0.1 * math.hypot(*v) * rng.standard_normal((count, 3))
        apart -= share @ apart
        velocity = np.array(v) + np.cross(w, offset) + apart
        sizes = share ** (1.0 / 3.0)
        return [
            replace(
                block, key=(*block.key, self._made + k), place=tuple((place + offset[k]).tolist()),
                velocity=tuple(velocity[k].tolist()),
                axes=tuple((sizes[k] * np.array(block.axes)).tolist()),
                spin=w, time=t, piece=self._made + k, kind=_FRAGMENT,
            )
            for k in range(count)
        ]  # fmt: skip

    def write(self, tables: dict[str, list[Any]], stations: FloatArray) -> None:
        """Add what instruments would read from the samples to the tables."""
        block, ground = self._block, self._site.ground
        rows = np.array(self._rows)
        t, x, y, z = rows[:, :4].T
        v, w = rows[:, 4:7], rows[:, 7:10]
        speed, turns = np.linalg.norm(v, axis=1), np.linalg.norm(w, axis=1) / (2.0 * math.pi)
        floor, _, _ = ground.surface(x, y)
        xyz = np.column_stack([x + ground.x0, y + ground.y0, z + ground.z0])
        who = (block.rock, block.piece, block.kind)
        s = ground.down(x, y)
        for number, station in enumerate(stations.tolist()):
            for k in np.flatnonzero((s[:-1] < station) & (station <= s[1:])) + 1:
                tables["passages"].append(
                    (*who, number, *xyz[k], speed[k], turns[k], z[k] - floor[k], block.mass)
                )
        last = len(rows) - 1
        for k in sorted({*range(0, last, _TRACK_EVERY), last}):
            tables["tracks"].append((*who, t[k], *xyz[k], speed[k], turns[k]))
        if self._stopped:
            under = (*xyz[last, :2], floor[last] + ground.z0)
            tables["deposits"].append((*who, *under, block.mass, block.volume))
        # Each spell of contact that begins and ends in the air: its first and last sample.
        edge = np.diff((rows[:, 10] > 0.5).astype(np.int8), prepend=0)
        firsts, ends = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
        spells = [(a, b) for a, b in zip(firsts.tolist(), ends.tolist(), strict=False) if a > 0]
        for number, (first, end) in enumerate(spells, start=1):
            row = self._contact(rows, first, end)
            if row is not None:
                tables["impacts"].append((*who, number, *row, block.mass, t[first]))

    def _contact(self, rows: FloatArray, first: int, end: int) -> tuple[float, ...] | None:
        """A contact between two samples: place, slope, speeds and spin before and after, turn."""
        ground, block = self._site.ground, self._block
        x, y, z = rows[first, 1:4].tolist()
        v, w = rows[first - 1, 4:7], rows[first - 1, 7:10]
        v_out, w_out = rows[end, 4:7], rows[end, 7:10]
        floor, gx, gy = (float(g) for g in ground.surface(x, y))
        normal = np.array([-gx, -gy, 1.0]) / math.sqrt(1.0 + gx * gx + gy * gy)
        into = float(v @ normal)
        beyond = z - floor > 1.6 * max(block.axes)
        if into > -_SOFTEST_MPS or beyond or (end - first + 1) * SAMPLE_S > _LONGEST_CONTACT_S:
            return None
        along, along_out = v - into * normal, v_out - (v_out @ normal) * normal
        heading = v[:2] / max(math.hypot(v[0], v[1]), 1e-9)
        speed = float(np.linalg.norm(along))
        forward = along / max(speed, 1e-9)
        back = -1.0 if along_out @ forward < 0.0 else 1.0
        # Clockwise as seen with the travel to the right.
        across = np.cross(normal, forward)
        # Azimuths grow clockwise.
        cross = v[1] * v_out[0] - v[0] * v_out[1]
        turn = math.degrees(math.atan2(cross, v[0] * v_out[0] + v[1] * v_out[1]))
        under = (x + ground.x0, y + ground.y0, floor + ground.z0)
        slope = math.degrees(math.atan(-(gx * heading[0] + gy * heading[1])))
        return (
            *under, slope, speed, into, float(w @ across),
            back * float(np.linalg.norm(along_out)), float(v_out @ normal), float(w_out @ across),
            turn,
        )  # fmt: skip


def run(job: Mapping[str, NDArray[Any]]) -> dict[str, FloatArray]:
    """What all blocks of a job did: the tables by their names."""
    site = RigidSite(job)
    ground = site.ground
    for k, row in enumerate(job["blocks"].tolist()):
        x, y, z, vx, vy, vz, a, b, c, density = row
        site.release(
            RigidBlock(
                rock=k, key=(int(job["keys"][k]),),
                place=(x - ground.x0, y - ground.y0, z - ground.z0), velocity=(vx, vy, vz),
                axes=(a, b, c), density=density, campaign=float(job["campaign"][k]),
            )
        )  # fmt: skip
    width = {"deposits": 8, "passages": 11, "impacts": 17, "tracks": 9}
    return {
        name: np.array(site.tables[name], np.float64).reshape(-1, columns)
        for name, columns in width.items()
    }


def main() -> None:
    """Read a job, write its tables."""
    # The library talks on the standard output.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as job:
        found = run(dict(job))
    with out:
        np.savez(out, **found)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
