"""Rockfall hazard zoning in GIS with the SASS model of Bozzolo and Pamini (1986).

The names below are the public interface; everything else may change between versions. Each is
loaded when it is first used, so that ``import sassgis`` is quick.

In memory
    ``simulate`` gives maps as an xarray.Dataset, ``zones`` and ``hazard_maps`` the hazard of such a
    dataset, ``profile`` tables of a single profile. Nothing is written.
Configurations
    ``configure`` makes one from a program, ``load_config`` reads one, ``save_config`` writes it
    down, ``check_inputs`` says what its inputs hold.
Results in folders
    ``run``, ``zone``, ``run_profile``, ``batch`` and ``compare`` do what the commands do.
Observations
    ``calibrate`` fits ground classes, ``diagnose`` says where a gap lies and what causes it.
Types
    ``GroundClass``, ``Grid``, ``StopReason``, ``Outcome``, the sections of a configuration
    (``TerrainSettings`` and so on), and the errors.

docs/python.md has examples.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sassgis.io.read.config import configure, load_config
    from sassgis.io.read.dem import read_dem
    from sassgis.io.write.config_file import save_config
    from sassgis.model.errors import (
        ConfigError,
        InputError,
        Interrupted,
        OutputError,
        SassgisError,
    )
    from sassgis.model.exposure import ObjectSettings, RiskSettings
    from sassgis.model.grid import Grid
    from sassgis.model.ground import GroundClass
    from sassgis.model.hazard import HazardSettings, ZoningSettings
    from sassgis.model.results import Outcome, StopReason
    from sassgis.model.run_config import Config
    from sassgis.model.settings import (
        BarrierSettings,
        BlockSettings,
        EngineSettings,
        GroundSettings,
        OutputSettings,
        ProfileSettings,
        ProjectSettings,
        ReleaseSettings,
        RunSettings,
        StationSettings,
        TerrainSettings,
    )
    from sassgis.runs.batch import batch
    from sassgis.runs.calibrate import calibrate
    from sassgis.runs.check_inputs import check_inputs
    from sassgis.runs.compare import compare
    from sassgis.runs.diagnose import diagnose
    from sassgis.runs.profile_run import run_profile
    from sassgis.runs.run import run
    from sassgis.runs.samples import sample_folder
    from sassgis.runs.without_files import hazard_maps, profile, simulate, zones
    from sassgis.runs.zone import zone

__version__ = "0.1.0"

__all__ = [
    "BarrierSettings",
    "BlockSettings",
    "Config",
    "ConfigError",
    "EngineSettings",
    "Grid",
    "GroundClass",
    "GroundSettings",
    "HazardSettings",
    "InputError",
    "Interrupted",
    "ObjectSettings",
    "Outcome",
    "OutputError",
    "OutputSettings",
    "ProfileSettings",
    "ProjectSettings",
    "ReleaseSettings",
    "RiskSettings",
    "RunSettings",
    "SassgisError",
    "StationSettings",
    "StopReason",
    "TerrainSettings",
    "ZoningSettings",
    "__version__",
    "batch",
    "calibrate",
    "check_inputs",
    "compare",
    "configure",
    "diagnose",
    "hazard_maps",
    "load_config",
    "profile",
    "read_dem",
    "run",
    "run_profile",
    "sample_folder",
    "save_config",
    "simulate",
    "zone",
    "zones",
]

_NAMES = {
    "io.read.config": "configure load_config",
    "io.read.dem": "read_dem",
    "io.write.config_file": "save_config",
    "model.errors": "ConfigError InputError Interrupted OutputError SassgisError",
    "model.exposure": "ObjectSettings RiskSettings",
    "model.grid": "Grid",
    "model.ground": "GroundClass",
    "model.hazard": "HazardSettings ZoningSettings",
    "model.results": "Outcome StopReason",
    "model.run_config": "Config",
    "model.settings": "BarrierSettings BlockSettings EngineSettings GroundSettings OutputSettings "
    "ProfileSettings ProjectSettings ReleaseSettings RunSettings StationSettings TerrainSettings",
    "runs.batch": "batch",
    "runs.calibrate": "calibrate",
    "runs.check_inputs": "check_inputs",
    "runs.compare": "compare",
    "runs.diagnose": "diagnose",
    "runs.profile_run": "run_profile",
    "runs.run": "run",
    "runs.samples": "sample_folder",
    "runs.without_files": "hazard_maps profile simulate zones",
    "runs.zone": "zone",
}
_HOMES = {name: f"sassgis.{home}" for home, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module 'sassgis' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
