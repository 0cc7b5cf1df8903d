"""Scores on rocks that were left out and at the other site, by groups; ranges of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from field_cases.scores import RANGES, misfit, part, quantiles, width
from field_cases.sites import Simulated, Site, halves, run_out, simulated, table_of
from sassgis.model.settings import EngineSettings

FloatArray = NDArray[np.float64]

#: Random divisions of the rocks into halves; each half is fitted on once.
DIVISIONS = 10
#: Parameter sets that are listed as about as good as the best one.
SHOWN = 6
#: Values of a parameter that are tried alone, and draws of the rocks for each.
STEPS = 9
DRAWS = 100
#: Share of the draws in which a value must do at least as well as that of the class.
AS_GOOD = 0.05


def held_out(
    sites: Mapping[str, Site],
    sets: Sequence[Mapping[str, float]],
    made: Mapping[str, Sequence[Simulated]],
) -> dict[str, Any]:
    """Calibrated on random halves of each site, scored on the other half and at the other site."""
    report: dict[str, Any] = {}
    for name, site in sites.items():
        rows: dict[str, list[FloatArray]] = {"left_out": [], "halves_observed": []}
        rows |= {f"at {other}": [] for other in sites if other != name}
        for division in range(DIVISIONS):
            two = halves(site, 2014 + division)
            for fit, left in (two, two[::-1]):
                best = int(np.argmin([misfit(site, m, fit) for m in made[name]]))
                rows["left_out"].append(_errors(site.take(left), part(made[name][best], left)))
                rows["halves_observed"].append(_between(site.take(fit), site.take(left)))
                for other in sites:
                    if other != name:
                        rows[f"at {other}"].append(_errors(sites[other], made[other][best]))
        distance = [misfit(site, m, range(len(site))) for m in made[name]]
        report[name] = {
            "halves": 2 * DIVISIONS,
            "rocks_left_out": len(site) // 2,
            **{key: _summary(np.array(found)) for key, found in rows.items()},
            "about as good on all rocks": [
                {"set": dict(sets[i]), "energy_distance": distance[i],
                 "error": _errors(site, made[name][i])}
                for i in np.argsort(distance)[:SHOWN]
            ],
        }  # fmt: skip
    return report


def _measures(rows: FloatArray) -> FloatArray:
    """Median and 90 % quantile of the run-out, width of the offset (m)."""
    return np.array([*quantiles(rows[:, 0])[1:], width(rows[:, 1])])


def _errors(site: Site, made: Simulated) -> FloatArray:
    """Relative errors of median, 90 % quantile and width."""
    rows = run_out(site, made.stops)[made.started]
    return _measures(rows) / _measures(run_out(site, site.stops)) - 1.0


def _between(site: Site, other: Site) -> FloatArray:
    """The same, of the observed stops of some rocks against those of others."""
    rows = (run_out(s, s.stops) for s in (site, other))
    one, two = (_measures(r) for r in rows)
    return one / two - 1.0


def _summary(errors: FloatArray) -> dict[str, Any]:
    """Of the errors over the halves: 10, 50, 90 % and the root of the mean square."""
    return {
        key: {"quantiles": quantiles(own), "rms": float(np.sqrt(np.mean(own**2)))}
        for key, own in zip(("median", "q90", "width"), errors.T, strict=True)
    }


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


def with_class_of(site: Site, other: Site) -> Site:
    """A site with the class that was calibrated at the other one on its slope."""
    return replace(site, classes=(other.classes[0], *site.classes[1:]))


def ranges(site: Site, settings: EngineSettings, count: int, seed: int = 1986) -> dict[str, Any]:
    """Values of single parameters of the class with which the stops are met about as well.

    A value is within the range if, the other parameters as they are, its energy distance is at most
    that of the class in a share AS_GOOD of random draws of the observed rocks.
    """
    name = site.classes[0]
    own = table_of(site).classes[0]
    draw = np.random.default_rng(seed)
    drawn = [draw.integers(0, len(site), len(site)).tolist() for _ in range(DRAWS)]

    def distances(changes: Mapping[str, float]) -> FloatArray:
        made = simulated(site, table_of(site, {name: changes}), settings, count)
        return np.array([misfit(site, made, rocks) for rocks in drawn])

    base = distances({})
    found: dict[str, Any] = {}
    for parameter, (low, high) in RANGES.items():
        value = float(getattr(own, parameter))
        good = [value]
        for tried in np.linspace(low, high, STEPS).tolist():
            if np.mean(distances({parameter: tried}) <= base) >= AS_GOOD:
                good.append(tried)
        found[parameter] = {
            "value": value,
            "low": min(good),
            "high": max(good),
            "tried": [low, high],
        }
    return found
