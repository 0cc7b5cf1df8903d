"""How often blocks start, what they do to the cells of the map, and the rules that make a level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, MinLen

from sassgis.model.declared import Example, PresetName, Renamed, Section, Text
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.in_memory import Input


@dataclass(frozen=True, slots=True)
class Source:
    """One block scenario of one release area: what starts, how often, and the sample behind it."""

    area: str
    scenario: str
    frequency: float  # onset frequency: blocks released per year, in the whole area
    rocks: int  # simulated blocks
    rocks_per_line: int  # blocks of one stratum of the sample: one fall line, or one round of it
    random_points: bool = False  # whether the release points were themselves drawn at random
    block_width_m: float = 0.0  # mean width of the block: twice its mean semi-axis (m)
    # Of the simulated blocks, those whose slope is below the friction at their release point: the
    # onset frequency is that of blocks that start, and these are no part of it.
    never_started: int = 0

    @property
    def label(self) -> str:
        """Area and scenario as tables name them."""
        return f"{self.area} / {self.scenario}"

    @property
    def rate_per_rock(self) -> float:
        """Annual frequency of each simulated block that started."""
        started = self.rocks - self.never_started
        return self.frequency / started if started else 0.0


@dataclass(frozen=True, slots=True)
class SourceCounts:
    """Blocks of one source that reached each place with at least some energy.

    A place is a cell of the map, or an exposed object.
    """

    # Shape (n,); flat indices of cells, or numbers of objects; ascending, each once.
    places: IntArray
    # Shape (n, n_energies); blocks whose largest energy in the place is at least that of the
    # column. The first column is for 0 kJ: all blocks that arrived.
    count: IntArray
    # Shape (n, n_energies); sum over the strata of the sample (fall lines) of the square of the
    # number of blocks.
    square: IntArray

    @classmethod
    def none(cls, n_energies: int) -> SourceCounts:
        """No block arrived anywhere."""
        empty = np.zeros((0, n_energies), np.int64)
        return cls(np.empty(0, np.int64), empty, empty.copy())


@dataclass(frozen=True, slots=True)
class HazardCurves:
    """Annual frequency with which blocks reach each place with at least some energy."""

    places: IntArray  # shape (n,); as in SourceCounts; all places that any source reaches
    energies_kj: FloatArray  # shape (n_energies,); ascending; the first is 0
    rate: FloatArray  # shape (n, n_energies); λ(E >= e) per year, from all sources
    variance: FloatArray  # shape (n, n_energies); of the rate, by the sampling of blocks (1/year²)
    # Shape (n,); the largest frequency of one simulated block, of all scenarios of the areas from
    # which a block reached the place (1/year): what one block more or less would change.
    rate_of_a_rock: FloatArray

    def column(self, energy_kj: float) -> int:
        """Position of an energy among ``energies_kj``.

        Raises
        ------
        ValueError
            The energy is none of them.
        """
        at = int(np.argmin(np.abs(self.energies_kj - energy_kj)))
        if not math.isclose(self.energies_kj[at], energy_kj, rel_tol=1e-9, abs_tol=1e-12):
            raise ValueError(f"{energy_kj} kJ is none of the energies of the curves")
        return at


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a value of a preset comes from."""

    source: str  # publication, with page or section where known
    # Whether the value was read in the source, rather than taken from general knowledge.
    verified: bool


@dataclass(frozen=True, slots=True)
class IntensityClass:
    """A class of intensity."""

    code: str  # as in the federal model: "low", "mean", "high"
    label: str
    # Lower limit of the kinetic energy (kJ), which belongs to the class; 0 for the lowest.
    from_kj: float
    colour: str  # ``#rrggbb``
    provenance: Provenance


@dataclass(frozen=True, slots=True)
class HazardLevel:
    """A hazard level."""

    code: str  # as in the federal model: "residual_hazard", "slight", "mean", "substantial"
    label: str  # name that the preset's users give it, as "elevato"
    colour: str  # ``#rrggbb``
    hatched: bool  # whether maps show it as a hatch
    provenance: Provenance


@dataclass(frozen=True, slots=True)
class HazardPreset:
    """The rules of one authority: intensities, return periods, levels and the matrix of both.

    Raises
    ------
    InputError
        If the rules contradict each other.
    """

    # As "ch-so", and a line for people.
    name: str
    title: str
    intensities: tuple[IntensityClass, ...]  # from weak to strong
    # Upper limits of the classes of return period (years), ascending; the last class, beyond the
    # last limit, is open. A limit belongs to the class below it.
    return_periods: tuple[float, ...]
    return_period_provenance: Provenance
    levels: tuple[HazardLevel, ...]  # from low to high
    # ``matrix[i][j]``: position in ``levels`` for intensity class i and return period class j.
    matrix: tuple[tuple[int, ...], ...]
    matrix_provenance: tuple[tuple[Provenance, ...], ...]  # of each field of the matrix
    file: str = ""  # where the preset was read
    # What is rarer than once in so many years has no level; None: whatever arrives at all has one.
    rarest_years: float | None = None
    rarest_provenance: Provenance | None = None

    def __post_init__(self) -> None:
        limits = [c.from_kj for c in self.intensities]
        if not limits or limits[0] != 0.0 or any(a >= b for a, b in pairwise(limits)):
            raise self._refused(
                "limits of the intensity classes do not rise from 0",
                "intensity",
                limits,
                "[0, ...]",
            )
        periods = self.return_periods
        if not periods or periods[0] <= 0.0 or any(a >= b for a, b in pairwise(periods)):
            raise self._refused(
                "limits of the return periods do not rise",
                "return_periods",
                list(periods),
                "years above 0, in ascending order",
            )
        if self.rarest_years is not None and self.rarest_years <= periods[-1]:
            raise self._refused(
                "is within the classes of return period",
                "rarest.years",
                f"{self.rarest_years:g}",
                f"more than {periods[-1]:g}, the last limit of the return periods",
            )
        for field, codes in (
            ("intensity", [c.code for c in self.intensities]),
            ("levels", [c.code for c in self.levels]),
        ):
            if len(set(codes)) != len(codes):
                raise self._refused("a code is used twice", field, codes, "codes that differ")
        self._check_matrix()

    def _check_matrix(self) -> None:
        n = len(self.return_periods) + 1
        if len(self.matrix) != len(self.intensities):
            raise self._refused(
                "the matrix does not have a row for each intensity class",
                "matrix",
                f"{len(self.matrix)} rows",
                f"{len(self.intensities)}",
            )
        for row, intensity in zip(self.matrix, self.intensities, strict=True):
            field = f"matrix.{intensity.code}"
            if len(row) != n:
                raise self._refused(
                    "the matrix has a hole",
                    field,
                    f"{len(row)} levels",
                    f"{n}, one per return period",
                )
            if any(not 0 <= k < len(self.levels) for k in row):
                raise self._refused("the matrix names no level", field, list(row), "known levels")
            codes = [self.levels[k].code for k in row]
            if any(later > earlier for earlier, later in pairwise(row)):
                raise self._refused(
                    "the matrix contradicts itself: a rarer event has a higher level",
                    field,
                    codes,
                    "levels that do not rise with the return period",
                )
        for (weak, low), (strong, high) in pairwise(
            zip(self.intensities, self.matrix, strict=True)
        ):
            if any(a > b for a, b in zip(low, high, strict=True)):
                raise self._refused(
                    "the matrix contradicts itself: a stronger event has a lower level",
                    f"matrix.{strong.code}",
                    [self.levels[k].code for k in high],
                    f"nowhere below the row of {weak.code}",
                )

    def _refused(self, problem: str, field: str, found: object, expected: str) -> InputError:
        return InputError(
            problem, file=self.file or self.name, field=field, found=found, expected=expected
        )

    @property
    def thresholds_kj(self) -> tuple[float, ...]:
        """Lower limits of the intensity classes (kJ), ascending, from 0."""
        return tuple(c.from_kj for c in self.intensities)


#: What an onset frequency refers to.
OnsetUnit = Literal["per_year", "per_year_ha", "per_year_m"]


@dataclass(frozen=True, slots=True)
class Onset:
    """How often a block scenario is released."""

    frequency: float | None  # in ``unit``; None if none is stated
    # Per release area, per hectare or per metre of it.
    unit: OnsetUnit = "per_year"
    share: float = 1.0  # of that frequency which falls between the limits of the scenario's volumes


#: The cantons, and Liechtenstein, as the federal model 166.1 names them.
Canton = Literal[
    "AG", "AI", "AR", "BE", "BL", "BS", "FL", "FR", "GE", "GL", "GR", "JU", "LU", "NE", "NW", "OW",
    "SG", "SH", "SO", "SZ", "TG", "TI", "UR", "VD", "VS", "ZG", "ZH",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class HazardSettings(Section):
    """From blocks to intensities and hazard levels (sassgis zone); needs onset frequencies."""

    preset: Annotated[
        Text,
        PresetName(),
        "rules for intensity and level: a built-in preset (ch-so, ti), or a "
        "TOML file of your own (docs/presets.md)",
    ] = "ch-so"
    frequencies: Annotated[
        Input | None,
        "table (CSV) with columns area, scenario, frequency, unit: onset frequencies "
        "of single release areas, in place of onset_frequency and onset_unit of [[blocks]]; "
        "onset_above_m3 holds for them too",
        Example("frequencies.csv"),
    ] = None
    ref_width_m: Annotated[
        float | None,
        Interval(gt=0, le=1000),
        "reference width of all frequencies (m): a block counts for a place if its centre comes "
        "within half of it, so block plus exposed object; one cell or more; sassgis zone and "
        "batch need it",
        Example(10.0),
    ] = None
    confidence: Annotated[
        float,
        Interval(ge=0.5, le=0.9999),
        "of the sampling interval that decides whether a level is statistically certain",
    ] = 0.95
    changed_share_max: Annotated[
        float | None,
        Interval(gt=0, lt=1),
        "if given, the simulation is repeated until another sample of as many blocks would change "
        "the level on no larger share of the zoned area",
        Renamed("uncertain_share_max"),
        Example(0.02),
    ] = None
    repetitions_max: Annotated[
        int,
        Interval(ge=1, le=1024),
        "most repetitions of rocks_per_point with changed_share_max",
        Renamed("rounds_max"),
    ] = 8
    by_source: Annotated[bool, "whether intensities are also written for each release area"] = True
    compare_barriers: Annotated[
        bool, "whether the zones are also made without walls and nets, and compared"
    ] = True
    design_return_periods_years: Annotated[
        tuple[Annotated[float, Interval(ge=1, le=10_000)], ...],
        MinLen(1),
        "for the energy and height that a barrier at each station must take",
    ] = (30.0, 100.0, 300.0)
    canton: Annotated[
        Canton | None,
        "code of the canton that is responsible for the data, as TI (federal model)",
        Example("TI"),
    ] = None


@dataclass(frozen=True, slots=True)
class ZoningSettings(Section):
    """From cells to polygons; the defaults suit a map of 1:5000 (docs/zones.md).

    There parts and gaps of 2 mm and areas of 8 mm² are legible. They are in metres, so that zones
    of one slope do not grow with the cells.
    """

    min_area_m2: Annotated[
        float, Interval(ge=0, le=1e6), "smallest area of a zone and of a hole in one (m2)"
    ] = 200.0
    closing_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "gaps between parts of a zone that are closed, up to this width (m); default: "
        "min_width_m, or release.spacing_m if that is wider",
        Example(5.0),
    ] = None
    min_width_m: Annotated[
        float,
        Interval(ge=0, le=1000),
        "threads narrower than this are widened, rims of a higher zone join it (m)",
    ] = 10.0
    tolerance_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "how far a smoothed outline may lie outside its cells (m); default: one and a half cells",
        Example(3.0),
    ] = None

    def smallest_cells(self, cell_size: float) -> int:
        """Cells that make up the smallest area; at least one."""
        return max(1, math.ceil(self.min_area_m2 / cell_size**2 - 1e-9))

    def closing_cells(self, cell_size: float) -> int:
        """Widest gap that is closed (whole cells)."""
        closing_m = self.min_width_m if self.closing_m is None else self.closing_m
        return math.floor(closing_m / cell_size + 1e-9)

    def width_cells(self, cell_size: float) -> int:
        """Least width of a part of a zone (whole cells, at least one)."""
        return max(1, math.ceil(self.min_width_m / cell_size - 1e-9))

    def tolerance_cells(self, cell_size: float) -> float:
        """Largest distance of the boundary from the outline of the cells (cells)."""
        return 1.5 if self.tolerance_m is None else self.tolerance_m / cell_size
