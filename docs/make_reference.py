"""Write docs/configuration.md, and the tables of effects and causes in other pages, from what is
declared.

``python docs/make_reference.py`` rewrites them all.
"""

from __future__ import annotations

import json
import math
import re
import types
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from sassgis.engine.effects.registry import EFFECTS
from sassgis.files.plain_file import LONGEST_TEXT
from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.observations.tables import METADATA_KEYS, METADATA_TEXTS, TABLE_TYPES, Column
from sassgis.gap.observations.tables import TABLES as OBSERVED
from sassgis.inputs.config import LISTS, declared_sections
from sassgis.settings.schema import Declared, interval

PAGE = Path(__file__).parent / "configuration.md"

_HEAD = f"""\
<!-- Written by docs/make_reference.py from the declared settings. Do not edit. -->

# Configuration

After this page you can set every key of a run. One TOML file describes it: `sassgis init` writes
the keys that every site must decide, `sassgis init --all` every key ([starting](starting.md));
`sassgis validate` reads it and all files that it names. Paths are relative to the file.
[Units](conventions.md#units) are part of the names. A *range* is `[low, high]`; a single number
means two equal limits. Unknown keys are errors, and so are texts of more than {LONGEST_TEXT}
characters, here and in all other inputs. [Formats](terrain.md#formats) of rasters and vector files.

A run on the map needs `terrain.dem`, `release.file` and one `[[blocks]]`; a run along one profile
needs `[profile]` (or `--csv`, `--point`, `--line`) and one `[[blocks]]`. Everything else has a
default (–: none).

Paths, numbers of cores and output settings do not change the simulated blocks. The sections
terrain, release, ground, blocks, stations, barriers, effects, engine and run (except
`jobs` and `ground_uncertainty`) may.
"""

_INTRO = {
    "project": "",
    "terrain": "Terrain model and paths: [terrain](terrain.md).",
    "release": "Where blocks start: [release points](terrain.md#release-points).",
    "ground": "The ground class of each cell: [classes](model.md#ground-classes).",
    "blocks": "One section for each block scenario; one is needed. Each value of a block is drawn "
    "uniformly between its limits (volumes by a power law with `volume_exponent`). Its size is "
    "given by three semi-axes or by a volume. Zones need its onset frequency: "
    "[hazard](hazard.md).",
    "stations": "Control lines where passing blocks are recorded; a section for each. Placed by "
    "exactly one of `line`, `file`, `chainage_m`.",
    "barriers": "Walls and nets, placed like stations. Names of stations and barriers must be "
    "unique. Kind and height are needed; both, and the capacity, are one for all features, or an "
    "attribute of each (`..._field`).",
    "engine": "Modelling assumptions where the paper leaves a question open: "
    "[model.md](model.md#modelling-assumptions).",
    "profile": "A run along one profile (`sassgis profile`).",
    "hazard": "Intensities and hazard levels (`sassgis zone`): [hazard.md](hazard.md).",
    "zones": "From cells to polygons: [zones.md](zones.md).",
    "edits": "Polygons in which an expert sets the hazard level: "
    "[zones.md](zones.md#edits-by-hand).",
    "risk": "Consequences of hits on exposed objects: [risk.md](risk.md).",
    "objects": "Exposed objects, a section for each layer: [risk.md](risk.md). Each number is one "
    "for all features, or an attribute of each (`..._field`).",
    "run": "",
    "output": "Output files: [outputs.md](outputs.md).",
}


def kind(annotation: Any) -> str:
    """Words for the kind of value of a key."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return kind(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return kind(next(a for a in get_args(annotation) if a is not type(None)))
    if origin is Literal:
        return " or ".join(f'`"{a}"`' for a in get_args(annotation))
    if origin is tuple:
        parts = get_args(annotation)
        if len(parts) == 2 and parts[1] is not Ellipsis:
            return "range"
        if len(parts) == 3:
            return "three ranges"
        if kind(parts[0]) == "text":
            return "list of texts"
        return "list of points" if kind(parts[0]) == "range" else "list of numbers"
    if origin is not None:
        return "table"
    names = {str: "text", Path: "path", float: "number", int: "whole number", bool: "true or false"}
    return names[annotation]


def shown(value: Any) -> str:
    """A default as it would be written in the file."""
    if isinstance(value, tuple):
        if len(set(value)) == 1:
            return shown(value[0])
        return "[" + ", ".join(shown(v) for v in value) + "]"
    if isinstance(value, float) and value == math.pi:
        return "3.14159..."
    return json.dumps(value)


def limits(annotation: Any) -> str:
    """Limits of a number, as in ``, > 0 to 10``; nothing if it has none."""
    own = interval(annotation)
    if own is None:
        return ""
    low = f"> {own.gt:g}" if own.gt is not None else f"{own.ge:g}"
    if own.le is not None:
        return f", {low} to {own.le:g}"
    if own.lt is not None:
        return f", {low} to < {own.lt:g}"
    return f", {low}" if own.gt is not None else f", ≥ {low}"


def row(own: Declared) -> str:
    """One key as a row of its section's table."""
    if own.is_required:
        default = "*needed*"
    elif own.default is None:
        default = "–"
    else:
        default = f"`{shown(own.default)}`"
    text = own.description.replace("|", "\\|").removesuffix(".")
    if re.match(r"A |[A-Z][a-z]", text):  # neither an abbreviation nor a symbol
        text = text[:1].lower() + text[1:]
    if own.old_name is not None:
        text += f". Formerly `{own.old_name}`, which is read with a note for one version"
    return f"| `{own.name}` | {kind(own.kind)}{limits(own.kind)} | {default} | {text} |"


def section(name: str, keys: Mapping[str, Declared]) -> str:
    """One section of the page."""
    brackets = f"[[{name}]]" if name in LISTS else f"[{name}]"
    lines = [f"## `{brackets}`", ""]
    effect = name.removeprefix("effects.")
    intro = _INTRO.get(name, f"Turns the effect on: [{effect}](effects.md#{effect}).")
    if intro:
        lines += [intro, ""]
    lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
    lines += [row(own) for own in keys.values()]
    return "\n".join(lines)


def page() -> str:
    """The whole page of the configuration."""
    sections = (section(name, keys) for name, keys in declared_sections().items())
    return "\n\n".join([_HEAD.rstrip(), *sections]) + "\n"


def effects_table() -> list[str]:
    """The effects, a row for each."""
    rows = ["| effect | what it is | phase | forms |", "|---|---|---|---|"]
    for name, own in EFFECTS.items():
        form = own.keys.get("form")
        forms = "" if form is None else kind(form.kind).replace(" or ", ", ").replace('"', "")
        rows.append(f"| [`{name}`](#{name}) | {own.summary} | {own.phase} | {forms} |")
    return rows


def causes_table() -> list[str]:
    """The causes that the diagnosis can name, a row for each."""
    rows = ["| cause | fingerprints | tables, any of |", "|---|---|---|"]
    for cause in CAUSES.values():
        taken = (own.tables for own in cause.statistics)
        tables = dict.fromkeys(" and ".join(f"`{name}`" for name in own) for own in taken)
        rows.append(f"| {cause.words[0]} | {cause.shown_by} | {'; '.join(tables)} |")
    return rows


def observation_tables() -> list[str]:
    """The tables of observations and the keys of their metadata, each with its columns."""
    rows = []
    for name, columns in OBSERVED.items():
        rows += [
            f"### `{name}`",
            "",
            TABLE_TYPES[name].about,
            "",
            *columns_table("column", columns),
        ]
    about = (
        "Two columns, `key` and `value`. The last keys hold words for whoever uses the site later. "
        "Other keys are passed on (`Metadata.others`)."
    )
    keys = columns_table("key", (*METADATA_KEYS.values(), *METADATA_TEXTS.values()))
    return [*rows, "### `metadata`", "", about, "", *keys[:-1]]


def columns_table(kind: str, columns: Iterable[Column]) -> list[str]:
    """Columns with unit and meaning, and an empty line; coordinates of a point in one row."""
    places: dict[tuple[str, str], list[str]] = {}
    for own in columns:
        meaning = re.sub(r": (x|y|height)$", "", own.meaning)
        places.setdefault((own.unit or "–", meaning), []).append(f"`{own.name}`")
    rows = (f"| {', '.join(names)} | {unit} | {text} |" for (unit, text), names in places.items())
    return [f"| {kind} | unit | |", "|---|---|---|", *rows, ""]


#: Pages with a table that is made here, and the word of its marks.
TABLES: Mapping[str, tuple[str, Callable[[], list[str]]]] = {
    "effects.md": ("effects", effects_table),
    "gap.md": ("causes", causes_table),
    "observations.md": ("tables", observation_tables),
}


def with_table(page: str, text: str) -> str:
    """The text of a page with its table made anew."""
    word, made = TABLES[page]
    first, last = f"<!-- {word}: made by docs/make_reference.py -->\n", f"<!-- {word}: end -->\n"
    before, rest = text.split(first)
    return before + first + "\n".join(made()) + "\n" + last + rest.split(last)[1]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    for name in TABLES:
        file = PAGE.with_name(name)
        file.write_text(with_table(name, file.read_text("utf-8")), encoding="utf-8")
