"""The plugin, unpacked from its zip, in the real QGIS."""

from __future__ import annotations

import ast
import configparser
import contextlib
import json
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from helpers.small_slope import NORTH, WEST, Slope
from make_zip import PLUGIN, REQUIRED, main, make_zip, problems_of
from sassgis_plugin.steps import Scenario, Site, next_step, steps_of, verdict

import sassgis
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import built_in_table
from sassgis.inputs.presets import preset_names
from sassgis.inputs.site_layers import site_layers
from sassgis.runs.inputs import read_map_run

#: Each tool starts the program anew; one fixture of them may take many minutes.
pytestmark = pytest.mark.timeout(1800)
PROBE = Path(__file__).with_name("plugin_probe.py")
#: Says what it is called with, and in which surroundings.
ECHO = """\
if [ "$1" = --version ]; then echo "sassgis, version 9.9.9"; exit 0; fi
echo "called: $*; PYTHONSTARTUP=[$PYTHONSTARTUP]"
"""


def script(file: Path, text: str) -> Path:
    file.write_text(f"#!/bin/sh\n{text}", encoding="utf-8")
    file.chmod(0o755)
    return file


@pytest.fixture(scope="module")
def program(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sassgis of the tests as a program."""
    folder = tmp_path_factory.mktemp("program")
    start = f'PYTHONPATH="{repository}" exec "{sys.executable}" -m sassgis "$@"\n'
    return script(folder / "sassgis", start)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel that needs nothing, with a program that knows its version."""
    name = f"sassgis-{sassgis.__version__}"
    wheel = tmp_path_factory.mktemp("wheel") / f"{name}-py3-none-any.whl"
    info = f"{name}.dist-info"
    files = {
        "sassgis.py": f"def main():\n    print('sassgis, version {sassgis.__version__}')\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: sassgis\nVersion: {sassgis.__version__}",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\nsassgis = sassgis:main\n",
    }
    with zipfile.ZipFile(wheel, "w") as archive:
        for file, text in files.items():
            archive.writestr(file, text)
        archive.writestr(f"{info}/RECORD", "".join(f"{f},,\n" for f in (*files, f"{info}/RECORD")))
    return wheel


Ask = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def ask(qgis: None, program: Path, tmp_path_factory: pytest.TempPathFactory) -> Ask:
    folder = tmp_path_factory.mktemp("plugins")
    make_zip(folder / "plugin.zip")
    with zipfile.ZipFile(folder / "plugin.zip") as archive:
        archive.extractall(folder)

    def report(*calls: dict[str, Any], program: object = program, **more: object) -> dict[str, Any]:
        home = tmp_path_factory.mktemp("home")
        task = {"plugins": str(folder), "program": str(program), "calls": calls, **more}
        (home / "task.json").write_text(json.dumps(task, default=str))
        kept = {k: v for k, v in os.environ.items() if k.startswith("SASSGIS")}
        done = subprocess.run(
            ["/usr/bin/python3", str(PROBE), str(home / "task.json")],
            capture_output=True, text=True, timeout=1700, check=False,
            env={**kept, "QT_QPA_PLATFORM": "offscreen", "HOME": str(home), "LC_ALL": "C.UTF-8",
                 "PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin", "PYTHONSTARTUP": "/x"},
        )  # fmt: skip
        assert done.returncode == 0 and done.stdout, done.stderr
        return json.loads(done.stdout.splitlines()[-1])  # type: ignore[no-any-return]

    return report


def calling(algorithm: str, out: Path, **parameters: object) -> dict[str, Any]:
    return {"algorithm": f"sassgis:{algorithm}", "parameters": {"OUTPUT": out, **parameters}}


@pytest.fixture(scope="module")
def slope(tmp_path_factory: pytest.TempPathFactory) -> Slope:
    return Slope.made(tmp_path_factory.mktemp("slope"))


@pytest.fixture(scope="module")
def valley(make_valley: Callable[..., Path]) -> Path:
    return make_valley(spacing_m=20.0, rocks_per_point=2)


@pytest.fixture(scope="module")
def layers(slope: Slope) -> dict[str, str]:
    """Layers as a user has them: ground, nets, trees, with attributes in capitals and others.

    Of the two lines the first leads down the slope.
    """

    def write(name: str, *geometry: Any, **columns: object) -> str:
        columns |= {"note": ["x"] * len(geometry)}
        frame = gpd.GeoDataFrame(columns, geometry=list(geometry), crs="EPSG:2056")
        frame.to_file(slope.folder / f"{name}.gpkg", driver="GPKG")
        return str(slope.folder / f"{name}.gpkg")

    foot, y = shapely.box(WEST + 100, NORTH - 100, WEST + 140, NORTH), NORTH - 50.0
    return {
        "release": str(slope.folder / "release.gpkg"),
        "ground": write("ground", foot, CLASS=["soft_meadow"]),
        "nets": write(
            "nets", shapely.LineString([(WEST + 70, NORTH - 80), (WEST + 70, NORTH - 10)]),
            Name=["net A"], Kind=["net"], height_m=[3.0], capacity_kj=[1000],
        ),
        "forest": write("forest", foot, stems_per_ha=[300], dbh_cm=[30.0]),
        "edits": write(
            "edits", shapely.box(WEST + 60, NORTH - 60, WEST + 90, NORTH - 30),
            level=["not_in_danger"], author=["A"], date=["2026-01-31"], reason=["rock cleared"],
        ),
        "bare": write("bare", shapely.LineString([(WEST, NORTH - 9), (WEST + 9, NORTH - 9)])),
        "lines": write(
            "lines",
            shapely.LineString([(WEST + 10, y), (WEST + 60, y - 5), (WEST + 130, y)]),
            shapely.LineString([(WEST + 10, y), (WEST + 20, y)]),
        ),
    }  # fmt: skip


SCENARIOS = ["small", 0.1, 0.3, 0.2, "large", 1, 2.5, 0.05]


@pytest.fixture(scope="module")
def seen(ask: Ask, valley: Path, slope: Slope, layers: dict[str, str]) -> dict[str, Any]:
    """One QGIS that runs, zones from layers, cuts a profile, and is given wrong input."""
    wrong = slope.folder / "wrong.toml"
    wrong.write_text(slope.config.read_text().replace("spacing_m", "spacing"))
    out = slope.folder
    plain = {"DEM": out / "dem.tif", "RELEASE": f"@{layers['release']}"}
    more = {
        "GROUND_LAYER": f"@{layers['ground']}", "BARRIERS": f"@{layers['nets']}",
        "FOREST": f"@{layers['forest']}", "EDITS": f"@{layers['edits']}",
    }  # fmt: skip
    choices = {"GROUND": "talus", "SCENARIOS": SCENARIOS, "SPACING": 6, "BLOCKS": 5}
    zoned = {**plain, **more, **choices, "AUTO": False}
    half, line = [*SCENARIOS[:7], ""], {"CONFIG": slope.config, "BLOCKS": 9}
    calls = {
        "run": calling("run", out / "run", CONFIG=valley, SEED=12345678),
        "zone": calling("zone", out / "zone", **zoned),
        "profile": calling("profile", out / "one", **line, LINE=f"@{layers['lines']}|1"),
        "two lines": calling("profile", out / "two", **line, LINE=f"@{layers['lines']}"),
        "wrong key": calling("run", out / "x", CONFIG=wrong),
        "nothing": calling("run", out / "x"),
        "both": calling("run", out / "x", CONFIG=valley, **plain),
        "no frequency": calling("zone", out / "x", **plain, SCENARIOS=half),
        "wrong row": calling("run", out / "x", **plain, SCENARIOS=["a", 2, 1, ""]),
        "no kind": calling("run", out / "x", **plain, BARRIERS=f"@{layers['bare']}"),
        "no vulnerability": calling("run", out / "x", **plain, ROADS=f"@{layers['bare']}"),
        "written": calling("configuration", out / "later", **plain, SCENARIOS=SCENARIOS),
        "again": calling("configuration", out / "later", **plain, SCENARIOS=SCENARIOS),
        "other choices": calling("zone", out / "zone", **{**zoned, "SPACING": 7}),
    }
    report = ask(*calls.values())
    return {**report, "calls": dict(zip(calls, report["calls"], strict=True))}


@pytest.fixture(scope="module")
def others(ask: Ask, seen: dict[str, Any], valley: Path, slope: Slope) -> dict[str, Any]:
    """The other tools, at the results of the first."""
    out = slope.folder
    calls = {
        "check": {
            "algorithm": "sassgis:dem_check",
            "parameters": {"DEM": str(out / "dem.tif"), "CELLS": str(out / "cells.gpkg")},
        },
        "new": calling("new_site", out / "site.gpkg", DEM=str(out / "dem.tif")),
        "cliffs": calling("cliffs", out / "cliffs.gpkg", DEM=str(out / "dem.tif"), THRESHOLD=35),
        "validate": {"algorithm": "sassgis:validate", "parameters": {"CONFIG": str(valley)}},
        "compare": calling("compare", out / "change", BEFORE=out / "run", AFTER=out / "run"),
        "export": calling("export", out / "zones.geojson", RESULT=out / "zone"),
        "sheets": calling("sheets", out / "sheets", RESULT=out / "zone", DPI=40),
    }
    return dict(zip(calls, ask(*calls.values())["calls"], strict=True))


def test_the_zip_has_what_a_plugin_must_have(tmp_path: Path) -> None:
    for name in ("a.zip", "b.zip"):
        make_zip(tmp_path / name, "https://code.sassgis.ch/sassgis", "rockfall@sassgis.ch")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert problems_of(tmp_path / "a.zip") == []
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        names = {Path(name) for name in archive.namelist()}
        metadata = configparser.ConfigParser(interpolation=None)
        metadata.read_string(archive.read("sassgis_plugin/metadata.txt").decode())
    files = {name.name for name in names}
    modules = {file.name for file in PLUGIN.glob("*.py")}
    assert files == modules | {"metadata.txt", "icon.png", "icon.svg", "LICENSE"}
    general = metadata["general"]
    assert general["version"] == sassgis.__version__
    assert general["hasProcessingProvider"] == "yes" and general["icon"] in files


def test_one_command_makes_the_zip_of_this_version(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["make_zip.py"])
    main()
    file = tmp_path / "dist" / f"sassgis_plugin-{sassgis.__version__}.zip"
    assert f"wrote {file.relative_to(tmp_path)}" in capsys.readouterr().out
    assert problems_of(file) == [f"metadata: no {key}" for key in REQUIRED[-3:]]


def test_a_zip_that_the_index_would_refuse_is_named(tmp_path: Path) -> None:
    file = tmp_path / "plugin.zip"
    make_zip(file)
    assert problems_of(file) == [f"metadata: no {key}" for key in REQUIRED[-3:]]
    make_zip(file, "https://example.org/sassgis", "me@example.org")
    assert [p.split(":")[1].split()[0] for p in problems_of(file)] == [
        "repository", "tracker", "homepage", "email",
    ]  # fmt: skip
    make_zip(file, "https://code.sassgis.ch/sassgis", "rockfall@sassgis.ch")
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("sassgis_plugin/a.whl", b"")
    assert problems_of(file) == ["holds sassgis_plugin/a.whl; expected no binaries"]


def test_nothing_of_the_program_is_imported_and_qt_has_no_version() -> None:
    for file in PLUGIN.glob("*.py"):
        text = file.read_text(encoding="utf-8")
        for word in ("PyQt5", "PyQt6", "exec_(", "import sassgis", "import numba", "import numpy"):
            assert word not in text, f"{file.name}: {word}"


def test_values_of_qt_are_named_with_their_kind_as_qt_6_wants() -> None:
    texts = "\n".join(file.read_text(encoding="utf-8") for file in PLUGIN.glob("*.py"))
    imports = re.findall(r"from qgis\.PyQt\.\w+ import (\([^)]*\)|[^\n]+)", texts)
    taken = {name for names in imports for name in re.findall(r"\w+", names)}
    asked = {name for name in re.findall(r"\bQ\w*(?:\.\w+)+", texts) if name.split(".")[0] in taken}
    assert len(taken) > 20 and "Qt.MouseButton.RightButton" in asked
    for name in asked:
        # In Qt 6 there is Qt.MouseButton.RightButton, and no Qt.RightButton.
        alone = name.count(".") == 1 and name.split(".")[1][0].isupper()
        assert not alone or any(own.startswith(f"{name}.") for own in asked), name


def constants(name: str) -> dict[str, Any]:
    """Plain values that a module of the plugin begins with."""
    found = {}
    for node in ast.parse((PLUGIN / f"{name}.py").read_text(encoding="utf-8")).body:
        with contextlib.suppress(ValueError, AttributeError):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            found[target.id] = ast.literal_eval(node.value)
    return found


def test_choices_are_those_of_the_program() -> None:
    assert constants("command")["GROUND_CLASSES"] == tuple(built_in_table().names)
    assert set(constants("run_tools")["PRESETS"]) <= set(preset_names())
    own = constants("site_files")
    known = {layer.name: tuple(layer.fields) for layer in site_layers()}
    assert own["SITE_LAYERS"] == known
    needed = {layer.name: layer.fields for layer in site_layers()}
    for name, columns in own["NEEDED"].items():
        assert all(needed[name][column].needed for column in columns)


def test_each_step_says_what_is_missing() -> None:
    good = Scenario("small", "0.1", "0.5", "0.2")
    site = Site(terrain="dem", release="areas", ground="debris", scenarios=(good,), folder="/x")

    def missing(**changes: object) -> dict[str, str]:
        return {own.key: own.missing for own in steps_of(replace(site, **changes))}

    assert missing() == {
        "program": "", "terrain": "", "release": "", "ground": "", "blocks": "", "run": "",
        "zones": "the reference width", "sheet": "a result with zones or maps",
    }  # fmt: skip
    assert missing(terrain="", folder="")["run"] == "a terrain model; a folder for the result"
    without = missing(program="not installed.", ref_width_m=10.0)
    assert (without["program"], without["zones"]) == ("not installed", "the program")
    assert missing(ref_width_m=10.0)["zones"] == ""
    assert "vulnerability" in missing(ref_width_m=10.0, exposed=True)["zones"]
    rows = {
        ("", "1", "2", ""): "no name", ("a", "x", "2", ""): "volumes are numbers",
        ("a", "2", "1", ""): "not above the greatest", ("a", "1", "2", "-1"): "0 or more",
        ("a", "1", "2", "often"): "number of blocks a year",
    }  # fmt: skip
    for row, words in rows.items():
        assert words in missing(scenarios=(Scenario(*row),))["blocks"]
        assert words in missing(scenarios=(Scenario(*row),))["run"]
    assert "differ" in missing(scenarios=(good, good))["blocks"]
    assert "onset frequency" in missing(scenarios=(Scenario("a", "1", "2", ""),))["zones"]
    run = {"simulated": "/x", "sheets": ("Energy",)}
    texts = [next_step(steps_of(replace(site, **own))) for own in (
        {"terrain": ""}, {"terrain": "", "program": "not installed."}, {"folder": ""}, {}, run,
        {**run, "ref_width_m": 10.0}, {**run, "changed_share": 0.11},
        {**run, "changed_share": 0.01},
    )]  # fmt: skip
    assert texts == [
        "Next: terrain (a terrain model).", "Next: program (see below).",
        "Next: run (a folder for the result).", "Next: run (ready).",
        "Next: zones (the reference width).", "Next: zones (ready).",
        "Next: more blocks per release point, or as many as the map needs; then zones again.",
        "All steps are done.",
    ]  # fmt: skip


def test_how_far_zones_are_settled_has_three_grades() -> None:
    assert [verdict(share)[0] for share in (0.0, 0.02, 0.021, 0.1, 0.4)] == [
        "good", "good", "look", "look", "bad",
    ]  # fmt: skip
    assert "12.3 % of the zoned area changes level" in verdict(0.123)[1]


@pytest.mark.qgis
def test_the_provider_loads_and_leaves(seen: dict[str, Any]) -> None:
    assert seen["icon"] and seen["unloaded"] and seen["imported"] == []
    assert seen["algorithms"] == {
        name: [True, ""]
        for name in (
            "batch", "calibrate", "cliffs", "compare", "configuration", "dem_check", "diagnose",
            "environment", "export", "frequency", "new_site", "profile", "rockyfor3d", "run",
            "sensitivity", "sheets", "validate", "zone",
        )
    }  # fmt: skip
    assert seen["menu"][0] == "Site: the work step by step"
    assert seen["menu"][-2:] == ["Make the environment ...", "Draw a profile"]
    # A line of one vertex is none.
    assert seen["drawn"] == [3]


def leaves(tree: list[dict[str, Any]]) -> list[dict[str, Any]]:
    parts = [leaves(node["within"]) if "within" in node else [node] for node in tree]
    return [leaf for part in parts for leaf in part]


@pytest.mark.qgis
def test_a_run_arrives_in_order_and_styled(seen: dict[str, Any], slope: Slope) -> None:
    call = seen["calls"]["run"]
    assert call["error"] is None
    assert json.loads((slope.folder / "run" / "manifest.json").read_text())["seed"] == 12345678
    assert call["results"]["REPORT"] == str(slope.folder / "run" / "report.html")
    (group,) = call["tree"]
    assert group["name"] == "run"
    groups = {own["name"]: own for own in group["within"]}
    first, *_, last = groups
    assert (first, last) == ("Stations and measures", "Terrain")
    assert groups["Maps"]["exclusive"]
    layers = leaves(call["tree"])
    assert all(layer["valid"] for layer in layers)
    renderers = {layer["name"]: layer["renderer"] for layer in layers}
    assert renderers["Barriers"] == renderers["Where blocks end"] == "categorizedSymbol"
    maps = leaves(groups["Maps"]["within"])
    assert {layer["renderer"] for layer in maps} == {"singlebandpseudocolor"}
    assert [layer["visible"] for layer in maps].count(True) == 1
    assert renderers["Relief"] == "hillshade"


@pytest.mark.qgis
def test_zones_from_layers_come_from_a_configuration_that_is_kept(
    seen: dict[str, Any], slope: Slope
) -> None:
    call = seen["calls"]["zone"]
    assert call["error"] is None
    zones = next(own for own in leaves(call["tree"]) if own["name"].startswith("Hazard zones"))
    assert zones["visible"] and zones["renderer"] != "singleSymbol"
    config = slope.folder / "zone_inputs" / "sassgis.toml"
    assert call["results"]["USED_CONFIG"] == str(config)
    made = load_config(config)
    assert (made.release.spacing_m, made.release.rocks_per_point) == (6.0, 5)
    assert (made.project.name, made.project.language) == ("zone", "en")
    later = load_config(seen["calls"]["written"]["results"]["USED_CONFIG"])
    # Unless it is switched off: as many as the map needs, with few at first.
    assert (made.hazard.blocks, later.hazard.blocks) == ("given", "auto")
    assert (later.release.rocks_per_point, later.hazard.ref_width_m) == (20, 10.0)
    edits = gpd.read_file(slope.folder / "zone" / "edits.gpkg", layer="edits")
    assert list(edits["reason"]) == ["rock cleared"]
    # A value under another name must not be a silent zero.
    assert "edits: no attribute limit, computed" in call["warnings"]
    assert made.ground.default == "talus" and made.hazard.ref_width_m == 10.0
    blocks = [(b.name, b.volume_m3, made.onsets[b.name].frequency) for b in made.blocks]
    assert blocks == [("small", (0.1, 0.3), 0.2), ("large", (1.0, 2.5), 0.05)]
    run = read_map_run(made)
    assert {run.table.names[i] for i in np.unique(run.ground)} == {"talus", "soft_meadow"}
    ((net, _),) = run.control_lines
    assert (net.name, net.kind, net.height_m, net.capacity_kj) == ("net A", "net", 3.0, 1000.0)
    assert run.forest is not None and run.forest.stems_per_m2.max() == pytest.approx(0.03)
    # Equal layers are equal inputs, which are there already.
    assert seen["calls"]["again"]["error"] is None
    share = float(call["results"]["CHANGED_SHARE"])
    told = [t for t in (*call["info"], *call["warnings"]) if "With another random seed" in t]
    assert f"{100 * share:.1f} % of the zoned area changes level" in told[-1]
    other = seen["calls"]["other choices"]["error"]
    assert "sassgis.toml: differs from what would be written" in other
    assert load_config(config).release.spacing_m == 6.0


@pytest.mark.qgis
def test_a_profile_is_that_of_the_selected_line(seen: dict[str, Any], slope: Slope) -> None:
    call = seen["calls"]["profile"]
    assert call["error"] is None and Path(call["results"]["REPORT"]).is_file()
    assert len(gpd.read_file(slope.folder / "one_inputs" / "site.gpkg")) == 1
    assert "holds several lines" in seen["calls"]["two lines"]["error"]


@pytest.mark.qgis
def test_what_is_wrong_is_one_line(seen: dict[str, Any], slope: Slope) -> None:
    for name, words in (
        ("wrong key", "wrong.toml: release.spacing: unknown key"),
        ("nothing", "Give either a configuration, or"),
        ("both", "Give either a configuration, or"),
        ("no frequency", "large: zones from layers need its onset frequency"),
        ("wrong row", "Block scenarios: a: the least volume is above 0"),
        ("no kind", "bare: no attribute kind and height_m (there are fid, note; expected name"),
        ("no vulnerability", "Exposed objects need a table of vulnerability"),
    ):
        error = seen["calls"][name]["error"]
        assert error.startswith("QgsProcessingException: ") and words in error, error
        assert "\n" not in error and "Error: " not in error and seen["calls"][name]["tree"] == []
        assert not any(words in line for line in seen["calls"][name]["info"])
    assert not (slope.folder / "x").exists()


@pytest.mark.battery
@pytest.mark.qgis
def test_the_other_tools_do_their_work(others: dict[str, Any], slope: Slope) -> None:
    calls = others
    for name, call in calls.items():
        assert call["error"] is None, (name, call["error"])
    assert "coordinate system  CH1903+ / LV95" in calls["check"]["results"]["ANSWER"]
    assert [layer["name"] for layer in leaves(calls["check"]["tree"])] == ["dem_defects"]
    assert "ready for      run" in calls["validate"]["results"]["ANSWER"]
    drawn = {layer["name"] for layer in leaves(calls["new"]["tree"])}
    assert {"release_areas", "barriers", "ground"} <= drawn
    assert len(gpd.read_file(slope.folder / "cliffs.gpkg")) > 0
    assert (slope.folder / "change" / "report.html").is_file()
    assert len(gpd.read_file(slope.folder / "zones.geojson")) > 0
    sheets = sorted((slope.folder / "sheets").glob("*.pdf"))
    assert len(sheets) > 3 and all(file.read_bytes()[:4] == b"%PDF" for file in sheets)


@pytest.mark.battery
@pytest.mark.qgis
def test_the_panel_leads_from_terrain_to_sheets(
    ask: Ask, slope: Slope, layers: dict[str, str], tmp_path: Path
) -> None:
    task = {"dem": slope.folder / "dem.tif", "layers": layers, "folder": tmp_path / "result"}
    seen = ask(steps=task)["steps"]
    assert seen["begin"]["next"] == "<b>Next: terrain (a terrain model).</b>"
    assert not seen["begin"]["run"] and not seen["begin"]["zone"]
    assert (seen["begin"]["auto"], seen["begin"]["blocks"]) == (True, 20)
    # However narrow the panel is made, nothing is cut off at its right.
    assert seen["hidden"] == 0
    assert seen["terrain"]["next"] == "<b>Next: release areas (a layer of release areas).</b>"
    assert "volumes are numbers" in seen["wrong row"]["status"]["blocks"]
    assert seen["ready"]["run"] and not seen["ready"]["zone"]
    assert "an onset frequency in each row" in seen["ready"]["status"]["zones"]
    assert not seen["busy"]["run"] and seen["run ended"] == [True]
    assert "vulnerability" in seen["exposed"]["status"]["zones"]
    assert seen["zone ended"][-1] is True, seen["after zone"]
    after = seen["after zone"]
    manifest = json.loads((tmp_path / "result" / "manifest.json").read_text())
    share = manifest["settings"]["zoning"]["changed_share"]
    assert after["bar"] == round(1000 * share) and f"{100 * share:.1f} %" in after["share"]
    assert f"{100 * share:.1f} % of the zoned area" in after["status"]["zones"]
    assert "zones." in after["line"]
    # Five blocks a point are too few.
    assert after["next"] == (
        "<b>Next: more blocks per release point, or as many as the map needs; then zones again.</b>"
    )
    assert "Hazard level" in after["sheets"][0]
    assert any("Hazard zones" in layer["name"] for layer in leaves(seen["tree"]))


@pytest.mark.battery
@pytest.mark.qgis
def test_cancelling_keeps_the_state_and_the_same_call_goes_on(
    ask: Ask, slope: Slope, tmp_path: Path
) -> None:
    slope.write_config(release__spacing_m="0.5", release__rocks_per_point="250")
    out = tmp_path / "long"
    call = calling("run", out, CONFIG=slope.config)
    first, second = ask({**call, "cancel": True}, call)["calls"]
    assert "Stopped: the same call goes on" in first["error"] and first["tree"] == []
    assert 0 < first["progress"][-1] < 100
    assert second["error"] is None and (out / "report.html").is_file()
    assert any("Resuming after" in line for line in second["info"])


@pytest.mark.qgis
def test_commands_get_their_arguments_and_none_of_the_surroundings(
    ask: Ask, seen: dict[str, Any], slope: Slope, tmp_path: Path
) -> None:
    out, vectors = tmp_path / "o", slope.folder / "run" / "result.gpkg"
    written = f'mkdir -p "{out}"; cp "{vectors}" "{out}/gap.gpkg"\n'
    echo = script(tmp_path / "sassgis", ECHO + written)
    table = slope.folder / "stops.csv"
    table.write_text("x\n")
    both = {"CONFIG": slope.config, "JOBS": 1, "OVERWRITE": True}
    given = {**both, "OBSERVATIONS": table, "DRAWS": 20}
    # As a script may give it.
    in_folder = {**given, "OBSERVATIONS": slope.folder}
    report = ask(
        calling("calibrate", out, **given),
        calling("diagnose", out, **in_folder, MAP=True),
        calling("batch", out, **both, RELEASES=table, MOSAIC_ONLY=True, MEMORY=2.5),
        calling("batch", out, **both),
        calling("sensitivity", out, **both, SAMPLES=16, SEED=2147483647),
        {"algorithm": "sassgis:frequency",
         "parameters": {"VOLUMES": table, "COMPLETE": 0.05, "YEARS": 40, "LIMITS": "0.1,1"}},
        calling("rockyfor3d", tmp_path / "r.toml", FOLDER=slope.folder, CRS="EPSG:2056"),
        program=echo,
    )["calls"]  # fmt: skip
    tail, config, folder = f"--jobs 1 -o {out} --overwrite", slope.config, slope.folder
    commands = (
        f"calibrate {config} --observations {folder} --draws 20",
        f"gap diagnose {config} --observations {folder} --draws 20 --map",
        f"batch {table} --config {config} --mosaic-only --memory 2.5",
        f"batch {config}",
    )
    for call, command in zip(report, commands, strict=False):
        assert call["error"] is None
        assert f"called: {command} {tail}; PYTHONSTARTUP=[]" in call["info"]
        assert any("sassgis 9.9.9 is installed" in text for text in call["warnings"])
        # Without a project, each layer brings the style that the file has for it.
        assert "categorizedSymbol" in {layer["renderer"] for layer in leaves(call["tree"])}
    # Numbers of a million and more keep all of their digits.
    commands = (
        f"sensitivity {config} --samples 16 --jobs 1 --seed 2147483647 -o {out} --overwrite",
        f"frequency {table} --complete-from 0.05 --years 40 --scenarios 0.1,1",
        f"init {tmp_path / 'r.toml'} --rockyfor3d {folder} --set terrain.crs=EPSG:2056",
    )
    for call, words in zip(report[4:], commands, strict=True):
        assert f"called: {words}; PYTHONSTARTUP=[]" in call["info"], call


@pytest.mark.battery
@pytest.mark.qgis
def test_the_environment_is_made_from_a_wheel(
    ask: Ask, slope: Slope, wheel: Path, tmp_path: Path
) -> None:
    run = calling("run", tmp_path / "o", CONFIG=slope.config)
    make = {"algorithm": "sassgis:environment", "parameters": {"SOURCE": wheel}}
    wrong = {"algorithm": "sassgis:environment", "parameters": {"PYTHON": "/bin/false"}}
    report = ask(run, wrong, make, run, program="")
    before, refused, made, after = report["calls"]
    assert "Run 'Make the environment'" in before["error"]
    assert report["algorithms"]["environment"] == [True, ""] and not report["algorithms"]["run"][0]
    assert "no Python 3.11 or later" in refused["error"]
    assert made["error"] is None and made["results"]["PROGRAM"].endswith("/environment/bin/sassgis")
    assert after["error"] is None and not after["warnings"]
    for program, words in ((tmp_path, "there is no such program"), (wheel, "does not start")):
        assert words in ask(run, program=program)["calls"][0]["error"]
