"""Inputs of a run on the map, and what it keeps of single blocks and lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.errors import ConfigError
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.blocks import BlockPopulation, EffectSettings, ForestPlace
from sassgis.settings.exposure import ObjectSettings, RiskSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.hazard_rules import EditSettings, HazardSettings, Onset, ZoningSettings
from sassgis.settings.languages import phrase
from sassgis.settings.results import ControlLine
from sassgis.settings.schema import Input, declared
from sassgis.settings.settings import (
    BarrierSettings,
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


@dataclass(frozen=True, slots=True)
class ObjectCells:
    """The cells of exposed objects."""

    n_objects: int
    cell: IntArray  # shape (n,); flat indices of cells, ascending
    number: IntArray  # shape (n,); the object that covers the cell; a cell may belong to several

    @classmethod
    def none(cls) -> ObjectCells:
        """Return a set of no objects."""
        return cls(0, np.empty(0, np.int64), np.empty(0, np.int64))

    def under(self, cells: IntArray) -> tuple[IntArray, IntArray]:
        """Return the objects on each of some cells (flat indices, ascending)."""
        first = np.searchsorted(self.cell, cells, side="left")
        size = np.searchsorted(self.cell, cells, side="right") - first
        offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        take = np.repeat(first - offset[:-1], size) + np.arange(offset[-1])
        return offset, np.asarray(self.number, np.int64)[take]


@dataclass(frozen=True, slots=True)
class Forest:
    """Stems on the cells of the grid."""

    stems_per_m2: FloatArray  # shape (n_rows * n_cols,)
    diameter_m: FloatArray  # shape (n_rows * n_cols,); at breast height


@dataclass(frozen=True, slots=True)
class Window:
    """A disk around the centre of each cell, in which a block counts once if its path meets it."""

    # Of the grid.
    n_rows: int
    n_cols: int
    # In cells. From half a cell on, no long straight path passes between all the disks.
    radius: float

    def steps(self) -> tuple[IntArray, IntArray]:
        """Return rows and columns from the middle of a window to each cell that its disk meets."""
        reach = math.ceil(self.radius + 0.5)
        step = np.arange(-reach, reach + 1)
        gap2 = np.maximum(np.abs(step) - 0.5, 0.0) ** 2
        near = gap2[:, None] + gap2[None, :] <= self.radius**2 + 1e-9
        drow, dcol = (step[i] for i in np.nonzero(near))
        return drow, dcol

    def around(self, cells: IntArray) -> tuple[IntArray, NDArray[np.int32]]:
        """Return windows whose disk meets any of some cells (flat indices).

        The cells in the middle of the windows (shape (n_windows,), flat indices, ascending), and of
        each of ``cells`` the window at each step from it, by its position among these; -1 outside
        the grid.
        """
        drow, dcol = self.steps()
        row, col = np.divmod(cells, self.n_cols)
        rows = row[:, None] + drow
        cols = col[:, None] + dcol
        inside = (rows >= 0) & (rows < self.n_rows) & (cols >= 0) & (cols < self.n_cols)
        flat = (rows * self.n_cols + cols)[inside]
        centres, position = np.unique(flat, return_inverse=True)
        number = np.full(inside.shape, -1, np.int32)
        number[inside] = position
        return centres.astype(np.int64), number


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """Repetitions of ``rocks_per_point`` blocks, of which some release points have fewer.

    A point that is halved h times has ``repetitions / 2**h`` of them, and each of their blocks
    counts ``2**h`` times: with its weights it has as many as any other point.
    """

    first: int = 0  # number of the first repetition
    repetitions: int = 1  # a multiple of 2**h for every h that occurs
    # Shape (n_points, n_scenarios): h of each release point and block scenario. None: 0 for all.
    halvings: NDArray[np.uint8] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Worth:
    """Worth of knowing how often blocks come to each cell with how much energy."""

    energy: IntArray  # shape (n,): positions of energies among those of the hazard curves, rising
    # Shape (n_cells, n): by which a smaller variance of the frequency there is multiplied.
    of_cell: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class MapRun:
    """Everything that a run on the map needs."""

    grid: Grid
    ground: NDArray[np.int32]  # shape of the grid; ground class of each cell
    table: GroundTable
    areas: tuple[ReleaseArea, ...]
    blocks: tuple[BlockPopulation, ...]  # names are those of the scenarios
    # Tuple of (ControlLine, float64 array of shape (k, 2)); stations and barriers with their trace
    # on the map.
    control_lines: tuple[tuple[ControlLine, FloatArray], ...]
    engine: EngineSettings
    terrain: TerrainSettings
    release: ReleaseSettings
    seed: int
    stop_points_max: int = 100_000  # most stop points to keep one by one
    # How often ``rocks_per_point`` blocks are released; those of the first repetitions stay the
    # same when there are more.
    rounds: tuple[Round, ...] = (Round(),)
    thresholds_kj: tuple[float, ...] = ()  # energies that hazard curves must have a value for
    # Exposed objects at which blocks are counted.
    objects: ObjectCells = field(default_factory=ObjectCells.none)
    ref_width_m: float = 0.0  # reference width of the hazard curves (m); 0: none are wanted
    # What the model of 1986 leaves out.
    effects: EffectSettings = field(default_factory=EffectSettings)
    forest: Forest | None = None  # for the effect of trees
    # Heights that blocks meet, on the cells of ``grid``; None: those of ``grid``.
    ground_heights: Grid | None = None
    # Cells at the north, east, south and west edge of the grid that no followed path may look at,
    # as the terrain goes on there.
    rim: tuple[int, int, int, int] = (0, 0, 0, 0)
    # As control_lines: further stations for the same blocks without barriers; None: these are not
    # wanted.
    further_stations: tuple[tuple[ControlLine, FloatArray], ...] | None = None

    @property
    def released_blocks(self) -> tuple[BlockPopulation, ...]:
        """The block scenarios that a release area of the run releases."""
        released = {name for area in self.areas for name in area.scenarios}
        return tuple(block for block in self.blocks if block.name in released)

    @property
    def all_lines(self) -> tuple[tuple[ControlLine, FloatArray], ...]:
        """The control lines, and after them the further stations."""
        return (*self.control_lines, *(self.further_stations or ()))

    @property
    def compared(self) -> int | None:
        """How many lines blocks meet with barriers; None if none are wanted without these."""
        return None if self.further_stations is None else len(self.control_lines)

    def sides_met(self, looked_at: tuple[int, int, int, int]) -> tuple[bool, bool, bool, bool]:
        """Find on which sides (north, east, south, west) paths looked into the rim (Simulated)."""
        n_rows, n_cols = self.grid.shape
        north, east, south, west = self.rim
        top, bottom, left, right = looked_at
        return (top < north, right >= n_cols - east, bottom >= n_rows - south, left < west)

    @property
    def repetitions(self) -> int:
        """How often ``rocks_per_point`` blocks are released at each point, with their weights."""
        return sum(own.repetitions for own in self.rounds)

    @property
    def heights(self) -> Grid:
        """Heights that blocks meet: those of profiles."""
        return self.grid if self.ground_heights is None else self.ground_heights

    @property
    def followed(self) -> bool:
        """Whether each block has a separate path."""
        return self.terrain.path == "followed"

    @property
    def block_scale_m(self) -> float:
        """Size below which terrain counts as roughness (m); 0: none does."""
        if self.terrain.block_scale_m is not None:
            return self.terrain.block_scale_m
        # The paper has profiles of the terrain as it was surveyed.
        paper = self.engine.readings == "1986"
        return 0.0 if paper else min(b.mean_width_m for b in self.blocks)

    @property
    def path_words(self) -> str:
        """In words: along what blocks are simulated."""
        return "a path for each block" if self.followed else "fall lines"

    @property
    def lateral_spread(self) -> str:
        """In words: how blocks leave the fall line."""
        if self.followed:
            return phrase(
                "blocks change direction at impacts and while rolling (lateral tilt {}°, drift "
                "{}°)",
                f"{self.engine.side_tilt_deg:g}",
                f"{self.engine.drift_deg:g}",
            )
        return "none (fall lines only); the map has gaps between diverging lines"

    @property
    def window(self) -> Window | None:
        """The disks in which a block counts for the hazard at the cell in their middle."""
        if self.ref_width_m == 0.0:
            return None
        return Window(*self.grid.shape, 0.5 * self.ref_width_m / self.grid.cell_size)


@dataclass(frozen=True, slots=True)
class BlockRows:
    """Blocks and passages one by one, with their place on the map."""

    rocks: NDArray[np.void]  # ROCK_DTYPE; ``line`` is the release point
    rock_scenario: IntArray  # position in ``blocks``
    # Where each block ends (m).
    x: FloatArray
    y: FloatArray
    passages: NDArray[np.void]  # PASSAGE_DTYPE; ``line`` is the release point
    passage_scenario: IntArray  # position in ``blocks``
    # How many times each counts.
    rock_weight: IntArray
    passage_weight: IntArray

    @classmethod
    def of_chunk(
        cls,
        rocks: NDArray[np.void],
        x: FloatArray,
        y: FloatArray,
        passages: NDArray[np.void],
        scenario: int,
        weight: int,
    ) -> BlockRows:
        """Return rows of blocks of one scenario that all count as often."""
        blocks, passed = (
            (np.full(n, scenario), np.full(n, weight)) for n in (rocks.size, passages.size)
        )
        return cls(rocks, blocks[0], x, y, passages, passed[0], blocks[1], passed[1])


@dataclass(frozen=True, slots=True)
class FallLines:
    """Fall lines for the map: ragged coordinates, thinned, and a row each."""

    # Line ``i`` owns ``[offset[i], offset[i + 1])``.
    offset: IntArray
    x: FloatArray
    y: FloatArray
    point: IntArray  # release point
    length_m: FloatArray
    drop_m: FloatArray
    end: NDArray[np.uint8]  # a LineEnd


@dataclass(frozen=True, slots=True)
class ReleaseArea:
    """A place from which blocks start."""

    name: str  # unique in the run; random draws hang on it
    geometry: Any  # shapely geometry; polygons, lines or points in the coordinates of the DEM (m)
    scenarios: tuple[str, ...]  # names of the block scenarios that start here
    # Share of it (of its area, length or points) where heights are known: only there blocks start.
    known: float = 1.0


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
