"""Scores on rocks that were left out, and by groups of rocks."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from field_cases.scores import misfit, part, quantiles, score
from field_cases.sites import Simulated, Site, halves, run_out

#: Parameter sets that are listed as about as good as the best one.
SHOWN = 6


def held_out(
    sites: Mapping[str, Site],
    sets: Sequence[Mapping[str, float]],
    made: Mapping[str, Sequence[Simulated]],
) -> dict[str, Any]:
    """Calibrated on halves of one site or of both, scored on the other halves and sites."""
    report: dict[str, Any] = {}
    split = {name: halves(site) for name, site in sites.items()}
    error = {
        (name, half): np.array([misfit(site, m, split[name][half]) for m in made[name]])
        for (name, site), half in itertools.product(sites.items(), (0, 1))
    }
    ways = {name: (name,) for name in sites} | {"both": tuple(sites)}
    for (way, used), half in itertools.product(ways.items(), (0, 1)):
        best = int(np.argmin(sum(error[name, half] for name in used)))
        entry: dict[str, Any] = {"set": dict(sets[best])}
        for name, site in sites.items():
            rocks = split[name][1 - half] if name in used else range(len(site))
            entry[name] = score(site.take(list(rocks)), part(made[name][best], rocks))
        report[f"{way}, half {half + 1}"] = entry
    together = sum(error[name, half] for name, half in error)
    order = np.argsort(together)[:SHOWN]
    report["about as good on all rocks of both"] = [
        {"set": dict(sets[i]), "energy_distance": float(together[i]),
         **{name: score(site, made[name][i])["error"] for name, site in sites.items()}}
        for i in order
    ]  # fmt: skip
    return report


def by_group(sites: Mapping[str, Site], made: Mapping[str, Simulated]) -> dict[str, Any]:
    """Run-out of each group of rocks: 10, 50 and 90 % (m)."""
    report: dict[str, Any] = {}
    for name, site in sites.items():
        for label in sorted(set(site.labels)):
            own = [i for i, group in enumerate(site.labels) if group == label]
            rows = run_out(site, made[name].stops)[own]
            report[f"{name}: {label}"] = {
                "rocks": len(own),
                "observed_m": quantiles(run_out(site, site.stops)[own, 0]),
                "simulated_m": quantiles(rows[made[name].started[own]][:, 0]),
            }
    return report
