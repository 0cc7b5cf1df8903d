"""Block populations, the base of the settings of effects, and where a forest stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeVar

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from sassgis.errors import ConfigError, InputError
from sassgis.settings.schema import (
    Example,
    InputFile,
    Section,
    Text,
    checked,
)

#: A low and a high limit.
Range = tuple[float, float]

#: Attributes of BlockPopulation between whose limits each block is drawn.
LIMITS_DTYPE = np.dtype(
    (
        np.record,
        [
            (name, np.float64)
            for name in (
                "axis_1_m", "axis_2_m", "axis_3_m", "density_kgm3", "speed_mps", "spin_radps",
                "drop_m", "orientation_rad", "volume_m3", "volume_exponent",
            )
        ],
    )
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class BlockPopulation:
    """Limits between which each block is drawn, all uniform and independent."""

    name: str = "block"  # name of the block scenario
    # Limits of the three *semi*-axes (m). After the draw they are sorted a >= b >= c.
    axis_1_m: Range = (0.5, 0.5)
    axis_2_m: Range = (0.4, 0.4)
    axis_3_m: Range = (0.3, 0.3)
    density_kgm3: Range = (2700.0, 2700.0)
    speed_mps: Range = (0.0, 0.0)  # initial speed along the slope, positive downhill
    # Initial spin, positive as a block that rolls downhill.
    spin_radps: Range = (0.0, 0.0)
    # Height above the resting position from which the block is released.
    drop_m: Range = (0.0, 0.0)
    # Angle of the major axis to the slope.
    orientation_rad: Range = (0.0, float(np.pi))
    # Limits of the volume (m³). Where they are given, the axes are relative: they set the shape,
    # the volume the size.
    volume_m3: Range | None = None
    # The b of the power law N(V > v) ~ v^-b from which volumes are drawn between their limits;
    # without it all volumes between them are equally likely.
    volume_exponent: float | None = None

    def __post_init__(self) -> None:
        positive = ["axis_1_m", "axis_2_m", "axis_3_m", "density_kgm3"]
        if self.volume_m3 is not None:
            positive.append("volume_m3")
        for key in (*positive, "speed_mps", "spin_radps", "drop_m", "orientation_rad"):
            low, high = getattr(self, key)
            found = f"[{low:g}, {high:g}]"
            if not (np.isfinite(low) and np.isfinite(high)):
                raise self._refused("limits must be numbers", key, (low, high))
            if low > high:
                raise self._refused("limits are reversed", key, found, "[low, high]")
            if key in positive and low <= 0.0:
                expected = "two positive numbers, low first"
                raise self._refused("must be above zero", key, found, expected)
        for key in ("drop_m", "speed_mps"):
            if getattr(self, key)[0] < 0.0:
                problem = "drop and speed cannot be negative"
                raise self._refused(problem, key, None, "zero or more")
        if self.volume_exponent is not None and self.volume_m3 is None:
            problem, field = "has no volumes to go with", "volume_exponent"
            raise self._refused(problem, field, self.volume_exponent, "volume_m3 as well")

    def _refused(
        self, problem: str, field: str, found: object, expected: str | None = None
    ) -> InputError:
        problem = f"blocks {self.name!r}: {problem}"
        return InputError(problem, field=field, found=found, expected=expected)

    def limits(self) -> NDArray[np.void]:
        """Return limits as the kernel reads them: LIMITS_DTYPE, shape (2,), the lower ones first.

        No volume stands as zeros, no exponent as NaN.
        """
        rows = np.zeros(2, LIMITS_DTYPE)
        for name in LIMITS_DTYPE.names or ():
            value = getattr(self, name)
            rows[name] = 0.0 if value is None else value
        if self.volume_exponent is None:
            rows["volume_exponent"] = np.nan
        return rows

    @property
    def volume_limits_m3(self) -> Range:
        """Volumes of the smallest and the largest block that can be drawn (m³)."""
        if self.volume_m3 is not None:
            return self.volume_m3
        limits = (self.axis_1_m, self.axis_2_m, self.axis_3_m)
        low, high = (_ellipsoid_m3(*axes) for axes in zip(*limits, strict=True))
        return low, high

    @property
    def mass_limits_kg(self) -> Range:
        """Masses of the lightest and the heaviest block that can be drawn (kg)."""
        low, high = self.volume_limits_m3
        return low * self.density_kgm3[0], high * self.density_kgm3[1]

    @property
    def size_limits_m(self) -> tuple[Range, Range, Range]:
        """Length, width and height of the smallest and the largest block (m), longest first.

        Where volumes are given, of blocks of the mean shape.
        """
        limits = np.array([self.axis_1_m, self.axis_2_m, self.axis_3_m])
        if self.volume_m3 is not None:
            mean = limits.mean(axis=1)
            limits = np.outer(mean, np.cbrt(np.array(self.volume_m3) / _ellipsoid_m3(*mean)))
        (a, b), (c, d), (e, f) = (2.0 * np.sort(limits, axis=0)[::-1]).tolist()
        return (a, b), (c, d), (e, f)

    @property
    def mean_width_m(self) -> float:
        """Twice the mean semi-axis (m): how wide a strip a typical block sweeps."""
        axes = [0.5 * sum(limits) for limits in (self.axis_1_m, self.axis_2_m, self.axis_3_m)]
        if self.volume_m3 is None:
            return 2.0 * sum(axes) / 3.0
        size = self._mean_root_volume_m / float(np.cbrt(_ellipsoid_m3(*axes)))
        return 2.0 * size * sum(axes) / 3.0

    @property
    def _mean_root_volume_m(self) -> float:
        """Mean of the cube root of the volume (m): lengths go with it, not with the volume."""
        assert self.volume_m3 is not None
        low, high = self.volume_m3
        if high <= low:
            return float(np.cbrt(low))
        # Mean with the density ~ v^(-b-1) between the limits, b = -1 where all are equally likely.
        b = -1.0 if self.volume_exponent is None else self.volume_exponent
        v = np.linspace(np.log(low), np.log(high), 2001)
        weight = np.exp(-b * (v - v[0]))
        weight[[0, -1]] *= 0.5
        return float((weight * np.exp(v / 3.0)).sum() / weight.sum())


def _ellipsoid_m3(a: float, b: float, c: float) -> float:
    """Return the volume of an ellipsoid of three semi-axes (m)."""
    return 4.0 / 3.0 * float(np.pi) * a * b * c


class EffectSection(Section):
    """Base of the settings of an effect: a frozen dataclass of declared settings with a name."""

    __slots__ = ()

    name: ClassVar[str]  # of the effect, as in ``[effects.<name>]``


Kind = TypeVar("Kind", bound=EffectSection)


@dataclass(frozen=True, slots=True, init=False)
class EffectSettings:
    """The effects of a run that are on, each with its settings."""

    on: tuple[EffectSection, ...]  # at most one of a kind

    def __init__(self, *on: EffectSection) -> None:
        if len({type(own) for own in on}) < len(on):
            raise ValueError("the settings of an effect are given twice")
        object.__setattr__(self, "on", on)

    def __iter__(self) -> Iterator[EffectSection]:
        return iter(self.on)

    def get(self, kind: type[Kind]) -> Kind | None:
        """Return settings of an effect; None if it is off."""
        return next((own for own in self.on if isinstance(own, kind)), None)

    def named(self, name: str) -> EffectSection | None:
        """Return settings of an effect by its name; None if it is off."""
        return next((own for own in self.on if own.name == name), None)

    def having(self, own: EffectSection) -> EffectSettings:
        """Return the same effects with this one, in place of another of its kind."""
        return EffectSettings(*self.without(type(own)), own)

    def without(self, kind: type[EffectSection]) -> EffectSettings:
        """Return the same effects but this one."""
        return EffectSettings(*(own for own in self.on if not isinstance(own, kind)))

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are on."""
        return tuple(own.name for own in self.on)


@checked(frozen=True, slots=True)
class ForestPlace(Section):
    """Where the forest of ``[effects.trees]`` stands."""

    file: Annotated[
        InputFile | None,
        "polygons of forest; without it, rasters and single trees, forest is everywhere",
        Example("forest.gpkg"),
    ] = None
    layer: Annotated[Text | None, "layer, where the file has several", Example("forest")] = None
    stems_field: Annotated[
        Text | None, "attribute with the stems per hectare", Example("stems_per_ha")
    ] = None
    dbh_field: Annotated[
        Text | None, "attribute with the diameter at breast height (cm)", Example("dbh_cm")
    ] = None
    stems_raster: Annotated[
        InputFile | None, "raster of stems per hectare, in place of polygons", Example("stems.tif")
    ] = None
    dbh_raster: Annotated[
        InputFile | None, "raster of diameters at breast height (cm)", Example("dbh.tif")
    ] = None
    single_trees: Annotated[
        InputFile | None,
        "trees one by one, in place of polygons: a CSV table with columns x, y, dbh_cm and, if "
        "wanted, conifer_share (0 to 1), or points with these attributes; stems are counted within "
        "5 m",
        Example("trees.csv"),
    ] = None
    stems_per_ha: Annotated[
        float | None,
        Interval(ge=0, le=20_000),
        "stems per hectare where no attribute or raster states them",
        Example(300.0),
    ] = None
    dbh_cm: Annotated[
        float | None,
        Interval(ge=0, le=300),
        "diameter at breast height where no attribute or raster states it (cm)",
        Example(30.0),
    ] = None

    def _fits_together(self) -> None:
        rasters = self.stems_raster is not None or self.dbh_raster is not None
        if rasters + (self.file is not None) + (self.single_trees is not None) > 1:
            raise ConfigError(
                "forest is given twice",
                field="stems_raster" if self.single_trees is None else "single_trees",
                expected="polygons, rasters or single trees",
            )
        if self.single_trees is not None:
            return
        for what, attribute, raster in (
            ("stems_per_ha", self.stems_field, self.stems_raster),
            ("dbh_cm", self.dbh_field, self.dbh_raster),
        ):
            if getattr(self, what) is None and attribute is None and raster is None:
                raise ConfigError(
                    "missing key", field=what, expected="a number, an attribute or a raster"
                )
            if attribute is not None and self.file is None:
                raise ConfigError(
                    "has no file to go with", field=what, expected="effects.trees.file as well"
                )
