"""Configurations written down: templates of declared settings, and settings that were given."""

from __future__ import annotations

import json
import os
import re
import textwrap
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import tomli_w

from sassgis.engine.effects.registry import EFFECTS
from sassgis.files.atomic_output import staged_file, write_new, writing
from sassgis.files.plain_file import seen_from
from sassgis.inputs.config import FILE_KEYS, LISTS, SECTIONS, declared_sections, first_line
from sassgis.outputs.manifest import plain
from sassgis.settings.ground import CLASS_MEANINGS
from sassgis.settings.map_run import Config
from sassgis.settings.schema import Declared, InMemory, is_preset_file

_HEAD = """\
# Configuration of a sassgis run.
#
# Paths are relative to this file. Units are part of the names: m, m/s (mps), rad/s (radps), kg/m3
# (kgm3), kJ (kj), degrees (deg). Where a range [low, high] is asked for, a single number will do.
# A line that starts with "# key =" shows an optional key: with its default, or with an example if
# it has none. Unknown keys are errors.
"""


_SHORT_HEAD = """\
# Configuration of a sassgis run: the lines that every site must decide. All keys with their meaning
# and default: `sassgis init --all`, or docs/configuration.md. Paths are relative to this file.
# The block is an example. Lines that start with "# key =" are needed for zones and have no default.
"""


#: What every site must decide, and the value that stands there if no file says it. None: that of
#: the template. What has no sensible value for all sites stands as a comment.
_SHORT: Mapping[str, Mapping[str, object]] = {
    "project": {"name": None},
    "terrain": {"dem": None},
    "release": {"file": None, "spacing_m": None, "rocks_per_point": 20},
    "ground": {"default": None},
    "blocks": {"name": None, "volume_m3": (0.5, 2.0), "onset_frequency": None},
    "hazard": {"preset": None, "ref_width_m": None, "blocks": "auto"},
}


#: What a new configuration has in place of the default.
_IN_PLACE = {("release", "rocks_per_point"), ("hazard", "blocks")}


#: Column of the meanings, where a line is not longer.
_WIDTH = 32


_HIDDEN = ("onset_frequency", "ref_width_m")


#: Sections that are left out of a run unless they are asked for.
_OPTIONAL = ("stations", "barriers", "profile", "objects")


#: Sections whose defaults are seldom changed, and stand as comments.
_QUIET = ("engine", "blocks")


#: Keys with their values, by section; a section with double brackets may come several times.
Given = Iterable[tuple[str, Mapping[str, object]]]


def short_template(given: Given = ()) -> str:
    """Return the few lines that every site must decide, and the sections ``given``."""
    keys = declared_sections()
    sections: list[tuple[str, dict[str, str]]] = []
    for name, short in _SHORT.items():
        plain = {k: _value(keys[name][k]) if v is None else v for k, v in short.items()}
        for own in [dict(values) for section, values in given if section == name] or [{}]:
            hidden = {k for k in _HIDDEN if k not in own}
            lines = {
                f"{'# ' if k in hidden else ''}{k}": toml_value(v) for k, v in (plain | own).items()
            }
            sections.append((name, lines))
    for name, values in given:
        if name not in _SHORT:
            sections.append((name, {k: toml_value(v) for k, v in values.items()}))
    parts = [_SHORT_HEAD]
    lengths = [len(f"{key} = {text}") for _, lines in sections for key, text in lines.items()]
    width = min(max(lengths), _WIDTH)
    for name, lines in sections:
        rows = [_bracketed(name)]
        for key, text in lines.items():
            meaning = re.split(r"[;:] ", keys[name][key.removeprefix("# ")].description)[0]
            rows.append(f"{f'{key} = {text}':<{width}}  # {meaning}")
            if (name, key) == ("ground", "default"):
                rows += [f"#   {own:<16} {what}" for own, what in CLASS_MEANINGS.items()]
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


def _bracketed(section: str) -> str:
    return f"[[{section}]]" if section in LISTS else f"[{section}]"


def config_template(given: Given = ()) -> str:
    """Return a commented configuration with every key; what is ``given`` replaces examples."""
    known = {name: dict(values) for name, values in given}
    parts = [_HEAD]
    for name, keys in declared_sections().items():
        own_values = known.get(name, {})
        optional = name not in known and (name in _OPTIONAL or "." in name)
        head = f"{'# ' if optional else ''}{_bracketed(name)}"
        lines = [*_wrapped(_summary(name), "# "), head]
        for own in keys.values():
            quiet = optional or name in _QUIET or name in _OPTIONAL or "." in name
            in_place = (name, own.name) in _IN_PLACE
            shown = (
                own.name in own_values
                or in_place
                or (_is_shown(own, quiet=quiet) and not (name in known and name in _OPTIONAL))
            )
            value = own_values.get(own.name, _SHORT[name][own.name] if in_place else _value(own))
            lines.append(f"{'' if shown else '# '}{own.name} = {toml_value(value)}")
            lines += _wrapped(_text(own), "#     ")
        parts.append("\n".join(lines) + "\n")
    # A second layer of a kind, as roads next to buildings.
    more = [(n, v) for n, v in given if v != known.get(n)]
    for name, values in more:
        rows = [f"{key} = {toml_value(value)}" for key, value in values.items()]
        parts.append("\n".join([_bracketed(name), *rows]) + "\n")
    return "\n".join(parts)


def _summary(section: str) -> str:
    """Return the summary of a section: the first line of the docstring of its type."""
    if "." in section:
        return first_line(EFFECTS[section.split(".")[1]].settings)
    return first_line(SECTIONS[section])


def _is_shown(own: Declared, *, quiet: bool) -> bool:
    """Return whether a key stands in the template as a setting, and not as a comment."""
    if own.example is not None and own.example.needed:
        return True
    return not quiet and not own.is_required and own.default is not None


def _value(own: Declared) -> Any:
    value = own.default if own.example is None else own.example.value
    # A range of equal limits is written as one number.
    if isinstance(value, tuple) and len(value) == 2 and value[0] == value[1]:
        return value[0]
    return value


def _text(own: Declared) -> str:
    text = own.description
    if own.is_required or (own.example is not None and own.example.needed):
        return text
    return f"{text} (no default)" if own.default is None and "default" not in text else text


def toml_value(value: Any) -> str:
    """Return a value on one line, as TOML has it."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _wrapped(text: str, start: str) -> list[str]:
    return textwrap.wrap(text, 100, initial_indent=start, subsequent_indent=start)


_SUFFIXES = {"raster": ".tif", "layer": ".gpkg", "table": ".csv"}


def save_config(config: Config, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a configuration as a TOML file, from which the same run can be made again.

    Inputs that are in memory are written next to it; files are named as seen from there. Those that
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
    """Return a configuration as a document for ``path``; writes what is in memory there."""
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
