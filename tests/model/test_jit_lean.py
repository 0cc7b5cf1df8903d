"""Compiled functions that count no references to arrays."""

from __future__ import annotations

import sys

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from sassgis.model.jit import lean


@lean
def _last(values: NDArray[np.float64]) -> float:
    return float(values[values.size - 1])


@lean
def _made(n: int) -> float:
    return float(np.ones(n).sum())


def test_an_array_is_held_as_often_after_a_call_as_before() -> None:
    values = np.arange(3.0)
    before = sys.getrefcount(values)
    assert [_last(values) for _ in range(50)] == [2.0] * 50
    assert sys.getrefcount(values) == before


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python compiles nothing")
def test_one_that_makes_an_array_does_not_compile() -> None:
    with pytest.raises(numba.core.errors.TypingError):
        _made(3)
