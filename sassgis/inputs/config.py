"""One TOML file describes a run: strict keys, units in the names, paths relative to the file.

``load_config`` reads it, ``configure`` takes the same sections and keys from a program, with
inputs in memory where files are named. Both are cheap: no raster and no layer is opened. The
readers check what the inputs hold.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, NotRequired, Required

import numpy as np
from pydantic import AfterValidator, TypeAdapter, ValidationError
from pydantic.json_schema import GenerateJsonSchema

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.registry import EFFECTS, Effect
from sassgis.errors import ConfigError, InputError
from sassgis.files.input_parts import file_digest
from sassgis.files.plain_file import read_toml, seen_from
from sassgis.inputs.checked import Place, first_error, first_of, table_type
from sassgis.settings.blocks import BlockPopulation, EffectSection, EffectSettings
from sassgis.settings.exposure import ObjectSettings, RiskSettings
from sassgis.settings.hazard_rules import EditSettings, HazardSettings, Onset, ZoningSettings
from sassgis.settings.map_run import Config
from sassgis.settings.results import ControlLine
from sassgis.settings.schema import (
    Declared,
    InMemory,
    Section,
    Several,
    declared,
    is_file,
    is_preset_file,
    refusal,
)
from sassgis.settings.settings import (
    AXES,
    BarrierSettings,
    BlockSettings,
    EngineSettings,
    GroundSettings,
    OutputSettings,
    ProfileSettings,
    ProjectSettings,
    ReleaseSettings,
    RunSettings,
    StationSettings,
    TerrainSettings,
)

#: The type of each section; that of ``[effects]`` holds a section for each effect that is on.
SECTIONS: Mapping[str, type[Section] | type[EffectSettings]] = {
    "project": ProjectSettings,
    "terrain": TerrainSettings,
    "release": ReleaseSettings,
    "ground": GroundSettings,
    "blocks": BlockSettings,
    "stations": StationSettings,
    "barriers": BarrierSettings,
    "engine": EngineSettings,
    "effects": EffectSettings,
    "profile": ProfileSettings,
    "hazard": HazardSettings,
    "zones": ZoningSettings,
    "edits": EditSettings,
    "risk": RiskSettings,
    "objects": ObjectSettings,
    "run": RunSettings,
    "output": OutputSettings,
}
#: Former sections, and what takes their place.
_GONE = {
    "spread": 'nothing: with terrain.path = "followed" (the default) each block has its own path'
}
#: Sections that are written with double brackets, as often as needed.
LISTS = ("blocks", "stations", "barriers", "objects")


def declared_sections() -> dict[str, Mapping[str, Declared]]:
    """Return the settings of each section by key; those of an effect under ``effects.<name>``."""
    found: dict[str, Mapping[str, Declared]] = {}
    for name, cls in SECTIONS.items():
        if name == "effects":
            found |= {f"effects.{row.name}": row.keys for row in EFFECTS.values()}
        else:
            found[name] = declared(cls)
    return found


#: Keys that name files, by section; the keys of ``[[...]]`` are those of each entry.
FILE_KEYS: Mapping[str, tuple[str, ...]] = {
    name: tuple(key for key, own in keys.items() if is_file(own.kind))
    for name, keys in declared_sections().items()
}


EffectTable = tuple[EffectSection, Section | None]


def _effect_type(row: Effect) -> Any:
    """Return ``[effects.<name>]``: the settings of the effect and, for some, where it acts."""

    def made(values: dict[str, Any]) -> EffectTable:
        try:
            place = None if row.place is None else _made_of(row.place, values)
            return _made_of(row.settings, values), place
        except ConfigError as error:
            raise refusal(error) from None

    fields = {
        key: Required[own.kind] if own.is_required else NotRequired[own.kind]
        for key, own in row.keys.items()
    }
    table = table_type(f"effects.{row.name}", fields, first_line(row.settings))
    return Annotated[table, AfterValidator(made)]


def _made_of(cls: Any, values: Mapping[str, Any]) -> Any:
    """Return a section of those values that are declared for it."""
    return cls(**{key: value for key, value in values.items() if key in declared(cls)})


def first_line(cls: Any) -> str:
    """Return the summary of a section: the first line of the docstring of its type."""
    return (cls.__doc__ or "").splitlines()[0]


@cache
def _document() -> TypeAdapter[dict[str, Any]]:
    """Return the whole file, section by section."""
    kinds: dict[str, Any] = {}
    for name, cls in SECTIONS.items():
        own: Any = cls
        if name == "effects":
            rows = {row.name: NotRequired[_effect_type(row)] for row in EFFECTS.values()}
            own = table_type("effects", rows, first_line(cls))
        kinds[name] = NotRequired[Several[own] if name in LISTS else own]
    return TypeAdapter(table_type("document", kinds, "A run of sassgis"))


class _ForToml(GenerateJsonSchema):
    """A JSON Schema of TOML files, which have no null."""

    def nullable_schema(self, schema: Any) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def config_schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration, with which editors complete and check it."""
    made = _document().json_schema(schema_generator=_ForToml)
    for section, keys in declared_sections().items():
        table = made
        for part in section.split("."):
            entry = table["properties"][part]
            table = made["$defs"][entry.get("items", entry)["$ref"].rpartition("/")[2]]
        known = table["properties"]
        table["properties"] = {}
        for key, own in keys.items():
            stated = {} if own.default in (dataclasses.MISSING, None) else {"default": own.default}
            kind = {name: value for name, value in known[key].items() if name != "default"}
            table["properties"][key] = {**kind, **stated, "description": own.description}
    return {"$schema": _ForToml.schema_dialect, **made}


def load_config(path: str | PathLike[str], overrides: Mapping[str, object] | None = None) -> Config:
    """Read and check a configuration, a TOML file; no raster and no layer is opened.

    ``overrides`` replace values of the file, by dotted key, as in ``{"run.seed": 7}``.
    """
    file = Path(os.path.expanduser(path))
    try:
        document = read_toml(file, None, "a TOML configuration file")
    except InputError as error:
        raise ConfigError(**error.parts(file=file)) from None
    for dotted, value in (overrides or {}).items():
        section, _, key = dotted.partition(".")
        target = document.setdefault(section, {})
        if not key or not isinstance(target, dict):
            raise ConfigError("cannot be overridden", field=dotted, expected="a key as in run.seed")
        target[key] = value
    return _config_of(document, file.resolve(), file.parent.resolve())


#: A section as a program gives it: its keys, or its settings as an object.
GivenSection = Mapping[str, object] | Section


def configure(**sections: GivenSection | Iterable[GivenSection] | None) -> Config:
    """Return a configuration made by a program: the sections and keys of the file, as keywords.

    Each is a mapping of keys to values, or its settings as an object; ``blocks``, ``stations``,
    ``barriers`` and ``objects`` are sequences of them. Where a key names a file, the value may be a
    path, or what is in memory: a raster as xarray.DataArray or as (array, affine transform,
    coordinate system), a layer as GeoDataFrame, a table as DataFrame, for ``ground.classes`` also
    ground classes. Paths are relative to the working folder.

    ConfigError as of load_config; InputError if what is in memory cannot be used.

    >>> import sassgis
    >>> config = sassgis.configure(
    ...     terrain={"dem": "dem.tif"},
    ...     release={"file": "release.gpkg", "spacing_m": 10},
    ...     blocks=[{"name": "1 m3", "volume_m3": (0.5, 2), "onset_frequency": 0.1}],
    ... )
    >>> config.blocks[0].volume_m3
    (0.5, 2.0)
    """
    document: dict[str, Any] = {}
    for name, value in sections.items():
        if name in LISTS:
            several = [value] if isinstance(value, Mapping | Section) else value
            if isinstance(several, str) or not isinstance(several, Iterable):
                wanted = f"sections [[{name}]]: a mapping, or a sequence of them"
                raise ConfigError("cannot be used", field=name, found=repr(value), expected=wanted)
            document[name] = [_plain_section(name, one) for one in several]
        elif name == "effects" and isinstance(value, Mapping):
            document[name] = {k: _plain_section(f"effects.{k}", v) for k, v in value.items()}
        elif value is not None:
            document[name] = _plain_section(name, value)
    return _config_of(document, None, Path.cwd())


def _plain_section(name: str, value: Any) -> Any:
    """Return a section as a file has it: plain values, and inputs that may be in memory."""
    # What reads frames takes long to load.
    from sassgis.inputs.in_memory import as_input

    if isinstance(value, Section):
        keys = declared(type(value)).values()
        value = {k.name: v for k in keys if (v := getattr(value, k.name)) != k.default}
    if not isinstance(value, Mapping):
        return value
    files = FILE_KEYS.get(name, ())
    given = {key: own for key, own in value.items() if own is not None}
    return {
        key: as_input(own, f"{name}.{key}") if key in files else _plain_value(own)
        for key, own in given.items()
    }


def _plain_value(value: Any) -> Any:
    """Return numbers and lists without numpy's types."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain_value(v) for v in value]
    return value


def _config_of(document: dict[str, Any], file: Path | None, base: Path) -> Config:
    """Return the configuration of a document, checked; ``file`` is None where a program made it."""
    for section in _GONE.keys() & document.keys():
        raise ConfigError(
            "is no section any more", file=file, field=section, found=f"[{section}]",
            expected=_GONE[section],
        )  # fmt: skip
    notes = _with_new_names(document, file)
    whole = {**{name: {} for name in SECTIONS if name not in (*LISTS, "profile")}, **document}
    try:
        sections = _document().validate_python(whole, context={"base": base, "file": file})
    except ValidationError as error:
        raise first_error(error, file, document, LISTS, _nearest, setting=_setting) from None
    if problems := _cross_checks(sections, file):
        raise first_of(problems)
    # The effects that are on, in the order of the registry.
    effects: dict[str, EffectTable] = {
        name: sections["effects"][name] for name in EFFECTS if name in sections["effects"]
    }
    trees: Any = effects["trees"][1] if "trees" in effects else None
    plain = {name: sections.get(name, ()) for name in SECTIONS} | {
        "blocks": tuple(map(_population, sections["blocks"])),
        "effects": EffectSettings(*(settings for settings, _ in effects.values())),
        "profile": sections.get("profile"),
    }
    plain |= {"onsets": {b.name: _onset(b) for b in sections["blocks"]}, "notes": tuple(notes)}
    return Config(file=file, trees=trees, given=document, base=base, **plain)


def _with_new_names(document: dict[str, Any], file: Path | None) -> list[str]:
    """Put the present key in place of a former one; what was found, for the user."""
    notes: dict[str, None] = {}
    for section, keys in declared_sections().items():
        found: Any = document
        for part in section.split("."):
            found = found.get(part, {}) if isinstance(found, dict) else {}
        tables = [t for t in (found if isinstance(found, list) else [found]) if isinstance(t, dict)]
        for key, own in keys.items():
            for table in (t for t in tables if own.old_name in t):
                if key in table:
                    problem = f"is given twice: {own.old_name} is its former name"
                    field, expected = f"{section}.{key}", f"{key} alone"
                    raise ConfigError(problem, file=file, field=field, expected=expected)
                table[key] = table.pop(own.old_name)
                notes[
                    f"{file or 'configuration'}: {section}.{own.old_name} is now called {key}; the "
                    "next version will not know the former name"
                ] = None
    return list(notes)


def profile_control_lines(config: Config) -> list[tuple[ControlLine, float]]:
    """Return stations and barriers of a profile run with their chainage (m)."""
    control_lines: list[tuple[ControlLine, float]] = []
    for section, items in (("stations", config.stations), ("barriers", config.barriers)):
        for item in items:
            if item.chainage_m is None:
                raise ConfigError(
                    "has no place along a profile", file=config.file,
                    field=f"{section}[{item.name}]",
                    found="line" if item.line is not None else "file", expected="chainage_m",
                )  # fmt: skip
            control_lines.append((control_line_of(item, item.name), item.chainage_m))
    return control_lines


def control_line_of(item: StationSettings, name: str) -> ControlLine:
    """Return a station or barrier under a name."""
    if isinstance(item, BarrierSettings):
        return item.control_line(name)
    return ControlLine(name, "station")


def resolved(config: Config) -> dict[str, Any]:
    """Return every setting with defaults filled in, as plain JSON values."""
    plain: dict[str, Any] = {}
    for section in SECTIONS:
        value = getattr(config, section)
        if section == "effects":
            plain[section] = {row.name: _plain_effect(row, config) for row in EFFECTS.values()}
        elif section in LISTS:
            plain[section] = [_plain(item) for item in value]
        else:
            plain[section] = None if value is None else _plain(value)
    plain["engine"] = _plain(config.engine.resolved())
    plain["onsets"] = {name: _plain(onset) for name, onset in config.onsets.items()}
    return plain


def as_named(config: Config) -> dict[str, Any]:
    """Return ``resolved`` with files as they are named from the folder of the configuration."""
    plain = resolved(config)
    if is_preset_file(plain["hazard"]["preset"]):
        plain["hazard"]["preset"] = seen_from(config.base, Path(plain["hazard"]["preset"]))
    named: dict[str, Any] = _with_files(plain, lambda file: seen_from(config.base, Path(file)))
    return named


def _with_files(node: Any, rewritten: Callable[[str], str]) -> Any:
    """Return plain settings with other words in place of the paths of files."""
    if isinstance(node, dict):
        return {
            key: rewritten(own)
            if key in _PATH_KEYS and isinstance(own, str) and not own.startswith(_IN_MEMORY)
            else _with_files(own, rewritten)
            for key, own in node.items()
        }
    return [_with_files(own, rewritten) for own in node] if isinstance(node, list) else node


def _plain_effect(row: Effect, config: Config) -> dict[str, Any] | None:
    """Return settings of an effect, and of where it acts; None if it is off."""
    settings = config.effects.named(row.name)
    place = {} if row.place is None or config.trees is None else _plain(config.trees)
    return None if settings is None else {**place, **_plain(settings)}


def _plain(item: Any) -> dict[str, Any]:
    """Return values as JSON has them: a path as it stands, an input in memory by what it holds."""
    fields = [field.name for field in dataclasses.fields(item)]
    names = declared(type(item)) if isinstance(item, Section) else fields

    def as_text(value: object) -> str:
        return f"{_IN_MEMORY}{value.digest}" if isinstance(value, InMemory) else str(value)

    values = {name: getattr(item, name) for name in names}
    plain: dict[str, Any] = json.loads(json.dumps(values, default=as_text))
    return plain


_IN_MEMORY = "in memory: "
#: Sections that bear on what the blocks do; the rest is about speed and presentation.
PHYSICS_SECTIONS = (
    *("terrain", "release", "ground", "blocks", "stations", "barriers"),
    *("engine", "effects", "run"),
)


def settings_hash(config: Config, *, sections: Iterable[str] = PHYSICS_SECTIONS) -> str:
    """Return the fingerprint of a run: 64 hexadecimal digits, the same on every machine.

    It is equal if and only if the settings of the ``sections`` and the files they name are equal.
    Files count by what they hold, not by where they are. The number of jobs does not count, nor
    that of draws of the ground classes: the blocks of the run itself are the same.
    """
    plain = resolved(config)
    chosen = {section: plain[section] for section in sections}
    if chosen.get("run"):
        idle = ("jobs", "ground_uncertainty")
        chosen["run"] = {k: v for k, v in chosen["run"].items() if k not in idle}
    named = _with_files(chosen, cache(file_digest))
    text = json.dumps(named, sort_keys=True, ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


_PATH_KEYS = frozenset(key for keys in FILE_KEYS.values() for key in keys)


def _cross_checks(sections: Mapping[str, Any], file: Path | None) -> list[ConfigError]:
    """Check what no section can see by itself."""
    wrong = partial(ConfigError, file=file)
    problems: list[ConfigError] = []
    if "profile" not in sections:
        for section, key in (("terrain", "dem"), ("release", "file")):
            if getattr(sections[section], key) is None:
                text = declared(SECTIONS[section])[key].description
                problems.append(wrong("missing key", field=f"{section}.{key}", expected=text))
    if not sections.get("blocks"):
        expected = "at least one [[blocks]]"
        problems.append(wrong("missing section", field="blocks", expected=expected))
    groups = {
        "blocks.name": ("blocks",),
        "stations/barriers.name": ("stations", "barriers"),
        "objects.name": ("objects",),
    }
    for field, members in groups.items():
        names = [item.name for member in members for item in sections.get(member, ())]
        twice = partial(wrong, "name is used twice", field=field, expected="names that differ")
        problems += [twice(found=repr(n)) for n, count in Counter(names).items() if count > 1]
    kept_to_lines = sections["terrain"].path == "fall_line"
    if kept_to_lines and LateralDeflection.name in sections["effects"]:
        problem = "has no meaning on fall lines: it turns the heading of paths that are followed"
        field, expected = f"effects.{LateralDeflection.name}", '"followed" (the default)'
        found, expected = 'terrain.path = "fall_line"', f"terrain.path = {expected}"
        problems.append(wrong(problem, field=field, found=found, expected=expected))
    return problems


def _population(block: BlockSettings) -> BlockPopulation:
    names = {field.name for field in dataclasses.fields(BlockPopulation)} - set(AXES)
    plain: dict[str, Any] = {name: getattr(block, name) for name in names} | block.axes
    return BlockPopulation(**plain)


def _onset(block: BlockSettings) -> Onset:
    """Return frequency of a block scenario; the power law gives the share between its volumes."""
    share = 1.0
    if block.onset_above_m3 is not None:
        assert block.volume_m3 is not None and block.volume_exponent is not None
        low, high = ((v / block.onset_above_m3) ** -block.volume_exponent for v in block.volume_m3)
        share = low - high
    return Onset(block.onset_frequency, block.onset_unit, share)


def _keys_at(loc: Place) -> Mapping[str, Declared]:
    """Return keys that are known where a key is."""
    name = str(loc[0])
    if name != "effects":
        return declared(SECTIONS[name]) if len(loc) > 1 else {}
    return EFFECTS[str(loc[1])].keys if len(loc) > 2 else {}


def _setting(loc: Place) -> Declared | None:
    """Return the setting at a place; None where there is none."""
    keys = _keys_at(loc)
    return next((keys[str(part)] for part in reversed(loc) if str(part) in keys), None)


def _nearest(loc: Place) -> str:
    """Return the known key that an unknown one was probably meant to be."""
    key = str(loc[-1])
    known: list[str] = list(SECTIONS if len(loc) == 1 else _keys_at(loc))
    if len(loc) == 2 and loc[0] == "effects":
        known = list(EFFECTS)
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if close:
        return f"{close[0]!r}, the nearest known key"
    homes = [n for n, keys in declared_sections().items() if key in keys and "." not in n]
    if homes:
        return f"this key in {' or '.join(f'[{h}]' for h in homes)}"
    # Whole names help where letters do not: "spacing" for "spacing_m".
    starts = [k for k in known if k.startswith(key) or key.startswith(k)]
    return f"{starts[0]!r}, the nearest known key" if starts else "one of " + ", ".join(known)
