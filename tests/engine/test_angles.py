"""Cosine and sine of an angle together."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.compiled.jit import kernel
from sassgis.engine.ellipse import cos_sin
from sassgis.grid import FloatArray

pytestmark = pytest.mark.kernels

QUARTERS = 0.25 * np.pi * np.arange(-40.0, 41.0)


@kernel
def _all(angles: FloatArray, out: FloatArray) -> None:
    for i in range(angles.size):
        out[i, 0], out[i, 1] = cos_sin(angles[i])


@pytest.mark.parametrize(
    "angles",
    [
        pytest.param(np.random.default_rng(1).uniform(-7.0, 7.0, 2000), id="a turn"),
        pytest.param(np.random.default_rng(2).uniform(-1e5, 1e5, 2000), id="many turns"),
        pytest.param(np.random.default_rng(3).uniform(1e5, 1e12, 200), id="very many turns"),
        pytest.param(
            np.concatenate([QUARTERS, np.nextafter(QUARTERS, 9e9)]), id="eighths of a turn"
        ),
    ],
)
def test_cosine_and_sine_are_those_of_extended_precision(angles):
    found = np.empty((angles.size, 2))
    _all(angles, found)
    exact = angles.astype(np.longdouble)
    want = np.stack([np.cos(exact), np.sin(exact)], axis=1)
    assert np.abs(found - want).max() < 2.3e-16


def test_no_angle_gives_no_number():
    found = np.empty((2, 2))
    _all(np.array([np.nan, np.nan]), found)
    assert np.isnan(found).all()
