"""How often blocks start, what they do to the cells of the map, and the rules that make a level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Source:
    """One block scenario of one release area: what starts, how often, and the sample behind it.

    Attributes
    ----------
    area, scenario : str
    frequency : float
        Onset frequency: blocks released per year, in the whole area.
    rocks : int
        Simulated blocks.
    rocks_per_line : int
        Blocks of one stratum of the sample: one fall line, or one round of it.
    random_points : bool
        Whether the release points were themselves drawn at random.
    block_width_m : float
        Mean width of the block: twice its mean semi-axis (m).
    never_started : int
        Of the simulated blocks, those whose slope is below the friction at their release point: the
        onset frequency is that of blocks that start, and these are no part of it.
    """

    area: str
    scenario: str
    frequency: float
    rocks: int
    rocks_per_line: int
    random_points: bool = False
    block_width_m: float = 0.0
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

    Attributes
    ----------
    places : int64, shape (n,)
        Flat indices of cells, or numbers of objects; ascending, each once.
    count : int64, shape (n, n_energies)
        Blocks whose largest energy in the place is at least that of the column. The first column is
        for 0 kJ: all blocks that arrived.
    square : int64, shape (n, n_energies)
        Sum over the strata of the sample (fall lines) of the square of the number of blocks.
    """

    places: IntArray
    count: IntArray
    square: IntArray

    @classmethod
    def none(cls, n_energies: int) -> SourceCounts:
        """No block arrived anywhere."""
        empty = np.zeros((0, n_energies), np.int64)
        return cls(np.empty(0, np.int64), empty, empty.copy())


@dataclass(frozen=True, slots=True)
class HazardCurves:
    """Annual frequency with which blocks reach each place with at least some energy.

    Attributes
    ----------
    places : int64, shape (n,)
        As in SourceCounts; all places that any source reaches.
    energies_kj : float64, shape (n_energies,)
        Ascending; the first is 0.
    rate : float64, shape (n, n_energies)
        λ(E >= e) per year, from all sources.
    variance : float64, shape (n, n_energies)
        Of the rate, by the sampling of blocks (1/year²).
    rate_of_a_rock : float64, shape (n,)
        The largest frequency of one simulated block, of all scenarios of the areas
        from which a block reached the place (1/year): what one block more or less would change.
    """

    places: IntArray
    energies_kj: FloatArray
    rate: FloatArray
    variance: FloatArray
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
    """Where a value of a preset comes from.

    Attributes
    ----------
    source : str
        Publication, with page or section where known.
    verified : bool
        Whether the value was read in the source, rather than taken from general knowledge.
    """

    source: str
    verified: bool


@dataclass(frozen=True, slots=True)
class IntensityClass:
    """A class of intensity.

    Attributes
    ----------
    code : str
        As in the federal model: "low", "mean", "high".
    label : str
    from_kj : float
        Lower limit of the kinetic energy (kJ), which belongs to the class; 0 for the lowest.
    colour : str
        ``#rrggbb``.
    provenance : Provenance
    """

    code: str
    label: str
    from_kj: float
    colour: str
    provenance: Provenance


@dataclass(frozen=True, slots=True)
class HazardLevel:
    """A hazard level.

    Attributes
    ----------
    code : str
        As in the federal model: "residual_hazard", "slight", "mean", "substantial".
    label : str
        Name that the preset's users give it, as "elevato".
    colour : str
        ``#rrggbb``.
    hatched : bool
        Whether maps show it as a hatch.
    provenance : Provenance
    """

    code: str
    label: str
    colour: str
    hatched: bool
    provenance: Provenance


@dataclass(frozen=True, slots=True)
class HazardPreset:
    """The rules of one authority: intensities, return periods, levels and the matrix of both.

    Attributes
    ----------
    name, title : str
        As "ch-federal", and a line for people.
    intensities : tuple of IntensityClass
        From weak to strong.
    return_periods : tuple of float
        Upper limits of the classes of return period (years), ascending; the last class, beyond the
        last limit, is open. A limit belongs to the class below it.
    return_period_provenance : Provenance
    levels : tuple of HazardLevel
        From low to high.
    matrix : tuple of tuple of int
        ``matrix[i][j]``: position in ``levels`` for intensity class i and return period class j.
    matrix_provenance : tuple of tuple of Provenance
        Of each field of the matrix.
    file : str
        Where the preset was read.

    Raises
    ------
    InputError
        If the rules contradict each other.
    """

    name: str
    title: str
    intensities: tuple[IntensityClass, ...]
    return_periods: tuple[float, ...]
    return_period_provenance: Provenance
    levels: tuple[HazardLevel, ...]
    matrix: tuple[tuple[int, ...], ...]
    matrix_provenance: tuple[tuple[Provenance, ...], ...]
    file: str = ""

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
    """How often a block scenario is released.

    Attributes
    ----------
    frequency : float or None
        In ``unit``; None if nothing is said.
    unit : {"per_year", "per_year_ha", "per_year_m"}
        Per release area, per hectare or per metre of it.
    share : float
        Of that frequency which falls between the limits of the scenario's volumes.
    """

    frequency: float | None
    unit: OnsetUnit = "per_year"
    share: float = 1.0
