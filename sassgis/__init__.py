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
    from sassgis.api import hazard_maps as hazard_maps
    from sassgis.api import profile as profile
    from sassgis.api import simulate as simulate
    from sassgis.api import zones as zones
    from sassgis.batches.batch import batch as batch
    from sassgis.errors import ConfigError as ConfigError
    from sassgis.errors import InputError as InputError
    from sassgis.errors import Interrupted as Interrupted
    from sassgis.errors import OutputError as OutputError
    from sassgis.errors import SassgisError as SassgisError
    from sassgis.grid import Grid as Grid
    from sassgis.inputs.config import configure as configure
    from sassgis.inputs.config import load_config as load_config
    from sassgis.inputs.dem import read_dem as read_dem
    from sassgis.outputs.config_template import save_config as save_config
    from sassgis.outputs.site_template import sample_folder as sample_folder
    from sassgis.runs.calibrate import calibrate as calibrate
    from sassgis.runs.check_inputs import check_inputs as check_inputs
    from sassgis.runs.compare import compare as compare
    from sassgis.runs.diagnose import diagnose as diagnose
    from sassgis.runs.profile_run import run_profile as run_profile
    from sassgis.runs.run import run as run
    from sassgis.runs.run import zone as zone
    from sassgis.settings.exposure import ObjectSettings as ObjectSettings
    from sassgis.settings.exposure import RiskSettings as RiskSettings
    from sassgis.settings.ground import GroundClass as GroundClass
    from sassgis.settings.hazard_rules import HazardSettings as HazardSettings
    from sassgis.settings.hazard_rules import ZoningSettings as ZoningSettings
    from sassgis.settings.map_run import Config as Config
    from sassgis.settings.results import Outcome as Outcome
    from sassgis.settings.results import StopReason as StopReason
    from sassgis.settings.settings import BarrierSettings as BarrierSettings
    from sassgis.settings.settings import BlockSettings as BlockSettings
    from sassgis.settings.settings import EngineSettings as EngineSettings
    from sassgis.settings.settings import GroundSettings as GroundSettings
    from sassgis.settings.settings import OutputSettings as OutputSettings
    from sassgis.settings.settings import ProfileSettings as ProfileSettings
    from sassgis.settings.settings import ProjectSettings as ProjectSettings
    from sassgis.settings.settings import ReleaseSettings as ReleaseSettings
    from sassgis.settings.settings import RunSettings as RunSettings
    from sassgis.settings.settings import StationSettings as StationSettings
    from sassgis.settings.settings import TerrainSettings as TerrainSettings

__version__ = "0.1.0"

_NAMES = {
    "inputs.config": "configure load_config",
    "inputs.dem": "read_dem",
    "outputs.config_template": "save_config",
    "outputs.site_template": "sample_folder",
    "errors": "ConfigError InputError Interrupted OutputError SassgisError",
    "settings.exposure": "ObjectSettings RiskSettings",
    "grid": "Grid",
    "settings.ground": "GroundClass",
    "settings.hazard_rules": "HazardSettings ZoningSettings",
    "settings.results": "Outcome StopReason",
    "settings.map_run": "Config",
    "settings.settings": "BarrierSettings BlockSettings EngineSettings GroundSettings "
    "OutputSettings ProfileSettings ProjectSettings ReleaseSettings RunSettings StationSettings "
    "TerrainSettings",
    "batches.batch": "batch",
    "runs.calibrate": "calibrate",
    "runs.check_inputs": "check_inputs",
    "runs.compare": "compare",
    "runs.diagnose": "diagnose",
    "runs.profile_run": "run_profile",
    "runs.run": "run zone",
    "api": "hazard_maps profile simulate zones",
}
_HOMES = {name: f"sassgis.{home}" for home, names in _NAMES.items() for name in names.split()}
if not TYPE_CHECKING:
    # What checks types reads the imports above.
    __all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module 'sassgis' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(["__version__", *_HOMES])
