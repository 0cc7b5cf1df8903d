"""The inputs of Rockyfor3D written as a configuration with its layers."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from sassgis.io.atomic_output import staged_file
from sassgis.io.read.rockyfor3d import rasters_of, read_rockyfor3d
from sassgis.io.read.start_keys import outline_of, with_values
from sassgis.io.write.config_template import short_template
from sassgis.io.write.frames import write_table


def write_rockyfor3d_site(
    file: Path, folder: Path, assignments: Sequence[str] = (), overwrite: bool = False
) -> tuple[list[Path], list[str]]:
    """Write a configuration from a folder of Rockyfor3D, and beside it what it is made into.

    Assignments are keys that the user sets, as ``terrain.crs=EPSG:2056``. Files that are there
    already are replaced with ``overwrite`` only. Returns the files, and what their user must know
    of them.
    """
    terrain = dict(with_values([("terrain", {})], assignments))["terrain"]
    dem = rasters_of(folder).get("dem", folder / "dem.asc")
    made = read_rockyfor3d(folder, file.parent, outline_of(dem, terrain).crs or None)
    comments = "".join(
        textwrap.fill(note, 100, initial_indent="# - ", subsequent_indent="#   ") + "\n"
        for note in made.notes
    )
    text = f"# From {folder.name}, inputs of Rockyfor3D.\n{comments}\n"
    text += short_template(with_values(made.keys, assignments))
    files = [file]
    with ExitStack() as staged:
        for name, layer in made.layers.items():
            files.append(file.parent / f"{name}.gpkg")
            work = staged.enter_context(staged_file(files[-1], overwrite))
            layer.to_file(work, driver="GPKG", layer=name)
        for name, table in made.tables.items():
            files.append(file.parent / f"{name}.csv")
            write_table(staged.enter_context(staged_file(files[-1], overwrite)), [table])
        staged.enter_context(staged_file(file, overwrite)).write_text(text, encoding="utf-8")
    return files, made.notes
