"""Warnings on observations and models that a user should know before trusting a diagnosis."""

from __future__ import annotations

import numpy as np

from sassgis.gap.constants import LAW_BOUNDS, WARNED_GROUPS, WARNED_LEAVING, WARNED_LIMIT
from sassgis.gap.forward.hypothesis_model import HypothesisModel
from sassgis.gap.observations.case import Case
from sassgis.settings.languages import joined, phrase
from sassgis.settings.run_config import Config


def scenario_warnings(config: Config) -> tuple[str, ...]:
    """Warn that of several block scenarios only one counts."""
    if len(config.blocks) == 1:
        return ()
    text = "Values not measured of a rock are those of the first block scenario ({})."
    return (phrase(text, config.blocks[0].name),)


def group_warnings(case: Case) -> tuple[str, ...]:
    """Warn of too few groups to separate what their members share from a cause."""
    groups = np.unique(case.group).size
    if groups >= WARNED_GROUPS:
        return ()
    text = "The rocks are in {} groups." if groups > 1 else "The rocks are in 1 group."
    found = phrase(text, groups)
    told = phrase(
        "With fewer than {} groups, causes cannot be separated from what the rocks of a group "
        "share. Intervals are far too narrow.",
        WARNED_GROUPS,
    )
    return (joined(" ", (found, told)),)


def stop_warnings(case: Case) -> tuple[str, ...]:
    """Warn that rocks passed the last station without a stop: the farthest may be among them."""
    seen = case.observations
    lying = seen.rock_of("deposits")
    if not (lying >= 0).any() or not case.station_names:
        return ()
    last = seen.passages.station == case.station_names[-1]
    lost = np.setdiff1d(seen.rock_of("passages")[last], [*lying, -1])
    if not lost.size:
        return ()
    text = (
        "Rocks that passed the last station and have no stop: {}. Observed run-outs may be too "
        "short."
    )
    return (phrase(text, lost.size),)


def limit_warnings(case: Case, model: HypothesisModel) -> tuple[str, ...]:
    """Warn that values of the ground are as far as any ground has shown."""
    met = [own for own in model.table.classes if own.name in case.met]
    found = [
        f"{own.name} {name} {getattr(own, name):.2g}"
        for own in met
        for name in LAW_BOUNDS
        if _at_limit(name, getattr(own, name))
    ]
    if not found:
        return ()
    text = (
        "Values at the limit of all known grounds: {}. The contact may follow a law that the "
        "model lacks."
    )
    return (phrase(text, ", ".join(found)),)


def _at_limit(name: str, value: float) -> bool:
    low, high = LAW_BOUNDS[name]
    near = WARNED_LIMIT * (high - low)
    # Most ground has no loss that grows with the speed.
    return high - value < near or (value - low < near and name != "mu_v")


def edge_warnings(before: float, after: float) -> tuple[str, ...]:
    """Warn that rocks leave the terrain, as configured and in the model that is handed over."""
    if max(before, after) < WARNED_LEAVING:
        return ()
    text = (
        "{} % of the rocks as configured and {} % in the calibrated model reach the edge of the "
        "terrain model or the end of their fall line. They count as stopped there. They may come "
        "farther."
    )
    return (phrase(text, *(f"{100.0 * share:.0f}" for share in (before, after))),)
