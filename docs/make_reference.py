"""Write docs/configuration.md, and the tables of causes and observations, from what is declared.

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

Here you look up a key of the TOML file that describes a run ([how to write
one](starting.md#the-configuration)). Paths are relative to the configuration. Names end in their
[unit](conventions.md#units). A *range* is `[low, high]`; a single number sets both limits. `layer`
is needed where a file has several. †: the same name with `_field` names the attribute that holds
the value of each feature. *needed*: no default; no entry: may be left out. Unknown keys and texts
of more than {LONGEST_TEXT} characters are errors.

A run on the map needs `terrain.dem`, `release.file` and one `[[blocks]]`; a run along one profile
`[profile]` (or `--csv`, `--point`, `--line`) and one `[[blocks]]`.

Terrain, release, ground, blocks, stations, barriers, effects, engine and run (except `jobs` and
`ground_uncertainty`) may change the simulated blocks; paths of files and output settings do not.
"""

_INTRO = {
    "project": "",
    "terrain": "[Terrain and paths](terrain.md).",
    "release": "[Release points](terrain.md#release-points).",
    "ground": "The [ground class](model.md#ground-classes) of each cell.",
    "blocks": "One section for each block scenario. State three semi-axes or a volume. Values are "
    "drawn uniformly within a range, volumes by `volume_exponent`. [Zones](hazard.md) need an "
    "onset frequency.",
    "stations": "Control lines that record passing blocks, one section each, placed by `line`, "
    "`file` or `chainage_m`.",
    "barriers": "Walls, nets and [galleries](model.md#galleries), one section each. They need "
    "`kind` and `height_m`, galleries also `width_m` and `cushion_kpa`. Names of stations and "
    "barriers must differ.",
    "engine": "[Modelling assumptions](model.md#modelling-assumptions). `readings` sets the keys "
    "without a default.",
    "profile": "For `sassgis profile`.",
    "hazard": "[Intensities and hazard levels](hazard.md), for `sassgis zone`.",
    "zones": "[From cells to polygons](zones.md). Defaults: those of the preset (mm) at the scale.",
    "edits": "Polygons in which an expert sets the hazard level ([edits](zones.md#edits-by-hand)).",
    "risk": "[Risk](risk.md) of exposed objects.",
    "objects": "[Exposed objects](risk.md), one section for each layer.",
    "run": "",
    "output": "[Output files](outputs.md).",
}

#: Meanings that another page explains; elsewhere the descriptions of the settings are used.
_EXPLAINED = {
    "terrain.block_scale_m": "[scale](terrain.md#flattening) below which terrain counts as "
    "roughness (m); 0: never",
    "terrain.energy_line_angle_deg": "[fall lines](terrain.md#fall-lines) end where they sink "
    "below this angle seen from the start (degrees); choose it lower than any run-out",
    "terrain.path": "each block [finds its path](model.md#followed-paths), or all blocks of a "
    "release point move on its [fall line](terrain.md#fall-lines)",
    "blocks.volume_exponent": "b: the frequency of blocks larger than V falls as V^-b between the "
    "limits of volume_m3; without it all volumes are equally likely",
    "blocks.onset_unit": "per year in each release area, per year and hectare of it (in plan), or "
    "per year and metre of release line",
    "blocks.onset_above_m3": "with volume_exponent: onset_frequency counts blocks larger than this "
    "(m3)",
    "engine.readings": "named [set of assumptions](model.md#two-sets-of-assumptions)",
    "engine.block": '`"point"`: a [mass point](studies/point.md); eta_max_rule may not be "scale"',
    "engine.eta_max_rule": "law of impact",
    "engine.slope_variation": "whether each impact varies the slope",
    "engine.rolling_threshold": "a bounce below this share of the radius ends in a soft landing",
    "engine.rolling": "law of rolling",
    "engine.rolling_friction_sd": "scatter of rolling friction between blocks",
    "engine.outline_edges": "ratio of axes that edges add to the [outline](model.md#outline)",
    "engine.outline_share": "share of a/b − 1 that acts in the plane of motion",
    "engine.tipping": "whether a sliding block may [tip over](model.md#tipping) and roll",
    "engine.corner": "shape that hits rising ground ([concave corners](model.md#concave-corners))",
    "engine.side_tilt_deg": "scatter of the lateral tilt at impacts ([followed "
    "paths](model.md#followed-paths), degrees)",
    "engine.drift_deg": "scatter of the angle between path and descent (degrees)",
    "effects.air_drag.drag_coefficient": "C_d",
    "effects.wind.acceleration_mps2": "horizontal, in flight, positive along the chainage (m/s2)",
    "effects.trees.file": "polygons of forest",
    "effects.trees.stems_raster": "raster of stems per hectare",
    "effects.trees.single_trees": "CSV table with columns x, y, dbh_cm, conifer_share (0 to 1), or "
    "points with these attributes",
    "effects.trees.stems_per_ha": "stems per hectare without attribute or raster",
    "effects.trees.dbh_cm": "diameter at breast height without attribute or raster (cm)",
    "effects.trees.species": "[species](effects.md#trees)",
    "effects.trees.efficiency": "factor on the energy of a stem",
    "effects.soft_ground.depth_law": "depth of the scar",
    "hazard.preset": "[rules](presets.md) of intensity and level: ch-so, ti, or a TOML file",
    "hazard.frequencies": "table (CSV) with columns area, scenario, frequency, unit: onset "
    "frequencies of single release areas, in place of those of `[[blocks]]`",
    "hazard.ref_width_m": "[reference width](hazard.md#source-and-rate) of all frequencies (m), "
    "one cell or more; sassgis zone and batch need it",
    "hazard.confidence": "share of all changes by [another "
    "sample](hazard.md#what-another-sample-would-change) that uncertain cells hold",
    "hazard.blocks": "release.rocks_per_point at each point, or [as many as the map "
    "needs](hazard.md#as-many-blocks-as-a-map-needs)",
    "hazard.changed_share_max": "with auto: largest share of the zoned area whose level another "
    "sample may change; default: 0.02",
    "hazard.blocks_max": "with auto: most blocks; default: 10 million",
    "hazard.minutes_max": "with auto: longest simulation (minutes, about); default: 60",
    "zones.min_width_m": "least width of a zone",
    "zones.min_area_m2": "smallest area of a zone and of a hole in one",
    "zones.closing_m": "gaps and slots up to this width are closed; at least release.spacing_m",
    "zones.envelope_m": "gaps in the outer limit that are closed; default: six reference widths",
    "zones.smoothing_m": "width over which the frequency at the outer limit is averaged; default: "
    "three reference widths",
    "run.ground_uncertainty": "repetitions with other values of the ground classes "
    "([bands](sensitivity.md#bands-by-the-spread-between-sites)); 0: none",
}

#: Names that end in their unit, which the meaning need not repeat.
_WITH_UNIT = re.compile(r"_(m|m2|m3|cm|deg|rad|mps|mps2|radps|kmh|kj|kpa|mpa|jkg|kgps|kgm3|years)$")

#: Sections whose keys stand, as far as they are the same, in another one.
_LIKE = {"barriers": "stations"}


def kind(annotation: Any) -> str:
    """Words for the kind of value of a key."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return kind(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return kind(next(a for a in get_args(annotation) if a is not type(None)))
    if origin is Literal:
        words = [f'`"{a}"`' for a in get_args(annotation)]
        return ", ".join(words if len(words) < 10 else (words[0], "…", words[-1]))
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
    names = {str: "text", Path: "path", float: "number", int: "integer", bool: "boolean"}
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


def meaning(section: str, own: Declared) -> str:
    """What a key means, with a link where another page explains it."""
    if own.name == "form":
        return "law"
    return _EXPLAINED.get(f"{section}.{own.name}", own.description)


def row(section: str, own: Declared, *others: str, has_attribute: bool = False) -> str:
    """One key as a row of its section's table, with other keys that belong to it.

    A dagger marks a key whose value an attribute of each feature may have.
    """
    if own.is_required:
        default = "*needed*"
    elif own.default is None:
        default = ""
    else:
        default = f"`{shown(own.default)}`"
    text = meaning(section, own).replace("|", "\\|").removesuffix(".")
    if _WITH_UNIT.search(own.name):
        text = re.sub(r" \((\w+|m/s2?|rad/s|kg/m3|kg/s|J/kg)\)$", "", text)
    if re.match(r"A |[A-Z][a-z]", text):  # neither an abbreviation nor a symbol
        text = text[:1].lower() + text[1:]
    if own.old_name is not None:
        text += f" (formerly `{own.old_name}`)"
    name = f"`{own.name}`" + "".join(f", `{key}`" for key in others) + " †" * has_attribute
    value = f"{kind(own.kind)}{limits(own.kind)}".removeprefix("number, ")
    return f"| {name} | {value} | {default} | {text} |".replace("|  |", "| |")


def is_attribute(own: Declared) -> bool:
    """Whether a key names the attribute that holds the value of another key."""
    return own.description == f"attribute with {own.name.removesuffix('_field')}"


def section(name: str, keys: Mapping[str, Declared]) -> str:
    """One section of the page."""
    brackets = f"[[{name}]]" if name in LISTS else f"[{name}]"
    lines = [f"## `{brackets}`", ""]
    intro = _INTRO.get(name, "")
    if intro:
        lines += [intro, ""]
    if name in _LIKE:
        like = declared_sections()[_LIKE[name]]
        same = [
            key
            for key, own in keys.items()
            if key in like and row(name, own) == row(name, like[key])
        ]
        names = ", ".join(f"`{key}`" for key in same)
        lines += [f"{names}: as in [{_LIKE[name]}](#{_LIKE[name]}).", ""]
        keys = {key: own for key, own in keys.items() if key not in same}
    lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
    attributes = {key for key, own in keys.items() if is_attribute(own)}
    hidden = attributes | ({"layer"} if "file" in keys else set())
    rows = {key: own for key, own in keys.items() if key not in hidden}
    for key, own in rows.items():
        with_it = ["layer"] if key == "file" and "layer" in keys else []
        lines.append(row(name, own, *with_it, has_attribute=f"{key}_field" in attributes))
    return "\n".join(lines)


def page() -> str:
    """The whole page of the configuration."""
    declared = declared_sections()
    unknown = _EXPLAINED.keys() - {f"{name}.{key}" for name in declared for key in declared[name]}
    assert not unknown, unknown
    sections = (section(name, keys) for name, keys in declared.items())
    return "\n\n".join([_HEAD.rstrip(), *sections]) + "\n"


#: What a cause leaves in the observations, in words of the field.
_TRACES = {
    "measurement_error": "speeds differ from positions over times of a path; impacts gain more "
    "energy than the fall gives, and no path in time confirms their speeds; a value is off at one "
    "station only; a stop lies off the fall line of a rock that was on it at a station at most "
    "30 m above",
    "release_error": "path or first contacts begin more than 1.5 m and the errors from the stated "
    "start, or more than 3 m above it; the lateral offset at the first station stays constant "
    "below; speed is wrong on the first reach only",
    "air_drag": "speed lost in flight, in proportion to the square of the speed over the size, "
    "with C_d from 0.2 (or 0.5, by the errors) to 2, of rocks so small and fast that it shows",
    "trees": "sudden loss of speed at least 0.8 m above the resting position, or of energy between "
    "two impacts (more than 15 % and 3.5 standard deviations), on few flights; loss on one reach "
    "only",
    "fragmentation": "fragments under the name of a rock (R7.2); masses of the rocks missing "
    "among the deposits and present in smaller blocks",
    "entrainment": "more mass deposited than rocks came down",
    "lateral_deflection": "turns at impacts, and lateral offsets that grow below the first "
    "station, beyond those simulated with at most the configured lateral tilt and drift, and by "
    "more than 10° and 15 % of the path",
    "soft_ground": "contacts on one yielding ground only, in its upper and lower part, lose more "
    "than with any usual values of its class; less rebound there; large rocks stop early at the "
    "foot",
    "roughness": "rebound scatters more than simulated, most for small rocks; small rocks are slow "
    "on all reaches",
    "rock_shape": "speed after impacts and on reaches depends on the flatness of the rock",
    "contact_law": "fits certainly better than any ground values; part of the base model",
}


def causes_table() -> list[str]:
    """The causes that the diagnosis can name, a row for each."""
    traces = {n: "; ".join(own.name for own in c.statistics) for n, c in CAUSES.items()} | _TRACES
    rows = (f"| {cause.words[0]} | {traces[name]} |" for name, cause in CAUSES.items())
    return ["| cause | fingerprints |", "|---|---|", *rows]


#: What the page says of tables and columns in place of their descriptions.
_ABOUT = {
    "rocks": "One row per rock that was released, or that fell from a known source.",
    "stations": "Lines across the slope where passing rocks were measured. In a GeoPackage a line "
    "may have more vertices.",
    "passages": "One row per rock and station; without numbers if the rock passed unmeasured.",
    "impacts": "One row per impact with known velocities of the centre before (`in`) and after "
    "(`out`), from films or sensors in the rock: in the vertical plane of motion, along the ground "
    "and its *outward* normal. Where the path turns, those after are along the new heading.",
    "contacts": "One row per contact with the ground: times and spins from sensors in the rock, "
    "places, if known, from a positioning system.",
    "deposits": "One row per deposited block, fragments included. A rock that broke has rows for "
    "its fragments only; these pass stations under their names.",
    "trajectories": "One row per rock and time.",
    "rock_id": "name of the rock; R7.2 is a fragment of R7",
    "rotation_hz": "revolutions per second, without sign",
    **dict.fromkeys(
        ("rotation_before_hz", "rotation_after_hz"), "revolutions per second before and after it"
    ),
    **dict.fromkeys(("vt_in_mps", "vt_out_mps"), "speed along the ground"),
    **dict.fromkeys(("vn_in_mps", "vn_out_mps"), "speed along the normal; before: below zero"),
    **dict.fromkeys(
        ("semi_axis_a_m", "semi_axis_b_m", "semi_axis_c_m"), "half of the extents, a the longest"
    ),
    "height_m": "vertical, from the ground to the centre; the resting height is included",
    "slope_deg": "dip of the ground along the travel, over one or two metres",
    "turn_deg": "change of the azimuth in plan, clockwise",
    **dict.fromkeys(("omega_in_radps", "omega_out_radps"), "spin; positive for a rolling rock"),
    **dict.fromkeys(("t_start_s", "t_end_s"), "start and end, from any zero of the clock"),
    "speed_error_rel": "of a speed, as a share of it (0.05: 5 %); at impacts of the whole speed",
    "rotation_error_rel": "of a rotation, as a share of it",
    "height_error_m": "of a height of flight",
    "position_error_m": "of a position",
    "stop_error_m": "of the place of a stop; default: of a position",
    "mass_error_rel": "of a mass, as a share of it",
    "contact_min_interval_s": "contacts that follow sooner count as one",
    "terrain_survey": "date, means and cell size of the terrain model",
    "ground": "kind, depth and moisture of the ground by stretch; diameter of blocks on it",
    "stops": "whether every rock has its stop, which left the survey, what held others",
}


def observation_tables() -> list[str]:
    """The tables of observations and the keys of their metadata, each with its columns.

    A column that means the same in several tables is described in the first one.
    """
    lines: list[str] = []
    described: dict[tuple[str, str, str], str] = {}
    for name, columns in OBSERVED.items():
        new = [own for own in columns if (own.name, own.unit, own.meaning) not in described]
        lines += [
            f"### `{name}`",
            "",
            _ABOUT.get(name, TABLE_TYPES[name].about),
            "",
            *columns_table("column", new),
        ]
        seen: dict[str, list[str]] = {}
        for own in columns:
            if own not in new:
                table = described[own.name, own.unit, own.meaning]
                seen.setdefault(table, []).append(f"`{own.name}`")
        if seen:
            as_in = "; ".join(f"{', '.join(own)} as in `{table}`" for table, own in seen.items())
            lines += [f"Also {as_in}.", ""]
        described |= {(own.name, own.unit, own.meaning): name for own in new}
    about = (
        "Columns `key` and `value`; `…_error_…`: a standard error. Other keys are passed on "
        "(`Metadata.others`)."
    )
    keys = columns_table("key", (*METADATA_KEYS.values(), *METADATA_TEXTS.values()))
    return [*lines, "### `metadata`", "", about, "", *keys[:-1]]


def columns_table(kind: str, columns: Iterable[Column]) -> list[str]:
    """Columns with their meaning, and an empty line; coordinates of a point in one row."""
    places: dict[str, list[str]] = {}
    for own in columns:
        about = re.sub(r": (x|y|height)$", "", _ABOUT.get(own.name, own.meaning))
        places.setdefault(about, []).append(f"`{own.name}`")
    rows = (f"| {', '.join(names)} | {text} |" for text, names in places.items())
    return [f"| {kind} | |", "|---|---|", *rows, ""]


#: Pages with a table that is made here, and the word of its marks.
TABLES: Mapping[str, tuple[str, Callable[[], list[str]]]] = {
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
