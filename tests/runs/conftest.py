"""One small run of the sample valley, shared by all tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.input_files import make_dem, make_layer
from helpers.map_bands import read_band

from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.runs.run import RunResult, run
from sassgis.settings.map_run import MapRun
from sassgis.terrain.prepare import Plan, plan

TABLES = {"output.rock_table": "csv", "output.passage_table": "csv"}

__all__ = ["make_dem", "make_layer"]


@dataclass(frozen=True)
class SmallRun:
    """A finished run."""

    config: Path
    folder: Path
    result: RunResult

    def band(self, stem: str, name: str) -> np.ndarray:
        """A band of a map, NaN where it holds nothing."""
        return read_band(self.folder, stem, name).astype(float).filled(np.nan)


@pytest.fixture(scope="session")
def small(make_valley: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> SmallRun:
    config = make_valley()
    folder = tmp_path_factory.mktemp("results") / "valley"
    return SmallRun(config, folder, run(load_config(config, TABLES), folder, jobs=1))


@pytest.fixture(scope="session")
def job(small: SmallRun) -> MapRun:
    return small.result.run


@pytest.fixture(scope="session")
def planned(job: MapRun) -> Plan:
    return plan(job)


@pytest.fixture
def read_job() -> Callable[..., MapRun]:
    def read(config: Path, **overrides: object) -> MapRun:
        dotted = {key.replace("__", "."): value for key, value in overrides.items()}
        return read_map_run(load_config(config, dotted))

    return read
