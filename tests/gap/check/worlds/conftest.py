from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from helpers.synthetic_rocks import with_effect

from sassgis.gap.check.worlds import WorldSpec
from sassgis.gap.check.worlds import motion as m
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.contact_laws import OWN
from sassgis.gap.check.worlds.forces import Forces
from sassgis.gap.check.worlds.make import base_world
from sassgis.gap.check.worlds.motion_state import Field, Tables
from sassgis.gap.check.worlds.world import World


@pytest.fixture(scope="session")
def null_world() -> World:
    return base_world(WorldSpec("cliff_talus_meadow"), 5)


@pytest.fixture(scope="session")
def with_magnitude(null_world: World) -> Callable[[str, float], World]:
    """The null world with one effect of a given magnitude, not calibrated."""
    return partial(with_effect, null_world)


class Plane:
    """One plane slope that falls to the east, with one kind of ground.

    ``law`` without rebound of the contact, unless all ten numbers are given.
    """

    def __init__(self, slope: float, law: list[float]) -> None:
        law = [*law, 0.0, 9.144, 0.1][:10] if len(law) == 7 else law
        n_rows, n_cols = 40, 200
        x = 2.0 * (np.arange(n_cols) + 0.5)
        self.slope = slope
        z = np.repeat(-math.tan(slope) * x[None, :], n_rows, axis=0)
        self.field = Field(
            z=z,
            gx=np.full_like(z, -math.tan(slope)),
            gy=np.zeros_like(z),
            west=0.0,
            north=80.0,
            cell=2.0,
            ground=np.zeros(z.shape, np.int64),
            law=np.array([law], float),
            contact=OWN,
            x0=0.0,
            y0=40.0,
            ux=1.0,
            uy=0.0,
            stations=np.zeros(0),
            ob_start=np.zeros(z.size + 1, np.int64),
            ob_near=np.zeros(0, np.int64),
            obstacles=np.zeros((0, 6)),
        )

    def rock(self, a: float, b: float, along: float, normal: float, spin: float = 0.0):  # type: ignore[no-untyped-def]
        """State of a rock with a velocity along and away from the slope, at 50 m."""
        st = np.zeros(ms.N_STATE)
        c, s = math.cos(self.slope), math.sin(self.slope)
        st[ms.X], st[ms.Y], st[ms.Z] = 50.0, 40.0, -math.tan(self.slope) * 50.0 + a / c
        st[ms.VX], st[ms.VZ] = along * c + normal * s, -along * s + normal * c
        st[ms.HX] = 1.0
        st[ms.SPIN] = spin
        st[ms.A], st[ms.B], st[ms.C], st[ms.DENSITY], st[ms.HAND] = a, b, b, 2700.0, 1.0
        return st

    def run(self, st, dt: float = 0.002, forces: Forces | None = None):  # type: ignore[no-untyped-def]
        tables = Tables.of((200, 10, 2000, 20000), 1)
        keys = np.array([1], np.uint64)
        m.run_rocks(self.field, forces or Forces(), st[None, :], keys, dt, tables)
        return tables


@pytest.fixture(scope="session")
def plane() -> type[Plane]:
    return Plane
