"""Mean and spread of a class between sites: closed forms, an integral over both, coverage."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sassgis.gap.calibration import class_spread as module
from sassgis.gap.calibration.class_spread import (
    SiteValue,
    between_sites,
    class_spread,
    site_values,
    spread_of_sites,
)
from sassgis.gap.calibration.parameters import RANGES, ClassParameter
from sassgis.io.read.ground_map import built_in_table
from sassgis.io.read.range_table import read_ranges
from sassgis.io.write.frames import write_table
from sassgis.io.write.sensitivity_tables import rule_table
from sassgis.model.errors import InputError
from sassgis.model.ground_ranges import ranges_of

VALUES, ERRORS = np.array([0.55, 0.70, 0.48]), np.array([0.03, 0.05, 0.02])


def test_one_site_leaves_the_spread_as_it_was() -> None:
    found = between_sites(np.array([0.6]), np.array([0.04]), 0.1)
    assert (found.mean, found.sd) == pytest.approx((0.6, 0.1 * np.sqrt(2.0 / np.pi)), rel=1e-6)
    # The new site lies about the mean, and the known one about it too.
    assert found.mean_error == pytest.approx(np.sqrt(0.04**2 + 0.1**2), rel=1e-6)
    assert found.predictive_sd == pytest.approx(np.sqrt(0.04**2 + 2.0 * 0.1**2), rel=1e-6)


def test_sites_that_are_all_alike_have_the_weighted_mean() -> None:
    found = between_sites(VALUES, ERRORS, 1e-4)
    weight = ERRORS**-2.0
    assert found.mean == pytest.approx((weight * VALUES).sum() / weight.sum(), rel=1e-3)
    assert found.mean_error == pytest.approx(weight.sum() ** -0.5, rel=1e-3)
    assert found.predictive_sd == pytest.approx(weight.sum() ** -0.5, rel=1e-3)


def test_the_quadrature_is_the_integral_over_mean_and_spread() -> None:
    mu = np.linspace(-1.0, 2.0, 6001)[:, None]
    tau = np.linspace(0.0, 0.8, 1601)
    log = -0.5 * (tau / 0.1) ** 2
    for value, error in zip(VALUES, ERRORS, strict=True):
        total = error**2 + tau**2
        log = log - 0.5 * np.log(total) - 0.5 * (value - mu) ** 2 / total
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = (weight * mu).sum()
    variance = (weight * (mu - mean) ** 2).sum()
    found = between_sites(VALUES, ERRORS, 0.1)
    assert found.mean == pytest.approx(mean, abs=1e-4)
    assert found.mean_error == pytest.approx(np.sqrt(variance), rel=1e-3)
    assert found.sd == pytest.approx((weight * tau).sum(), rel=1e-3)
    assert found.predictive_sd == pytest.approx(
        np.sqrt(variance + (weight * tau**2).sum()), rel=1e-3
    )


def test_a_third_site_lies_within_the_range_of_two() -> None:
    rng = np.random.default_rng(4)
    inside, n = 0, 1500
    for _ in range(n):
        spread = abs(rng.normal(0.0, 0.1))
        sites, error = rng.normal(0.5, spread, 3), np.array([0.03, 0.05])
        found = between_sites(rng.normal(sites[:2], error), error, 0.1)
        inside += abs(sites[2] - found.mean) < 1.645 * found.predictive_sd
    # 90 %, and 0.8 % of chance.
    assert 0.87 < inside / n < 0.94


@pytest.mark.parametrize(("errors", "scale"), [([0.0, 0.1], 0.1), ([0.1, 0.1], 0.0)])
def test_what_cannot_be_told_is_refused(errors: list[float], scale: float) -> None:
    with pytest.raises(InputError, match=r"spread between sites cannot be told.*above 0"):
        between_sites(np.array([0.5, 0.6]), np.array(errors), scale)


def test_the_table_is_read_again_and_goes_before_what_was_assumed(tmp_path: Path) -> None:
    table = built_in_table()
    before = ranges_of(table, ["talus"], read_ranges(table), ["eta_max", "mu_f"])
    sites = [
        SiteValue("A", "talus", "eta_max", 0.97, 0.02, 30),
        SiteValue("B", "talus", "eta_max", 0.95, 0.02, 12),
        SiteValue("B", "rock", "mu_f", 0.7, 0.1, 12),
    ]
    (rule,) = class_spread(sites, before)
    file = tmp_path / "class_spread.csv"
    write_table(file, [rule_table([rule])])
    (read,) = ranges_of(table, ["talus"], read_ranges(table, file), ["eta_max"])
    assert (read.sites, read.rocks, read.high) == (2, 42, 1.0)
    told = between_sites(np.array([0.97, 0.95]), np.array([0.02, 0.02]), before[0].sd)
    assert rule.low == pytest.approx(told.mean - 1.645 * told.predictive_sd)
    assert "A, B: mean 0.96" in read.source


class Bowls:
    """Squared distances of the first parameter from the centres of the rocks of each site."""

    def __init__(self, *centres: np.ndarray) -> None:
        self.centres, self.sizes = centres, [c.size for c in centres]
        self.columns = [np.array([0, 1])] * len(centres)

    def weighted(self, weights: list[np.ndarray], _rng: object) -> Any:
        total = sum(w.sum() for w in weights)
        best = sum(float(w @ c) for w, c in zip(weights, self.centres, strict=True)) / total
        # Of the second parameter the scores say nothing: the search ends where it begins.
        return SimpleNamespace(minimum=lambda own: (np.array([best, own[0, 1]]), 0.0))


def test_the_error_of_a_site_is_that_of_the_mean_of_its_rocks(monkeypatch) -> None:
    rng = np.random.default_rng(1)
    centres = rng.normal(0.3, 0.1, 40), rng.normal(0.7, 0.2, 10)
    ranges = RANGES["mu_0"]
    parameters = (
        ClassParameter("rock", "mu_0", ranges, 0.4), ClassParameter("debris", "mu_0", ranges, 0.4),
    )  # fmt: skip
    table = built_in_table()
    met = {"A": ("rock", "debris"), "B": ("rock",)}
    sites = tuple(
        SimpleNamespace(name=n, n_rocks=c.size, case=SimpleNamespace(table=table, met=met[n]))
        for n, c in zip("AB", centres, strict=True)
    )
    monkeypatch.setattr(module, "classes_met", lambda case: case.met)
    task: Any = SimpleNamespace(sites=sites, parameters=parameters, seed=3)
    found: Any = SimpleNamespace(surface=Bowls(*centres))
    values = {(v.site, v.class_name): v for v in site_values(task, found)}
    assert set(values) == {("A", "rock"), ("A", "debris"), ("B", "rock")}
    width = ranges.high - ranges.low
    for name, own in zip("AB", centres, strict=True):
        error = width * max(own.std() / np.sqrt(own.size), 0.02)
        told = values[name, "rock"]
        assert told.value == pytest.approx(ranges.low + width * own.mean(), abs=error)
        assert told.error == pytest.approx(error, rel=0.3) and told.rocks == own.size
    # What is not told scatters over its range, as a uniform distribution does.
    assert values["A", "debris"].error == pytest.approx(width / np.sqrt(12.0), rel=0.25)
    # Each class by the sites whose rocks meet it, from the spread that was assumed before.
    rules = {r.class_name: r for r in spread_of_sites(task, found, read_ranges(table))}
    assert [(name, r.sites, r.rocks) for name, r in rules.items()] == [
        ("rock", 2, 50),
        ("debris", 1, 40),
    ]
