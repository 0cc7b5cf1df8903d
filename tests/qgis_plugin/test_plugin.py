"""The plugin, unpacked from its zip, in the real QGIS."""

from __future__ import annotations

import configparser
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas as gpd
import pytest
import shapely
from helpers.small_slope import NORTH, WEST, Slope, heights, release_box
from make_zip import PLUGIN, make_zip

import sassgis
from sassgis.io.read.config import load_config
from sassgis.io.read.ground_map import built_in_table

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
def ask(qgis: None, wheel: Path, program: Path, tmp_path_factory: pytest.TempPathFactory) -> Ask:
    folder = tmp_path_factory.mktemp("plugins")
    make_zip(folder / "plugin.zip", wheel)
    with zipfile.ZipFile(folder / "plugin.zip") as archive:
        archive.extractall(folder)

    def report(*calls: dict[str, Any], program: object = program) -> dict[str, Any]:
        home = tmp_path_factory.mktemp("home")
        task = {"plugins": str(folder), "program": str(program), "calls": calls}
        (home / "task.json").write_text(json.dumps(task, default=str))
        kept = {k: v for k, v in os.environ.items() if k.startswith("SASSGIS")}
        done = subprocess.run(
            ["/usr/bin/python3", str(PROBE), str(home / "task.json")],
            capture_output=True, text=True, timeout=900, check=False,
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
    made = Slope(tmp_path_factory.mktemp("slope"))
    made.write_config()
    made.write_dem(heights())
    made.write_release(release_box())
    return made


@pytest.fixture(scope="module")
def valley(make_valley: Callable[..., Path]) -> Path:
    return make_valley()


@pytest.fixture(scope="module")
def line(slope: Slope) -> Path:
    """Two lines, of which the first leads down the slope."""
    y = NORTH - 50.0
    lines = [
        shapely.LineString([(WEST + 10, y), (WEST + 60, y - 5), (WEST + 130, y)]),
        shapely.LineString([(WEST + 10, y), (WEST + 20, y)]),
    ]
    frame = gpd.GeoDataFrame(geometry=lines, crs="EPSG:2056")
    frame.to_file(slope.folder / "lines.gpkg", driver="GPKG")
    return slope.folder / "lines.gpkg"


@pytest.fixture(scope="module")
def seen(ask: Ask, valley: Path, slope: Slope, line: Path) -> dict[str, Any]:
    """One QGIS that runs, zones from layers, cuts a profile, and is given wrong input."""
    wrong = slope.folder / "wrong.toml"
    wrong.write_text(slope.config.read_text().replace("spacing_m", "spacing"))
    out = slope.folder
    layers = {"DEM": out / "dem.tif", "RELEASE": f"@{out / 'release.gpkg'}"}
    choices = {
        "GROUND": "talus", "VOLUME_FROM": 0.2, "VOLUME_TO": 0.4, "SPACING": 6, "BLOCKS": 5,
    }  # fmt: skip
    zoned = {**layers, **choices, "FREQUENCY": 0.1, "REF_WIDTH": 10}
    calls = {
        "run": calling("run", out / "run", CONFIG=valley, SEED=5),
        "zone": calling("zone", out / "zone", **zoned),
        "profile": calling("profile", out / "one", CONFIG=slope.config, LINE=f"@{line}|1"),
        "two lines": calling("profile", out / "two", CONFIG=slope.config, LINE=f"@{line}"),
        "wrong key": calling("run", out / "x", CONFIG=wrong),
        "nothing": calling("run", out / "x"),
        "both": calling("run", out / "x", CONFIG=valley, **layers),
        "no width": calling("zone", out / "x", **layers, FREQUENCY=0.1),
        "other choices": calling("zone", out / "zone", **{**zoned, "SPACING": 7}),
    }
    report = ask(*calls.values())
    return {**report, "calls": dict(zip(calls, report["calls"], strict=True))}


def test_the_zip_has_what_a_plugin_must_have(tmp_path: Path, wheel: Path) -> None:
    for name in ("a.zip", "b.zip"):
        make_zip(tmp_path / name, wheel)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        names = {Path(name) for name in archive.namelist()}
        metadata = configparser.ConfigParser(interpolation=None)
        metadata.read_string(archive.read("sassgis_plugin/metadata.txt").decode())
    assert {name.parts[0] for name in names} == {"sassgis_plugin"}
    files = {name.name for name in names}
    modules = {file.name for file in PLUGIN.glob("*.py")}
    assert files == modules | {"metadata.txt", "icon.png", "icon.svg", "LICENSE", wheel.name}
    general = metadata["general"]
    for key in (
        "name", "qgisMinimumVersion", "description", "about", "version", "author", "email",
        "repository", "tracker", "homepage", "category", "tags", "changelog",
    ):  # fmt: skip
        assert general[key].strip(), key
    assert general["version"] == sassgis.__version__
    assert general["hasProcessingProvider"] == "yes" and general["icon"] in files


def test_nothing_of_the_program_is_imported_and_qt_has_no_version() -> None:
    for file in PLUGIN.glob("*.py"):
        text = file.read_text(encoding="utf-8")
        for word in ("PyQt5", "PyQt6", "exec_(", "import sassgis", "import numba", "import numpy"):
            assert word not in text, f"{file.name}: {word}"


def test_choices_are_those_of_the_program() -> None:
    text = (PLUGIN / "algorithms.py").read_text(encoding="utf-8")
    written = text.partition("GROUND_CLASSES = (")[2].partition(")")[0]
    assert tuple(part.strip(' "\n') for part in written.split(",") if part.strip()) == tuple(
        built_in_table().names
    )


@pytest.mark.qgis
def test_the_provider_loads_and_leaves(seen: dict[str, Any]) -> None:
    assert seen["icon"] and seen["unloaded"] and seen["imported"] == []
    assert seen["algorithms"] == {
        name: [True, ""]
        for name in ("batch", "calibrate", "diagnose", "environment", "profile", "run", "zone")
    }
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
    assert json.loads((slope.folder / "run" / "manifest.json").read_text())["seed"] == 5
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
    assert renderers["Walls and nets"] == renderers["Stopping points"] == "categorizedSymbol"
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
    zones = next(
        layer for layer in leaves(call["tree"]) if layer["name"].startswith("Hazard zones")
    )
    assert zones["visible"] and zones["renderer"] != "singleSymbol"
    config = slope.folder / "zone_inputs" / "sassgis.toml"
    assert call["results"]["USED_CONFIG"] == str(config)
    made = load_config(config)
    assert (made.release.spacing_m, made.release.rocks_per_point) == (6.0, 5)
    assert made.ground.default == "talus" and made.hazard.ref_width_m == 10.0
    assert [b.name for b in made.blocks] == ["0.2 to 0.4 m3"]
    other = seen["calls"]["other choices"]["error"]
    assert "sassgis.toml: differs from what would be written" in other
    assert load_config(config).release.spacing_m == 6.0


@pytest.mark.qgis
def test_a_profile_is_that_of_the_selected_line(seen: dict[str, Any], slope: Slope) -> None:
    call = seen["calls"]["profile"]
    assert call["error"] is None and Path(call["results"]["REPORT"]).is_file()
    assert len(gpd.read_file(slope.folder / "one_inputs" / "line.fgb")) == 1
    assert "holds several lines" in seen["calls"]["two lines"]["error"]


@pytest.mark.qgis
def test_what_is_wrong_is_one_line(seen: dict[str, Any], slope: Slope) -> None:
    for name, words in (
        ("wrong key", "wrong.toml: release.spacing: unknown key"),
        ("nothing", "Give either a configuration, or"),
        ("both", "Give either a configuration, or"),
        ("no width", "Reference width of all frequencies (m): zones from layers need it"),
    ):
        error = seen["calls"][name]["error"]
        assert error.startswith("QgsProcessingException: ") and words in error, error
        assert "\n" not in error and "Error: " not in error and seen["calls"][name]["tree"] == []
        assert not any(words in line for line in seen["calls"][name]["info"])
    assert not (slope.folder / "x").exists()


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
    assert any("Going on after" in line for line in second["info"])


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
        program=echo,
    )["calls"]
    tail, config, folder = f"--jobs 1 -o {out} --overwrite", slope.config, slope.folder
    for call, command in zip(
        report,
        (
            f"calibrate {config} --observations {folder} --draws 20",
            f"gap diagnose {config} --observations {folder} --draws 20 --map",
            f"batch {table} --config {config} --mosaic-only --memory 2.5",
            f"batch {config}",
        ),
        strict=True,
    ):
        assert call["error"] is None
        assert f"called: {command} {tail}; PYTHONSTARTUP=[]" in call["info"]
        assert any("sassgis 9.9.9 is installed" in text for text in call["warnings"])
        # Without a project, each layer brings the style that the file has for it.
        assert "categorizedSymbol" in {layer["renderer"] for layer in leaves(call["tree"])}


@pytest.mark.qgis
def test_the_environment_is_made_from_the_wheel_in_the_zip(
    ask: Ask, slope: Slope, wheel: Path, tmp_path: Path
) -> None:
    run = calling("run", tmp_path / "o", CONFIG=slope.config)
    make = {"algorithm": "sassgis:environment", "parameters": {}}
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
