"""Where the parameters of a hypothesis are drawn from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.special import ndtri


def rounded(value: float) -> float:
    """As many digits as a configuration states: the model that is written is the one scored."""
    return float(f"{value:.6g}")


@dataclass(frozen=True, slots=True)
class Range:
    """Where a parameter may lie: between two limits, searched evenly or on a logarithmic scale."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"


class ParameterDraws:
    """Where the parameters of a draw come from: a number in [0, 1) under each name.

    Parameters
    ----------
    rng : numpy.random.Generator or None
        For names that are not set; None: these are in the middle.
    values : mapping, optional
        Values of an earlier draw: the same names then give the same parameters.
    """

    def __init__(
        self, rng: np.random.Generator | None, values: Mapping[str, float] | None = None
    ) -> None:
        self._rng = rng
        self._given = values or {}
        self.used: dict[str, float] = {}
        #: Names under which something changes gradually; the others choose between forms.
        self.smooth: set[str] = set()

    def share(self, name: str) -> float:
        """A number from 0 to 1."""
        if name not in self.used:
            known = self._given.get(name)
            if known is None:
                known = 0.5 if self._rng is None else float(self._rng.random())
            self.used[name] = known
        return self.used[name]

    def _gradual(self, name: str) -> float:
        self.smooth.add(name)
        return self.share(name)

    def uniform(self, name: str, low: float, high: float) -> float:
        """A number between limits."""
        return rounded(low + (high - low) * self._gradual(name))

    def log(self, name: str, low: float, high: float) -> float:
        """A number between limits, evenly on a logarithmic scale."""
        return rounded(math.exp(math.log(low) + math.log(high / low) * self._gradual(name)))

    def normal(self, name: str, sd: float) -> float:
        """A number from a normal distribution about zero."""
        return rounded(sd * float(ndtri(min(max(self._gradual(name), 1e-6), 1.0 - 1e-6))))

    def within(self, name: str, limits: Range) -> float:
        """A number from a range."""
        draw = self.log if limits.scale == "log" else self.uniform
        return draw(name, limits.low, limits.high)

    def one_of(self, name: str, choices: Sequence[str], shares: Sequence[float]) -> str:
        """One of some words."""
        edges = np.cumsum(shares) / sum(shares)
        return choices[min(int(np.searchsorted(edges, self.share(name), "right")), len(edges) - 1)]


@dataclass(frozen=True, slots=True)
class Fit:
    """What the diagnosis fits of an effect."""

    ranges: Mapping[str, Range]  # of all forms; a parameter that is not named keeps its default
    #: How often each form is tried, relative to the others; empty if the effect has one law.
    forms: Mapping[str, float] = field(default_factory=dict)
    #: Parameters that a form draws, where it does not draw all of ``ranges``.
    parameters: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def drawn(self, name: str, draws: ParameterDraws) -> tuple[str, dict[str, float]]:
        """A form ("" if there is one law alone) and its parameters, for the effect ``name``."""
        form = ""
        if self.forms:
            form = draws.one_of(f"{name}.form", tuple(self.forms), tuple(self.forms.values()))
        keys = self.parameters.get(form, tuple(self.ranges))
        return form, {key: draws.within(f"{name}.{key}", self.ranges[key]) for key in keys}
