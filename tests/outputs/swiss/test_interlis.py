"""Transfer files follow the model, and the real validator takes the good ones and no others."""

from __future__ import annotations

import importlib.util
import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree as ET

import pyogrio
import pytest
import shapely
from helpers import made_zones as made

from sassgis.errors import ConfigError, InputError, OutputError
from sassgis.outputs.swiss.federal_model import FEDERAL_CLASSES, MODEL_NAME
from sassgis.outputs.swiss.transfer import (
    XTF_NAMESPACE,
    export_xtf,
    touching_at_corners,
    validate_xtf,
)

NS = f"{{{XTF_NAMESPACE}}}"


def objects(xtf: Path) -> list[ET.Element]:
    return [o for basket in ET.parse(xtf).getroot().find(f"{NS}DATASECTION") for o in basket]  # type: ignore[union-attr]


def edit(package: Path, statement: str) -> None:
    """Change a value as a user may do in QGIS."""
    with closing(sqlite3.connect(package)) as database, database:
        triggers = database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        ).fetchall()
        for (name,) in triggers:  # they ask for functions that plain SQLite does not have
            database.execute(f'DROP TRIGGER "{name}"')
        assert database.execute(statement).rowcount > 0


@pytest.fixture
def xtf(result: Path, tmp_path: Path) -> Path:
    """The transfer file of the result."""
    export_xtf(result, tmp_path / "a.xtf")
    return tmp_path / "a.xtf"


def test_the_validator_accepts_what_is_written_whatever_its_name(
    result: Path, tmp_path: Path, official_models: Path
) -> None:
    odd = tmp_path / "zürich; 日本 x"
    shutil.copytree(official_models, odd / "models; ü")
    xtf = odd / "zone 1; più.xtf"
    exported = export_xtf(result, xtf, odd / "models; ü", validate=True)
    assert exported.validation is not None and str(xtf) in exported.lines()[-1]
    assert exported.validation.errors == []
    assert exported.accepted and exported.validation.validator.startswith("ilivalidator 1.")
    assert list(exported.objects.values()) == [1, 5, 1, 4, 1]


def test_the_file_names_the_model_and_its_objects_as_the_model_asks(xtf: Path) -> None:
    (model,) = ET.parse(xtf).iter(f"{NS}MODEL")
    assert (model.get("NAME"), model.get("VERSION")) == ("Hazard_Mapping_LV95_V1_3", "2021-03-01")
    written = objects(xtf)
    assert len(written) == 12
    assert {o.tag.removeprefix(NS).rsplit(".", 1)[0] for o in written} == {
        "Hazard_Mapping_LV95_V1_3.hazard_mapping"
    }
    # A name of XML begins with no digit; then the canton, as the model's text has it.
    names = [o.get("TID") or "" for o in written]
    assert all(re.fullmatch(r"_[0-9a-f-]{36}\.ti\.ch", name) for name in names)
    assert len(set(names)) == 12
    corners = [c.text or "" for o in written for c in o.iter() if c.tag in (f"{NS}C1", f"{NS}C2")]
    assert corners and all(re.fullmatch(r"\d{7}\.\d{3}", text) for text in corners)


def test_values_and_surfaces_arrive_as_they_were(result: Path, xtf: Path) -> None:
    by_class: dict[str, list[ET.Element]] = {}
    for item in objects(xtf):
        by_class.setdefault(item.tag.rsplit(".", 1)[-1], []).append(item)
    for name, kind in FEDERAL_CLASSES.items():
        frame = pyogrio.read_dataframe(result / "hazard.gpkg", layer=name)
        assert len(by_class[name]) == len(frame)
        for item, (_, row) in zip(by_class[name], frame.iterrows(), strict=True):
            for attribute in kind.attributes:
                text = item.findtext(f"{NS}{attribute.name}")
                value = row[attribute.name]
                if text is None:
                    assert not attribute.required and (value != value or value is None)
                elif attribute.kind == "boolean":
                    assert text == ("true" if value else "false")
                elif attribute.kind == "number":
                    assert float(text) == pytest.approx(value, abs=5e-3)
                elif attribute.kind == "whole":
                    assert text == str(int(value))
                else:
                    assert text == value
            rings = [
                [(float(c[0].text or ""), float(c[1].text or "")) for c in ring.iter(f"{NS}COORD")]
                for ring in item.iter(f"{NS}BOUNDARY")
            ]
            polygon = shapely.Polygon(rings[0], rings[1:])
            assert polygon.equals(row.geometry)


def test_equal_results_give_equal_files_and_identifiers_follow_content(
    make_result: Callable[..., Path], tmp_path: Path
) -> None:
    package = make_result(indicative=[made.STEPS, made.STEPS]) / "hazard.gpkg"
    one, two = tmp_path / "one.xtf", tmp_path / "two.xtf"
    export_xtf(package.parent, one)
    export_xtf(package.parent, two)
    assert one.read_bytes() == two.read_bytes()
    before = [o.get("TID") for o in objects(one)]
    assert len(set(before)) == 13
    edit(package, "UPDATE hazard_area SET hazard_level = 'slight' WHERE fid = 1")
    export_xtf(package.parent, two, overwrite=True)
    after = [o.get("TID") for o in objects(two)]
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


#: What is found (a regular expression), what takes its place, what the validator says.
SPOILED: dict[str, tuple[str, str, str]] = {
    "wrong code": ("<hazard_level>mean<", "<hazard_level>medium<", "medium is not a member"),
    "broken ring": (
        f"<C1>{made.E + 40:.3f}</C1><C2>{made.N:.3f}</C2>",
        f"<C1>{made.E - 5:.3f}</C1><C2>{made.N + 30:.3f}</C2>",
        "Intersection",
    ),
    "identifier used twice": (
        r'(?s)TID="([^"]*)"(.*?)TID="[^"]*"', r'TID="\1"\2TID="\1"', "OID _"
    ),
    "half a file": ("(?s)</SURFACE>.*", "", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", SPOILED)
def test_spoiled_files_are_rejected(xtf: Path, official_models: Path, case: str) -> None:
    old, new, words = SPOILED[case]
    text = xtf.read_text()
    assert re.search(old, text)
    xtf.write_text(re.sub(old, new, text, count=1))
    verdict = validate_xtf(xtf, official_models)
    assert not verdict.valid
    assert re.search(words, " ".join(map(str, verdict.errors))), verdict.lines()
    assert "not valid" in verdict.lines()[0]


#: Begins as the model does, and holds no more.
STUB = f'INTERLIS 2.3;\nMODEL {MODEL_NAME} (en)\n AT "x" VERSION "1" =\nEND {MODEL_NAME}.\n'


def test_folders_without_the_model(result: Path, tmp_path: Path) -> None:
    folder, xtf = tmp_path / "models", tmp_path / "b.xtf"
    folder.mkdir()
    with pytest.raises(InputError, match="holds no model"):
        export_xtf(result, xtf, folder)
    (folder / "a.ILI").write_text(STUB.replace("V1_3", "V1_2"))
    with pytest.raises(InputError, match=r"missing.*V1_2.*expected.*Hazard_Mapping_LV95_V1_3"):
        export_xtf(result, xtf, folder)
    assert not xtf.exists()


def test_a_validator_that_is_missing_or_breaks_down(
    result: Path, xtf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "model.ili").write_text(STUB)
    for body, words in (
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "broke down: signal SIGSEGV"),
        ("raise OSError('no such library')", "broke down: OSError: no such library"),
        ("import sys; sys.exit(0)", "broke down: exit code 0"),
        ("import time; time.sleep(60)", "did not end within"),
    ):
        monkeypatch.setattr("sassgis.outputs.swiss.transfer._RUNNER", body)
        waited = 1.0 if "sleep" in body else 60.0
        monkeypatch.setattr("sassgis.outputs.swiss.transfer._TIMEOUT_S", waited)
        with pytest.raises(OutputError, match=words):
            validate_xtf(xtf, tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"not installed.*sassgis\[interlis\]"):
        export_xtf(result, tmp_path / "b.xtf", tmp_path)


def test_folders_that_are_no_result(result: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a result"):
        export_xtf(tmp_path / "nowhere", tmp_path / "a.xtf")
    (result / "hazard.gpkg").unlink()
    with pytest.raises(InputError, match="no hazard zones"):
        export_xtf(result, tmp_path / "a.xtf")
    (result / "hazard.gpkg").write_text("not a database")
    with pytest.raises(InputError, match="cannot be read"):
        export_xtf(result, tmp_path / "a.xtf")
    with pytest.raises(ConfigError, match="needs the files of the model"):
        export_xtf(result, tmp_path / "a.xtf", validate=True)
    assert not (tmp_path / "a.xtf").exists()


def test_files_in_the_way(result: Path, tmp_path: Path) -> None:
    xtf = tmp_path / "a.xtf"
    xtf.write_text("mine")
    for overwrite, words in ((False, "exists"), (True, "a.xtf: .*not of sassgis")):
        with pytest.raises(OutputError, match=words):
            export_xtf(result, xtf, overwrite=overwrite)
    assert xtf.read_text() == "mine"
    with pytest.raises(OutputError, match="cannot be written"):
        export_xtf(result, xtf / "b.xtf")


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE hazard_area SET hazard_level = 'blue'", "hazard_area.hazard_level.*feature 1"),
        ("UPDATE synoptic_intensity SET extreme_scenario = 1", "too frequent"),
        ("UPDATE assessment_area SET data_responsibility = NULL", "data_responsibility.*missing"),
        ("UPDATE hazard_area SET geom = NULL", "cannot be a zone.*nothing"),
        ("ALTER TABLE hazard_area DROP COLUMN sources_complete", "sources_complete.*column"),
    ],
)
def test_values_that_were_spoiled_by_hand(
    result: Path, tmp_path: Path, statement: str, words: str
) -> None:
    if statement.startswith("ALTER"):
        with closing(sqlite3.connect(result / "hazard.gpkg")) as database, database:
            database.execute(statement)
    else:
        edit(result / "hazard.gpkg", statement)
    with pytest.raises(InputError, match=words) as error:
        export_xtf(result, tmp_path / "a.xtf")
    assert "hazard.gpkg" in str(error.value)
    assert not (tmp_path / "a.xtf").exists()


def test_the_canton_may_be_given_later(make_result: Callable[..., Path], tmp_path: Path) -> None:
    folder = make_result(canton=None)
    with pytest.raises(InputError, match=r"data_responsibility.*missing"):
        export_xtf(folder, tmp_path / "a.xtf")
    with pytest.raises(ConfigError, match=r"--canton: is no code of a canton \(found Ticino"):
        export_xtf(folder, tmp_path / "a.xtf", canton="Ticino")
    export_xtf(folder, tmp_path / "a.xtf", canton="TI")
    assert (tmp_path / "a.xtf").read_text().count("<data_responsibility>TI<") == 12


def test_results_from_abroad(tmp_path: Path) -> None:
    """In other coordinates, and then in these but outside."""
    for crs, words in (("EPSG:32632", "Switzerland only"), ("EPSG:2056", "outside the extent")):
        folder = tmp_path / crs[5:]
        folder.mkdir()
        (folder / "manifest.json").write_text("{}")
        for layer in made.some_layers():
            frame = layer.frame.set_crs(crs, allow_override=True)
            frame.geometry = frame.geometry.translate(-400_000.0)
            pyogrio.write_dataframe(frame, folder / "hazard.gpkg", layer=layer.name)
        with pytest.raises(InputError, match=words):
            export_xtf(folder, tmp_path / "a.xtf")


def test_layers_that_are_missing(result: Path, tmp_path: Path) -> None:
    for layer in ("intensity_by_source", "hazard_area"):
        with closing(sqlite3.connect(result / "hazard.gpkg")) as database, database:
            for table in ("gpkg_contents", "gpkg_geometry_columns"):
                database.execute(f"DELETE FROM {table} WHERE table_name = '{layer}'")
            database.execute(f"DROP TABLE {layer}")
        if layer == "intensity_by_source":
            assert export_xtf(result, tmp_path / "a.xtf").objects[layer] == 0
    with pytest.raises(InputError, match="hazard_area: layer is missing"):
        export_xtf(result, tmp_path / "b.xtf")


def test_rings_that_touch_have_a_corner_there() -> None:
    before = shapely.get_num_coordinates(made.HOLLOW)
    outline, hole = touching_at_corners(made.HOLLOW)
    assert len(outline) + len(hole) == before + 1
    assert (made.E, made.N + 20) in outline and (made.E, made.N + 20) in hole
    assert shapely.Polygon(outline, [hole]).equals(made.HOLLOW)
    # Two on one edge, in the direction of the ring, and one that is a corner already.
    ring = [(0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (0.0, 9.0), (0.0, 0.0)]
    holes = [[(x, 0.0), (x + 0.5, 2.0), (x - 0.5, 2.0), (x, 0.0)] for x in (6.0, 3.0)]
    corner = [(9.0, 9.0), (8.0, 6.0), (7.0, 7.0), (9.0, 9.0)]
    rings = touching_at_corners(shapely.Polygon(ring, [*holes, corner]))
    assert rings[0] == [ring[0], (3.0, 0.0), (6.0, 0.0), *ring[1:]]
    assert rings[1:] == [*holes, corner]
    assert touching_at_corners(shapely.Polygon(ring)) == [ring]


def test_classes_and_codes_are_those_of_the_official_text(official_models: Path) -> None:
    text = (official_models / "Hazard_Mapping_V1_3.ili").read_text(encoding="utf-8")
    text = re.sub(r"!!.*|(?s:/\*.*?\*/)", "", text)
    text = text[: text.index(f"END {MODEL_NAME}.")]
    domains = {
        name: [code.strip() for code in codes.split(",")]
        for name, codes in re.findall(r"(\w+) \(FINAL\) =(?: MANDATORY)?\s*\(([^()]*)\);", text)
    }
    bodies = {
        name: (base, body)
        for name, base, body in re.findall(
            r"CLASS (\w+)(?: \(ABSTRACT\))?(?: EXTENDS (\w+))?\s*=(.*?)END \1;", text, re.S
        )
    }

    def attributes(name: str) -> list[tuple[str, str, str]]:
        base, body = bodies[name]
        own = re.findall(r"(\w+): (MANDATORY )?([^;]+);", body)
        return [*(attributes(base) if base else []), *own]

    for name, kind in FEDERAL_CLASSES.items():
        (zone, _, _), *official = attributes(name)
        assert zone == kind.geometry
        assert [a.name for a in kind.attributes] == [attribute for attribute, _, _ in official]
        for ours, (_, mandatory, domain) in zip(kind.attributes, official, strict=True):
            simple = domain == "assessment_simple_type"  # mandatory in itself
            assert ours.required == bool(mandatory or simple), ours.name
            assert sorted(ours.codes) == sorted(domains.get(domain, [])), ours.name
            if domain.startswith("TEXT"):
                assert domain == f"TEXT*{ours.longest}"
