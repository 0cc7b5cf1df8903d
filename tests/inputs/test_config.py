from __future__ import annotations

import dataclasses
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from helpers.input_files import ONE_BLOCK
from helpers.one_line import one_line
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sassgis.errors import ConfigError, InputError
from sassgis.inputs.config import (
    SECTIONS,
    as_named,
    declared_sections,
    load_config,
    profile_control_lines,
    resolved,
    settings_hash,
)
from sassgis.outputs.config_template import config_template
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.map_run import Config
from sassgis.settings.settings import EngineSettings

MINIMAL = """
[terrain]
dem = "dem.tif"
[release]
file = "release.gpkg"
[[blocks]]
name = "large"
axis_1_m = [0.6, 0.8]
axis_2_m = 0.5
axis_3_m = 0.4
"""


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Config]:
    def write_and_load(text: str = MINIMAL, **overrides: object) -> Config:
        path = tmp_path / "run.toml"
        path.write_text(text, encoding="utf-8")
        return load_config(path, {k.replace("__", "."): v for k, v in overrides.items()})

    return write_and_load


def test_minimal_file_gives_core_types_and_absolute_paths(load, tmp_path):
    config = load()
    assert config.dem_source == tmp_path / "dem.tif"
    assert config.release_source == tmp_path / "release.gpkg"
    assert config.blocks == (
        BlockPopulation("large", axis_1_m=(0.6, 0.8), axis_2_m=(0.5, 0.5), axis_3_m=(0.4, 0.4)),
    )
    assert config.engine == EngineSettings()
    assert config.block_names == ("large",)


def test_paths_are_relative_to_the_file_not_to_the_working_folder(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    text = "\ufeff" + MINIMAL.replace('"dem.tif"', '"../b/dem.tif"')  # as Windows editors write
    (tmp_path / "a" / "run.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    config = load_config("a/run.toml")
    assert config.dem_source.resolve() == tmp_path / "b" / "dem.tif"
    assert config.dem_source.is_absolute()


def test_overrides_are_validated_like_the_file(load):
    assert load(run__seed=7).run.seed == 7
    with one_line(ConfigError, "run.seed", "-7"):
        load(run__seed=-7)


def _template_lines() -> Iterator[tuple[str, str, str]]:
    """Section, key and line of the template, those in comments included."""
    section = ""
    for line in config_template().splitlines():
        head = re.match(r"(?:# )?\[+([\w.]+)\]+\s*$", line)
        key = re.match(r"(?:# )?(\w+) = ", line)
        if head:
            section = head.group(1)
        elif key and section:
            yield section, key.group(1), line


#: Every section that has keys of its own.
ALL_SECTIONS = declared_sections()


@pytest.mark.parametrize("section", sorted(ALL_SECTIONS))
def test_template_shows_every_key_and_no_other(section):
    shown = {key for own, key, _ in _template_lines() if own == section}
    fields = set(ALL_SECTIONS[section])
    if section == "barriers":  # placed as stations are: those keys are explained there
        shown |= {"file", "layer", "name_field", "chainage_m"}
    assert shown == fields


def test_defaults_in_comments_of_the_template_are_the_true_ones():
    checked = 0
    for section, key, line in _template_lines():
        if not line.startswith("# ") or section in ("stations", "barriers", "objects"):
            continue
        default = ALL_SECTIONS[section][key].default
        if default is None:
            continue
        shown = tomllib.loads(line.removeprefix("# "))[key]
        if isinstance(default, tuple) and not isinstance(shown, list):
            shown = [shown, shown]
        assert shown == (list(default) if isinstance(default, tuple) else default), line
        checked += 1
    assert checked >= 15


NET = '[[barriers]]\nname = "road"\nchainage_m = 3\nkind = "net"\nheight_m = 2\n'

WRONG = [
    ('dem = "dem.tif"', 'demm = "dem.tif"', ["terrain.demm", "unknown key", "'dem'"]),
    ("[terrain]", "[terain]", ["terain", "unknown key", "'terrain'"]),
    ("[terrain]", "[terrain]\nrocks = 3", ["terrain.rocks", "this key in [profile]"]),
    ("[terrain]", "[terrain]\nxyz = 3", ["terrain.xyz", "unknown key", "one of", "smoothing_m"]),
    ('dem = "dem.tif"', "", ["terrain.dem", "missing key"]),
    ('dem = "dem.tif"', 'dem = ""', ["terrain.dem", "empty"]),
    ("[release]", '[release]\nspacing_m = "5"', ["release.spacing_m", "'5'", "a number"]),
    ("[release]", '[release]\nplacement = "hex"', ["release.placement", "'hex'", "'random'"]),
    ("[release]", "[release]\nrocks_per_point = 1.5", ["rocks_per_point", "whole number"]),
    ("[release]", "[[release]]", ["release", "a section [release]"]),
    ("[[blocks]]", "[blocks]", ["blocks", "[[blocks]]"]),
    ("axis_2_m = 0.5", "", ["blocks[large].axis_2_m", "missing key", "SEMI-axis"]),
    ("axis_2_m = 0.5", "axis_2_m = [0.5]", ["blocks[large].axis_2_m", "[0.5]", "[low, high]"]),
    ("axis_2_m = 0.5", "axis_2_m = [2, 1]", ["axis_2_m", "reversed", "[low, high]"]),
    ("axis_2_m = 0.5", "axis_2_m = [1, nan]", ["blocks[large].axis_2_m", "nan", "finite"]),
    ('name = "large"', 'name = "a;b"', ["blocks[a;b].name", "semicolon"]),
    ('name = "large"', "", ["blocks[no. 1].name", "missing key"]),
    ("[terrain]", "[spread]\nlines_per_point = 3\n[terrain]", ["spread", "followed"]),
    ("[terrain]", "[engine]\nend_sliding = 1\n[terrain]", ["engine.end_sliding", "true or false"]),
    ("[terrain]", "[output]\nenergy_classes_kj = [3, 3]\n[terrain]", ["energy_classes_kj", "asc"]),
    ("[terrain]", '[ground]\nraster_classes = {1="rock"}\n[terrain]', ["ground.raster_classes"]),
    ("[terrain]", '[ground]\nfile = "g.tif"\nraster_classes = {one="rock"}\n[terrain]',
     ["ground.raster_classes", "whole number"]),
    ("[terrain]", '[[stations]]\nname = "a"\nchainage_m = 1\nfile = "x"\n[terrain]',
     ["stations[a]", "file and chainage_m", "exactly one"]),
    ("[terrain]", '[[stations]]\nname = "a"\nline = [[1, 2], [3]]\n[terrain]',
     ["stations[a].line", "two numbers"]),
    ("[terrain]",
     '[[stations]]\nname = "a"\nline = [[1, 2], [3, 4]]\nlayer = "x"\n[terrain]',
     ["stations[a].layer", "file as well"]),
    ("[terrain]",
     '[[barriers]]\nname = "a"\nchainage_m = 1\nheight_m = 3\nkind = "fence"\n[terrain]',
     ["barriers[a].kind", "'fence'", "'wall', 'net' or 'gallery'"]),
    ("[terrain]", '[[barriers]]\nname = "n"\nchainage_m = 1\nkind = "net"\n[terrain]',
     ["barriers[n].height_m: missing key"]),
    ("[terrain]", NET.replace("= 2", "= 0") + "[terrain]",
     ["barriers[road].height_m: a net needs a height"]),
    ("[terrain]", NET + "width_m = 5\n[terrain]",
     ["barriers[road].width_m: does not go with a net", "galleries"]),
    ("[terrain]", NET.replace('"net"', '"gallery"') + "width_m = 5\n[terrain]",
     ["barriers[road].cushion_kpa: missing key", "modulus M_E"]),
]  # fmt: skip


STATION = '[[stations]]\nname = "road"\nchainage_m = 3\n'
#: Whole files, whose sections do not go together or cannot be used.
WHOLE = [
    (MINIMAL + ONE_BLOCK, ["blocks.name", "used twice", "large"]),
    (MINIMAL + STATION + NET, ["name", "used twice", "road"]),
    (MINIMAL[: MINIMAL.index("[[blocks]]")], ["blocks", "at least one [[blocks]]"]),
    # Under its former name, and under both.
    (MINIMAL + "[hazard]\nuncertain_share_max = 0", ["hazard.changed_share_max", "found 0"]),
    (MINIMAL + "[hazard]\nuncertain_share_max = 0.3\nchanged_share_max = 0.3",
     ["hazard.changed_share_max", "uncertain_share_max"]),
    (MINIMAL + "[hazard]\nchanged_share_max = 0.1", ["hazard.changed_share_max", '"auto"']),
    (MINIMAL + '[hazard]\nblocks = "auto"\nblocks_max = 0', ["hazard.blocks_max", "found 0"]),
    (MINIMAL + '[hazard]\nblocks = "auto"\nchanged_share_max = 1.0',
     ["hazard.changed_share_max", "found 1.0"]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [*((MINIMAL.replace(old, new, 1), words) for old, new, words in WRONG), *WHOLE],
)
def test_mistakes_are_told_in_one_line(load, text, words):
    with one_line(ConfigError, "run.toml", *words):
        load(text)


def test_several_mistakes_are_counted_and_unknown_keys_come_first(load):
    text = MINIMAL.replace('dem = "dem.tif"', 'demm = "x"\nsmoothing_m = -1').replace(
        "[release]", "[release]\nspacing_m = 0\n[engine]\neta_max_rule = 3\n[release2]"
    )
    with one_line(ConfigError, "run.toml", match=r"unknown key .*\(and 4 more\)$"):
        load(text)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[terrain\n", ["not valid TOML", "line 1"]),
        (b'[terrain]\ndem = "C:\\maps\\dem.tif"\n', ["not valid TOML", "line 2", "write /"]),
        (b"[run]\nseed = 1\nseed = 2\n", ["not valid TOML", "line 3"]),
        (b'[project]\nname = "\xe9boulis"\n', ["not UTF-8"]),
    ],
)
def test_files_that_are_not_toml(tmp_path, content, words):
    path = tmp_path / "run.toml"
    path.write_bytes(content)
    with one_line(ConfigError, "run.toml", *words):
        load_config(path)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=st.one_of(st.floats(), st.integers(-(10**6), 10**6)))
def test_spacing_is_either_usable_or_refused_in_one_line(load, value):
    text = MINIMAL.replace("[release]", f"[release]\nspacing_m = {value!r}")
    usable = math.isfinite(value) and 0.0 < value <= 10_000.0
    if usable:
        assert load(text).release.spacing_m == value
    else:
        with one_line(ConfigError, "release.spacing_m"):
            load(text)


def test_resolved_is_plain_and_complete(load):
    plain = resolved(load())
    assert resolved(load(config_template()))["run"] == plain["run"]
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert set(plain) == {*SECTIONS, "onsets"}
    assert plain["engine"] == dataclasses.asdict(EngineSettings().resolved())
    assert plain["release"]["spacing_m"] == 5.0


def _run_folder(folder: Path) -> Path:
    folder.mkdir()
    (folder / "run.toml").write_text(MINIMAL)
    (folder / "dem.tif").write_bytes(b"heights")
    (folder / "release.gpkg").write_bytes(b"areas")
    return folder / "run.toml"


def test_fingerprint_follows_contents_not_places_nor_jobs(tmp_path):
    here, there = _run_folder(tmp_path / "a"), _run_folder(tmp_path / "b")
    reference = settings_hash(load_config(here))
    assert re.fullmatch(r"[0-9a-f]{64}", reference)
    assert settings_hash(load_config(there, {"run.jobs": 3, "project.name": "other"})) == reference
    assert settings_hash(load_config(there, {"run.seed": 2})) != reference
    assert settings_hash(load_config(there, {"engine.eta_max_rule": "coulomb"})) != reference
    (there.parent / "dem.tif").write_bytes(b"other heights")
    assert settings_hash(load_config(there)) != reference


def test_the_manifest_names_files_as_from_the_folder_of_the_configuration(tmp_path):
    more = """
objects = [{name = "houses", kind = "building", file = "../houses.gpkg", value = 1.0}]
hazard.preset = "rules/mine.toml"
effects.trees = {file = "wood.gpkg", stems_field = "n", dbh_cm = 30.0}
"""
    files = [_run_folder(tmp_path / name) for name in ("a", "b")]
    for file in files:
        file.write_text(more + MINIMAL)
    here, there = (as_named(load_config(file)) for file in files)
    assert here == there and here["terrain"]["dem"] == "dem.tif"
    assert here["hazard"]["preset"] == "rules/mine.toml"
    assert here["objects"][0]["file"] == "../houses.gpkg"
    assert here["effects"]["trees"]["file"] == "wood.gpkg"


def test_the_tiles_of_a_virtual_raster_count_as_it_does(tmp_path):
    file = _run_folder(tmp_path / "a")
    (file.parent / "tile.tif").write_bytes(b"II*\0 heights")
    source = '<SourceFilename relativeToVRT="1">tile.tif</SourceFilename>'
    # Under any name: GDAL looks at what a file holds.
    (file.parent / "dem.tif").write_text(f"<VRTDataset>{source}{source}</VRTDataset>")
    before = settings_hash(load_config(file))
    (file.parent / "tile.tif").write_bytes(b"II*\0 other heights")
    assert settings_hash(load_config(file)) != before
    (file.parent / "tile.tif").unlink()
    with pytest.raises(InputError, match=r"cannot be read|not found"):
        settings_hash(load_config(file))


PROFILE = (
    MINIMAL[MINIMAL.index("[[blocks]]") :]
    + """
[profile]
file = "profile.csv"
start_m = [0, 20]
[[stations]]
name = "road"
chainage_m = 120
[[barriers]]
name = "net"
kind = "net"
height_m = 4
capacity_kj = 500
chainage_m = 90
"""
)


def test_profile_runs_need_no_map(load, tmp_path):
    config = load(PROFILE)
    assert config.profile is not None
    assert config.profile.file == tmp_path / "profile.csv"
    assert [(g.name, g.kind, g.capacity_kj, at) for g, at in profile_control_lines(config)] == [
        ("road", "station", math.inf, 120.0),
        ("net", "net", 500.0, 90.0),
    ]
    with one_line(ConfigError, "run.toml", "terrain.dem", "missing key"):
        _ = config.dem_source


def test_lines_on_the_map_have_no_chainage(load):
    config = load(PROFILE.replace("chainage_m = 120", "line = [[0, 0], [1, 1]]"))
    with one_line(ConfigError, "run.toml", "stations[road]", "found line", "expected chainage_m"):
        profile_control_lines(config)


def test_former_keys_are_read_and_noted_once(load):
    barriers = NET + "lets_go = true\n" + NET.replace("road", "m") + "lets_go = false\n"
    text = MINIMAL + barriers + '[hazard]\nblocks = "auto"\nuncertain_share_max = 0.1\n'
    old = load(text)
    assert [b.restarts_from_rest for b in old.barriers] == [True, False]
    assert old.hazard.changed_share_max == 0.1
    words = (
        ("run.toml", "barriers.lets_go", "restarts_from_rest"),
        ("run.toml", "hazard.uncertain_share_max", "changed_share_max"),
    )
    assert all(w in note for note, own in zip(old.notes, words, strict=True) for w in own)
    new = load(
        text.replace("lets_go", "restarts_from_rest").replace("uncertain_share", "changed_share")
    )
    assert new.notes == () and resolved(new) == resolved(old)
