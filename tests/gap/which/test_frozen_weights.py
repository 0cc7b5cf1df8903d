"""The frozen weights and the page about them are those of the committed rows."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sassgis.io.read.gap_thresholds import cause_weights_of, read_thresholds


@pytest.fixture(scope="module")
def study(repository: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "gap_weights", repository / "docs" / "studies" / "gap_weights.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_weights_are_those_of_the_rows(study: ModuleType) -> None:
    rows = study.read_rows()
    found = json.loads(study.RESULTS.read_text(encoding="utf-8"))
    assert found["sites"] == len(rows) >= 150
    cause = study.causes_of(rows)
    known = cause >= 0
    counts = study.counts_of(study.z_of(rows))[known]
    weights, offset = study.fitted(counts, cause[known], found["ridge"])
    frozen = cause_weights_of(read_thresholds())
    # Causes and fingerprints that no site has had yet follow.
    n, k = weights.shape
    assert frozen.causes[:n] == study.CAUSES and frozen.sharpness == found["sharpness"]
    np.testing.assert_allclose(frozen.weights[:n, :k], weights, atol=0.02)
    np.testing.assert_allclose(frozen.offset[:n], offset, atol=0.02)


def test_the_page_has_the_figures_of_the_results(study: ModuleType) -> None:
    text = study.PAGE.read_text(encoding="utf-8")
    assert study.filled(text) == text


def test_the_sites_are_those_of_the_rows(study: ModuleType) -> None:
    for name, design in study.TABLES.items():
        sites = dict(study.sites(*design))
        for row in study.read_rows(name):
            spec = sites[int(row.get("seed") or row["site"])]
            assert (spec.law, spec.kind, spec.n_rocks) == (
                row["law"], row["kind"], int(row["rocks"]),
            )  # fmt: skip
            assert "+".join(e.name for e in spec.effects) == row["effects"]
