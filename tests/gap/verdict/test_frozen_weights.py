"""The frozen weights and the page about them are those of the committed rows."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.scripts import load

from sassgis.inputs.observation_values import cause_weights_of, read_thresholds


@pytest.fixture(scope="module")
def study(repository: Path) -> ModuleType:
    return load(repository / "docs" / "studies" / "gap_weights.py")


@pytest.mark.battery
def test_the_weights_are_those_of_the_rows(study: ModuleType) -> None:
    rows = study.read_rows()
    assert json.loads(study.RESULTS.read_text(encoding="utf-8"))["sites"] == len(rows) >= 40
    frozen, weights = cause_weights_of(read_thresholds()), study.fitted(rows)
    np.testing.assert_allclose(frozen.weights, weights.weights, atol=0.02)
    for name in study.NUMBERS:
        assert getattr(frozen, name) == pytest.approx(getattr(weights, name), abs=0.02)
    assert frozen.farthest == pytest.approx(weights.farthest, abs=0.1)


def test_the_page_has_the_figures_of_the_results(study: ModuleType) -> None:
    for page, filled in ((study.PAGE, study.filled), (study.GAP_PAGE, study.with_headline)):
        text = page.read_text(encoding="utf-8")
        assert filled(text) == text
