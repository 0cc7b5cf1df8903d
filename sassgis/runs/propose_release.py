"""Release areas proposed from a terrain model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sassgis.errors import InputError
from sassgis.files.atomic_output import staged_file
from sassgis.grid import FloatArray
from sassgis.inputs.ground_map import ground_raster, read_ground_table
from sassgis.inputs.tiles import read_terrain
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers.run_vectors import proposed_areas
from sassgis.runs.inputs import check_heights, collected_notices
from sassgis.settings.settings import GroundSettings
from sassgis.terrain.slope_units import SlopeUnits, cliff_patches, slope_units, slopes_deg

#: Below this threshold cells are hardly bare rock: fresh rock debris rests at about 35 to
#: 40 degrees (our choice).
_LEAST_CLIFF_DEG = 40.0
#: Smaller than this no patch is resolved by the cells.
_LEAST_CELLS = 4


@dataclass(frozen=True, slots=True)
class Proposal:
    """Proposed release areas."""

    units: SlopeUnits | None  # None if the threshold was stated and there are no cliffs
    threshold_deg: float  # slopes that were used, also where the user stated them
    rock_deg: float
    areas: int
    area_m2: float  # of all proposed areas, in plan
    cell_size: float
    warnings: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the proposal for people, line by line."""
        out = []
        if self.units is not None:
            out.append("slope unit          mean  std. dev.  share of the surface")
            out += [
                f"  {u.name:<14}{u.mean_deg:7.1f}°{u.sd_deg:9.1f}°{100.0 * u.surface_share:9.1f} %"
                for u in self.units.units
            ]
            out.append(
                f"cliffs prevail from {self.units.cliff_deg:.1f}°, on cells of {self.cell_size:g} m"
            )
        out.append(f"threshold       {self.threshold_deg:.1f}°")
        if self.rock_deg < self.threshold_deg:
            out.append(f"mapped rock     from {self.rock_deg:.1f}°")
        out.append(f"proposed        {self.areas} areas, {self.area_m2:.0f} m2 in plan")
        return out + [f"WARNING         {text}" for text in self.warnings]


def propose_release(
    dem: Path,
    out: Path,
    *,
    crs: str | None = None,
    override_crs: bool = False,
    ground: Path | None = None,
    class_field: str = "class",
    layer: str | None = None,
    rock: str = "rock",
    threshold_deg: float | None = None,
    min_area_m2: float = 50.0,
    overwrite: bool = False,
) -> Proposal:
    """Propose release areas from slope and ground and write them into a GeoPackage.

    Parameters
    ----------
    crs : str, optional
        Of the terrain model, where it states none, or with ``override_crs`` in place of it.
    ground : Path, optional
        Polygons of ground classes: what they call ``rock`` counts from a gentler slope on.
    threshold_deg : float, optional
        Used in place of the slope from which cliffs prevail (degrees).
    min_area_m2 : float
        Smaller patches, in plan, are left out, and those of fewer than four cells.
    """
    if out.suffix.lower() != ".gpkg":
        raise InputError("is no GeoPackage", file=out, expected="a name ending in .gpkg")
    with staged_file(out, overwrite) as work:
        with collected_notices() as warnings:
            grid = read_terrain(dem, crs, None, override_crs)
            check_heights(grid, dem)
        slopes = slopes_deg(grid.values, grid.cell_size, grid.cell_size)
        found = _units(slopes, dem, threshold_deg)
        known = None
        if ground is not None:
            table = read_ground_table()
            other = next(name for name in table.names if name != rock)
            own = GroundSettings(default=other, file=ground, layer=layer, class_field=class_field)
            known = ground_raster(own, grid, table) == table.index(rock)
        threshold = threshold_deg
        if threshold is None:
            assert found is not None
            threshold = found.cliff_deg
        rock_deg = threshold
        if known is not None and found is not None:
            rock_deg = min(threshold, found.steep_deg)
        least = max(_LEAST_CELLS, math.ceil(min_area_m2 / grid.cell_size**2))
        patches = cliff_patches(slopes, threshold, least, known, rock_deg)
        if not patches.any():
            raise InputError(
                "holds no release area", file=dem,
                found=f"no {least} connected cells of {threshold:.1f} degrees or more; "
                f"the steepest has {np.nanmax(slopes):.1f}",
                expected="steeper ground, a lower --threshold or a smaller --min-area",
            )  # fmt: skip
        proposed = proposed_areas(patches, grid, slopes, known)
        facts: dict[str, object] = {
            "method": "slope angle distribution (Loye, Jaboyedoff and Pedrazzini, 2009)",
            "terrain": dem.name,
            "cell_size_m": grid.cell_size,
            "threshold_deg": round(threshold, 2),
            "rock_threshold_deg": round(rock_deg, 2),
            "min_area_m2": min_area_m2,
        }
        for unit in () if found is None else found.units:
            facts[unit.name] = (
                f"mean {unit.mean_deg:.2f}, standard deviation {unit.sd_deg:.2f} degrees, "
                f"share {unit.surface_share:.4f}"
            )
        write_geopackage(work, [proposed], facts)
    if threshold < _LEAST_CLIFF_DEG:
        warnings.append(
            f"cells from {threshold:.1f} degrees on may be debris or vegetated slopes, not rock"
        )
    if grid.cell_size > 10.0:
        warnings.append(
            f"cells of {grid.cell_size:g} m flatten cliffs that are lower than about "
            f"{2.0 * grid.cell_size:g} m"
        )
    return Proposal(
        units=found, threshold_deg=threshold, rock_deg=rock_deg, areas=int(patches.max()),
        area_m2=float((patches > 0).sum()) * grid.cell_size**2, cell_size=grid.cell_size,
        warnings=tuple(warnings),
    )  # fmt: skip


def _units(slopes: FloatArray, dem: Path, threshold_deg: float | None) -> SlopeUnits | None:
    """Return the slope units; None if there are no cliffs and the user knows the threshold."""
    try:
        return slope_units(slopes)
    except InputError as error:
        if threshold_deg is not None:
            return None
        raise InputError(**error.parts(file=dem)) from None
