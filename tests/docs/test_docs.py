"""The documentation keeps up with the code."""

from __future__ import annotations

import ast
import dataclasses
import doctest
import importlib
import json
import re
import subprocess
import sys

import pytest
from helpers.scripts import load, run_script

import sassgis
from sassgis.inputs.ground_map import built_in_table
from sassgis.settings.settings import EngineSettings


def examples(repository):
    """Python blocks of docs/python.md that are marked, by name."""
    text = (repository / "docs" / "python.md").read_text(encoding="utf-8")
    found = re.findall(r"<!-- example: (\w+) -->\n```python\n(.*?)```", text, re.S)
    return dict(found)


def pages(repository):
    yield repository / "README.md"
    yield repository / "CONTRIBUTING.md"
    yield from sorted((repository / "docs").rglob("*.md"))


def anchors(path):
    """Anchors of the headings of a page, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.S)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in heads}


# --- public names --------------------------------------------------------------------------------


def test_public_names_resolve():
    for name in sassgis.__all__:
        assert getattr(sassgis, name) is not None, name
    assert sassgis.load_config.__module__ == "sassgis.inputs.config"
    assert sassgis.run.__module__ == "sassgis.runs.run"
    assert set(sassgis._HOMES) == set(sassgis.__all__) - {"__version__"}


def test_names_known_to_type_checkers_are_those_that_resolve(repository):
    tree = ast.parse((repository / "sassgis" / "__init__.py").read_text(encoding="utf-8"))
    checked = next(node for node in tree.body if isinstance(node, ast.If))
    homes = {alias.name: node.module for node in checked.body for alias in node.names}
    assert homes == sassgis._HOMES


@pytest.mark.parametrize("name", ["sassgis.api", "sassgis.inputs.config"])
def test_examples_in_docstrings_run(name):
    failed, tried = doctest.testmod(importlib.import_module(name))
    assert tried > 2 and not failed


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = sassgis.no_such_name


def test_import_is_light():
    code = "import sys, sassgis; dir(sassgis); print(sorted(sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for heavy in ("numpy", "numba", "rasterio", "geopandas", "pydantic", "matplotlib"):
        assert f"'{heavy}'" not in out.stdout


# --- pages ---------------------------------------------------------------------------------------


def test_configuration_page_is_up_to_date(repository):
    made = load(repository / "docs" / "make_reference.py").page()
    committed = (repository / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert committed == made, "run: python docs/make_reference.py"


def test_tables_of_the_maps_are_up_to_date(repository):
    maker = load(repository / "docs" / "make_statistics.py")
    for path, page in ((maker.MAPS, maker.maps_page), (maker.README, maker.readme_page)):
        text = path.read_text(encoding="utf-8")
        assert text == page(text), "run: python docs/make_statistics.py"


def test_tables_of_declared_things_are_up_to_date(repository):
    maker = load(repository / "docs" / "make_reference.py")
    for page in maker.TABLES:
        committed = (repository / "docs" / page).read_text(encoding="utf-8")
        assert committed == maker.with_table(page, committed), "run: python docs/make_reference.py"


def test_every_key_is_on_the_configuration_page(repository):
    from sassgis.inputs.config import declared_sections

    text = (repository / "docs" / "configuration.md").read_text(encoding="utf-8")
    for section, keys in declared_sections().items():
        part = re.search(rf"^## `\[+{section}\]+`$(.*?)(?=^## |\Z)", text, re.S | re.M)
        assert part, section
        for key in keys:
            own = key.removesuffix("_field")
            names = {f"`{key}`", f"`{own}` †" if own != key else f"`{key}`"}
            assert any(name in part.group(1) for name in names), f"{section}.{key}"


def test_model_page_tells_every_reading_with_its_default(repository):
    text = (repository / "docs" / "model.md").read_text(encoding="utf-8")
    numerical = {"gravity_mps2", "contact_tolerance_m", "max_events"}
    sets = [EngineSettings(readings=name).resolved() for name in ("1986", "hazard")]
    for field in dataclasses.fields(EngineSettings):
        if field.default is None:
            row = next(line for line in text.splitlines() if line.startswith(f"| `{field.name}` |"))
            for own, cell in zip(sets, row.split("|")[2:], strict=False):
                value = getattr(own, field.name)
                assert value is None or json.dumps(value) in cell, field.name
        elif field.name not in numerical:
            assert f"`{field.name} = {json.dumps(field.default)}`" in text, field.name


def test_links_lead_somewhere(repository):
    broken = []
    for page in pages(repository):
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"https?:|mailto:", target):
                continue
            name, _, anchor = target.partition("#")
            file = (page.parent / name).resolve() if name else page
            if not file.exists() or (anchor and anchor not in anchors(file)):
                broken.append(f"{page.relative_to(repository)}: {target}")
    assert not broken


@pytest.fixture(scope="module")
def small_result(tmp_path_factory):
    """What `sassgis demo` writes, with few rocks."""
    from sassgis.outputs.site_template import sample_folder

    out = tmp_path_factory.mktemp("run") / "out"
    config = sassgis.load_config(
        sample_folder() / "valley" / "config.toml",
        {
            "release.spacing_m": 30.0,
            "release.rocks_per_point": 4,
            "hazard.blocks": "given",
            "hazard.changed_share_max": None,
        },
    )
    return sassgis.zone(config, out, jobs=1), out


@pytest.mark.battery
def test_pages_name_every_map(repository, small_result):
    import rasterio

    _, out = small_result
    maps = (repository / "docs" / "maps.md").read_text(encoding="utf-8")
    readme = (repository / "README.md").read_text(encoding="utf-8")
    readme = readme.replace(" _", " intensity_")
    files = sorted((out / "maps").glob("*.tif"))
    assert len(files) > 12
    for path in files:
        assert re.search(rf"\b{path.stem}\b", readme), path.stem
        if path.stem != "terrain":
            with rasterio.open(path) as raster:
                bands = ", ".join(raster.tags(i)["NAME"] for i in raster.indexes)
            assert f"| `{path.stem}` | {bands} |" in maps


def test_readme_lists_everything_in_the_folder(repository, small_result):
    _, out = small_result
    readme = (repository / "README.md").read_text(encoding="utf-8")
    listing = re.search(r"```\ndemo_out/\n(.*?)```", readme, re.S).group(1)
    listed = {m.split("/")[0] for m in re.findall(r"^  (\S+)", listing, re.M)}
    assert {p.name for p in out.iterdir() if not p.name.startswith(".")} == listed


def test_output_page_names_every_layer(repository, small_result):
    import pyogrio

    _, out = small_result
    text = (repository / "docs" / "outputs.md").read_text(encoding="utf-8")
    for file in sorted(out.glob("*.gpkg")):
        part = re.search(rf"^## Layers of `{file.name}`$(.*?)(?=^## |\Z)", text, re.S | re.M)
        assert part, file.name
        for name, kind in pyogrio.list_layers(file):
            if kind is not None:
                assert re.search(rf"^\|.*`{name}`.*\|.*\|", part.group(1), re.M), name


def test_output_page_names_every_table(repository, small_result):
    _, out = small_result
    text = (repository / "docs" / "outputs.md").read_text(encoding="utf-8")
    risk = (repository / "docs" / "risk.md").read_text(encoding="utf-8")
    names = {p.name.replace("_without_barriers", "") for p in (out / "tables").glob("*.csv")}
    assert len(names) > 6
    for name in names:
        assert f"`{name}`" in text, name
        assert not name.startswith("risk") or f"`tables/{name}`" in risk


def test_output_page_tells_every_column(repository):
    from sassgis.settings.results import PASSAGE_DTYPE, ROCK_DTYPE, Outcome, StopReason

    text = (repository / "docs" / "outputs.md").read_text(encoding="utf-8")
    for name in (*ROCK_DTYPE.names, *PASSAGE_DTYPE.names):
        assert f"`{name}`" in text, name
    for member in (*StopReason, *Outcome):
        assert f"`{member.name.lower()}`" in text, member


def test_tables_of_the_studies_are_those_of_their_files(repository):
    tables = load(repository / "docs" / "studies" / "tables.py")
    seen = set()
    for page in tables.PAGES:
        text = page.read_text(encoding="utf-8")
        assert tables.filled(text) == text, f"{page.name}: run python docs/studies/tables.py"
        seen |= set(re.findall(r"<!-- table: (.+?) -->", text))
    assert seen == set(tables.TABLES)


def test_field_study_was_made_with_the_shipped_classes(repository):
    found = json.loads((repository / "docs/studies/field/results.json").read_text("utf-8"))
    table = {c.name: c for c in built_in_table().classes}
    assert set(found["classes"].values()) <= {one["class"] for one in found["parameters"]}
    for one in found["parameters"]:
        shipped = getattr(table[one["class"]], one["parameter"])
        assert shipped == pytest.approx(one["configured"], rel=1e-3)


def test_fig9_study(repository, tmp_path):
    script = repository / "docs" / "studies" / "fig9.py"
    assert run_script(script, "-o", tmp_path).code == 0
    facts = json.loads((tmp_path / "fig9.json").read_text(encoding="utf-8"))
    # The closed form is given to two decimals.
    assert facts["largest_difference_percent"] <= 0.005
    folder = script.with_suffix("")
    assert (folder / "fig9.csv").read_text("utf-8") == (tmp_path / "fig9.csv").read_text("utf-8")
    page = (script.parent / "fig9.md").read_text(encoding="utf-8")
    assert f"{facts['largest_difference_percent']:g} percentage" in page


def test_convergence_study_changes_the_constants_of_the_engine(repository, monkeypatch):
    study = load(repository / "docs" / "studies" / "convergence.py")
    for name in (name for some in study.NUMERICAL for name in some):
        file, constant = name.split(".")
        assert getattr(importlib.import_module(f"sassgis.engine.{file}"), constant) > 0.0, name
    from sassgis.engine import ground_motion, landing

    # The first assignment has the value put back at the end.
    for module in (landing, ground_motion):
        monkeypatch.setattr(module, "FIRST_TURN", landing.FIRST_TURN)
    before = landing.FIRST_TURN
    study.change_constant("landing.FIRST_TURN", 0.5)
    assert landing.FIRST_TURN == ground_motion.FIRST_TURN == 0.5 * before


def test_cutting_segments_leaves_the_ground(repository):
    import numpy as np

    slopes = load(repository / "docs" / "studies" / "slopes.py")
    whole = slopes.table_slope("bedrina", "config_before.toml").profile(0.25)
    cut = slopes.split(whole, 3)
    assert cut.s.size == 3 * (whole.s.size - 1) + 1
    assert np.allclose(np.interp(cut.s, whole.s, whole.z), cut.z, atol=1e-9)
    middle = 0.5 * (cut.s[1:] + cut.s[:-1])
    at = np.searchsorted(whole.s, middle) - 1
    assert np.array_equal(cut.ground[:-1], whole.ground[at])


def test_slope_of_a_table_keeps_its_heights(repository):
    import numpy as np

    slopes = load(repository / "docs" / "studies" / "slopes.py")
    folder = repository / "sample_dem" / "bedrina"
    given = np.genfromtxt(folder / "profile.csv", delimiter=",", names=True, usecols=(0, 1))
    flat = slopes.table_slope("bedrina", "config_before.toml").profile(0.05)
    shift = 0.5 * slopes.STRIP_CELL_M
    gap = np.interp(flat.s + shift, given["s_m"], given["z_m"]) - flat.z
    # Corners are cut off within one cell of the strip.
    assert np.abs(gap).max() < 0.15


# --- examples ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["map", "profile", pytest.param("zones", marks=pytest.mark.battery)]
)
def test_examples_run(repository, tmp_path, monkeypatch, name):
    example = tmp_path / f"{name}.py"
    example.write_text(examples(repository)[name], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    share = re.search(r"(\d+) of (\d+) blocks", run_script(example).out)
    assert share and 0 < int(share[1]) <= int(share[2])
