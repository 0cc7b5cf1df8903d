"""The study of other ways of sampling: blocks that are split come as far as others do."""

from __future__ import annotations

import numpy as np
import pytest

import docs.studies.sampling as study
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run


@pytest.mark.battery
def test_splitting_keeps_all_weight_and_changes_no_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "POINTS", 2)
    points = study.Points(read_map_run(load_config(study.VALLEY)))
    seed, n = np.random.default_rng(5), 4096
    waste = np.zeros(study.ROOM)

    def followed(levels: list[float], copies: int, far: list[float]) -> tuple[np.ndarray, ...]:
        unit = study.units(study.PLAIN, seed, n)
        own = np.array(levels), copies, np.array(far)
        came, furthest, _ = points.follow(0, unit, seed, *own, waste)
        return came, furthest

    _, furthest = followed([], 1, [])
    levels = np.quantile(furthest, [0.5, 0.8, 0.9]).tolist()
    far = [-0.5, *np.quantile(furthest, [0.4, 0.9, 0.97])]
    plain, split = followed([], 1, far)[0], followed(levels, 3, far)[0]
    assert plain[0] == split[0] == 1.0
    # Below the first level nothing is split, beyond the last the variance is no larger.
    error = np.sqrt(plain * (1.0 - plain) / n + 1e-12)
    assert (np.abs(split - plain) <= 4.0 * np.sqrt(2.0) * error).all()
