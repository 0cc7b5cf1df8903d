"""Sites whose rocks move in MuJoCo: rigid blocks in three dimensions on a height field.

Two laws. ``elastic``: contacts rebound, with Coulomb friction. ``plastic``: they hardly do; blocks
are held by rolling resistance, and by a loss that grows with the speed. Nothing is shared with the
engine or the diagnosis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gap_check.motion import (
    FILM_S,
    FRAGMENT,
    LOOSENED,
    ROCK,
    TABLES,
    Rocks,
    Run,
    table_of,
)
from gap_check.slopes import CLASSES, FloatArray
from gap_check.worlds import PlacedEffect, World

STEP_S = 0.002
_LONGEST_S = 90.0
# A block has stopped where it has been this slow for so long.
_STILL_MPS, _STILL_S = 0.15, 0.6
#: Steps after which the ground under a block is looked up again.
_LOOK = 5
# What is longer, softer or higher above the ground is no impact.
_LONGEST_CONTACT_S, _SOFTEST_MPS = 0.12, 0.3
_GAP_STEPS = 3
_MAX_PIECES = 40
_NODES_M = 1.0
_DEEP_M = 20.0
#: Between what limits contacts of a class are drawn: restitution, friction, rolling resistance
#: (share of the radius), half period of the contact as a spring (s), bumps (m).
_CONTACTS = {
    "rock": ((0.3, 0.6), (0.4, 0.8), (0.02, 0.1), (0.02, 0.03), (0.02, 0.08)),
    "debris": ((0.15, 0.45), (0.45, 0.9), (0.05, 0.2), (0.02, 0.04), (0.03, 0.09)),
    "talus": ((0.15, 0.45), (0.45, 0.9), (0.08, 0.25), (0.02, 0.04), (0.04, 0.12)),
    "soft_meadow": ((0.05, 0.3), (0.4, 0.8), (0.08, 0.3), (0.03, 0.06), (0.01, 0.04)),
    "forest_soil": ((0.05, 0.3), (0.4, 0.8), (0.08, 0.3), (0.03, 0.06), (0.02, 0.06)),
    "overgrown_slope": ((0.05, 0.3), (0.4, 0.8), (0.08, 0.3), (0.03, 0.06), (0.0, 0.05)),
}
#: The same limits, where contacts are plastic: factors.
_PLASTIC = np.array([0.15, 1.0, 1.5, 1.2, 1.0])
#: Loss at contacts μ v²/d (m/s²): μ of plastic ones, and of a disturbed site besides.
_SPEED_LOSS = {"plastic": (0.01, 0.06), "disturbed": (0.03, 0.08)}
_BREAKS_JKG = (300.0, 2.0)  # weakest to strongest fragmentation, of a block of 0.5 m³

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Block:
    """A block before it moves; places from the middle of the terrain, at its lowest point (m)."""

    rock: int
    key: tuple[int, ...]  # seed of its draws
    place: Vector
    velocity: Vector
    axes: Vector  # semi-axes (m)
    mass: float
    volume: float
    spin: Vector  # (rad/s)
    time: float = 0.0
    piece: int = 0
    kind: int = ROCK

    @property
    def radius(self) -> float:
        """Of the sphere of equal volume (m)."""
        return float(np.cbrt(self.axes.prod()))


def run_rocks(world: World, rocks: Rocks) -> Run:
    """Release rocks; what they make is theirs. The same seed gives the same numbers."""
    site = Site(world)
    gx, gy = world.surface.gradient_at(rocks.place[:, 0], rocks.place[:, 1])
    down = -np.column_stack([gx, gy, gx**2 + gy**2])
    down /= np.linalg.norm(down, axis=1)[:, None]
    tables: dict[str, list[tuple[float, ...]]] = {name: [] for name in TABLES}
    for k in range(len(rocks)):
        waiting, made = [
            Block(
                k, (*rocks.seed, k), rocks.place[k] - site.middle, rocks.speed[k] * down[k],
                rocks.axes[k], float(rocks.volume[k] * rocks.density[k]), float(rocks.volume[k]),
                np.zeros(3),
            )
        ], 1  # fmt: skip
        while waiting:
            path = Path(site, waiting.pop(), made)
            children = path.follow()
            made += len(children)
            waiting += children
            path.write(tables)
    return Run(rocks, **{name: table_of(name, rows) for name, rows in tables.items()})


class Site:
    """The terrain, its contacts and the effects of a world."""

    def __init__(self, world: World) -> None:
        self.world, self.surface = world, world.surface
        rng = np.random.default_rng([world.seed, 616])
        limits = np.array([_CONTACTS[name] for name in CLASSES])
        # Ground that is hard in one class is mostly hard in others: half of each is the site's.
        share = 0.5 * (rng.random((1, limits.shape[1])) + rng.random(limits.shape[:2]))
        self.contacts = limits[..., 0] + share * (limits[..., 1] - limits[..., 0])
        plastic, disturbed = (rng.uniform(*limits) for limits in _SPEED_LOSS.values())
        self.loss = 0.0
        if world.spec.law == "plastic":
            self.contacts *= _PLASTIC
            self.loss = plastic
        if world.spec.disturbance == "speed_loss":
            self.loss += disturbed
        self.shape = str(rng.choice(["ellipsoid", "box", "mesh"]))
        if world.effect("rock_shape") is not None:
            self.shape = "box"
        self.middle, self.size, self.heights = self._nodes(rng)
        self.stems = self._stems()
        self.effects = {e.name: e for e in world.effects}
        side = np.random.default_rng(world.seed).random() - 0.5
        self.wind = math.atan2(world.relief.frame.uy, world.relief.frame.ux) + math.copysign(
            0.9, side
        )

    def _nodes(self, rng: np.random.Generator) -> tuple[Vector, Vector, FloatArray]:
        """Middle of the terrain, half widths, and heights of nodes from south to north (m)."""
        world, own = self.world, self.surface
        n_rows, n_cols = (int(n * own.cell_m / _NODES_M) - 1 for n in own.z.shape)
        # Nodes stay within the centres of the outermost cells.
        west, south = own.west + own.cell_m / 2, own.north - own.cell_m * (own.z.shape[0] - 0.5)
        x, y = np.meshgrid(
            west + _NODES_M * np.arange(n_cols), south + _NODES_M * np.arange(n_rows)
        )
        z = own.at(x, y)
        row, col = (np.rint(v).astype(int) for v in own.cells(x, y))
        code = world.ground[row, col]
        z += self.contacts[code, 4] * rng.standard_normal(z.shape)
        rough = world.effect("roughness")
        if rough is not None:
            s = world.relief.frame.s(x, y)
            there = (code == CLASSES.index(rough.ground)) & (s > rough.s0_m) & (s < rough.s1_m)
            bumps = gaussian_filter(rng.standard_normal(z.shape), 0.7)
            z += there * rough.between(0.02, 1.0) * bumps / bumps.std()
        half = 0.5 * _NODES_M * np.array([n_cols - 1, n_rows - 1])
        return np.array([west + half[0], south + half[1], float(z.min())]), half, z - z.min()

    def _stems(self) -> FloatArray:
        """Stems from the middle of the terrain: x, y, z of the foot, radius (m)."""
        trees = self.world.effect("trees")
        if trees is None:
            return np.zeros((0, 4))
        rng = np.random.default_rng([trees.seed, 606])
        width = 45.0
        area = (trees.s1_m - trees.s0_m) * 2.0 * width
        # A denser stand holds all the stems of a lighter one.
        places = rng.random((int(0.1 * area), 3))[: int(trees.between(0.002, 0.1) * area)]
        s = trees.s0_m + (trees.s1_m - trees.s0_m) * places[:, 0]
        x, y = self.world.relief.frame.xy(s, width * (2.0 * places[:, 1] - 1.0))
        foot = np.column_stack([x, y, self.surface.at(x, y)]) - self.middle
        return np.column_stack([foot, 0.08 + 0.2 * places[:, 2]])

    def model(self, block: Block, points: FloatArray) -> mujoco.MjModel:
        """The terrain with one block."""
        size = " ".join(f"{v:.6g}" for v in block.axes)
        own = f'type="ellipsoid" size="{size}"'
        if self.shape == "box":
            # Of the volume of the ellipsoid.
            half = " ".join(f"{v:.6g}" for v in block.axes * (math.pi / 6.0) ** (1.0 / 3.0))
            own = f'type="box" size="{half}"'
        elif self.shape == "mesh":
            own = 'type="mesh" mesh="hull"'
        hull = " ".join(f"{v:.6g}" for v in points.ravel())
        rows, cols = self.heights.shape
        top = float(self.heights.max())
        near = np.linalg.norm(self.stems[:, :2] - block.place[:2], axis=1) < 400.0
        stems = "".join(
            f'<geom type="capsule" size="{r:.3f} 7" pos="{x:.3f} {y:.3f} {z + 6:.3f}" priority="2" '
            'friction="0.6 0 0" solref="0.03 1"/>'
            for x, y, z, r in self.stems[near].tolist()
        )
        model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><option timestep="{STEP_S}" cone="elliptic" impratio="10"
            integrator="implicitfast" gravity="0 0 -9.81"/>
            <asset><mesh name="hull" vertex="{hull}"/>
            <hfield name="ground" nrow="{rows}" ncol="{cols}"
             size="{self.size[0]} {self.size[1]} {top} {_DEEP_M}"/></asset>
            <worldbody><geom name="ground" type="hfield" hfield="ground" priority="1" condim="6"
             solimp="0.95 0.95 0.001"/>{stems}
            <body><freejoint/><geom name="block" {own} mass="{block.mass}"/></body></worldbody>
            </mujoco>"""
        )
        model.hfield_data[:] = (self.heights / top).ravel()
        drag = self.effects.get("air_drag")
        if drag is not None:
            # Of MuJoCo's box of equal inertia, with a coefficient of 1.
            model.opt.density = 1.2 * drag.between(0.5, 2.5)
        return model

    def set_ground(self, model: mujoco.MjModel, code: int, icy: bool, radius: float) -> None:
        """Put the contacts of a class of ground into a model."""
        e, friction, rolling, half_period, _ = self.contacts[code].tolist()
        if icy:
            friction, rolling = 0.08, 0.02
        lost = -math.log(max(e, 0.02))
        damping = lost / math.hypot(math.pi, lost)
        model.geom_friction[0] = friction, rolling * radius, rolling * radius
        model.geom_solref[0] = half_period / (math.pi * damping), damping

    def icy(self, x: float, y: float, s: float) -> bool:
        """Whether a place lies on a lens of ice."""
        ice = self.effects.get("ice")
        if ice is None or not ice.s0_m < s < ice.s1_m:
            return False
        lens = np.random.default_rng([int(x // 3.0) + 4096, int(y // 3.0) + 4096, ice.seed])
        return bool(lens.random() < ice.between(0.02, 1.0))


class Path:
    """One block on its way, with a row for each step."""

    def __init__(self, site: Site, block: Block, made: int) -> None:
        self.site, self.block, self._made = site, block, made
        self._rng = np.random.default_rng(block.key)
        points = hull_of(block, self._rng)
        self._model = site.model(block, points)
        self._data = mujoco.MjData(self._model)
        turned = Rotation.random(random_state=self._rng)
        # Its lowest corner is where it would lie, or the block where it was set free.
        place = block.place.copy()
        if block.kind != FRAGMENT:
            corners = turned.apply(points) + place + site.middle
            under = site.surface.at(corners[:, 0], corners[:, 1]) + 0.1 - corners[:, 2]
            place[2] += max(0.0, float(under.max()))
        x, y, z, w = turned.as_quat().tolist()
        self._data.qpos[:] = *place, w, x, y, z
        self._data.qvel[:] = *block.velocity, *turned.inv().apply(block.spin)
        self._strength = math.exp(0.4 * self._rng.standard_normal())
        self._side = math.copysign(1.0, self._rng.random() - 0.5)
        #: Place, quaternion, velocity, spin about the axes of the block, whether it is touched.
        self.rows = np.zeros((int(_LONGEST_S / STEP_S) + 1, 14))
        self.count, self.stopped = 0, False

    def follow(self) -> list[Block]:
        """Move until the block stops, breaks or leaves the terrain; blocks that come of it."""
        site, block, model, data, rows = self.site, self.block, self._model, self._data, self.rows
        frame, own, children = site.world.relief.frame, site.surface, []
        (half_x, half_y), (mid_x, mid_y) = (site.size - 3.0).tolist(), site.middle[:2].tolist()
        radius, place, velocity, force = block.radius, data.qpos, data.qvel, data.xfrc_applied
        touched, still, s, code = False, 0, 0.0, 0
        windy, ground = "wind" in site.effects, (-1, False)
        for k in range(len(rows)):
            if k % _LOOK == 0:
                x, y = float(place[0]), float(place[1])
                s = float(frame.s(x + mid_x, y + mid_y))
                row = int((own.north - y - mid_y) / own.cell_m)
                code = int(site.world.ground[row, int((x + mid_x - own.west) / own.cell_m)])
                if ground != (code, icy := site.icy(x + mid_x, y + mid_y, s)):
                    ground = code, icy
                    site.set_ground(model, code, icy, radius)
                turning = radius * math.hypot(*velocity[3:])
                slow = math.hypot(*velocity[:3]) + turning < _STILL_MPS
                still = still + _LOOK if slow else 0
                self.stopped = still * STEP_S > _STILL_S
                if self.stopped or abs(x) > half_x or abs(y) > half_y:
                    break
            now = data.ncon > 0
            rows[k, :7], rows[k, 7:13], rows[k, 13] = place, velocity, now
            self.count = k + 1
            if now != touched:
                if now:
                    children += self._began(s, code)
                else:
                    self._ended()
                    force[1, :3] = 0.0
                if children and children[-1].kind == FRAGMENT:
                    break
                touched = now
            if now or windy:
                force[1, :3] = self._force(now, s, code)
            mujoco.mj_step(model, data)
        return children

    def _force(self, touched: bool, s: float, code: int) -> Vector:
        """What ground and air do besides (N); in flight it is the wind."""
        site, v = self.site, self._data.qvel[:3]
        soft = site.effects.get("soft_ground")
        if not touched:
            wind = site.effects["wind"]
            push = self.block.mass * wind.between(0.05, 3.0) * 0.3 / self.block.radius
            return push * np.array([math.cos(site.wind), math.sin(site.wind), 0.0])
        speed = math.sqrt(float(v @ v))
        held = site.loss * speed / (2.0 * self.block.radius)
        if soft is not None and s > soft.s0_m and CLASSES[code] == soft.ground:
            held += soft.between(0.3, 40.0)
        # No more than would stop it within some steps.
        return -self.block.mass * min(held, 0.2 / STEP_S) * v

    def _began(self, s: float, code: int) -> list[Block]:
        """New blocks as a contact begins."""
        site, block, v = self.site, self.block, self._data.qvel[:3].copy()
        loose, breaks = site.effects.get("entrainment"), site.effects.get("fragmentation")
        new: list[Block] = []
        if (loose is None and breaks is None) or self._made >= _MAX_PIECES:
            return new
        gx, gy = site.surface.gradient_at(*(self._data.qpos[:2] + site.middle[:2]))
        into = float(gx * v[0] + gy * v[1] - v[2]) / math.sqrt(1.0 + float(gx**2 + gy**2))
        if into < _SOFTEST_MPS:
            return new
        if loose is not None and block.kind == ROCK and self._acts(loose, s, code):
            # The more likely, the harder it hits.
            chance = 1.0 - math.exp(-loose.between(0.001, 0.5) * into)
            if self._rng.random() < chance:
                new.append(self._loosened(v))
                self._made += 1
        if breaks is not None and block.volume > 0.01:
            weak = breaks.between(*_BREAKS_JKG) * self._strength * (0.5 / block.volume) ** 0.25
            if 0.5 * into**2 > weak:
                new += self._pieces(v)
        return new

    def _acts(self, effect: PlacedEffect, s: float, code: int) -> bool:
        return effect.s0_m < s < effect.s1_m and effect.ground in ("", CLASSES[code])

    def _ended(self) -> None:
        """Turn the way of a block that leaves the ground, to the side that it tends to."""
        turn, v = self.site.effects.get("lateral_deflection"), self._data.qvel
        if turn is not None and np.linalg.norm(v[:3]) > 1.0:
            angle = turn.between(0.01, 0.8) * (0.4 * self._side + 0.8 * self._rng.standard_normal())
            c, d = math.cos(angle), math.sin(angle)
            v[:2] = c * v[0] - d * v[1], d * v[0] + c * v[1]

    def _loosened(self, v: Vector) -> Block:
        """A smaller block that takes some of the momentum."""
        block, rng = self.block, self._rng
        share, given = rng.uniform(0.25, 0.65), rng.uniform(0.1, 0.5)
        beside = np.append(rng.choice([-1.0, 1.0], 2) * block.radius, 0.0)
        self._data.qvel[:3] = (1.0 - share**3 * given) * v
        return replace(
            block, key=(*block.key, self._made), place=self._data.qpos[:3] + beside,
            velocity=given * v, axes=share * block.axes, mass=share**3 * block.mass,
            volume=share**3 * block.volume, spin=np.zeros(3), time=self.count * STEP_S + block.time,
            piece=self._made, kind=LOOSENED,
        )  # fmt: skip

    def _pieces(self, v: Vector) -> list[Block]:
        """Pieces of a block: its volume and momentum, each with the velocity of its place."""
        block, rng, data = self.block, self._rng, self._data
        share = np.maximum(rng.dirichlet(np.full(2 + int(rng.poisson(1.2)), 1.5)), 0.03)
        share /= share.sum()
        offset = rng.standard_normal((share.size, 3)) * 0.4 * block.axes
        offset -= share @ offset
        apart = 0.1 * float(np.linalg.norm(v)) * rng.standard_normal((share.size, 3))
        spin = _rotation(data.qpos[None, 3:7]).apply(data.qvel[3:])
        velocity = v + np.cross(spin, offset) + apart - share @ apart
        return [
            replace(
                block, key=(*block.key, self._made + k), place=data.qpos[:3] + offset[k],
                velocity=velocity[k], axes=np.cbrt(own) * block.axes, mass=own * block.mass,
                volume=own * block.volume, spin=np.atleast_2d(spin)[0],
                time=self.count * STEP_S + block.time, piece=self._made + k, kind=FRAGMENT,
            )
            for k, own in enumerate(share.tolist())
        ]  # fmt: skip

    def energy(self) -> FloatArray:
        """Energy of each step, of place, motion and spin (J/kg), without that in contacts."""
        rows, model = self.rows[: self.count], self._model
        w = _rotation(model.body_iquat[1]).inv().apply(rows[:, 10:13])
        turning = (model.body_inertia[1] * w**2).sum(axis=1) / model.body_mass[1]
        found: FloatArray = 9.81 * rows[:, 2] + 0.5 * ((rows[:, 7:10] ** 2).sum(axis=1) + turning)
        return found

    def write(self, tables: dict[str, list[tuple[float, ...]]]) -> None:
        """Add what instruments would read from the steps to the tables."""
        site, block = self.site, self.block
        rows = self.rows[: self.count]
        if len(rows) < 2:
            return
        who = (block.rock, block.piece, block.kind)
        place, v = rows[:, :3] + site.middle, rows[:, 7:10]
        w = _rotation(rows[:, 3:7]).apply(rows[:, 10:13])
        speed, turns = np.linalg.norm(v, axis=1), np.linalg.norm(w, axis=1) / (2.0 * math.pi)
        t = block.time + STEP_S * np.arange(len(rows))
        s = site.world.relief.frame.s(place[:, 0], place[:, 1])
        for number, station in enumerate(site.world.stations_s.tolist()):
            for k in (np.flatnonzero((s[:-1] < station) & (station <= s[1:])) + 1)[:1].tolist():
                height = place[k, 2] - float(site.surface.at(*place[k, :2]))
                tables["passages"].append(
                    (*who, number, *place[k], speed[k], turns[k], height, block.mass)
                )
        every = round(FILM_S / STEP_S)
        for k in range(0, len(rows), every):
            tables["tracks"].append((*who, t[k], *place[k], speed[k], turns[k]))
        if self.stopped:
            x, y = place[-1, :2]
            under = float(site.surface.at(x, y))
            tables["deposits"].append((*who, x, y, under, block.mass, block.volume))
        for number, (first, end) in enumerate(spells(rows[:, 13] > 0.5), 1):
            row = self._contact(place[first], v, w, first, end)
            if row is not None:
                tables["impacts"].append((*who, number, *row, block.mass, t[first]))

    def _contact(
        self, place: Vector, v: Vector, w: Vector, first: int, end: int
    ) -> tuple[float, ...] | None:
        """A contact between two rows: place, slope, speeds and spin before and after, turn."""
        surface = self.site.surface
        x, y, z = place.tolist()
        gx, gy = (float(g) for g in surface.gradient_at(x, y))
        normal = np.array([-gx, -gy, 1.0]) / math.sqrt(1.0 + gx**2 + gy**2)
        before, after = v[first], v[end]
        into, floor = float(before @ normal), float(surface.at(x, y))
        high = z - floor > 2.0 * max(self.block.axes)
        held = (end - first) * STEP_S > _LONGEST_CONTACT_S or float(after @ normal) <= 0.0
        if into > -_SOFTEST_MPS or high or held:
            return None
        along, beyond = (u - (u @ normal) * normal for u in (before, after))
        speed = float(np.linalg.norm(along))
        forward = along / max(speed, 1e-9)
        back = -1.0 if beyond @ forward < 0.0 else 1.0
        # Forward rolling is about this axis; azimuths grow clockwise.
        across = np.cross(normal, forward)
        turn = math.atan2(
            before[1] * after[0] - before[0] * after[1], float(before[:2] @ after[:2])
        )
        slope = -(gx * before[0] + gy * before[1]) / max(math.hypot(*before[:2]), 1e-9)
        return (
            x, y, floor, math.degrees(math.atan(slope)), speed, into, float(w[first] @ across),
            back * float(np.linalg.norm(beyond)), float(after @ normal), float(w[end] @ across),
            math.degrees(turn),
        )  # fmt: skip


def spells(touched: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Last row before each contact and first row after it; short gaps do not end one."""
    edges = np.flatnonzero(np.diff(touched.astype(np.int8)))
    if edges.size and touched[0]:
        edges = edges[1:]
    found: list[tuple[int, int]] = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=False):
        if found and begin - found[-1][1] < _GAP_STEPS:
            found[-1] = found[-1][0], end + 1
        else:
            found.append((begin, end + 1))
    return found


def hull_of(block: Block, rng: np.random.Generator) -> FloatArray:
    """Points on the ellipsoid of a block, with its volume and its centre, shape (n, 3) (m)."""
    points = rng.standard_normal((int(rng.integers(14, 26)), 3))
    points = block.axes * points / np.linalg.norm(points, axis=1)[:, None]
    hull = ConvexHull(points)
    # Tetrahedra from the middle to each face.
    corners = points[hull.simplices]
    volume = np.abs(np.linalg.det(corners))
    centre = (volume[:, None] * corners.sum(axis=1) / 4.0).sum(axis=0) / volume.sum()
    made: FloatArray = (points - centre) * np.cbrt(block.volume / hull.volume)
    return made


def _rotation(quaternion: FloatArray) -> Rotation:
    """From the axes of the block to those of the terrain; w is first."""
    return Rotation.from_quat(np.roll(quaternion, -1, axis=-1))
