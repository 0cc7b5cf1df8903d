"""Transfer files follow the model, and the real validator takes the good ones and no others."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree as ET

import geopandas as gpd
import pyogrio
import pytest
import shapely
from helpers import made_zones as made
from shapely.geometry import box

from sassgis.io.interlis.ili_parser import read_models
from sassgis.io.interlis.transfer import export_xtf, write_xtf
from sassgis.io.interlis.validation import XTF_NAMESPACE, check_xtf, validate_xtf
from sassgis.io.interlis.xtf_document import touching_at_corners
from sassgis.io.write.geopackage import write_geopackage
from sassgis.io.write.layers.federal import (
    hazard_area,
)
from sassgis.io.write.layers.federal_model import (
    FEDERAL_CLASSES,
)
from sassgis.model.errors import ConfigError, InputError, OutputError

SIMPLE, STRUCTURED = made.MODELS / "simple", made.MODELS / "structured"
NS = f"{{{XTF_NAMESPACE}}}"
needs_validator = pytest.mark.skipif(
    importlib.util.find_spec("ilivalidator") is None,
    reason="ilivalidator is not installed (there is none for this machine, or not the extra)",
)


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


# --- what is written -------------------------------------------------------------------------


@needs_validator
@pytest.mark.parametrize("models", [SIMPLE, STRUCTURED], ids=["simple", "structured"])
def test_the_validator_accepts_what_is_written(result: Path, tmp_path: Path, models: Path) -> None:
    exported = export_xtf(result, tmp_path / "zones.xtf", models, validate=True)
    assert exported.validation is not None
    assert exported.validation.errors == []
    assert exported.accepted and exported.validation.validator.startswith("ilivalidator 1.")
    assert dict(exported.summary.objects) == {
        "assessment_area": 1,
        "synoptic_intensity": 5,
        "intensity_by_source": 1,
        "hazard_area": 4,
        "indicative_hazard_area": 1,
    }
    assert exported.summary.from_model
    assert any("_State_Another" in n or "_state_another" in n for n in exported.summary.notes)


@pytest.mark.parametrize("models", [SIMPLE, STRUCTURED], ids=["simple", "structured"])
def test_attributes_come_in_the_order_of_the_model(
    result: Path, tmp_path: Path, models: Path
) -> None:
    library = read_models(models)
    write_xtf(result / "hazard.gpkg", tmp_path / "zones.xtf", model_folder=models)
    written = objects(tmp_path / "zones.xtf")
    assert len(written) == 12
    for item in written:
        order = [a.name for a in library.attributes(library.classes[item.tag.removeprefix(NS)])]
        found = [child.tag.removeprefix(NS) for child in item]
        assert found == [name for name in order if name in found]
        assert len(found) >= 4


def test_values_and_surfaces_arrive_as_they_were(result: Path, tmp_path: Path) -> None:
    package = result / "hazard.gpkg"
    write_xtf(package, tmp_path / "zones.xtf", model_folder=SIMPLE)
    by_class: dict[str, list[ET.Element]] = {}
    for item in objects(tmp_path / "zones.xtf"):
        by_class.setdefault(item.tag.rsplit(".", 1)[-1], []).append(item)
    for name, kind in FEDERAL_CLASSES.items():
        frame = pyogrio.read_dataframe(package, layer=name)
        assert len(by_class[name]) == len(frame)
        for item, (_, row) in zip(by_class[name], frame.iterrows(), strict=True):
            for attribute in kind.attributes:
                text = item.findtext(f"{NS}{attribute.name}")
                value = row[attribute.name]
                if text is None:
                    # Names of states that the model of the tests does not have.
                    assert value != value or value is None or not attribute.verified
                elif attribute.kind == "boolean":
                    assert text == ("true" if value else "false")
                elif attribute.kind == "number":
                    assert float(text) == pytest.approx(value, abs=5e-4)
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
    package = make_result() / "hazard.gpkg"
    one, two = tmp_path / "one.xtf", tmp_path / "two.xtf"
    write_xtf(package, one, model_folder=SIMPLE)
    write_xtf(package, two, model_folder=SIMPLE)
    assert one.read_bytes() == two.read_bytes()
    before = [o.get("TID") for o in objects(one)]
    assert len(set(before)) == 12
    edit(package, "UPDATE hazard_area SET hazard_level = 'slight' WHERE fid = 1")
    write_xtf(package, two, model_folder=SIMPLE, overwrite=True)
    after = [o.get("TID") for o in objects(two)]
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


def test_equal_zones_have_identifiers_of_their_own(
    make_result: Callable[..., Path], tmp_path: Path
) -> None:
    package = make_result(indicative=[made.STEPS, made.STEPS]) / "hazard.gpkg"
    write_xtf(package, tmp_path / "a.xtf", model_folder=SIMPLE)
    assert len({o.get("TID") for o in objects(tmp_path / "a.xtf")}) == 13


def with_multipart(package: Path) -> None:
    """A multipart zone, as a merge in QGIS leaves it."""
    frame = pyogrio.read_dataframe(package, layer="hazard_area")
    frame = gpd.GeoDataFrame(
        frame.iloc[:1].drop(columns="geometry"), geometry=[made.PARTS], crs=frame.crs
    )
    pyogrio.write_dataframe(frame, package, layer="hazard_area", driver="GPKG", append=True)


@needs_validator
@pytest.mark.parametrize(("models", "more"), [(SIMPLE, 2), (STRUCTURED, 1)])
def test_multipart_zones(result: Path, tmp_path: Path, models: Path, more: int) -> None:
    with_multipart(result / "hazard.gpkg")
    exported = export_xtf(result, tmp_path / "a.xtf", models, validate=True)
    assert exported.summary.objects["hazard_area"] == 4 + more
    assert exported.accepted, exported.lines()


@needs_validator
def test_texts_go_into_structures_with_their_language(result: Path, tmp_path: Path) -> None:
    for language, wanted in (("it", "it"), ("nl", None)):
        write_xtf(
            result / "hazard.gpkg",
            tmp_path / "a.xtf",
            model_folder=STRUCTURED,
            language=language,
            overwrite=True,
        )
        assert validate_xtf(tmp_path / "a.xtf", STRUCTURED).valid
        (text,) = ET.parse(tmp_path / "a.xtf").iter(f"{NS}SassgisTest_Base_V1.LocalisedText")
        assert text.findtext(f"{NS}Language") == wanted
        assert text.findtext(f"{NS}Text") == 'Only "rockfall" <here>'


def test_without_models_names_are_called_unverified(result: Path, tmp_path: Path) -> None:
    summary = write_xtf(result / "hazard.gpkg", tmp_path / "a.xtf", model_folder=None)
    assert not summary.from_model and "unverified" in " ".join(summary.lines())
    text = (tmp_path / "a.xtf").read_text()
    assert "unverified" in text.split("</HEADERSECTION>")[0]
    assert check_xtf(tmp_path / "a.xtf") == []
    assert len(objects(tmp_path / "a.xtf")) == 12


def test_an_empty_result_gives_a_file_without_objects(tmp_path: Path) -> None:
    layers = [
        gpd.GeoDataFrame(layer.frame.iloc[:0], crs="EPSG:2056") for layer in made.some_layers()
    ]
    for layer, frame in zip(made.some_layers(), layers, strict=True):
        pyogrio.write_dataframe(
            frame, tmp_path / "h.gpkg", layer=layer.name, geometry_type="MultiPolygon"
        )
    summary = write_xtf(tmp_path / "h.gpkg", tmp_path / "a.xtf", model_folder=SIMPLE)
    assert set(summary.objects.values()) == {0}


# --- the validator refuses what is wrong -----------------------------------------------------

SPOILED: dict[str, tuple[str, str, str]] = {
    "wrong code": ("<hazard_level>mean<", "<hazard_level>medium<", "medium is not a member"),
    "missing attribute": (
        "<main_process>rockfall</main_process>\n",
        "",
        "main_process requires a value",
    ),
    "missing period": (
        "<return_period_in_years>300</return_period_in_years>\n",
        "",
        "Mandatory Constraint",
    ),
    "frequent extreme": (
        "<return_period_in_years>300</return_period_in_years>\n<extreme_scenario>false<",
        "<return_period_in_years>300</return_period_in_years>\n<extreme_scenario>true<",
        "Mandatory Constraint",
    ),
    "period out of range": ("_years>30</", "_years>10001</", "out of range"),
    "broken ring": (
        f"<COORD><C1>{made.E + 40:.3f}</C1><C2>{made.N:.3f}</C2></COORD>\n",
        f"<COORD><C1>{made.E - 5:.3f}</C1><C2>{made.N + 30:.3f}</C2></COORD>\n",
        "ntersection|overlay|valid",
    ),
    "outside the extent": (f"<C1>{made.E + 60:.3f}<", "<C1>2870001.000<", "out of range"),
    "unknown attribute": (
        "<main_process>",
        "<chief_process>x</chief_process><main_process>",
        "chief_process",
    ),
    "text too long": (
        "<process_cantonal_term>",
        "<process_cantonal_term>" + 50 * "x",
        "length restricted to 50",
    ),
}


@needs_validator
@pytest.mark.parametrize("case", SPOILED)
def test_spoiled_files_are_rejected(result: Path, tmp_path: Path, case: str) -> None:
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=SIMPLE)
    assert validate_xtf(xtf, SIMPLE).valid
    old, new, words = SPOILED[case]
    text = xtf.read_text()
    assert old in text
    xtf.write_text(text.replace(old, new, 1))
    verdict = validate_xtf(xtf, SIMPLE)
    assert not verdict.valid
    assert re.search(words, " ".join(map(str, verdict.errors))), verdict.lines()
    assert "not valid" in verdict.lines()[0]


@needs_validator
def test_an_open_ring_is_rejected(result: Path, tmp_path: Path) -> None:
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=SIMPLE)
    text = re.sub(r"<COORD>.*</COORD>\n</POLYLINE>", "</POLYLINE>", xtf.read_text(), count=1)
    xtf.write_text(text)
    assert not validate_xtf(xtf, SIMPLE).valid
    assert any("not closed" in problem for problem in check_xtf(xtf))


@needs_validator
def test_a_broken_file_is_refused(result: Path, tmp_path: Path) -> None:
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=SIMPLE)
    whole = xtf.read_text()
    xtf.write_text(whole[: len(whole) // 2])
    verdict = validate_xtf(xtf, SIMPLE)
    assert not verdict.valid and verdict.errors
    for text in ("", "hello", "<a/>"):
        xtf.write_text(text)
        with pytest.raises(InputError, match="no INTERLIS transfer file"):
            validate_xtf(xtf, SIMPLE)
    with pytest.raises(InputError, match="cannot be read"):
        validate_xtf(tmp_path / "nothing.xtf", SIMPLE)


@needs_validator
def test_names_of_files_may_be_anything(result: Path, tmp_path: Path) -> None:
    odd = tmp_path / "zürich; 日本 x"
    shutil.copytree(STRUCTURED, odd / "models; ü")
    xtf = odd / "zone 1; più.xtf"
    exported = export_xtf(result, xtf, odd / "models; ü", validate=True)
    assert exported.accepted and str(xtf) in exported.lines()[-1]


@needs_validator
def test_absent_and_broken_models(result: Path, tmp_path: Path) -> None:
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=STRUCTURED)
    with pytest.raises(InputError, match=r"missing.*SassgisTest_HazardMapping_Structured_V1"):
        validate_xtf(xtf, SIMPLE)
    folder = tmp_path / "models"
    folder.mkdir()
    main = folder / "SassgisTest_HazardMapping_Structured_V1.ili"
    shutil.copyfile(STRUCTURED / main.name, main)
    for act in (
        lambda: validate_xtf(xtf, folder),
        lambda: write_xtf(result / "hazard.gpkg", tmp_path / "b.xtf", model_folder=folder),
    ):
        with pytest.raises(InputError, match="SassgisTest_Base_V1"):
            act()
    shutil.copyfile(STRUCTURED / "SassgisTest_Base_V1.ili", folder / "SassgisTest_Base_V1.ili")
    main.write_text(main.read_text().replace("DEFINED(", "DEFINITELY("))
    verdict = validate_xtf(xtf, folder)  # reads well enough for us, but does not compile
    assert not verdict.valid and str(main) in str(verdict.errors[0])


def test_a_validator_that_is_missing_or_breaks_down(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=SIMPLE)
    for body, words in (
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "broke down: signal SIGSEGV"),
        ("raise OSError('no such library')", "broke down: OSError: no such library"),
        ("import sys; sys.exit(0)", "broke down: exit code 0"),
        ("import time; time.sleep(60)", "did not end within"),
    ):
        monkeypatch.setattr("sassgis.io.interlis.validation._RUNNER", body)
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
        with pytest.raises(OutputError, match=words):
            validate_xtf(xtf, SIMPLE, timeout_s=3.0 if "sleep" in body else 60.0)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"not installed.*sassgis\[interlis\]"):
        validate_xtf(xtf, SIMPLE)


# --- what cannot be exported -----------------------------------------------------------------


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
    with pytest.raises(OutputError, match="exists"):
        export_xtf(result, xtf)
    assert xtf.read_text() == "mine"
    export_xtf(result, xtf, overwrite=True)
    assert len(objects(xtf)) == 12
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        export_xtf(result, tmp_path / "folder", overwrite=True)
    with pytest.raises(OutputError, match="cannot be written"):
        export_xtf(result, xtf / "b.xtf")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.xtf", "folder", "result"]


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE hazard_area SET hazard_level = 'blue'", "hazard_area.hazard_level.*feature 1"),
        ("UPDATE hazard_area SET hazard_level = NULL", "value is missing"),
        ("UPDATE synoptic_intensity SET return_period_in_years = NULL", "return_period_in_years"),
        ("UPDATE synoptic_intensity SET extreme_scenario = 1", "too frequent"),
        ("UPDATE synoptic_intensity SET return_period_in_years = 0", "1 to 10000"),
        ("UPDATE intensity_by_source SET process_source = ''", "process_source.*missing"),
        ("UPDATE assessment_area SET data_responsibility = NULL", "data_responsibility.*missing"),
        ("UPDATE assessment_area SET rf_state_rock_fall = 'x'", "rf_state_rock_fall"),
        ("UPDATE hazard_area SET geom = NULL", "cannot be a zone.*nothing"),
        ("ALTER TABLE hazard_area DROP COLUMN sources_complete", "sources_complete.*column"),
    ],
)
@pytest.mark.parametrize("models", [None, SIMPLE], ids=["default", "model"])
def test_values_that_were_spoiled_by_hand(
    result: Path, tmp_path: Path, statement: str, words: str, models: Path | None
) -> None:
    if statement.startswith("ALTER"):
        with closing(sqlite3.connect(result / "hazard.gpkg")) as database, database:
            database.execute(statement)
    else:
        edit(result / "hazard.gpkg", statement)
    with pytest.raises(InputError, match=words) as error:
        export_xtf(result, tmp_path / "a.xtf", models)
    assert "hazard.gpkg" in str(error.value)
    assert not (tmp_path / "a.xtf").exists()


def test_a_code_that_only_the_model_knows(result: Path, tmp_path: Path) -> None:
    edit(result / "hazard.gpkg", "UPDATE assessment_area SET rf_state_rock_fall = 'to_be_assessed'")
    write_xtf(result / "hazard.gpkg", tmp_path / "a.xtf", model_folder=SIMPLE)
    with pytest.raises(InputError, match="rf_state_rock_fall"):
        write_xtf(result / "hazard.gpkg", tmp_path / "b.xtf", model_folder=None)


def test_the_canton_may_be_given_later(make_result: Callable[..., Path], tmp_path: Path) -> None:
    folder = make_result(canton=None)
    with pytest.raises(InputError, match=r"data_responsibility.*missing"):
        export_xtf(folder, tmp_path / "a.xtf", SIMPLE)
    with pytest.raises(InputError, match="data_responsibility"):
        export_xtf(folder, tmp_path / "a.xtf", SIMPLE, canton="Ticino")
    export_xtf(folder, tmp_path / "a.xtf", SIMPLE, canton="TI")
    assert "<data_responsibility>TI<" in (tmp_path / "a.xtf").read_text()


def test_results_from_abroad(tmp_path: Path) -> None:
    zone = box(680_000, 5_150_000, 680_100, 5_150_100)
    for crs in ("EPSG:32632", None):
        folder = tmp_path / str(crs)[-5:]
        folder.mkdir()
        (folder / "manifest.json").write_text("{}")
        write_geopackage(
            folder / "hazard.gpkg", [hazard_area([zone], ["mean"], crs=crs, federal=False)]
        )
        with pytest.raises(InputError, match=r"layer is missing|Switzerland only"):
            export_xtf(folder, tmp_path / "a.xtf")
    # All five layers, but in other coordinates, and then in these but outside.
    for crs, words in (("EPSG:32632", "Switzerland only"), ("EPSG:2056", "outside the extent")):
        package = tmp_path / f"{crs[5:]}.gpkg"
        for layer in made.some_layers():
            frame = layer.frame.set_crs(crs, allow_override=True)
            frame.geometry = frame.geometry.translate(-400_000.0)
            pyogrio.write_dataframe(frame, package, layer=layer.name)
        with pytest.raises(InputError, match=words):
            write_xtf(package, tmp_path / "a.xtf", model_folder=None)


def test_a_layer_that_is_missing(result: Path, tmp_path: Path) -> None:
    with closing(sqlite3.connect(result / "hazard.gpkg")) as database, database:
        for table in ("gpkg_contents", "gpkg_geometry_columns"):
            database.execute(f"DELETE FROM {table} WHERE table_name = 'intensity_by_source'")
        database.execute("DROP TABLE intensity_by_source")
    with pytest.raises(InputError, match="intensity_by_source: layer is missing"):
        export_xtf(result, tmp_path / "a.xtf")


MISFITS: dict[str, tuple[str, str, str]] = {
    "other version": ("INTERLIS 2.3;", "INTERLIS 2.4;", "INTERLIS 2.4"),
    "other coordinates": (
        "COORD 2460000.000 .. 2870000.000 [INTERLIS.m],\n"
        "                   1045000.000 .. 1310000.000",
        "COORD 460000.000 .. 870000.000 [INTERLIS.m],\n                   45000.000 .. 310000.000",
        "other coordinates",
    ),
    "no class": ("hazard_area =\n      impact", "danger_area =\n      impact", "no class for"),
    "mandatory extra": (
        "main_process : MANDATORY Process;",
        "main_process : MANDATORY Process; basin : MANDATORY TEXT*5;",
        "basin: attribute is mandatory, but has no counterpart",
    ),
    "other type": (
        "main_process : MANDATORY Process;",
        "main_process : MANDATORY FORMAT INTERLIS.XMLDate '1' .. '2';",
        "main_process: attribute is mandatory, but of a type",
    ),
    "other code": (
        "(not_indicated, indicated)",
        "(no, yes)",
        "found indicated; expected one of no",
    ),
    "no surface": ("impact_zone : MANDATORY Zone", "impact_zone : MANDATORY TEXT", "no surface"),
    "official identifiers": (
        "TOPIC hazard_mapping =",
        "TOPIC hazard_mapping = OID AS INTERLIS.STANDARDOID;",
        "STANDARDOID",
    ),
}


@pytest.mark.parametrize("case", MISFITS)
def test_models_that_do_not_fit(result: Path, tmp_path: Path, case: str) -> None:
    text = next(SIMPLE.iterdir()).read_text()
    old, new, words = MISFITS[case]
    if case == "no class":
        text = text.replace("END hazard_area", "END danger_area")
        old, new = "CLASS hazard_area", "CLASS danger_area"
    assert old in text
    (tmp_path / "m.ili").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words) as error:
        write_xtf(result / "hazard.gpkg", tmp_path / "a.xtf", model_folder=tmp_path)
    assert "\n" not in str(error.value) and not (tmp_path / "a.xtf").exists()


def test_what_the_model_lacks_is_told(result: Path, tmp_path: Path) -> None:
    text = next(SIMPLE.iterdir()).read_text()
    text = text.replace("process_cantonal_term : MANDATORY TEXT*50;", "")
    text = text.replace("      comments : TEXT*1000;\n", "      remarks : TEXT;\n")
    text = text.replace("impact_zone : MANDATORY Zone", "surface : MANDATORY Zone")
    text = text.replace(
        "  END hazard_mapping;",
        "    ASSOCIATION of_area = a -- {0..*} hazard_area; b -- {0..1} assessment_area;\n"
        "    END of_area;\n  END hazard_mapping;",
    )
    (tmp_path / "m.ili").write_text(text)
    summary = write_xtf(result / "hazard.gpkg", tmp_path / "a.xtf", model_folder=tmp_path)
    told = " ".join(summary.notes)
    for words in (
        "synoptic_intensity.process_cantonal_term is left out",
        "assessment_area.comments is left out",
        "assessment_area.remarks of the model: left empty",
        "the zone is written as surface",
        "Associations of SassgisTest_HazardMapping_V1.hazard_mapping are not written: of_area",
    ):
        assert words in told
    if importlib.util.find_spec("ilivalidator"):
        assert validate_xtf(tmp_path / "a.xtf", tmp_path).valid


@needs_validator
def test_numbers_as_identifiers(result: Path, tmp_path: Path) -> None:
    text = next(SIMPLE.iterdir()).read_text()
    text = text.replace("hazard_mapping =\n", "hazard_mapping =\n  OID AS INTERLIS.I32OID;\n", 1)
    (tmp_path / "m.ili").write_text(text)
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=tmp_path)
    assert [o.get("TID") for o in objects(xtf)] == [str(n) for n in range(1, 13)]
    assert validate_xtf(xtf, tmp_path).valid


def test_of_several_models_the_fitting_one_is_taken(result: Path, tmp_path: Path) -> None:
    text = next(SIMPLE.iterdir()).read_text()
    name = "SassgisTest_HazardMapping_V1"
    old, new = name.replace("_V1", "_V1_2"), name.replace("_V1", "_V1_3")
    (tmp_path / "a.ili").write_text(text.replace(name, old))
    (tmp_path / "b.ili").write_text(text.replace(name, new))
    summary = write_xtf(result / "hazard.gpkg", tmp_path / "a.xtf", model_folder=tmp_path)
    assert summary.model == new
    (tmp_path / "b.ili").write_text(text.replace(name, name.replace("_V1", "_V1_1")))
    with pytest.raises(InputError, match="several models fit"):
        write_xtf(result / "hazard.gpkg", tmp_path / "b.xtf", model_folder=tmp_path)
    (tmp_path / "a.ili").write_text('INTERLIS 2.3; MODEL A AT "x" VERSION "1" = END A.')
    (tmp_path / "b.ili").unlink()
    with pytest.raises(InputError, match="no model here has the classes"):
        write_xtf(result / "hazard.gpkg", tmp_path / "b.xtf", model_folder=tmp_path)


# --- structure without a model ---------------------------------------------------------------

BROKEN: dict[str, tuple[str, str, str]] = {
    "other root": ("TRANSFER xmlns", "TRANSFER xmlnss", "root is"),
    "same identifier": ("", "", "identifier of its own"),
    "no basket identifier": (" BID=", " BIT=", "no identifier"),
    "other model": ('NAME="', 'NAME="X', "no topic of a model in the header"),
    "too fine": (".000</C1>", ".0001</C1>", "finer than 1 mm"),
    "no number": (".000</C1>", ".00x</C1>", "no numbers"),
    "an arc": ("<COORD>", "<ARC></ARC><COORD>", "ARC in place of a corner"),
    "outside": (f"<C1>{made.E + 60:.3f}<", "<C1>2870001.000<", "outside the extent"),
    "crossed": (*SPOILED["broken ring"][:2], "Self-intersection|Hole lies outside"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_structure_is_checked_without_a_model(result: Path, tmp_path: Path, case: str) -> None:
    xtf = tmp_path / "a.xtf"
    write_xtf(result / "hazard.gpkg", xtf, model_folder=None)
    old, new, words = BROKEN[case]
    text = xtf.read_text()
    if case == "same identifier":
        text = re.sub(r'TID="[^"]*"', 'TID="1"', text)
    else:
        assert old in text
        text = text.replace(old, new, 1)
    xtf.write_text(text)
    assert re.search(words, " ".join(check_xtf(xtf)))


def test_files_that_are_no_xml(tmp_path: Path) -> None:
    (tmp_path / "a.xtf").write_text("hello")
    with pytest.raises(InputError, match="no INTERLIS transfer file"):
        check_xtf(tmp_path / "a.xtf")
    with pytest.raises(InputError, match="cannot be read"):
        check_xtf(tmp_path / "b.xtf")


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


# --- the model itself ------------------------------------------------------------------------


@needs_validator
def test_the_official_model(make_result: Callable[..., Path], tmp_path: Path) -> None:
    folder = os.environ.get("SASSGIS_ILI_MODELS")
    if not folder or not Path(folder).is_dir():
        pytest.skip(
            "the official model files are absent: set SASSGIS_ILI_MODELS to a folder with the "
            ".ili files of the federal model 166.1, version 1.3, and of all that it imports"
        )
    # The codes of hazard_indication are not known here: that layer stays empty.
    result = make_result(indicative=[])
    exported = export_xtf(result, tmp_path / "a.xtf", Path(folder), validate=True)
    assert exported.accepted, "\n".join(exported.lines())
