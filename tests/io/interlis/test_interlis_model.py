"""Models (.ili) are read as far as data for them need it."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import made_zones as made

from sassgis.io.interlis.ili_models import IliLibrary, normalised
from sassgis.io.interlis.ili_parser import read_ili, read_models
from sassgis.model.errors import InputError

ODDITIES = """
INTERLIS 2.3;
!! CLASS not_me =
/* CLASS nor_me = END nor_me; */
CONTRACTED TYPE MODEL Base_V1 (en) AT "https://example.org/a//b" VERSION "1 /* no comment */"
  // explained: CLASS neither_me = //
  TRANSLATION OF Other_V1 ["2020"] =
  IMPORTS UNQUALIFIED INTERLIS;
  UNIT Year [yr] EXTENDS INTERLIS.TIME; Degree = (PI / 180 [INTERLIS.rad]) [deg];
  FUNCTION f (a: TEXT; b: OBJECTS OF ANYCLASS): BOOLEAN;
  LINE FORM Clothoid : LineStructure;
  DOMAIN
    Colour = (red (dark: FINAL, light), green, blue: FINAL) ORDERED;
    MoreColours EXTENDS Colour = (green (grass, sea));
    Needed EXTENDS Colour = MANDATORY;
    Points = COORD 1.5e6 .. 2.5S6 [INTERLIS.m] {CHLV95[1]}, -10.25 .. +20.125, ROTATION 2 -> 1;
    Area2 = AREA WITH (STRAIGHTS, ARCS) VERTEX Points WITHOUT OVERLAPS > 0.001;
  CLASS Thing (ABSTRACT) =
    ATTRIBUTE
    Length : -1.25 .. 100.00 [Year];
    Colour (FINAL) : Colour;
    Free : TEXT;
    MANDATORY CONSTRAINT INTERLIS.len(Free) < 10 AND (Length > 5 OR NOT(DEFINED(Colour)));
    UNIQUE (LOCAL) Free : Length;
    SET CONSTRAINT f(ALL, "END");
    EXISTENCE CONSTRAINT Free REQUIRED IN Thing : Free;
  END Thing;
  ASSOCIATION =
    one -- {0..1} Thing;
    two -<> {1} Thing;
  END;
END Base_V1.

MODEL Fine_V1 (en) AT "mailto:a@b.c" VERSION "2" =
  IMPORTS Base_V1, Missing_V1;
  IMPORTS UNQUALIFIED Other_V2;
  TOPIC Root =
    BASKET OID AS INTERLIS.UUIDOID;
    OID AS INTERLIS.I32OID;
    DEPENDS ON Base_V1.X;
    DOMAIN Local = TEXT*7;
    STRUCTURE Part = p : Local; END Part;
    CLASS Item EXTENDS Base_V1.Thing =
      Colour (EXTENDED) : MANDATORY Base_V1.MoreColours;
      parts : BAG {0..1} OF Part;
      many : LIST {2..*} OF Part;
      hidden (TRANSIENT) : TEXT*3 := "x";
      sum : 0 .. 9 := Length;
      flag : BOOLEAN;
      where_ : Base_V1.Area2;
      day : INTERLIS.XMLDate;
      other : REFERENCE TO (EXTERNAL) Item;
      lost : Nowhere.Found;
    END Item;
    VIEW v PROJECTION OF Item; WHERE DEFINED (Item->flag); = ATTRIBUTE ALL OF Item; END v;
    ASSOCIATION knows = a -- {0..*} Item; b -- {0..1} Item; END knows;
  END Root;
  TOPIC Leaf EXTENDS Root =
    CLASS Item (EXTENDED) =
      Free (EXTENDED) : MANDATORY;
      last : Part;
    END Item;
  END Leaf;
END Fine_V1.
"""


@pytest.fixture
def library(tmp_path: Path) -> IliLibrary:
    (tmp_path / "odd.ILI").write_text(ODDITIES)
    (tmp_path / "other.txt").write_text("no model")
    return read_models(tmp_path)


def test_headers(library: IliLibrary) -> None:
    base, fine = library.models["Base_V1"], library.models["Fine_V1"]
    assert (base.version, base.uri) == ("1 /* no comment */", "https://example.org/a//b")
    assert base.language_version == "2.3"
    assert fine.imports == ["Base_V1", "Missing_V1", "Other_V2"]
    assert fine.unqualified == ["Other_V2"]
    assert library.missing_imports("Fine_V1") == ["Missing_V1", "Other_V2"]
    assert library.missing_imports("Base_V1") == []


def test_topics(library: IliLibrary) -> None:
    root = library.topics["Fine_V1.Root"]
    assert (root.oid, root.basket_oid) == ("INTERLIS.I32OID", "INTERLIS.UUIDOID")
    assert root.associations == ("knows",)
    assert library.topics["Fine_V1.Leaf"].base == "Root"
    assert [c.simple_name for c in library.models["Base_V1"].classes] == ["Thing"]


def test_attributes_are_inherited_in_order(library: IliLibrary) -> None:
    names = [a.name for a in library.attributes(library.classes["Fine_V1.Leaf.Item"])]
    assert names == [
        "Length", "Colour", "Free", "parts", "many", "sum", "flag", "where_", "day", "other",
        "lost", "last",
    ]  # fmt: skip


def test_types(library: IliLibrary) -> None:
    item = library.classes["Fine_V1.Leaf.Item"]
    kinds = {a.name: library.resolve(a.type, a.scope)[0] for a in library.attributes(item)}
    length = kinds["Length"]
    assert (length.low, length.high, length.decimals) == (-1.25, 100.0, 2)
    assert kinds["Colour"].mandatory
    assert kinds["Colour"].codes == ("red.dark", "red.light", "blue", "green.grass", "green.sea")
    assert kinds["Free"].kind == "text" and kinds["Free"].mandatory
    assert kinds["Free"].longest is None
    assert (kinds["parts"].target, kinds["parts"].many) == ("Fine_V1.Root.Part", False)
    assert kinds["many"].many and kinds["many"].mandatory and not kinds["parts"].mandatory
    assert kinds["last"].target == "Fine_V1.Root.Part"
    assert kinds["flag"].kind == "boolean"
    assert (kinds["sum"].kind, kinds["sum"].high) == ("number", 9.0)
    assert [kinds[n].kind for n in ("day", "other", "lost")] == ["other"] * 3
    part = library.classes["Fine_V1.Root.Part"].attributes[0]
    assert library.resolve(part.type, part.scope)[0].longest == 7
    zone = next(a for a in library.attributes(item) if a.name == "where_")
    surface, scope = library.resolve(zone.type, zone.scope)
    assert (surface.kind, surface.target, scope) == ("surface", "Points", "Base_V1")
    points = library.find_domain("Points", scope)
    assert points is not None
    assert points.type.axes == ((1.5e6, 2.5e6, 1), (-10.25, 20.125, 3))
    needed = library.find_domain("Needed", "Base_V1")
    assert needed is not None and library._domain_type(needed).mandatory
    assert library._domain_type(needed).codes[0] == "red.dark"


def test_a_name_that_goes_in_circles_ends(tmp_path: Path) -> None:
    (tmp_path / "a.ili").write_text(
        'INTERLIS 2.3; MODEL A (en) AT "x" VERSION "1" = DOMAIN B = C; C = B; D EXTENDS D = B;'
        " CLASS X EXTENDS Y = a : B; b : D; END X; CLASS Y EXTENDS X = END Y; END A."
    )
    library = read_models(tmp_path)
    kind = library.classes["A.X"]
    assert [library.resolve(a.type, a.scope)[0].kind for a in library.attributes(kind)] == [
        "other"
    ] * 2


def test_latin_1_is_read(tmp_path: Path) -> None:
    file = tmp_path / "a.ili"
    file.write_bytes(
        'INTERLIS 2.3; !! Zürich\nMODEL A AT "http://zürich" VERSION "1" = END A.'.encode("latin-1")
    )
    assert read_ili(file)[0].uri == "http://zürich"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no model of INTERLIS 2"),
        ("SCOPE; MODEL x", "no model of INTERLIS 2"),
        ('INTERLIS 2.3; MODEL A AT "x" VERSION "1" = CLASS B = c : TEXT', "ends too early"),
        ('INTERLIS 2.3;\n\nMODEL A AT "x" VERSION "1" = CLASS B = c TEXT; END B; END A.', "line 3"),
        ("INTERLIS 2.3; MODEL A = DOMAIN D = (a, (b;", "ends too early"),
        ("INTERLIS 2.3; MODEL A = DOMAIN", "ends too early"),
        ("INTERLIS 2.3; 7", "expected MODEL"),
    ],
)
def test_what_is_no_model_is_refused_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.ili").write_text(text)
    with pytest.raises(InputError, match=words) as error:
        read_models(tmp_path)
    assert "a.ili: line" in str(error.value) and "\n" not in str(error.value)


def test_folders_without_models(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no model"):
        read_models(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        read_models(tmp_path / "nowhere")


def test_the_models_of_the_tests() -> None:
    library = read_models(made.MODELS / "structured")
    area = library.classes["SassgisTest_HazardMapping_Structured_V1.Hazard_Mapping.Hazard_Area"]
    attributes = library.attributes(area)
    assert attributes[0].name == "Impact_Zone"
    zone = library.resolve(attributes[0].type, attributes[0].scope)[0]
    assert zone.target == "SassgisTest_Base_V1.MultiSurface"
    assert normalised("Hazard_Area") == normalised("hazardArea")
