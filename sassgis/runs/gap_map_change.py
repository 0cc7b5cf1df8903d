"""What a calibrated model makes of the map: the same release areas run before and after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sassgis.io.read.config import load_config, resolved
from sassgis.io.read.objects import object_cells
from sassgis.io.staging import staged_output
from sassgis.io.write.frames import object_change_frame, write_table
from sassgis.io.write.manifest import write_manifest
from sassgis.io.write.raster import write_raster
from sassgis.model.errors import ConfigError
from sassgis.model.exposure import PlacedObjects
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.results import Band, RasterLayer
from sassgis.model.run_config import Config
from sassgis.report import figures
from sassgis.report.map_report import release_outlines, save_figure
from sassgis.runs.inputs import input_files, placed_objects
from sassgis.runs.run import RunResult, run
from sassgis.runs.workers import Jobs

#: Values before and after, and their difference.
_Change = tuple[FloatArray, FloatArray, FloatArray]
_RAMP = "RdBu_r"
#: Limits of the legend: as much below as above zero.
_BREAKS = {
    "reach_probability": (-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3),
    "energy": (-300.0, -100.0, -30.0, -10.0, 10.0, 30.0, 100.0, 300.0),
}


@dataclass(frozen=True, slots=True)
class ObjectChange:
    """What changes at an exposed object: the largest values over its cells, before and after.

    Attributes
    ----------
    name : str
        A road as a whole.
    reach : (float, float)
        Reach probability; 0 where no rock comes.
    energy_kj : (float, float)
        95 % quantile of the energy (kJ); 0 where no rock comes.
    """

    name: str
    reach: tuple[float, float]
    energy_kj: tuple[float, float]

    def line(self) -> str:
        """The numbers in words."""
        (r0, r1), (e0, e1) = self.reach, self.energy_kj
        return (
            f"{self.name}: energy (95 % quantile) {e0:,.0f} kJ before, {e1:,.0f} kJ after; "
            f"reach probability {100 * r0:.2g} % before, {100 * r1:.2g} % after."
        )


@dataclass(frozen=True, slots=True)
class MapChange:
    """What changes on the map.

    Attributes
    ----------
    folder : Path
    area_before_m2, area_after_m2 : float
        Area that rocks reach (m²).
    reach_change : float
        Mean change of the reach probability over the cells that rocks reach before or after.
    energy_change_kj : float
        Mean change of the 95 % quantile of the energy over the cells that rocks reach before and
        after (kJ); NaN if there is none.
    objects : tuple of ObjectChange
        Of the configured objects.
    """

    folder: Path
    area_before_m2: float
    area_after_m2: float
    reach_change: float
    energy_change_kj: float
    objects: tuple[ObjectChange, ...] = ()

    def lines(self) -> tuple[str, ...]:
        """The numbers in words."""
        share = 100.0 * (self.area_after_m2 / self.area_before_m2 - 1.0)
        out: tuple[str, ...] = (
            f"Area that rocks reach: {self.area_before_m2:,.0f} m² before, "
            f"{self.area_after_m2:,.0f} m² after ({share:+.0f} %).",
            f"Reach probability, mean change over these cells: {100 * self.reach_change:+.2g} "
            "percentage points.",
        )
        if np.isfinite(self.energy_change_kj):
            out += (
                f"Energy (95 % quantile), mean change over the cells reached by both: "
                f"{self.energy_change_kj:+.3g} kJ.",
            )
        said = tuple(" ".join(line.split()).replace("-", "\u2212") for line in out)
        return said + tuple(one.line() for one in self.objects)


def map_change(
    config_before: str | Path,
    config_after: str | Path,
    out: str | Path,
    jobs: Jobs = None,
    *,
    overwrite: bool = False,
    say: Callable[[str], None] | None = None,
) -> MapChange:
    """Run two configurations and map what changes.

    Writes the results ``before`` and ``after`` (as ``sassgis run`` does), the rasters
    ``maps/reach_probability_change.tif`` and ``maps/energy_change.tif``, a figure of each, and
    ``tables/objects.csv``, if objects are configured.

    Parameters
    ----------
    config_before, config_after : path
        With the same terrain. ``terrain.path`` of the second holds for both.
    out : path
        Folder of the result; appears whole or not at all.
    jobs : int, optional
        In place of that of the configurations.
    overwrite : bool
        Whether a result that is there already may be replaced.
    say : callable, optional
        Called with a line of text now and then.

    Returns
    -------
    MapChange

    Raises
    ------
    ConfigError
        A configuration has no release areas, or the two differ in their terrain.
    InputError, OutputError
    """
    after = load_config(config_after)
    # Paths of another kind would be a change by themselves.
    before = load_config(config_before, {"terrain.path": after.terrain.path})
    for config in (before, after):
        _check(config)
    tell = say or (lambda _text: None)
    with staged_output(Path(out), overwrite) as work:
        results = []
        for name, config in (("before", before), ("after", after)):
            tell(f"Running the map {name}")
            results.append(run(config, work / name, jobs=jobs))
        placed = placed_objects(after, results[1].run.grid)
        change = _write(work, Path(out), results[0], results[1], placed)
        write_manifest(
            work / "manifest.json",
            inputs={
                f"{role} ({name})": file
                for name, config in (("before", before), ("after", after))
                for role, file in input_files(config).items()
            },
            base=before.file.parent,
            crs=results[0].run.grid.crs,
            vertical_datum=results[0].run.grid.vertical_datum,
            seed=results[0].run.seed,
            ref_widths_m={"reach_probability": results[0].run.grid.cell_size},
            preset="",
            settings={"before": resolved(before), "after": resolved(after)},
            counts={"rocks_before": results[0].rocks, "rocks_after": results[1].rocks},
            warnings=[*results[0].warnings, *results[1].warnings],
        )
    return change


def _check(config: Config) -> None:
    if config.release.file is None:
        raise ConfigError(
            "has no release areas, so that there is no map to compare",
            file=config.file,
            field="release.file",
            found="nothing",
            expected="polygons, lines or points of release",
        )


def _band(result: RunResult, stem: str) -> Band:
    return next(layer for layer in result.layers if layer.stem == stem).bands[0]


def difference(before: FloatArray, after: FloatArray) -> FloatArray:
    """After less before; where no rock comes counts as zero, NaN where none comes in either."""
    old, new = np.asarray(before, np.float64), np.asarray(after, np.float64)
    change = np.nan_to_num(new) - np.nan_to_num(old)
    result: FloatArray = np.where(np.isfinite(old) | np.isfinite(new), change, np.nan)
    return result


def _write(
    work: Path, out: Path, before: RunResult, after: RunResult, placed: PlacedObjects
) -> MapChange:
    grid = before.run.grid
    _same_cells(grid, after)
    nothing = "Cells that no rock reaches count as zero."
    changes = {}
    for stem, title, unit, words, ramp in (
        ("reach_probability", "Reach probability", "1", "Change of the reach probability",
         "plasma_r"),
        ("energy", "Kinetic energy, 95 % quantile", "kJ", "Change of the energy (95 % quantile)",
         "YlOrRd"),
    ):  # fmt: skip
        bands = [_band(result, stem) for result in (before, after)]
        old, new = (np.asarray(band.values, np.float64) for band in bands)
        change = difference(old, new)
        changes[stem] = (old, new, change)
        layer = RasterLayer(
            f"{stem}_change",
            f"{words}, after less before" + (f" ({unit})" if unit != "1" else ""),
            f"{nothing} Width {grid.cell_size:.4g} m (one cell).",
            (
                Band("change", f"{words}, after less before", unit, change.astype(np.float32)),
                Band("before", f"{title}, before", unit, old.astype(np.float32)),
                Band("after", f"{title}, after", unit, new.astype(np.float32)),
            ),
            _BREAKS[stem],
            _RAMP,
        )
        write_raster(layer, grid, work / "maps")
        figure = figures.map_change_figure(
            grid, old, new, change, unit="" if unit == "1" else unit, ramp=ramp,
            release=release_outlines(before.run), title=f"{title}, before and after", note=nothing,
        )  # fmt: skip
        save_figure(work / "figures", f"{stem}_change", figure)
    cell = grid.cell_size**2
    old, new, change = changes["reach_probability"]
    _, _, energy = changes["energy"]
    both = np.isfinite(old) & np.isfinite(new)
    objects = _at_objects(placed, grid, changes["reach_probability"], changes["energy"])
    if objects:
        frame = object_change_frame(
            [o.name for o in objects], [o.reach for o in objects], [o.energy_kj for o in objects]
        )
        write_table(work / "tables" / "objects.csv", [frame])
    return MapChange(
        folder=out,
        area_before_m2=float(np.isfinite(old).sum() * cell),
        area_after_m2=float(np.isfinite(new).sum() * cell),
        reach_change=float(np.nanmean(change)),
        energy_change_kj=float(np.mean(energy[both])) if both.any() else float("nan"),
        objects=objects,
    )


def _at_objects(
    placed: PlacedObjects, grid: Grid, reach: _Change, energy: _Change
) -> tuple[ObjectChange, ...]:
    """Largest values over the cells of each object, roads as a whole."""
    cells, owner = object_cells(placed, grid)
    whole = np.array([o.whole for o in placed.objects])
    found = []
    for name in dict.fromkeys(whole.tolist()):
        own = cells[whole[owner] == name]
        largest = [
            float(np.nan_to_num(values.ravel()[own]).max(initial=0.0))
            for values in (*reach[:2], *energy[:2])
        ]
        found.append(ObjectChange(name, (largest[0], largest[1]), (largest[2], largest[3])))
    return tuple(found)


def _same_cells(grid: Grid, after: RunResult) -> None:
    other = after.run.grid
    places = [(g.shape, g.west, g.north, g.cell_size) for g in (grid, other)]
    if places[0] != places[1]:
        raise ConfigError(
            "the two configurations have different terrain models",
            field="terrain.dem",
            found=f"{other.shape[0]} x {other.shape[1]} cells of {other.cell_size:g} m",
            expected=f"{grid.shape[0]} x {grid.shape[1]} cells of {grid.cell_size:g} m",
        )
