"""Mean and spread of a class between sites: closed forms, an integral over both, coverage."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sassgis.errors import InputError
from sassgis.gap.fit import class_calibration as module
from sassgis.gap.fit.class_calibration import (
    SiteValue,
    between_sites,
    class_spread,
    site_values,
    spread_of_sites,
)
from sassgis.gap.fit.parameters import RANGES, ClassParameter, Estimated
from sassgis.inputs.ground_map import built_in_table, read_ranges
from sassgis.outputs.frames import write_table
from sassgis.outputs.layers.variant_layers import rule_table
from sassgis.settings.ground import ranges_of

VALUES, ERRORS = np.array([0.55, 0.70, 0.48]), np.array([0.03, 0.05, 0.02])


def test_one_site_leaves_the_spread_as_it_was() -> None:
    found = between_sites(np.array([0.6]), np.array([0.04]), 0.1)
    assert (found.mean, found.sd) == pytest.approx((0.6, 0.1 * np.sqrt(2.0 / np.pi)), rel=1e-6)
    # The new site lies about the mean, and the known one about it too.
    assert found.mean_error == pytest.approx(np.sqrt(0.04**2 + 0.1**2), rel=1e-6)
    assert found.predictive_sd == pytest.approx(np.sqrt(0.04**2 + 2.0 * 0.1**2), rel=1e-6)


def test_the_quadrature_is_the_integral_over_mean_and_spread() -> None:
    mu = np.linspace(-1.0, 2.0, 3001)[:, None]
    tau = np.linspace(0.0, 0.8, 801)
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
    with pytest.raises(InputError, match=r"spread between sites cannot be estimated.*above 0"):
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
    estimated = between_sites(np.array([0.97, 0.95]), np.array([0.02, 0.02]), before[0].sd)
    assert rule.low == pytest.approx(estimated.mean - 1.645 * estimated.predictive_sd)
    assert "A, B: mean 0.96" in read.source


def estimated(precision: tuple[float, float], at: float) -> Estimated:
    """Of the first of two parameters, about a best value of zero; of the second nothing."""
    first, second = precision
    pull = np.array([first * at, 0.0])
    return Estimated(np.zeros(2), np.diag([first, 0.0]), pull, pull[None], np.diag([second, 0.0]))


def test_the_error_of_a_site_is_that_of_its_rocks(monkeypatch) -> None:
    ranges = RANGES["mu_0"]
    parameters = tuple(ClassParameter(n, "mu_0", ranges, 0.4, 0.1) for n in ("rock", "debris"))
    table = built_in_table()
    met = {"A": ("rock", "debris"), "B": ("rock",)}
    sites = tuple(
        SimpleNamespace(name=n, n_rocks=m, case=SimpleNamespace(table=table, met=met[n]))
        for n, m in (("A", 40), ("B", 10))
    )
    monkeypatch.setattr(module, "classes_met", lambda case: case.met)
    task: Any = SimpleNamespace(sites=sites, parameters=parameters, seed=3)
    # The rocks of B scatter twice as much as their numbers say if each is independent.
    found: Any = SimpleNamespace(
        estimated=(estimated((25.0, 25.0), 0.5), estimated((16.0, 64.0), -1.0))
    )
    values = {(v.site, v.class_name): v for v in site_values(task, found)}
    assert set(values) == {("A", "rock"), ("A", "debris"), ("B", "rock")}
    # One standard deviation of the prior is a tenth of the range.
    width, unit = ranges.high - ranges.low, 0.1 * (ranges.high - ranges.low)
    for name, at, error in (("A", 0.5, 0.2), ("B", -1.0, 0.5)):
        own = values[name, "rock"]
        assert own.value == pytest.approx(0.4 + at * unit, abs=0.05 * unit)
        assert own.error == pytest.approx(error * unit, rel=0.05)
    # What is not estimated scatters over its range.
    assert values["A", "debris"].error > width / np.sqrt(12.0)
    # Each class by the sites whose rocks meet it, from the spread that was assumed before.
    rules = {r.class_name: r for r in spread_of_sites(task, found, read_ranges(table))}
    assert [(name, r.sites, r.rocks) for name, r in rules.items()] == [
        ("rock", 2, 50),
        ("debris", 1, 40),
    ]
