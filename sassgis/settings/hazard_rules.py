"""How often blocks start, what they do to the cells of the map, and the rules that make a level."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import chain, pairwise
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval, MinLen
from numpy.typing import NDArray

from sassgis.errors import ConfigError, InputError
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.schema import (
    Example,
    File,
    InputFile,
    Preset,
    Renamed,
    Section,
    Several,
    Text,
    checked,
)

#: Which rows or columns of an array.
Rows = slice | list[int]
_ALL = slice(None)


@dataclass(frozen=True, slots=True)
class Source:
    """One block scenario of one release area: what starts, how often, and the sample behind it."""

    area: str
    scenario: str
    frequency: float  # onset frequency: blocks released per year, in the whole area
    rocks: int  # simulated blocks
    rocks_per_line: int  # blocks of one stratum of the sample: one repetition of a fall line
    random_points: bool = False  # whether the release points were themselves drawn at random
    block_width_m: float = 0.0  # mean width of the block: twice its mean semi-axis (m)
    # Of the simulated blocks, those whose slope is below the friction at their release point: the
    # onset frequency is that of blocks that start, and these are no part of it.
    never_started: int = 0
    heaviest: int = 1  # how often that of the simulated blocks counts which counts most

    @property
    def lines(self) -> int:
        """Strata of the sample: release points, or fall lines, with their repetitions."""
        return self.rocks // max(self.rocks_per_line, 1)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of variances: one less than points that were drawn, else infinite."""
        return max(self.lines - 1.0, 0.0) if self.random_points else math.inf

    @property
    def label(self) -> str:
        """Area and scenario as tables name them."""
        return f"{self.area} / {self.scenario}"

    @property
    def rate_per_rock(self) -> float:
        """Annual frequency of each simulated block that started."""
        started = self.rocks - self.never_started
        return self.frequency / started if started else 0.0

    @property
    def rate_of_a_rock(self) -> float:
        """The largest annual frequency of one simulated block, which may count several times."""
        return self.heaviest * self.rate_per_rock


@dataclass(frozen=True, slots=True)
class SourceCounts:
    """Blocks of one source that reached each place with at least some energy.

    A place is a cell of the map, or an exposed object.
    """

    # Shape (n,); flat indices of cells, or numbers of objects; ascending, each once.
    places: IntArray
    # Shape (n, n_energies); blocks whose largest energy in the place is at least that of the
    # column. The first column is for 0 kJ: all blocks that arrived.
    count: NDArray[np.signedinteger[Any]]
    # Shape (n, n_energies); sum over the strata of the sample (fall lines) of the square of the
    # number of blocks.
    square: NDArray[np.signedinteger[Any]]

    @classmethod
    def none(cls, n_energies: int) -> SourceCounts:
        """Return counts of no block arriving anywhere."""
        empty = np.zeros((0, n_energies), np.int64)
        return cls(np.empty(0, np.int64), empty, empty.copy())


@dataclass(frozen=True, slots=True)
class DrawnPoints:
    """What release points drawn at random, few as they are, leave open of hazard curves."""

    # Shape (n, n_energies); annual frequency of the blocks that come from one point more.
    rate_of_a_point: FloatArray
    freedom: FloatArray  # shape (n, n_energies); degrees of freedom of the variance

    def part(self, rows: Rows, columns: Rows) -> DrawnPoints:
        """Cut out some places and energies."""
        return DrawnPoints(self.rate_of_a_point[rows][:, columns], self.freedom[rows][:, columns])


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
    drawn: DrawnPoints | None = None  # None: the release points are given

    @property
    def rate_of_one(self) -> FloatArray:
        """Rate (1/year) that one more draw would add: a block, or a point with its blocks.

        Of the shape (n, 1) or (n, n_energies).
        """
        of_a_point = 0.0 if self.drawn is None else self.drawn.rate_of_a_point
        return np.maximum(self.rate_of_a_rock[:, None], of_a_point)

    @property
    def freedom(self) -> FloatArray | float:
        """Degrees of freedom of the variances; infinite where the release points are given."""
        return math.inf if self.drawn is None else self.drawn.freedom

    def part(self, rows: Rows, columns: Rows = _ALL) -> HazardCurves:
        """Return the curves of some places, at some of their energies."""
        return HazardCurves(
            self.places[rows], self.energies_kj[columns], self.rate[rows][:, columns],
            self.variance[rows][:, columns], self.rate_of_a_rock[rows],
            None if self.drawn is None else self.drawn.part(rows, columns),
        )  # fmt: skip

    def column(self, energy_kj: float) -> int:
        """Return the position of an energy among ``energies_kj``; ValueError if it is not there."""
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
class SheetRules:
    """How large zones must be to be drawn on a sheet, and how the outer limit is drawn."""

    width_mm: float  # least width of a zone
    area_mm2: float  # smallest zone, and smallest hole in one
    gap_mm: float  # gaps and slots up to this width are closed
    # The outer limit, in reference widths: gaps in it that are closed, and the width over which
    # the frequency is averaged there.
    envelope_widths: float
    smoothing_widths: float
    provenance: Provenance


@dataclass(frozen=True, slots=True)
class HazardPreset:
    """The rules of one authority: intensities, return periods, levels and the matrix of both.

    InputError if they contradict each other.
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
    sheet: SheetRules | None = None  # None: zones are their cells, as they are

    def __post_init__(self) -> None:
        for problem, field, found, expected in chain(self._faults(), self._faults_of_matrix()):
            raise InputError(
                problem, file=self.file or self.name, field=field, found=found, expected=expected
            )

    def _faults(self) -> Iterator[tuple[str, str, object, str]]:
        """Yield what cannot be: problem, field, found, expected."""
        limits = [c.from_kj for c in self.intensities]
        if not limits or limits[0] != 0.0 or any(a >= b for a, b in pairwise(limits)):
            problem = "limits of the intensity classes do not rise from 0"
            yield problem, "intensity", limits, "[0, ...]"
        periods = self.return_periods
        if not periods or periods[0] <= 0.0 or any(a >= b for a, b in pairwise(periods)):
            problem, expected = "limits of the return periods do not rise", "years above 0"
            yield problem, "return_periods", list(periods), f"{expected}, in ascending order"
        if self.rarest_years is not None and self.rarest_years <= periods[-1]:
            expected = f"more than {periods[-1]:g}, the last limit of the return periods"
            problem = "is within the classes of return period"
            yield problem, "rarest.years", f"{self.rarest_years:g}", expected
        for own in fields(self.sheet) if self.sheet is not None else ():
            value = getattr(self.sheet, own.name)
            if own.name != "provenance" and value < 0.0:
                yield "is below 0", f"sheet.{own.name}", f"{value:g}", "0 or more"
        for field, kinds in (("intensity", self.intensities), ("levels", self.levels)):
            codes = [kind.code for kind in kinds]
            if len(set(codes)) != len(codes):
                yield "a code is used twice", field, codes, "codes that differ"

    def _faults_of_matrix(self) -> Iterator[tuple[str, str, object, str]]:
        n = len(self.return_periods) + 1
        if len(self.matrix) != len(self.intensities):
            problem = "the matrix does not have a row for each intensity class"
            yield problem, "matrix", f"{len(self.matrix)} rows", f"{len(self.intensities)}"
        for row, intensity in zip(self.matrix, self.intensities, strict=True):
            field = f"matrix.{intensity.code}"
            if len(row) != n:
                problem = "the row does not have a level for each class of return period"
                yield problem, field, f"{len(row)} levels", f"{n}"
            if any(not 0 <= k < len(self.levels) for k in row):
                yield "the matrix names no level", field, list(row), "known levels"
            if any(later > earlier for earlier, later in pairwise(row)):
                problem = "the matrix contradicts itself: a rarer event has a higher level"
                codes = [self.levels[k].code for k in row]
                yield problem, field, codes, "levels that do not rise with the return period"
        rows = zip(self.intensities, self.matrix, strict=True)
        for (weak, low), (strong, high) in pairwise(rows):
            if any(a > b for a, b in zip(low, high, strict=True)):
                problem = "the matrix contradicts itself: a stronger event has a lower level"
                codes = [self.levels[k].code for k in high]
                expected = f"nowhere below the row of {weak.code}"
                yield problem, f"matrix.{strong.code}", codes, expected

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


@dataclass(frozen=True)
class BlockBudget:
    """How far a zoning goes on: to a share of the zoned area, a number of blocks, or a time."""

    changed_share: float = 0.02  # whose level another sample would change
    blocks: int = 10_000_000
    seconds: float = 3600.0


@checked(frozen=True, slots=True)
class HazardSettings(Section):
    """From blocks to intensities and hazard levels (sassgis zone); needs onset frequencies."""

    preset: Annotated[
        Preset,
        "rules for intensity and level: a built-in preset (ch-so, ti) or a TOML file "
        "(docs/presets.md)",
    ] = "ch-so"
    frequencies: Annotated[
        InputFile | None,
        "table (CSV) with columns area, scenario, frequency, unit: onset frequencies "
        "of single release areas, in place of onset_frequency and onset_unit of [[blocks]], which "
        "hold for all areas that are not in it; "
        "onset_above_m3 holds for them too",
        Example("frequencies.csv"),
    ] = None
    ref_width_m: Annotated[
        float | None,
        Interval(gt=0, le=1000),
        "reference width of all frequencies (m): a block counts for a place if its centre comes "
        "within half of it; choose the width of block plus exposed object, one cell or more; "
        "sassgis zone and batch need it",
        Example(10.0),
    ] = None
    confidence: Annotated[
        float,
        Interval(ge=0.5, le=0.9999),
        "share of all changes of the level by another random seed that the statistically "
        "uncertain (hatched) cells hold; also the probability that another seed gives no level "
        "below lowest_level, and none above highest_level; in a mosaic made block by block only "
        "this probability",
    ] = 0.95
    blocks: Annotated[
        Literal["given", "auto"],
        "number of simulated blocks; given: release.rocks_per_point at each point; auto: more, "
        "until another random seed would change the level on at most changed_share_max of the "
        "zoned area and, on average, of each level",
    ] = "given"
    changed_share_max: Annotated[
        float | None,
        Interval(gt=0, lt=1),
        'with blocks = "auto": largest share of the zoned area, and of the levels on average, '
        "whose level may change with another random seed; default: 0.02",
        Renamed("uncertain_share_max"),
        Example(0.02),
    ] = None
    blocks_max: Annotated[
        int | None,
        Interval(ge=1),
        'with blocks = "auto": most blocks that are simulated; default: 10 million',
        Example(10_000_000),
    ] = None
    minutes_max: Annotated[
        float | None,
        Interval(gt=0),
        'with blocks = "auto": approximate limit of the simulation time; default: 60 (minutes)',
        Example(60.0),
    ] = None
    by_source: Annotated[bool, "also write intensities for each release area"] = True
    compare_barriers: Annotated[bool, "also make the zones without barriers, and compare"] = True
    assessed: Annotated[
        InputFile | None,
        "polygons of the completely assessed area (sheets, federal model); without it the whole "
        "terrain model counts as still to be clarified",
        Example("perimeter.gpkg"),
    ] = None
    assessed_layer: Annotated[
        Text | None, "layer of assessed, if the file has several", Example("assessed_area")
    ] = None
    design_return_periods_years: Annotated[
        Several[Annotated[float, Interval(ge=1, le=10_000)]],
        MinLen(1),
        "return periods of the design values at stations and barriers (years)",
    ] = (30.0, 100.0, 300.0)
    canton: Annotated[
        Canton | None,
        "code of the canton that is responsible for the data, as TI (federal model)",
        Example("TI"),
    ] = None

    def _fits_together(self) -> None:
        for key in ("changed_share_max", "blocks_max", "minutes_max"):
            if self.blocks != "auto" and getattr(self, key) is not None:
                raise ConfigError(
                    'applies only with blocks = "auto"',
                    field=key,
                    expected='hazard.blocks = "auto" as well',
                )

    @property
    def budget(self) -> BlockBudget | None:
        """Limit of the search for as many blocks as the map needs; None where it is not asked."""
        if self.blocks != "auto":
            return None
        return BlockBudget(
            self.changed_share_max or BlockBudget.changed_share,
            self.blocks_max or BlockBudget.blocks,
            60.0 * (self.minutes_max or BlockBudget.seconds / 60.0),
        )


@dataclass(frozen=True, slots=True)
class Drawing:
    """How zones are drawn (m and m2); of zeros, zones are their cells as they are."""

    width_m: float = 0.0  # least width of a zone
    area_m2: float = 0.0  # smallest zone, and smallest hole in one
    gap_m: float = 0.0  # gaps and slots up to this width are closed
    envelope_m: float = 0.0  # those of the outer limit
    smoothing_m: float = 0.0  # width over which the frequency at the outer limit is averaged
    tolerance_m: float = 0.0  # how far a smoothed outline may lie outside its cells
    scale: float = 0.0  # denominator of the scale of the sheet; 0: none


#: Scales of the sheet (denominators) between which zones are drawn unless another is given.
SHEET_SCALES = (5000.0, 10_000.0)


@checked(frozen=True, slots=True)
class ZoningSettings(Section):
    """From cells to zones as they are drawn (docs/zones.md).

    The preset says how wide and large a zone must be on the sheet, in millimetres; with the scale
    that gives metres, so that zones do not grow with the cells.
    """

    scale: Annotated[
        float | None,
        Interval(ge=100, le=1e6),
        "denominator of the scale of the sheet for which zones are drawn; default: that at which "
        "they fit on it, from 5000 to 10000; in a batch 5000",
        Example(5000.0),
    ] = None
    min_width_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "least width of a zone (m); default: that of the preset (mm) at the scale",
        Example(10.0),
    ] = None
    min_area_m2: Annotated[
        float | None,
        Interval(ge=0, le=1e6),
        "smallest area of a zone and of a hole in one (m2); default: that of the preset",
        Example(1000.0),
    ] = None
    closing_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "gaps and slots that are closed, up to this width (m); default: that of the preset, or "
        "release.spacing_m if that is wider",
        Example(20.0),
    ] = None
    envelope_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "gaps in the outer limit that are closed (m); default: that of the preset, six reference "
        "widths",
        Example(100.0),
    ] = None
    smoothing_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "width over which the frequency at the outer limit is averaged (m); default: that of the "
        "preset, three reference widths",
        Example(30.0),
    ] = None
    tolerance_m: Annotated[
        float | None,
        Interval(ge=0, le=1000),
        "how far a smoothed outline may lie outside its cells (m); default: one and a half cells",
        Example(3.0),
    ] = None

    def at_scale(self, needed: float) -> ZoningSettings:
        """Return the settings at the scale at which zones fit on the sheet; a given one stays."""
        if self.scale is not None:
            return self
        least, most = SHEET_SCALES
        return replace(self, scale=min(max(needed, least), most))

    def drawing(
        self, sheet: SheetRules | None, ref_width_m: float, spacing_m: float, cell_size: float
    ) -> Drawing:
        """Return the rules of a preset for drawing zones."""
        scale = SHEET_SCALES[0] if self.scale is None else self.scale
        mm = scale / 1000.0
        rules = SheetRules(0, 0, 0, 0, 0, Provenance("", False)) if sheet is None else sheet

        def metres(own: float | None, default: float) -> float:
            return default if own is None else own

        return Drawing(
            width_m=metres(self.min_width_m, rules.width_mm * mm),
            area_m2=metres(self.min_area_m2, rules.area_mm2 * mm**2),
            # Between two fall lines nothing was computed: the gap is not a place that is safe.
            gap_m=metres(self.closing_m, max(rules.gap_mm * mm, spacing_m)),
            envelope_m=metres(self.envelope_m, rules.envelope_widths * ref_width_m),
            smoothing_m=metres(self.smoothing_m, rules.smoothing_widths * ref_width_m),
            tolerance_m=metres(self.tolerance_m, 1.5 * cell_size),
            scale=scale,
        )


#: Code of places without a level.
NO_LEVEL = "not_in_danger"
#: How an edit bears on what was computed: it replaces it, or the level is no lower, or no higher.
EditLimit = Literal["", "at_least", "at_most"]
LIMIT_TEXT: Mapping[str, str] = {"": "", "at_least": "at least", "at_most": "at most"}


@checked(frozen=True, slots=True)
class EditSettings(Section):
    """Levels that an expert sets by hand; every run keeps them (docs/zones.md)."""

    file: Annotated[
        File | None,
        "polygons (any vector file) with level, author, date, reason; may be empty; --edits "
        "replaces it",
        Example("edits.gpkg"),
    ] = None
    layer: Annotated[Text | None, "layer of the file, if it has several", Example("edits")] = None


@dataclass(frozen=True, slots=True)
class Edit:
    """A level of a place, or a limit of it, that an expert has set."""

    geometry: Any  # shapely geometry; polygons, in the coordinates of the terrain model
    level: int  # position among the levels of the preset, plus 1; 0 for none
    # Whether the level holds, or only where the computed one is lower, or higher.
    limit: EditLimit
    author: str
    date: str  # as 2026-01-31
    reason: str
    # What was computed there when the edit was made, as ``level_shares`` has it; empty if nobody
    # noted it.
    computed: str = ""

    @property
    def words(self) -> str:
        """Note on who edited, when and why."""
        return f"{self.author}, {self.date}: {self.reason}"
