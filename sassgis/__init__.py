"""Rockfall hazard zoning in GIS with the SASS model of Bozzolo and Pamini (1986).

The names below are the public interface; everything else may change between versions. Each is
loaded when it is first used, so that ``import sassgis`` is quick.

Runs
    ``load_config`` reads a configuration, ``check_inputs`` says what its files hold, ``run``,
    ``zone`` and ``run_profile`` do what the commands ``run``, ``zone`` and ``profile`` do.
Engine
    ``simulate`` follows blocks down profiles that are given as arrays; ``read_dem`` reads a terrain
    model.
Types
    ``Grid``, ``GroundTable`` and ``GroundClass``, ``BlockPopulation``, ``EngineSettings``,
    ``ControlLine``, ``StopReason``, ``Outcome``.

docs/python.md has examples.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sassgis.engine.simulate import simulate
    from sassgis.io.read.config import load_config
    from sassgis.io.read.dem import read_dem
    from sassgis.model.blocks import BlockPopulation
    from sassgis.model.grid import Grid
    from sassgis.model.ground import GroundClass, GroundTable
    from sassgis.model.results import ControlLine, Outcome, StopReason
    from sassgis.model.settings import EngineSettings
    from sassgis.runs.check_inputs import check_inputs
    from sassgis.runs.profile_run import run_profile
    from sassgis.runs.run import run
    from sassgis.runs.zone import zone

__version__ = "0.1.0"

__all__ = [
    "BlockPopulation",
    "ControlLine",
    "EngineSettings",
    "Grid",
    "GroundClass",
    "GroundTable",
    "Outcome",
    "StopReason",
    "__version__",
    "check_inputs",
    "load_config",
    "read_dem",
    "run",
    "run_profile",
    "simulate",
    "zone",
]

_HOMES = {
    "BlockPopulation": "sassgis.model.blocks",
    "EngineSettings": "sassgis.model.settings",
    "ControlLine": "sassgis.model.results",
    "Grid": "sassgis.model.grid",
    "GroundClass": "sassgis.model.ground",
    "GroundTable": "sassgis.model.ground",
    "Outcome": "sassgis.model.results",
    "StopReason": "sassgis.model.results",
    "check_inputs": "sassgis.runs.check_inputs",
    "load_config": "sassgis.io.read.config",
    "read_dem": "sassgis.io.read.dem",
    "run": "sassgis.runs.run",
    "run_profile": "sassgis.runs.profile_run",
    "simulate": "sassgis.engine.simulate",
    "zone": "sassgis.runs.zone",
}


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module 'sassgis' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
