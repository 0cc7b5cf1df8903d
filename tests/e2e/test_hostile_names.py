"""Files are data: whatever stands in them, results stay in their folder and nothing is run."""

from __future__ import annotations

import csv
import re
import sqlite3
import zipfile
from contextlib import closing
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from helpers.zone_slope import HOUSE, Case, box, place, two_areas

from sassgis.settings.results import file_stem, file_stems

#: Mathematics that is none, and letters that run to the left.
SIGNS = r" $\frac{$ ^_ \ $x^$ " + "\u202eedoc \u05e9\u05dc\u05d5\u05dd \u0645\u0631\u062d"
#: Names of release areas, as a file from anywhere may hold them.
NAMES = (
    "../../escape/<script>alert(1)</script>&\"'" + SIGNS,
    "'; DROP TABLE gpkg_contents; -- {{ 7*7 }} %s".ljust(1000, "n"),  # as long as they may be
)
FORMULA = '=HYPERLINK("http://example.org")' + SIGNS
TITLE = "<img src=x onerror=alert(1)> [% env('HOME') %] {{ 7*7 }}" + SIGNS
_COMPUTED = re.compile(r"\[%(.*?)%\]", re.DOTALL)


def hostile(folder: Path) -> Case:
    """Two release areas, a station, a house and a title with such names."""
    case = two_areas(folder, project={"name": TITLE})
    case.write_layer(
        "release.gpkg", [box(4.0, 20.0, 8.0, 9.0), box(5.0, 41.0, 7.0, 9.0)], {"name": NAMES}
    )
    for block in case.blocks:
        block["name"] += SIGNS
    case.expose("houses" + SIGNS, "building", {FORMULA: box(50.0, 25.0, 6.0, 20.0)}, **HOUSE)
    case.lists["stations"] = [
        {"name": FORMULA, "line": [list(place(40.0, 20.0)), list(place(40.0, 50.0))]}
    ]
    case.write()
    return case


class Tags(HTMLParser):
    """Tags and attributes of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from sassgis.runs.run import zone

    folder = tmp_path_factory.mktemp("hostile") / "deep" / "site"
    folder.mkdir(parents=True)
    case = hostile(folder)
    case.set("output.rock_table", "csv")
    before = set(folder.parents[1].rglob("*"))
    zone(case.config, folder / "out", jobs=1)
    new = set(folder.parents[1].rglob("*")) - before
    assert all(path.is_relative_to(folder / "out") for path in new)
    return folder / "out"


def test_no_cell_of_a_table_is_a_formula(made: Path) -> None:
    texts = set()
    for file in made.rglob("*.csv"):
        with file.open(encoding="utf-8", newline="") as stream:
            texts |= {cell for row in csv.reader(stream) for cell in row}
    assert "'" + FORMULA in texts
    odd = {t for t in texts if t.startswith(("=", "+", "@")) or re.match(r"-[^\d.]", t)}
    assert not odd


def test_the_report_runs_nothing(made: Path) -> None:
    page = (made / "report.html").read_text(encoding="utf-8")
    tags = Tags(page).seen
    assert not {"script", "iframe", "object", "link", "form"} & {tag for tag, _ in tags}
    assert not [a for _, attributes in tags for a in attributes if a.startswith("on")]
    sources = [attributes.get("src") or "" for tag, attributes in tags if tag == "img"]
    assert sources and all(source.startswith("data:") for source in sources)
    assert "{{ 7*7 }}" in page and "&lt;script&gt;" in page


def test_names_are_values_of_the_database(made: Path) -> None:
    with closing(sqlite3.connect(made / "result.gpkg")) as database:
        names = {row[0] for row in database.execute("SELECT name FROM release_areas")}
        assert names == set(NAMES)
        assert database.execute("SELECT count(*) FROM gpkg_contents").fetchone()[0] > 5


def test_the_project_computes_nothing_that_a_name_holds(made: Path) -> None:
    texts, variables = [], []
    for file in (*made.rglob("*.qgz"), *made.rglob("*.qml")):
        if file.suffix == ".qgz":
            with zipfile.ZipFile(file) as packed:
                assert all("/" not in n and ".." not in n for n in packed.namelist())
                content = packed.read(next(n for n in packed.namelist() if n.endswith(".qgs")))
        else:
            content = file.read_bytes()
        for element in ET.fromstring(content).iter():
            evaluated = element.tag == "LayoutItem" or element.get("name", "").startswith("legend/")
            if element.tag == "Option":
                # Labels show variables, whose values are not computed in their turn.
                variables.append(element.get("value") or "")
            if evaluated:
                texts += [element.get("labelText") or "", element.get("value") or ""]
    assert any("env(" in text for text in (*texts, *variables))
    assert not [t for t in texts if any("env" in found for found in _COMPUTED.findall(t))]


def test_folders_of_areas_stay_in_the_result(tmp_path: Path) -> None:
    """Names of areas become names of folders."""
    from sassgis.batches.batch import find_areas
    from sassgis.inputs.config import load_config

    names = [
        "..", "../../x", "/etc/passwd", "C:\\Windows", "a/b", "CON", "nul", "com1", "n" * 400,
        "n" * 401, "𝔫" * 200, "\u202eevil", "a\tb\x00c", "~root", "$HOME", "x.partial", "aux.txt",
    ]  # fmt: skip
    case = two_areas(tmp_path)
    shapes = [box(4.0 + i, 20.0, 1.0, 1.0) for i in range(len(names))]
    case.write_layer("release.gpkg", shapes, {"name": [n.replace("\x00", "") for n in names]})
    found = find_areas(load_config(case.config))
    assert len(found) == len(names)
    root = (tmp_path / "areas").resolve()
    for stem in (c.stem for c in found):
        assert (root / stem).resolve().parent == root
        (root / f"{stem}.partial").mkdir(parents=True)  # the longest that is made of it
    assert len({c.stem.casefold() for c in found}) == len(names)


@pytest.mark.parametrize("name", ["CON", "nul", "Lpt1", "com0"])
def test_names_of_devices_are_no_file_names(name: str) -> None:
    assert file_stem(name) == f"{name.lower()}_"


def test_long_names_stay_apart() -> None:
    one, two = file_stems(["ä" * 300, "ä" * 301])
    assert one != two and max(len(s.encode()) for s in (one, two)) < 200
