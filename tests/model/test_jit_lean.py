"""Compiled functions that count no references to arrays, and parts of others."""

from __future__ import annotations

import sys

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from sassgis.model.jit import inlined, kernel, lean


@lean
def _last(values: NDArray[np.float64]) -> float:
    return float(values[values.size - 1])


@lean
def _made(n: int) -> float:
    return float(np.ones(n).sum())


@inlined
def _times(x: float, factor: int) -> float:
    return x * factor


@kernel
def _five_times(x: float) -> float:
    return _times(x, 2) + _times(x, 3)


def test_an_array_is_held_as_often_after_a_call_as_before() -> None:
    values = np.arange(3.0)
    before = sys.getrefcount(values)
    assert [_last(values) for _ in range(50)] == [2.0] * 50
    assert sys.getrefcount(values) == before


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python compiles nothing")
def test_one_that_makes_an_array_does_not_compile() -> None:
    with pytest.raises(numba.core.errors.TypingError):
        _made(3)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python calls all functions")
def test_python_cannot_call_a_part_of_a_kernel() -> None:
    with pytest.raises(TypeError, match="_times can be called by compiled code only"):
        _times(1.0, 2)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python compiles nothing")
def test_a_part_is_compiled_once_for_all_literals() -> None:
    assert _five_times(2.0) == 10.0
    assert len(_times.overloads) <= 1  # none where the caller comes from the cache
