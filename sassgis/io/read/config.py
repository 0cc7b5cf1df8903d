"""One TOML file describes a run: strict keys, units in the names, paths relative to the file.

``load_config`` is cheap: it opens no raster and no layer. The readers check what the files hold.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import textwrap
import tomllib
from collections.abc import Iterable, Mapping
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import (
    BaseModel,
    Field,
    ValidationError,
)

from sassgis.io.read.effect_sections import (
    EFFECT_SECTIONS,
    EffectsSection,
    ForestPlace,
    effect_settings,
    model_of,
)
from sassgis.io.read.sections import (
    OBJECT_NUMBERS,
    BarrierSettings,
    BlockSettings,
    GroundSettings,
    HazardSettings,
    ObjectSection,
    ObjectSettings,
    OutputSettings,
    ProfileSettings,
    ProjectSettings,
    ReleaseSettings,
    RiskSettings,
    RunSettings,
    Section,
    SpreadSettings,
    StationSettings,
    TerrainSettings,
    ZoneSettings,
)
from sassgis.model.blocks import BlockPopulation
from sassgis.model.effects import EffectSettings
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.hazard import Onset
from sassgis.model.results import ControlLine
from sassgis.model.settings import EngineSettings

_EngineSection = model_of(EngineSettings, "EngineSection")


class _Document(Section):
    """The whole file, before blocks and engine become types of the core."""

    project: ProjectSettings = Field(default_factory=ProjectSettings)
    terrain: TerrainSettings = Field(default_factory=TerrainSettings)
    release: ReleaseSettings = Field(default_factory=ReleaseSettings)
    spread: SpreadSettings = Field(default_factory=SpreadSettings)
    ground: GroundSettings = Field(default_factory=GroundSettings)
    blocks: tuple[BlockSettings, ...] = ()
    stations: tuple[StationSettings, ...] = ()
    barriers: tuple[BarrierSettings, ...] = ()
    engine: Any = None
    effects: EffectsSection = Field(default_factory=EffectsSection)  # type: ignore[valid-type]
    profile: ProfileSettings | None = None
    hazard: HazardSettings = Field(default_factory=HazardSettings)
    zones: ZoneSettings = Field(default_factory=ZoneSettings)
    risk: RiskSettings = Field(default_factory=RiskSettings)
    objects: tuple[ObjectSettings, ...] = ()  # type: ignore[valid-type]
    run: RunSettings = Field(default_factory=RunSettings)
    output: OutputSettings = Field(default_factory=OutputSettings)


#: The model of each section, for documentation and for the messages about unknown keys.
SECTIONS: dict[str, type[BaseModel]] = {
    "project": ProjectSettings,
    "terrain": TerrainSettings,
    "release": ReleaseSettings,
    "spread": SpreadSettings,
    "ground": GroundSettings,
    "blocks": BlockSettings,
    "stations": StationSettings,
    "barriers": BarrierSettings,
    "engine": _EngineSection,
    "effects": EffectsSection,
    "profile": ProfileSettings,
    "hazard": HazardSettings,
    "zones": ZoneSettings,
    "risk": RiskSettings,
    "objects": ObjectSettings,
    "run": RunSettings,
    "output": OutputSettings,
}
_LISTS = ("blocks", "stations", "barriers", "objects")


@dataclasses.dataclass(frozen=True, slots=True)
class Config:
    """What the user asked for, checked in itself but not yet against the files it names.

    Attributes
    ----------
    file : Path
        The configuration file (absolute).
    project, terrain, release, spread, ground, hazard, zones, risk, run, output
        The sections; paths in them are absolute.
    blocks : tuple of BlockPopulation
        At least one; names are unique.
    stations, barriers
        As configured; names are unique over both.
    engine : EngineSettings
    profile : ProfileSettings or None
        None if the file has no ``[profile]``.
    objects
        Layers of exposed objects.
    onsets : dict of str to Onset
        By the name of the block scenario.
    """

    file: Path
    project: ProjectSettings
    terrain: TerrainSettings
    release: ReleaseSettings
    spread: SpreadSettings
    ground: GroundSettings
    blocks: tuple[BlockPopulation, ...]
    stations: tuple[StationSettings, ...]
    barriers: tuple[BarrierSettings, ...]
    engine: EngineSettings
    effects: Section
    profile: ProfileSettings | None
    hazard: HazardSettings
    zones: ZoneSettings
    risk: RiskSettings
    objects: tuple[ObjectSection, ...]
    run: RunSettings
    output: OutputSettings
    onsets: dict[str, Onset]

    @property
    def effect_settings(self) -> EffectSettings:
        """The effects that are on."""
        return effect_settings(self.effects)

    @property
    def trees(self) -> ForestPlace | None:
        """Section ``[effects.trees]``, with where the forest stands."""
        section: ForestPlace | None = getattr(self.effects, "trees", None)
        return section

    @property
    def dem_path(self) -> Path:
        """Path of the DEM; ConfigError if the file names none (it may, for profile runs)."""
        if self.terrain.dem is None:
            raise _missing(self.file, "terrain", "dem")
        return self.terrain.dem

    @property
    def release_path(self) -> Path:
        """Path of the release areas; ConfigError if the file names none."""
        if self.release.file is None:
            raise _missing(self.file, "release", "file")
        return self.release.file

    @property
    def block_names(self) -> tuple[str, ...]:
        """Names of the block scenarios, in the order of the file."""
        return tuple(block.name for block in self.blocks)


# ---------------------------------------------------------------------------------------------
# Reading


def load_config(path: str | PathLike[str], overrides: Mapping[str, object] | None = None) -> Config:
    """Read and check a configuration; no raster and no layer is opened.

    Parameters
    ----------
    path
        The TOML file.
    overrides
        Values that replace those of the file, by dotted key, as in ``{"run.seed": 7}``.

    Raises
    ------
    ConfigError
        With the file and the dotted key; where several things are wrong, the first and how many
        more there are.
    """
    file = Path(path).expanduser()
    document = _parse(file)
    for dotted, value in (overrides or {}).items():
        section, _, key = dotted.partition(".")
        target = document.setdefault(section, {})
        if not key or not isinstance(target, dict):
            raise ConfigError("cannot be overridden", field=dotted, expected="a key as in run.seed")
        target[key] = value

    file = file.resolve()
    problems: list[ConfigError] = []
    engine_table = document.pop("engine", {})
    context = {"base": file.parent, "file": file}
    parsed: _Document | None = None
    engine: EngineSettings | None = None
    try:
        parsed = _Document.model_validate(document, context=context)
    except ValidationError as error:
        problems += _translate(error, file, document)
    try:
        section_model = _EngineSection.model_validate(engine_table)
        engine = EngineSettings(**section_model.model_dump())
    except ValidationError as error:
        problems += _translate(error, file, document, prefix=("engine",))
    except ConfigError as error:
        problems.append(_relocated(error, file, error.field or "engine"))
    blocks: tuple[BlockPopulation, ...] = ()
    if parsed is not None:
        problems += _effect_problems(parsed, file)
        problems += _cross_checks(parsed, file)
        made = [_population(block, file) for block in parsed.blocks]
        problems += [m for m in made if isinstance(m, ConfigError)]
        blocks = tuple(m for m in made if isinstance(m, BlockPopulation))
    if problems or parsed is None or engine is None:
        raise _first_of(problems)
    return Config(
        file=file,
        project=parsed.project,
        terrain=parsed.terrain,
        release=parsed.release,
        spread=parsed.spread,
        ground=parsed.ground,
        blocks=blocks,
        stations=parsed.stations,
        barriers=parsed.barriers,
        engine=engine,
        effects=parsed.effects,
        profile=parsed.profile,
        hazard=parsed.hazard,
        zones=parsed.zones,
        risk=parsed.risk,
        objects=parsed.objects,
        run=parsed.run,
        output=parsed.output,
        onsets={b.name: _onset(b) for b in parsed.blocks},
    )


def config_template() -> str:
    """A commented configuration with every key; it loads once its paths are filled in."""
    text = (resources.files("sassgis") / "data" / "config_template.toml").read_text("utf-8")
    return (
        text.replace("#@ engine\n", _engine_lines())
        .replace("#@ objects\n", _object_lines())
        .replace("#@ effects\n", _effect_lines())
    )


def _effect_lines() -> str:
    """Every ``[effects.<family>]`` in comments, with defaults and meaning."""
    lines: list[str] = []
    for name, model in EFFECT_SECTIONS.items():
        lines.append(f"# [effects.{name}]")
        for key, field in model.model_fields.items():
            shown = "..." if field.default is None else json.dumps(field.default)
            lines.append(f"# {key} = {shown}")
            lines += textwrap.wrap(
                field.description or "", 95, initial_indent="#     ", subsequent_indent="#     "
            )
        lines.append("")
    return "\n".join(lines) + "\n"


def _object_lines() -> str:
    """Keys of ``[[objects]]`` for the numbers of an object."""
    return "".join(
        f'# {name} = 1.0\n#     {text}\n# {name}_field = "{name}"\n'
        for name, text in OBJECT_NUMBERS.items()
    )


def _engine_lines() -> str:
    """Keys of ``[engine]`` with defaults and meaning, from the type that the engine reads."""
    lines: list[str] = []
    for key, field in _EngineSection.model_fields.items():
        lines.append(f"# {key} = {json.dumps(field.default)}")
        lines += textwrap.wrap(
            field.description or "", 95, initial_indent="#     ", subsequent_indent="#     "
        )
    return "\n".join(lines) + "\n"


def profile_control_lines(config: Config) -> list[tuple[ControlLine, float]]:
    """Stations and barriers of a profile run with their chainage (m).

    Raises
    ------
    ConfigError
        If one of them is placed on the map instead of by ``chainage_m``.
    """
    control_lines: list[tuple[ControlLine, float]] = []
    for section, items in (("stations", config.stations), ("barriers", config.barriers)):
        for item in items:
            if item.chainage_m is None:
                raise ConfigError(
                    "has no place along a profile",
                    file=config.file,
                    field=f"{section}[{item.name}]",
                    found="line" if item.line is not None else "file",
                    expected="chainage_m",
                )
            control_line = (
                item.control_line(item.name)
                if isinstance(item, BarrierSettings)
                else ControlLine(item.name, "station")
            )
            control_lines.append((control_line, item.chainage_m))
    return control_lines


def resolved(config: Config) -> dict[str, Any]:
    """Every setting with defaults filled in, as plain JSON values, for the manifest of a run."""
    plain: dict[str, Any] = {}
    for section in SECTIONS:
        value = getattr(config, section)
        if section in _LISTS:
            plain[section] = [_plain(item) for item in value]
        else:
            plain[section] = None if value is None else _plain(value)
    plain["onsets"] = {name: _plain(onset) for name, onset in config.onsets.items()}
    return plain


#: Sections that bear on what the rocks do; the rest is about speed and presentation.
PHYSICS_SECTIONS = (
    "terrain",
    "release",
    "spread",
    "ground",
    "blocks",
    "stations",
    "barriers",
    "engine",
    "effects",
    "run",
)


def settings_hash(
    config: Config, *, sections: Iterable[str] = PHYSICS_SECTIONS, contents: bool = True
) -> str:
    """Fingerprint of a run: equal if and only if the settings and the files they name are equal.

    Parameters
    ----------
    config
        The configuration.
    sections
        Sections that count. The number of jobs never does.
    contents
        Whether files count by what they hold (and not by where they are). If false, by path.

    Returns
    -------
    str
        64 hexadecimal digits, the same on every machine.
    """
    plain = resolved(config)
    chosen = {section: plain[section] for section in sections}
    if chosen.get("run"):
        chosen["run"] = {k: v for k, v in chosen["run"].items() if k != "jobs"}
    if contents:
        digests: dict[str, str] = {}

        def by_content(node: Any) -> Any:
            if isinstance(node, dict):
                return {
                    k: digests.setdefault(v, file_digest(v))
                    if k in _PATH_KEYS and isinstance(v, str)
                    else by_content(v)
                    for k, v in node.items()
                }
            return [by_content(v) for v in node] if isinstance(node, list) else node

        chosen = by_content(chosen)
    text = json.dumps(chosen, sort_keys=True, ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


_PATH_KEYS = ("dem", "file", "classes", "stems_raster", "dbh_raster")
_SIDECARS = (
    *(".shx", ".dbf", ".prj", ".cpg", ".qpj", ".aux", ".hdr"),
    *(".tfw", ".tifw", ".wld", ".aux.xml", ".flt", ".bil"),
)


def file_digest(path: str | PathLike[str]) -> str:
    """SHA-256 of a file with the side files that give it meaning (.prj, .dbf, .aux.xml, ...).

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    main = Path(path)
    if main.is_dir():  # an Esri file geodatabase
        parts = sorted(p for p in main.rglob("*") if p.is_file() and p.suffix != ".lock")
    else:
        beside = {main.with_suffix(s) for s in _SIDECARS} | {Path(f"{main}.aux.xml")}
        parts = [main, *sorted(p for p in beside if p != main and p.is_file())]
    digest = hashlib.sha256()
    try:
        for part in parts:
            with part.open("rb") as stream:
                digest.update(part.suffix.lower().encode())
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    except OSError as error:
        raise InputError(
            "cannot be read", file=main, found=error.strerror, expected="a file"
        ) from None
    return digest.hexdigest()


# ---------------------------------------------------------------------------------------------
# From what pydantic finds to one line


def _parse(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise ConfigError("file not found", file=file, expected="a TOML configuration file")
    try:
        # utf-8-sig: some Windows editors put a mark in front of UTF-8.
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ConfigError(
            "is not UTF-8 text", file=file, found=f"byte {error.start}", expected="UTF-8"
        ) from None
    except OSError as error:
        raise ConfigError("cannot be read", file=file, found=error.strerror) from None
    except tomllib.TOMLDecodeError as error:
        hint = "valid TOML"
        if "escape" in str(error).lower() or "hex" in str(error).lower():
            hint = "valid TOML (in paths write / or \\\\ instead of a single \\)"
        raise ConfigError("is not valid TOML", file=file, found=str(error), expected=hint) from None


def _missing(file: Path, section: str, key: str) -> ConfigError:
    text = SECTIONS[section].model_fields[key].description
    return ConfigError("missing key", file=file, field=f"{section}.{key}", expected=text)


def _first_of(problems: list[ConfigError]) -> ConfigError:
    # A misspelt key shows up twice, as unknown and as missing: the first tells more.
    first = min(problems, key=lambda p: p.problem != "unknown key")
    if len(problems) > 1:
        first.args = (f"{first} (and {len(problems) - 1} more)",)
    return first


def _relocated(error: InputError, file: Path, field: str) -> ConfigError:
    return ConfigError(
        error.problem, file=file, field=field, found=error.found, expected=error.expected
    )


def _cross_checks(document: _Document, file: Path) -> list[ConfigError]:
    """What no section can see by itself."""
    problems: list[ConfigError] = []
    if document.profile is None:
        if document.terrain.dem is None:
            problems.append(_missing(file, "terrain", "dem"))
        if document.release.file is None:
            problems.append(_missing(file, "release", "file"))
    if not document.blocks:
        problems.append(
            ConfigError(
                "missing section", file=file, field="blocks", expected="at least one [[blocks]]"
            )
        )
    groups = {
        "blocks": [b.name for b in document.blocks],
        "stations, barriers": [g.name for g in (*document.stations, *document.barriers)],
        "objects": [o.name for o in document.objects],  # type: ignore[attr-defined]
    }
    for field, names in groups.items():
        for name in dict.fromkeys(n for n in names if names.count(n) > 1):
            problems.append(
                ConfigError(
                    "name is used twice",
                    file=file,
                    field=f"{field}.name" if "," not in field else "stations/barriers.name",
                    found=repr(name),
                    expected="names that differ",
                )
            )
    return problems


def _population(block: BlockSettings, file: Path) -> BlockPopulation | ConfigError:
    try:
        plain = block.model_dump(exclude={*block.axes, "shape", *_ONSET_KEYS})
        return BlockPopulation(**(plain | block.axes))
    except InputError as error:
        return _relocated(error, file, f"blocks[{block.name}].{error.field}")


def _effect_problems(document: _Document, file: Path) -> list[ConfigError]:
    """What is wrong with single effects, and what does not go together."""
    try:
        effects = effect_settings(document.effects)
    except ConfigError as error:
        return [_relocated(error, file, f"effects.{error.field}")]
    if effects.lateral_deflection is not None and document.spread.lines_per_point > 1:
        return [
            ConfigError(
                "does not go with a bundle of lines",
                file=file,
                field="effects.lateral_deflection",
                found=f"spread.lines_per_point = {document.spread.lines_per_point}",
                expected="one of both",
            )
        ]
    return []


_ONSET_KEYS = ("onset_frequency", "onset_unit", "onset_above_m3")


def _onset(block: BlockSettings) -> Onset:
    """Frequency of a block scenario; the power law gives the share between its volumes."""
    share = 1.0
    if block.onset_above_m3 is not None:
        assert block.volume_m3 is not None and block.volume_exponent is not None
        low, high = ((v / block.onset_above_m3) ** -block.volume_exponent for v in block.volume_m3)
        share = low - high
    return Onset(block.onset_frequency, block.onset_unit, share)


def _plain(item: Any) -> Any:
    if isinstance(item, BaseModel):
        return item.model_dump(mode="json")
    return json.loads(json.dumps(dataclasses.asdict(item)))


def _dotted(loc: tuple[int | str, ...], document: Mapping[str, Any]) -> str:
    """Key as the user would look for it: ``blocks[large].axis_1_m``."""
    head, rest = str(loc[0]), list(loc[1:])
    text = head
    if head in _LISTS and rest and isinstance(rest[0], int):
        number = int(rest.pop(0))
        try:
            name = document[head][number]["name"]
        except (KeyError, IndexError, TypeError):
            name = None
        text += f"[{name}]" if isinstance(name, str) and name.strip() else f"[no. {number + 1}]"
    for part in rest:
        # The place inside a pair or a list is told by the value that was found there.
        if isinstance(part, str) and part != "[key]":
            text += f".{part}"
    return text


_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "path_type": "a path in quotes",
    "tuple_type": "a list in [ ]",
    "string_too_short": "a text that is not empty",
}


def _translate(
    error: ValidationError,
    file: Path,
    document: Mapping[str, Any],
    prefix: tuple[str, ...] = (),
) -> list[ConfigError]:
    return [_one_line({**e, "loc": (*prefix, *e["loc"])}, file, document) for e in error.errors()]


def _one_line(e: dict[str, Any], file: Path, document: Mapping[str, Any]) -> ConfigError:
    loc, kind, context = e["loc"], e["type"], e.get("ctx", {})
    field = _dotted(loc, document)
    if kind == "extra_forbidden":
        return ConfigError("unknown key", file=file, field=field, expected=_nearest(loc))
    if kind == "missing":
        info = _model_at(loc).model_fields.get(str(loc[-1]))
        text = info.description if info is not None else None
        if len(loc) > 1 and info is None:
            text = "two numbers [x, y]"
        return ConfigError(
            "missing key" if info else "is too short", file=file, field=field, expected=text
        )
    found: object = context["found"] if "found" in context else _shown(e["input"])
    if kind == "sassgis":
        if context["key"]:
            field = f"{field}.{context['key']}"
        if context["key"] and "found" not in context:
            found = None
        return ConfigError(
            context["problem"], file=file, field=field, found=found, expected=context["expected"]
        )
    if kind in ("model_type", "model_attributes_type", "dataclass_type"):
        section = str(loc[0])
        expected = f"[[{section}]]" if section in _LISTS else f"a section [{section}]"
    elif kind == "tuple_type" and len(loc) == 1:
        expected = f"one or more sections [[{loc[0]}]], with double brackets"
    elif kind == "literal_error":
        expected = f"one of {context['expected']}"
    elif kind == "too_short":
        expected = f"a list of at least {context['min_length']}"
    elif kind == "too_long":
        expected = f"{context['max_length']} numbers"
    else:
        expected = _EXPECTED.get(kind, e["msg"])
    return ConfigError("cannot be used", file=file, field=field, found=found, expected=expected)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _model_at(loc: tuple[int | str, ...]) -> type[BaseModel]:
    """The model in which a key is."""
    if loc[0] == "effects" and len(loc) > 2:
        return EFFECT_SECTIONS[str(loc[1])]
    return SECTIONS[str(loc[0])]


def _nearest(loc: tuple[int | str, ...]) -> str:
    """The known key that an unknown one was probably meant to be."""
    key = str(loc[-1])
    if len(loc) == 1:
        known: Iterable[str] = SECTIONS
    else:
        known = _model_at(loc).model_fields
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if close:
        return f"{close[0]!r}, the nearest known key"
    homes = [name for name, model in SECTIONS.items() if key in model.model_fields]
    if homes:
        return f"this key in {' or '.join(f'[{h}]' for h in homes)}"
    # Whole names help where letters do not: "spacing" for "spacing_m".
    starts = [k for k in known if k.startswith(key) or key.startswith(k)]
    return f"{starts[0]!r}, the nearest known key" if starts else "one of " + ", ".join(known)
