"""Ground classes on which an effect may act, and the reaches that they lie on."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np

from sassgis.gap.causes.cause import Placing
from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel

#: Ground on which nothing yields and no block lies loose.
HARD = ("rock", "asphalt")


def _yielding(case: Case) -> list[str]:
    """Classes that profiles cross, but for hard ones if there are others."""
    present = [case.table.classes[k].name for k in np.unique(case.profiles.ground).tolist()]
    return [name for name in present if name not in HARD] or present


def soft_first(case: Case) -> list[str]:
    """Classes that are not hard, the softest first."""
    return sorted(
        _yielding(case), key=lambda name: case.table.classes[case.table.index(name)].eta_max
    )


def loose_classes(case: Case, draws: ParameterDraws) -> tuple[str, ...]:
    """Classes with loose blocks."""
    loose = _yielding(case)
    # Meadows are commonly free of stones.
    if len(loose) > 1 and draws.share("loose_classes") < 0.6:
        loose = soft_first(case)[1:]
    return tuple(loose)


def on_its_classes(effect: str) -> Placing:
    """Reaches with the classes that most fitted models have an effect on; all without any."""

    def place(case: Case, models: Sequence[HypothesisModel]) -> tuple[str, ...]:
        effects = [model.effects.named(effect) for model in models]
        counts = Counter(name for own in effects for name in getattr(own, "classes", ()))
        classes = [name for name, n in counts.items() if 2 * n > len(models)]
        return reaches_on(case, classes) if classes else case.reaches

    return place


def reaches_between(case: Case, low: float, high: float) -> tuple[str, ...]:
    """Reaches that a stretch of chainage touches (m)."""
    # Medians over the rocks.
    inner = np.nanmedian(case.station_s, axis=0).tolist() if case.station_names else []
    edges = [-np.inf, *inner, np.inf]
    return tuple(
        name
        for name, start, end in zip(case.reaches, edges[:-1], edges[1:], strict=True)
        if low < end and high > start
    )


def reaches_on(case: Case, classes: Sequence[str]) -> tuple[str, ...]:
    """Reaches in which the profiles cross any of some ground classes."""
    wanted = [k for k, name in enumerate(case.table.names) if name in classes]
    found: set[str] = set()
    source = case.profiles
    for line in np.unique(case.line).tolist():
        own = slice(int(source.offset[line]), int(source.offset[line + 1]) - 1)
        ends = itertools.pairwise(source.s[own.start : own.stop + 1].tolist())
        for (low, high), ground in zip(ends, source.ground[own].tolist(), strict=True):
            if ground in wanted and high > 0.0:
                found.update(reaches_between(case, low, high))
    return tuple(name for name in case.reaches if name in found)
