"""Rockfall hazard zoning in GIS with the SASS model of Bozzolo and Pamini (1986).

The names below are the public interface; everything else may change between versions. Each is
loaded when it is first used, so that ``import sassgis`` is quick.

Runs
    ``load_config`` reads a configuration, ``check_inputs`` says what its files hold, ``run``,
    ``zone`` and ``run_profile`` do what the commands ``run``, ``zone`` and ``profile`` do.
Engine
    ``simulate`` follows rocks down profiles that are given as arrays; ``read_dem`` reads a terrain
    model.
Types
    ``Grid``, ``GroundTable`` and ``GroundClass``, ``BlockPopulation``, ``EngineSettings``,
    ``Gate``, ``StopReason``, ``Outcome``.

docs/python.md has examples.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sassgis.core.blocks import BlockPopulation
    from sassgis.core.grid import Grid
    from sassgis.core.ground import GroundClass, GroundTable
    from sassgis.core.results import Gate, Outcome, StopReason
    from sassgis.core.settings import EngineSettings
    from sassgis.engine.simulate import simulate
    from sassgis.io.check import check_inputs
    from sassgis.io.config import load_config
    from sassgis.io.dem import read_dem
    from sassgis.workflow.profile_run import run_profile
    from sassgis.workflow.run import run
    from sassgis.workflow.zone import zone

__version__ = "0.1.0"

__all__ = [
    "BlockPopulation",
    "EngineSettings",
    "Gate",
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
    "BlockPopulation": "sassgis.core.blocks",
    "EngineSettings": "sassgis.core.settings",
    "Gate": "sassgis.core.results",
    "Grid": "sassgis.core.grid",
    "GroundClass": "sassgis.core.ground",
    "GroundTable": "sassgis.core.ground",
    "Outcome": "sassgis.core.results",
    "StopReason": "sassgis.core.results",
    "check_inputs": "sassgis.io.check",
    "load_config": "sassgis.io.config",
    "read_dem": "sassgis.io.dem",
    "run": "sassgis.workflow.run",
    "run_profile": "sassgis.workflow.profile_run",
    "simulate": "sassgis.engine.simulate",
    "zone": "sassgis.workflow.zone",
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
