"""Sites of the rigid-body library: its contacts drawn wide, and the process in which it works."""

from __future__ import annotations

import importlib.util
import io
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from sassgis.gap.check.worlds.motion_state import CAMPAIGN, DENSITY, VX, VZ, A, X, Z
from sassgis.gap.check.worlds.slopes import CLASSES
from sassgis.gap.check.worlds.world import RIGID, Run, World, WorldRocks
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray

_SCRIPT = Path(__file__).with_name("rigid_bodies.py")
#: Effects that are in the rocks, in the ground or in what is written down.
_ELSEWHERE = ("release_error", "measurement_error", "rock_shape", "terrace", "trees", "collisions")
#: Between what limits contacts of a class are drawn at a site: restitution, friction, rolling and
#: spinning friction (shares of the radius), half period of the ground as a spring (s; below
#: ``_SOFT_S`` it is hard), bumps (m).
_CONTACTS: dict[str, tuple[tuple[float, float], ...]] = {
    "rock": ((0.2, 0.5), (0.45, 0.9), (0.05, 0.15), (0.0, 0.1), (0.0, 0.0), (0.02, 0.08)),
    "debris": ((0.1, 0.4), (0.45, 0.95), (0.1, 0.3), (0.0, 0.2), (0.0, 0.0), (0.03, 0.09)),
    "talus": ((0.1, 0.4), (0.45, 0.95), (0.15, 0.35), (0.0, 0.2), (0.0, 0.0), (0.04, 0.12)),
    "soft_meadow": ((0.0, 0.3), (0.4, 0.85), (0.15, 0.4), (0.05, 0.4), (-0.02, 0.04), (0.01, 0.04)),
    "forest_soil": ((0.0, 0.3), (0.4, 0.9), (0.12, 0.35), (0.05, 0.4), (-0.02, 0.03), (0.02, 0.06)),
    "overgrown_slope": ((0.0, 0.3), (0.4, 0.9), (0.1, 0.3), (0.1, 0.3), (-0.02, 0.03), (0.0, 0.05)),
}  # fmt: skip
_SOFT_S = 0.008
#: Twice the rate of samples.
_LONGEST_STEP_S = 0.002


def require_library(laws: Iterable[str]) -> None:
    """Raise InputError where one of the laws needs the rigid-body library and it is not there."""
    if RIGID in laws and importlib.util.find_spec("pybullet") is None:
        raise InputError(
            "sites of this law need pybullet",
            field="law",
            found=RIGID,
            expected='pip install "sassgis[rigid]"',
        )


def drawn_contacts(rng: np.random.Generator) -> FloatArray:
    """Contacts of the classes at a site, shape (n_classes, 6)."""
    limits = np.array([_CONTACTS[name] for name in CLASSES])
    # Ground that is hard in one class is mostly hard in the others: half of each is the site's.
    share = 0.5 * (rng.random((1, limits.shape[1])) + rng.random(limits.shape[:2]))
    drawn: FloatArray = limits[..., 0] + share * (limits[..., 1] - limits[..., 0])
    soft = drawn[:, 4]
    soft[soft < _SOFT_S] = 0.0
    return drawn


def run_rocks(
    world: World, rocks: WorldRocks, obstacles: FloatArray, wind: float, dt: float
) -> Run:
    """Release rocks; what they make is theirs.

    Parameters
    ----------
    obstacles : float64, shape (n, 6)
        Stems and lying blocks.
    wind : float
        Direction of a wind in plan (rad, counter-clockwise from east).
    dt : float
        Time step (s); no longer than the library takes contacts well.

    Raises
    ------
    InputError
        If the library is not installed, or fails.
    """
    require_library([world.spec.law])
    grid, frame = world.true_grid, world.relief.frame
    effects = [e for e in world.effects if e.name not in _ELSEWHERE and e.magnitude > 0.0]
    job = io.BytesIO()
    np.savez(
        job,
        heights=grid.values,
        corner=np.array([grid.west, grid.north, grid.cell_size]),
        ground=world.ground,
        law=world.law,
        seed=np.array([world.seed, 616]),
        speed_loss=np.array(world.speed_loss),
        frame=np.array([frame.x0, frame.y0, frame.ux, frame.uy]),
        stations=world.stations_s,
        blocks=rocks.state[:, [*range(X, Z + 1), *range(VX, VZ + 1), *range(A, DENSITY + 1)]],
        keys=rocks.keys,
        campaign=rocks.state[:, CAMPAIGN],
        effects=np.array([e.name for e in effects], np.str_),
        effect_values=np.array(
            [
                (e.magnitude, wind if e.name == "wind" else e.s0_m, e.s1_m, e.seed % 2**31)
                for e in effects
            ]
        ).reshape(-1, 4),
        obstacles=obstacles,
        dt=np.array(min(dt, _LONGEST_STEP_S)),
    )
    done = subprocess.run(
        [sys.executable, "-P", str(_SCRIPT)], input=job.getvalue(), capture_output=True, check=False
    )
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines() or ["nothing"]
        raise InputError("the rigid-body library failed", field="law", found=said[-1])
    with np.load(io.BytesIO(done.stdout)) as tables:
        found = {name: tables[name] for name in tables.files}
    return Run(rocks, energy_gain=np.full(len(rocks.keys), np.nan), **found)
