"""All settings of a run together, as they go from stage to stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sassgis.errors import ConfigError
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.effects import EffectSettings
from sassgis.settings.exposure import ObjectSettings, RiskSettings
from sassgis.settings.hazard_rules import EditSettings, HazardSettings, Onset, ZoningSettings
from sassgis.settings.schema import Input, declared
from sassgis.settings.settings import (
    BarrierSettings,
    EngineSettings,
    ForestPlace,
    GroundSettings,
    OutputSettings,
    ProfileSettings,
    ProjectSettings,
    ReleaseSettings,
    RunSettings,
    StationSettings,
    TerrainSettings,
)


@dataclass(frozen=True, slots=True)
class Config:
    """What the user configured, checked in itself but not yet against the files it names.

    Names of blocks are unique, and those of stations and barriers together. Paths are absolute.
    """

    file: Path | None  # None where a program made it
    project: ProjectSettings
    terrain: TerrainSettings
    release: ReleaseSettings
    ground: GroundSettings
    blocks: tuple[BlockPopulation, ...]  # at least one
    stations: tuple[StationSettings, ...]
    barriers: tuple[BarrierSettings, ...]
    engine: EngineSettings
    effects: EffectSettings  # those that are on
    trees: ForestPlace | None  # where the forest of ``[effects.trees]`` stands
    profile: ProfileSettings | None  # None if the file has no ``[profile]``
    hazard: HazardSettings
    zones: ZoningSettings
    edits: EditSettings
    risk: RiskSettings
    objects: tuple[ObjectSettings, ...]
    run: RunSettings
    output: OutputSettings
    onsets: dict[str, Onset]  # by the name of the block scenario
    # What the user should know of the file, as keys that have a new name.
    notes: tuple[str, ...] = ()
    # What was given, section by section, and the folder from which its paths are seen.
    given: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)
    base: Path = field(default_factory=Path, compare=False, repr=False)

    @property
    def label(self) -> str:
        """Name of the file, for reports."""
        return "made by a program" if self.file is None else self.file.name

    @property
    def dem_source(self) -> Input:
        """The DEM; ConfigError if the file names none (it may, for profile runs)."""
        if self.terrain.dem is None:
            raise _missing(self.file, "terrain", TerrainSettings, "dem")
        return self.terrain.dem

    @property
    def release_source(self) -> Input:
        """The release areas; ConfigError if the file names none."""
        if self.release.file is None:
            raise _missing(self.file, "release", ReleaseSettings, "file")
        return self.release.file

    @property
    def block_names(self) -> tuple[str, ...]:
        """Names of the block scenarios, in the order of the file."""
        return tuple(block.name for block in self.blocks)


def _missing(file: Path | None, section: str, cls: type, key: str) -> ConfigError:
    return ConfigError(
        "missing key", file=file, field=f"{section}.{key}", expected=declared(cls)[key].description
    )
