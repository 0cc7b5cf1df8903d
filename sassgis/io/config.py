"""One TOML file describes a run: strict keys, units in the names, paths relative to the file.

``load_config`` is cheap: it opens no raster and no layer. The readers check what the files hold.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import itertools
import json
import math
import re
import textwrap
import tomllib
from collections.abc import Iterable, Mapping
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from sassgis.core.blocks import BlockPopulation
from sassgis.core.errors import ConfigError, InputError
from sassgis.core.results import Gate
from sassgis.core.settings import EngineSettings

# ---------------------------------------------------------------------------------------------
# Kinds of value


def _refuse(problem: str, expected: str, *, key: str = "", found: object = None) -> Exception:
    """An error that pydantic carries to the place where it is told in one line."""
    context: dict[str, Any] = {"problem": problem, "expected": expected, "key": key}
    if found is not None:
        context["found"] = str(found)
    return PydanticCustomError("sassgis", "{problem}", context)


def _pair(value: object) -> object:
    """A single number stands for two equal limits."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise _refuse("is not a range", "a number, or two numbers [low, high]")
    return tuple(value)


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise _refuse("limits are reversed", "[low, high] with the lower number first")
    return value


def _between(
    low: float, high: float = math.inf, *, above: bool = False, below: bool = False
) -> AfterValidator:
    """Limits for a number or both ends of a range; ``above`` and ``below`` leave the ends out."""
    text = f"above {low:g}" if above else f"{low:g} or more"
    if math.isfinite(high):
        text = f"{text} and below {high:g}" if below else f"{text} and at most {high:g}"

    def check(value: Any) -> Any:
        for number in value if isinstance(value, tuple) else (value,):
            if (
                number < low
                or number > high
                or (above and number == low)
                or (below and number == high)
            ):
                kind = "numbers" if isinstance(value, tuple) else "a number"
                raise _refuse("is out of range", f"{kind} {text}")
        return value

    return AfterValidator(check)


def _clean_name(value: str) -> str:
    name = value.strip()
    if not name or re.search(r"[,;\r\n\t]", name):
        raise _refuse("cannot be used as a name", "a text without comma, semicolon or line break")
    return name


def _anchor(value: Path, info: ValidationInfo) -> Path:
    """Paths are relative to the configuration file."""
    if str(value) in ("", "."):
        raise _refuse("is empty", "the path of a file", found="''")
    base = (info.context or {}).get("base", Path())
    return Path(base, value.expanduser())


Num = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Int = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Span = Annotated[tuple[Num, Num], BeforeValidator(_pair), AfterValidator(_ascending)]
Name = Annotated[str, AfterValidator(_clean_name)]
FileName = Annotated[Path, AfterValidator(_anchor)]
TableFormat = Literal["none", "csv", "parquet"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    _config_file: Path | None = PrivateAttr(default=None)

    def model_post_init(self, context: Any) -> None:
        """Remember the file, for messages of those who are given the section alone."""
        self._config_file = (context or {}).get("file")

    @property
    def config_file(self) -> Path | None:
        """The configuration file; None for a section that was made in code."""
        return self._config_file


# ---------------------------------------------------------------------------------------------
# Sections


class ProjectSettings(_Section):
    """``[project]``."""

    name: str = Field(
        default="rockfall", min_length=1, description="title on maps and in the report"
    )


class TerrainSettings(_Section):
    """``[terrain]``: the DEM and how fall lines are traced and flattened."""

    dem: FileName | None = Field(
        default=None, description="terrain model: any raster that GDAL reads"
    )
    crs: str | None = Field(
        default=None,
        min_length=1,
        description="coordinate system where the DEM states none, e.g. EPSG:2056, or 'local'",
    )
    vertical_datum: str | None = Field(
        default=None,
        min_length=1,
        description="name of the height system where the DEM states none",
    )
    smoothing_m: Annotated[Num, _between(0, 200)] = Field(
        default=5.0,
        description="scale of the terrain that steers fall lines: Gaussian standard deviation (m)",
    )
    segment_tolerance_m: Annotated[Num, _between(0, 100)] = Field(
        default=0.25, description="largest vertical gap between terrain and segments (m)"
    )
    energy_line_angle_deg: Annotated[Num, _between(0, 60)] = Field(
        default=20.0,
        description="lines end where they sink below this angle seen from the start (degrees)",
    )
    max_line_length_m: Annotated[Num, _between(0, 100_000, above=True)] = Field(
        default=5000.0, description="longest fall line, in plan (m)"
    )
    flat_slope_deg: Annotated[Num, _between(0, 30)] = Field(
        default=8.0, description="slope below which a line tends to keep its heading (degrees)"
    )


class ReleaseSettings(_Section):
    """``[release]``: where rocks start."""

    file: FileName | None = Field(default=None, description="polygons, lines or points of release")
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    name_field: str | None = Field(
        default=None,
        min_length=1,
        description="attribute with the names of the areas; else area 1, area 2, ...",
    )
    scenario_field: str | None = Field(
        default=None,
        min_length=1,
        description="attribute naming the block scenarios of an area: a;b for several; empty: all",
    )
    spacing_m: Annotated[Num, _between(0, 10_000, above=True)] = Field(
        default=5.0, description="distance between release points (m)"
    )
    placement: Literal["grid", "random"] = Field(
        default="grid", description="how points are laid out"
    )
    rocks_per_point: Annotated[Int, _between(1, 1_000_000)] = Field(
        default=50, description="rocks let go at each release point"
    )


class SpreadSettings(_Section):
    """``[spread]``: a bundle of lines from each release point."""

    lines_per_point: Annotated[Int, _between(1, 1001)] = Field(
        default=1, description="lines traced from each release point"
    )
    width_percent: Annotated[Num, _between(0, 100)] = Field(
        default=0.0,
        description="width of the bundle, both sides together, in percent of the length",
    )

    @model_validator(mode="after")
    def _has_width(self) -> SpreadSettings:
        if self.lines_per_point > 1 and self.width_percent == 0.0:
            raise _refuse(
                "would trace the same line several times",
                "a width above 0 where lines_per_point is above 1",
                key="width_percent",
                found=self.width_percent,
            )
        return self


def _codes(value: object) -> object:
    """TOML keys are text; raster codes are whole numbers."""
    if not isinstance(value, Mapping):
        raise _refuse("is not a table of codes", 'codes and class names, as in {1 = "rock"}')
    try:
        return {int(str(code)): name for code, name in value.items()}
    except ValueError:
        raise _refuse(
            "has a code that is no whole number", 'codes and class names, as in {1 = "rock"}'
        ) from None


class GroundSettings(_Section):
    """``[ground]``: the kind of ground, cell by cell."""

    default: Name = Field(default="debris", description="class where nothing else is said")
    file: FileName | None = Field(
        default=None, description="polygons or a raster of ground classes"
    )
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    class_field: str = Field(
        default="class", min_length=1, description="attribute with the class names"
    )
    classes: FileName | None = Field(
        default=None,
        description="own class table (CSV or TOML), added to the built-in one or overriding it",
    )
    raster_classes: Annotated[dict[int, Name], BeforeValidator(_codes)] | None = Field(
        default=None, description="class of each code, where the file is a raster"
    )

    @model_validator(mode="after")
    def _fits_file(self) -> GroundSettings:
        for key in ("layer", "raster_classes"):
            if getattr(self, key) is not None and self.file is None:
                raise _refuse("has no file to go with", "ground.file as well", key=key)
        return self


class BlockSettings(_Section):
    """``[[blocks]]``: one block scenario; every range may also be a single number."""

    name: Name = Field(description="name of the scenario")
    axis_1_m: Annotated[Span, _between(0, 10, above=True)] = Field(
        description="first SEMI-axis, half the length of the block (m)"
    )
    axis_2_m: Annotated[Span, _between(0, 10, above=True)] = Field(
        description="second SEMI-axis (m)"
    )
    axis_3_m: Annotated[Span, _between(0, 10, above=True)] = Field(
        description="third SEMI-axis (m)"
    )
    density_kgm3: Annotated[Span, _between(500, 10_000)] = Field(
        default=(2700.0, 2700.0), description="density of the rock (kg/m3)"
    )
    speed_mps: Annotated[Span, _between(0, 150)] = Field(
        default=(0.0, 0.0), description="speed at the start, downhill along the slope (m/s)"
    )
    spin_radps: Annotated[Span, _between(-300, 300)] = Field(
        default=(0.0, 0.0),
        description="spin at the start, positive as a rock rolling downhill (rad/s)",
    )
    drop_m: Annotated[Span, _between(0, 1000)] = Field(
        default=(0.0, 0.0), description="height above rest from which the rock is let go (m)"
    )
    orientation_rad: Annotated[Span, _between(-2.0 * math.pi, 2.0 * math.pi)] = Field(
        default=(0.0, math.pi),
        description="angle of the longest axis to the slope at the start (rad)",
    )


class StationSettings(_Section):
    """``[[stations]]``: a line on the map, or a chainage, where passing rocks are recorded."""

    name: Name = Field(description="name of the station")
    line: tuple[tuple[Num, Num], ...] | None = Field(
        default=None, min_length=2, description="[[x, y], [x, y], ...] in the DEM's coordinates (m)"
    )
    file: FileName | None = Field(
        default=None, description="layer of lines; each feature is a station"
    )
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    name_field: str | None = Field(
        default=None,
        min_length=1,
        description="attribute with the names; else the name and a number",
    )
    chainage_m: Num | None = Field(
        default=None, description="chainage along the profile; profile runs only (m)"
    )

    @model_validator(mode="after")
    def _has_one_place(self) -> StationSettings:
        places = [k for k in ("line", "file", "chainage_m") if getattr(self, k) is not None]
        if len(places) != 1:
            raise _refuse(
                "must be put in one place",
                "exactly one of line, file, chainage_m",
                found=" and ".join(places) or "none",
            )
        for key in ("layer", "name_field"):
            if getattr(self, key) is not None and self.file is None:
                raise _refuse("has no file to go with", "file as well", key=key)
        return self


class BarrierSettings(StationSettings):
    """``[[barriers]]``: a wall or a net; placed as a station is."""

    kind: Literal["wall", "net"] = Field(description="wall or net")
    height_m: Annotated[Num, _between(0, 100, above=True)] = Field(
        description="height of the top above the ground, vertical (m)"
    )
    capacity_kj: Annotated[Num, _between(0, above=True)] | None = Field(
        default=None,
        description="energy that it takes (kJ); without it every rock that meets it is stopped",
    )

    lets_go: Flag = Field(
        default=False,
        description="whether rocks that it takes move on from zero speed, as nets may let them",
    )

    def gate(self, name: str) -> Gate:
        """Return this barrier under the name of one of its features."""
        capacity = math.inf if self.capacity_kj is None else self.capacity_kj
        return Gate(name, self.kind, self.height_m, capacity, self.lets_go)


class ProfileSettings(_Section):
    """``[profile]``: a run along a single profile, without a map."""

    file: FileName | None = Field(
        default=None, description="CSV with columns s_m, z_m and, if wanted, ground"
    )
    start_m: Span = Field(default=(0.0, 0.0), description="chainages between which rocks start (m)")
    rocks: Annotated[Int, _between(1, 100_000_000)] = Field(
        default=100, description="number of rocks"
    )


class RunSettings(_Section):
    """``[run]``."""

    seed: Annotated[Int, _between(0, 2**63 - 1)] = Field(
        default=1, description="the same seed gives the same rocks"
    )
    jobs: Annotated[Int, _between(0, 4096)] = Field(
        default=0, description="processor cores; 0: all of them"
    )


class OutputSettings(_Section):
    """``[output]``."""

    stop_points_max: Annotated[Int, _between(0, 100_000_000)] = Field(
        default=100_000, description="most stop points written to the map"
    )
    rock_table: TableFormat = Field(default="none", description="one row per rock")
    passage_table: TableFormat = Field(
        default="none", description="one row per rock and station or barrier"
    )
    energy_classes_kj: tuple[Annotated[Num, _between(0, above=True)], ...] = Field(
        default=(30.0, 300.0), min_length=1, description="limits between the energy classes (kJ)"
    )

    @model_validator(mode="after")
    def _limits_rise(self) -> OutputSettings:
        limits = self.energy_classes_kj
        if any(low >= high for low, high in itertools.pairwise(limits)):
            raise _refuse(
                "limits do not rise",
                "numbers in ascending order",
                key="energy_classes_kj",
                found=list(limits),
            )
        return self


def _attribute_notes(cls: type) -> dict[str, str]:
    """Text under each attribute of a numpydoc class docstring."""
    notes: dict[str, str] = {}
    current = ""
    for line in (cls.__doc__ or "").splitlines():
        head = re.match(r"    (\w+) : ", line)
        if head:
            current = head.group(1)
            notes[current] = ""
        elif current and line.startswith("        "):
            notes[current] = f"{notes[current]} {line.strip()}".strip()
    return notes


def _engine_model() -> type[_Section]:
    """``[engine]``: exactly the fields of EngineSettings, so that the two cannot drift apart."""
    kinds: dict[Any, Any] = {float: Num, int: Int, bool: Flag}
    hints = get_type_hints(EngineSettings)
    notes = _attribute_notes(EngineSettings)
    fields: dict[str, Any] = {
        f.name: (
            kinds.get(hints[f.name], hints[f.name]),
            Field(f.default, description=notes.get(f.name) or f.name),
        )
        for f in dataclasses.fields(EngineSettings)
    }
    return create_model("EngineSection", __base__=_Section, **fields)


_EngineSection = _engine_model()


class _Document(_Section):
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
    profile: ProfileSettings | None = None
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
    "profile": ProfileSettings,
    "run": RunSettings,
    "output": OutputSettings,
}
_LISTS = ("blocks", "stations", "barriers")


@dataclasses.dataclass(frozen=True, slots=True)
class Config:
    """What the user asked for, checked in itself but not yet against the files it names.

    Attributes
    ----------
    file : Path
        The configuration file (absolute).
    project, terrain, release, spread, ground, run, output
        The sections; paths in them are absolute.
    blocks : tuple of BlockPopulation
        At least one; names are unique.
    stations, barriers
        As configured; names are unique over both.
    engine : EngineSettings
    profile : ProfileSettings or None
        None if the file has no ``[profile]``.
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
    profile: ProfileSettings | None
    run: RunSettings
    output: OutputSettings

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
        profile=parsed.profile,
        run=parsed.run,
        output=parsed.output,
    )


def config_template() -> str:
    """A commented configuration with every key; it loads once its paths are filled in."""
    text = (resources.files("sassgis") / "data" / "config_template.toml").read_text("utf-8")
    return text.replace("#@ engine\n", _engine_lines())


def _engine_lines() -> str:
    """Keys of ``[engine]`` with defaults and meaning, from the type that the engine reads."""
    lines: list[str] = []
    for key, field in _EngineSection.model_fields.items():
        lines.append(f"# {key} = {json.dumps(field.default)}")
        lines += textwrap.wrap(
            field.description or "", 95, initial_indent="#     ", subsequent_indent="#     "
        )
    return "\n".join(lines) + "\n"


def profile_gates(config: Config) -> list[tuple[Gate, float]]:
    """Stations and barriers of a profile run with their chainage (m).

    Raises
    ------
    ConfigError
        If one of them is placed on the map instead of by ``chainage_m``.
    """
    gates: list[tuple[Gate, float]] = []
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
            gate = (
                item.gate(item.name)
                if isinstance(item, BarrierSettings)
                else Gate(item.name, "station")
            )
            gates.append((gate, item.chainage_m))
    return gates


def resolved(config: Config) -> dict[str, Any]:
    """Every setting with defaults filled in, as plain JSON values, for the manifest of a run."""
    plain: dict[str, Any] = {}
    for section in SECTIONS:
        value = getattr(config, section)
        if section in _LISTS:
            plain[section] = [_plain(item) for item in value]
        else:
            plain[section] = None if value is None else _plain(value)
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
                    if k in ("dem", "file", "classes") and isinstance(v, str)
                    else by_content(v)
                    for k, v in node.items()
                }
            return [by_content(v) for v in node] if isinstance(node, list) else node

        chosen = by_content(chosen)
    text = json.dumps(chosen, sort_keys=True, ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


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
    }
    for field, names in groups.items():
        for name in dict.fromkeys(n for n in names if names.count(n) > 1):
            problems.append(
                ConfigError(
                    "name is used twice",
                    file=file,
                    field=f"{field}.name" if field == "blocks" else "stations/barriers.name",
                    found=repr(name),
                    expected="names that differ",
                )
            )
    return problems


def _population(block: BlockSettings, file: Path) -> BlockPopulation | ConfigError:
    try:
        return BlockPopulation(**block.model_dump())
    except InputError as error:
        return _relocated(error, file, f"blocks[{block.name}].{error.field}")


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
        info = SECTIONS[str(loc[0])].model_fields.get(str(loc[-1]))
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


def _nearest(loc: tuple[int | str, ...]) -> str:
    """The known key that an unknown one was probably meant to be."""
    key = str(loc[-1])
    if len(loc) == 1:
        known: Iterable[str] = SECTIONS
    else:
        known = SECTIONS[str(loc[0])].model_fields
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if close:
        return f"{close[0]!r}, the nearest known key"
    homes = [name for name, model in SECTIONS.items() if key in model.model_fields]
    if homes:
        return f"this key in {' or '.join(f'[{h}]' for h in homes)}"
    # Whole names help where letters do not: "spacing" for "spacing_m".
    starts = [k for k in known if k.startswith(key) or key.startswith(k)]
    return f"{starts[0]!r}, the nearest known key" if starts else "one of " + ", ".join(known)
