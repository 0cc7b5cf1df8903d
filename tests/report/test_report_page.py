from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from helpers.worked_example import HOUSE
from shapely import box

from sassgis.errors import OutputError
from sassgis.hazard.object_values import ObjectEstimate, ObjectValues
from sassgis.hazard.warnings import rule_warnings
from sassgis.inputs.presets import read_preset
from sassgis.report.figures import blocks_figure, to_png
from sassgis.report.map_report import object_lines
from sassgis.report.page import (
    ReportContext,
    ReportFigure,
    ReportTable,
    number_columns,
    render_report,
    sensible,
    translated_report,
    write_report,
)
from sassgis.report.protection_page import MOST_ROWS, exposed_table, most_exposed, with_limits
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.languages import in_language

VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Reads tags, attributes and words, and checks that every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style" and data.strip():
            self.words.append(re.sub(r"[ \n]+", " ", data).strip(" "))

    @property
    def text(self) -> str:
        return " ".join(self.words)


PNG = to_png(blocks_figure([(10, 0.2), (20, 0.1)], 0.05))
TABLE = ReportTable(
    "Stations",
    (("station", ""), ("energy, 95 %", "kJ"), ("rocks", "")),
    (("road", 812.34, 1234), ("camera 2", None, 7)),
    "Over the rocks that pass.",
)
FULL = ReportContext(
    title="Bedrina 1",
    subtitle="100 000 rocks",
    byline=("A. Author", "2026-01-31"),
    summary=(("Energy at objects", "12 kJ"),),
    what_was_run=(("Rocks", 100_000),),
    warnings=("12 rocks left the profile",),
    key_results=TABLE,
    figures=(ReportFigure("Run-out", "Where rocks end.", lambda: PNG),),
    tables=(TABLE, replace(TABLE, title="nothing", rows=())),
    provenance=(("Seed", 42),),
)


def test_warnings_stand_first_by_weight_and_the_others_are_notes() -> None:
    set_up, *_ = rule_warnings(read_preset("ch-so"), {})
    wrong = tuple(f"{n} blocks were aborted" for n in range(7))
    report = translated_report(replace(FULL, warnings=(set_up, *wrong)))
    assert report.warnings == wrong[:5] and report.notes == (set_up, *wrong[5:])
    text = Page(render_report(report)).text
    assert text.index(wrong[4]) < text.index("Notes on the set-up") < text.index(set_up)


def test_full_report_says_everything_the_answer_first_and_then_the_warnings() -> None:
    page = render_report(FULL)
    parsed = Page(page)
    text = parsed.text
    assert parsed.open == [] and parsed.tags.count("h1") == 1
    assert ("lang", "en") in parsed.attributes
    # Figures open in full without a second copy.
    assert '<figure id="figure-1">' in page and '<a href="#figure-1"' in page
    assert "figure:target img { max-width: none; }" in page
    (inside,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert base64.b64decode(inside) == PNG and page.count("base64,") == 1
    order = [
        "Bedrina 1 100 000 rocks", "A. Author · 2026-01-31", "Figure 1. Run-out.",
        "Where rocks end.", "In short", "Energy at objects 12 kJ", "Check before use",
        "12 rocks left the profile", "Contents Main results What was computed Tables Stations",
        "Over the rocks that pass.", "What was computed", "Table 1. Stations",
        "How to repeat this run",
    ]  # fmt: skip
    places = []
    for part in order:
        places.append(text.index(part, places[-1] if places else 0))
    assert "energy, 95 % kJ" in text
    assert "road 812 1\u202f234" in text
    assert "camera 2 – 7" in text
    assert "nothing" not in text


def test_empty_sections_disappear() -> None:
    text = Page(render_report(ReportContext(title="Bare"))).text
    assert text == "Bare Bare"


def test_everything_from_outside_is_escaped() -> None:
    evil = '<script>alert("x")</script> & "quoted"'
    table = ReportTable(evil, ((evil, evil),), ((evil,),), evil)
    figure, pairs = ReportFigure(evil, evil, lambda: PNG, alt=f'{evil}" onload="x'), ((evil, evil),)
    context = ReportContext(
        title=evil, subtitle=evil, byline=(evil,), summary=pairs, what_was_run=pairs,
        warnings=(evil,), key_results=table, figures=(figure,), tables=(table,), provenance=pairs,
    )  # fmt: skip
    parsed = Page(render_report(context))
    assert "script" not in parsed.tags
    assert not [name for name, _ in parsed.attributes if name.startswith("on")]
    assert parsed.text.count(evil) == 24
    assert parsed.open == []


def test_nothing_is_fetched_from_elsewhere() -> None:
    page = render_report(FULL)
    parsed = Page(page)
    assert not {"script", "link", "iframe", "object", "base", "form"} & set(parsed.tags)
    for name, value in parsed.attributes:
        if name == "href":
            assert value[1:] in [words for key, words in parsed.attributes if key == "id"]
        elif name in {"src", "srcset", "action", "poster"}:
            assert value.startswith("data:image/png;base64,")
    assert not re.search(r"https?:|//[a-z]|url\(|@import", page.split("data:image/png")[0])


def test_the_page_is_written_or_refused_in_a_line(tmp_path: Path) -> None:
    path = write_report(tmp_path / "report.html", FULL)
    assert path.read_bytes().decode("utf-8") == render_report(FULL)
    with pytest.raises(OutputError, match=r"report\.html: the report cannot be written"):
        write_report(tmp_path / "no" / "report.html", FULL)


def test_number_columns_are_told_from_words() -> None:
    with pytest.raises(OutputError, match="2 cells, the head 1 columns"):
        ReportTable("t", (("a", ""),), (("x", 1),))
    assert number_columns(TABLE) == (False, True, True)
    numpy = replace(TABLE, rows=((None, np.int64(3), np.float32(2.0)),))
    assert number_columns(numpy) == (False, True, True)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"), (float("nan"), "–"), (float("inf"), "∞"), ("as it is", "as it is"),
        (True, "yes"), (0.0, "0"), (1234567, "1\u202f234\u202f567"), (0.01234, "0.0123"),
        (4.567, "4.57"), (0.8, "0.8"), (9.996, "10"), (812.34, "812"),
        (10340.2, "10\u202f340"), (-3.14159, "\u22123.14"), (100.0, "100"),
        (2.5e-6, "2.50 × 10⁻⁶"), (np.int64(70000), "70\u202f000"),
    ],
)  # fmt: skip
def test_sensible_digits(value: object, text: str) -> None:
    assert sensible(value) == text


def test_limits_have_the_decimals_of_their_value() -> None:
    assert with_limits(4.4, 4.361, 4.44) == "4.40 (4.36 to 4.44)"
    assert with_limits(67.7, 0.0, 120.4) == "67.7 (0.0 to 120.4)"
    assert with_limits(1163.0, 1139.6, 1186.0) == "1\u202f163 (1\u202f140 to 1\u202f186)"


def test_the_page_has_the_language_of_the_program_and_leaves_names_and_sources() -> None:
    table = ReportTable("Sources", (("name", ""), ("source", "")), (("Oberwald", "high (red)"),))
    with in_language("fr"):
        page = Page(render_report(replace(FULL, tables=(table,))))
    assert ("lang", "fr") in page.attributes
    assert "En bref" in page.text and "In short" not in page.text
    assert "Oberwald high (red)" in page.text and "Bedrina 1" in page.text


def test_all_exposed_objects_are_counted_and_as_many_listed_as_a_page_can_show() -> None:
    n, reached = 100, 60
    houses = tuple(replace(HOUSE, name=f"house {k}") for k in range(n))
    values = np.where(np.arange(n) < reached, 100.0 + np.arange(n), np.nan)
    estimate = ObjectEstimate(values, values, values)
    placed = PlacedObjects(houses, (box(0.0, 0.0, 1.0, 1.0),) * n)
    exposed = exposed_table(placed, ObjectValues(estimate, estimate, estimate), {})
    ((_, words),) = object_lines(exposed)
    assert f"blocks reach {reached} of {n} objects; largest value at house {reached - 1}" in words
    listed = most_exposed(exposed)
    assert listed.rows == exposed.rows[:MOST_ROWS] and listed.note.startswith(exposed.note)
    assert f"{MOST_ROWS} of {n} are listed" in listed.note
    assert most_exposed(listed) is listed
