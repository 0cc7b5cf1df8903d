"""Compiled functions that count no references to arrays, and parts of others."""

from __future__ import annotations

import sys

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from sassgis.compiled.jit import fused, inlined, kernel, lean


@lean
def _last(values: NDArray[np.float64]) -> float:
    return float(values[values.size - 1])


@lean
def _made(n: int) -> float:
    return float(np.ones(n).sum())


@fused
def _times(x: float, factor: int) -> float:
    return x * factor


@inlined
def _or_none(x: float, factor: int | None) -> float:
    if factor is None:
        return x
    return _times(x, factor)


@kernel
def _six_times(x: float) -> float:
    return _or_none(x, None) + _or_none(x, 2) + _times(x, 3)


def test_an_array_is_held_as_often_after_a_call_as_before() -> None:
    values = np.arange(3.0)
    before = sys.getrefcount(values)
    assert [_last(values) for _ in range(50)] == [2.0] * 50
    assert sys.getrefcount(values) == before


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python compiles nothing")
def test_one_that_makes_an_array_does_not_compile() -> None:
    with pytest.raises(numba.core.errors.TypingError):
        _made(3)


def test_python_can_call_a_part_of_a_kernel_also_after_its_callers() -> None:
    assert _six_times(2.0) == 12.0
    assert _times(1.0, 2) == 2.0
    assert _or_none(3.0, None) == 3.0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python compiles nothing")
def test_a_part_is_compiled_once_for_all_literals() -> None:
    assert _six_times(2.0) == 12.0
    assert len(_times.overloads) <= 1  # none where the caller comes from the cache
