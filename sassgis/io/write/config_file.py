"""A configuration written down: the sections and keys that were given, and what was in memory."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import tomli_w

from sassgis.io.read.config import FILE_KEYS, LISTS
from sassgis.io.read.plain_file import seen_from
from sassgis.io.staging import staged_file, write_new, writing
from sassgis.io.write.manifest import plain
from sassgis.model.declared import is_preset_file
from sassgis.model.in_memory import InMemory
from sassgis.model.run_config import Config

_SUFFIXES = {"raster": ".tif", "layer": ".gpkg", "table": ".csv"}


def save_config(config: Config, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a configuration as a TOML file, from which the same run can be made again.

    Inputs that are in memory are written beside it; files are named as seen from there. Those that
    are there already are replaced with ``overwrite`` only.

    Raises
    ------
    OutputError
        If a file is there already, or cannot be written.
    """
    file = Path(path)
    document = written_document(config, file, overwrite)
    write_new(file, tomli_w.dumps(document), overwrite)
    return file


def written_document(config: Config, path: Path, overwrite: bool = False) -> dict[str, Any]:
    """The document of a configuration that is to be written to ``path``.

    What is in memory is written beside it.
    """
    # Symbolic links are followed: the way up from the new place counts real folders.
    base, place = Path(os.path.realpath(config.base)), Path(os.path.realpath(path)).parent

    def named(value: Any, own: str) -> str:
        if not isinstance(value, InMemory):
            return seen_from(place, Path(base, Path(value).expanduser()))
        file = path.parent / f"{own}{_SUFFIXES[value.kind]}"
        with staged_file(file, overwrite) as work, writing(work):
            if value.kind == "raster":
                work.write_bytes(value.data)
            elif value.kind == "table":
                work.write_text(value.data, encoding="utf-8", newline="\n")
            else:
                value.data.to_file(work, driver="GPKG", layer=file.stem)
        return file.name

    def section(name: str, values: Any, own: str) -> Any:
        if not isinstance(values, Mapping):
            return values
        files = FILE_KEYS.get(name, ())
        return {
            key: named(value, own if key == "file" else key) if key in files else plain(value)
            for key, value in values.items()
        }

    document: dict[str, Any] = {}
    for name, values in config.given.items():
        if name in LISTS:
            document[name] = [section(name, v, f"{name}_{k}") for k, v in enumerate(values, 1)]
        elif name == "effects":
            document[name] = {k: section(f"effects.{k}", v, k) for k, v in values.items()}
        else:
            document[name] = section(name, values, name)
    preset = document.get("hazard", {}).get("preset")
    # As the configuration distinguishes a file from the name of a built-in preset.
    if isinstance(preset, str) and is_preset_file(preset):
        document["hazard"]["preset"] = named(preset, "preset")
    return document
