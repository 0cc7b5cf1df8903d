"""Compare two results, or run two configurations and compare: maps, tables, project, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from sassgis.errors import ConfigError
from sassgis.files.atomic_output import MANIFEST_NAME, staged_output
from sassgis.inputs.config import load_config
from sassgis.inputs.result_folder import read_result
from sassgis.outputs.frames import write_table
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers.variant_layers import (
    change_layers,
    change_rows_table,
    difference_table,
    level_change_layer,
    zone_changes,
)
from sassgis.outputs.manifest import write_manifest
from sassgis.outputs.qgis.entries import LayerEntry
from sassgis.outputs.raster import write_over_relief
from sassgis.report.change_report import change_figures, change_report
from sassgis.report.page import translated_report, write_report
from sassgis.runs.inputs import cells_of_wholes, input_files, placed_objects
from sassgis.runs.run import run
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.languages import in_language, phrase, translated
from sassgis.settings.schema import Input
from sassgis.simulation.workers import Jobs
from sassgis.studies.result_change import ResultChange, levels_differ, result_change
from sassgis.studies.stored_result import (
    StoredResult,
    is_one_line,
    objects_within,
    on_common_cells,
)


def compare(
    before: str | Path,
    after: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    say: Callable[[str], None] | None = None,
) -> ResultChange:
    """Compare two results that run, zone or batch wrote, and write what changes.

    Folders of a batch are those of an area, or of the mosaic. InputError: a folder is no result, or
    the cells of the two do not coincide.
    """
    folders = {"before": Path(before), "after": Path(after)}
    one, two = (read_result(folder) for folder in folders.values())
    # One that both have is as the second has it.
    known = {o.whole for o in two.objects.objects}
    own = [i for i, o in enumerate(one.objects.objects) if o.whole not in known]
    placed = PlacedObjects(
        (*two.objects.objects, *(one.objects.objects[i] for i in own)),
        (*two.objects.geometries, *(one.objects.geometries[i] for i in own)),
    )
    inputs = {role: folder / MANIFEST_NAME for role, folder in folders.items()}
    with staged_output(Path(out), overwrite) as work:
        base = Path(out).absolute().parent
        return _write_comparison(work, one, two, placed, inputs=inputs, base=base, say=say)


def map_change(
    config_before: str | Path,
    config_after: str | Path,
    out: str | Path,
    jobs: Jobs = None,
    *,
    overwrite: bool = False,
    say: Callable[[str], None] | None = None,
) -> ResultChange:
    """Run two configurations and map what changes.

    Writes the results ``before`` and ``after`` (as ``sassgis run`` does), and next to them what
    ``sassgis compare`` writes, with the configured objects. ``terrain.path`` of the second holds
    for both. ConfigError: a configuration has no release areas; InputError: the cells of the two
    terrain models do not coincide.
    """
    after = load_config(config_after)
    # Paths of another kind would be a change by themselves.
    before = load_config(config_before, {"terrain.path": after.terrain.path})
    configs = {"before": before, "after": after}
    for config in configs.values():
        if config.release.file is None:
            raise ConfigError(
                "has no release areas, so that there is no map to compare",
                file=config.file, field="release.file", found="nothing",
                expected="polygons, lines or points of release",
            )  # fmt: skip
    tell = say or (lambda _text: None)
    with staged_output(Path(out), overwrite) as work:
        for name, config in configs.items():
            tell(f"Running the map {name}")
            done = run(config, work / name, jobs=jobs)
        inputs = {
            f"{role} ({name})": file
            for name, config in configs.items()
            for role, file in input_files(config).items()
        }
        one, two = (read_result(work / name) for name in configs)
        placed = placed_objects(after, done.run.grid)
        return _write_comparison(work, one, two, placed, inputs=inputs, base=before.base, say=say)


def _write_comparison(
    work: Path,
    before: StoredResult,
    after: StoredResult,
    placed: PlacedObjects,
    *,
    inputs: Mapping[str, Input],
    base: Path,
    say: Callable[[str], None] | None,
) -> ResultChange:
    """Write the comparison of two results, with their values at the ``placed`` objects."""
    tell = say or (lambda _text: None)
    whole = before.grid.shape, after.grid.shape
    before, after = on_common_cells(before, after)
    notes: list[str] = []
    if (before.grid.shape, after.grid.shape) != whole:
        notes.append(
            "The results cover different areas. Maps, zones and objects are compared on the "
            "common part."
        )
        placed = objects_within(placed, after.grid)
    traces = {name: trace for name, _, trace in before.traces}
    moved = [name for name, _, own in after.traces if not is_one_line(traces.get(name, own), own)]
    if moved:
        text = "Moved from one result to the other, so that loads are those of two places: {}."
        notes.append(phrase(text, ", ".join(moved)))
    grid = after.grid
    names, touched = cells_of_wholes(placed, grid)
    change = result_change(before, after, (names, touched.cell, touched.number), notes)
    levels = not levels_differ(before, after)
    tell("Writing the maps of the change")
    maps = change_layers(before, after)
    changed = None
    if levels:
        maps = (level_change_layer(before, after), *maps)
        zones = zone_changes(before, after)
        if zones is not None:
            changed = LayerEntry(zones[0], "changes.gpkg")
            write_geopackage(work / "changes.gpkg", [zones[0]])
            write_table(work / "tables" / "level_changes.csv", [zones[1]])
    write_table(work / "tables" / "changes.csv", [change_rows_table(change.rows)])
    write_table(work / "tables" / "differences.csv", [difference_table(change.differences)])
    with in_language(after.manifest["settings"].get("project", {}).get("language", "en")):
        write_over_relief(
            work, grid, maps, group="Change, after less before",
            title=translated(phrase("{}: before and after", after.title)),
            abstract="Changes between two results.", zones=changed,
        )  # fmt: skip
        tell("Drawing the figures")
        pictures = change_figures(before, after, work / "figures", levels=levels)
        report = change_report(before, after, change, pictures)
        write_report(work / "report.html", translated_report(report))
    stated = {"before": before.manifest, "after": after.manifest}
    write_manifest(
        work / MANIFEST_NAME, inputs=inputs, base=base, crs=grid.crs,
        vertical_datum=grid.vertical_datum, seed=int(after.manifest["seed"]),
        ref_widths_m=after.manifest["ref_widths_m"], preset=str(after.manifest["preset"]),
        settings={when: own["settings"] for when, own in stated.items()},
        counts={f"rocks_{when}": int(own["counts"]["rocks"]) for when, own in stated.items()},
        warnings=change.notes,
    )  # fmt: skip
    return change
