"""Classes, colours and the XML made of them; that QGIS agrees is tested in tests/qgis."""

from __future__ import annotations

import math
from itertools import pairwise
from xml.etree import ElementTree as ET

import geopandas as gpd
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sassgis.files.vector_layer import VectorLayer
from sassgis.outputs.qgis.entries import qml
from sassgis.settings.results import Band, RasterLayer
from sassgis.settings.styles import (
    STOP_STYLE,
    FieldInfo,
    StyleClass,
    Symbol,
    VectorStyle,
    class_colours,
    class_labels,
    class_limits,
)

breaks_lists = st.lists(
    st.floats(0, 1e6, allow_subnormal=False).map(lambda v: float(np.float32(round(v, 3)))),
    min_size=1,
    unique=True,
).map(sorted)


def shader_items(values: list[float], breaks: tuple[float, ...], unit: str) -> list[ET.Element]:
    band = Band("a", "A", unit, np.asarray([values], np.float32))
    layer = RasterLayer("a", "A", "", (band,), breaks, "viridis")
    return list(ET.fromstring(qml(layer)).iter("item"))


def drawn(style: VectorStyle) -> ET.Element:
    frame = gpd.GeoDataFrame({style.column: []}, geometry=[])
    return ET.fromstring(qml(VectorLayer("a", "A", "", frame, style=style)))


@given(breaks_lists)
def test_classes_cover_everything_once(breaks: list[float]) -> None:
    limits = class_limits(breaks)
    assert limits[-1][1] == math.inf
    assert limits[0][0] == (0 if breaks[0] == 0 else -math.inf)
    assert all(first[1] == second[0] for first, second in pairwise(limits))
    assert len(limits) == len(class_labels(breaks, "m")) == len(class_colours(breaks, "viridis"))
    # Zero as the first break leaves out the palest colour.
    higher = [b + 1.0 for b in breaks]
    assert class_colours(breaks, "Blues") == class_colours(higher, "Blues")[-len(limits) :]


@given(breaks_lists, st.floats(0, 2e6, width=32))
def test_the_map_shows_the_class_that_the_legend_says(breaks: list[float], value: float) -> None:
    """QGIS colours a cell by the first item whose value is not below it."""
    cell = np.float32(value)
    items = shader_items([value], tuple(breaks), "kJ")
    shown = next(i for i, item in enumerate(items) if cell <= float(item.get("value", "nan")))
    low, high = class_limits(breaks)[shown]
    assert low <= cell < high


def test_labels() -> None:
    assert class_labels((30, 300), "kJ") == ["< 30 kJ", "30 – 300 kJ", "≥ 300 kJ"]
    assert class_labels((0, 0.5), "1") == ["0 – 0.5", "≥ 0.5"]


@pytest.mark.parametrize("breaks", [(), (2.0, 1.0), (1.0, 1.0), (math.nan, 1.0)])
def test_breaks_must_ascend(breaks: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="ascend"):
        class_limits(breaks)


def test_a_ramp_over_the_range_of_the_data() -> None:
    items = shader_items([0.0, 2.0, 12.0, math.nan], (), "kJ")
    assert (items[0].get("value"), items[-1].get("value")) == ("2.0", "12.0")
    assert items[-1].get("label") == "12 kJ"
    alike = shader_items([4.0, 4.0], (), "kJ")
    assert (alike[0].get("value"), alike[-1].get("value")) == ("4.0", "8.0")


@pytest.mark.parametrize(("unit", "transparent"), [("kJ", True), ("m", False)])
def test_zero_is_transparent_where_it_means_nothing(unit: str, transparent: bool) -> None:
    band = Band("a", "A", unit, np.ones((2, 2), np.float32))
    pipe = ET.fromstring(qml(RasterLayer("a", "A", "", (band,), (), "viridis")))
    assert (pipe.find(".//pixelListEntry") is not None) is transparent


def test_ranges_are_listed_from_the_highest() -> None:
    symbol = Symbol("line", "#000000")
    classes = (StyleClass("low", symbol, upper=30), StyleClass("high", symbol, lower=30))
    renderer = drawn(VectorStyle(symbol, "ranges", "e", classes))
    assert [entry.get("label") for entry in renderer.iter("range")] == ["high", "low"]
    assert [entry.get("symbol") for entry in renderer.iter("range")] == ["1", "0"]


def test_a_style_must_hang_together() -> None:
    fill = StyleClass("a", Symbol("fill", "#000000"), value="a")
    with pytest.raises(ValueError, match="one kind"):
        VectorStyle(STOP_STYLE.symbol, "categories", "a", (fill,))
    with pytest.raises(ValueError, match="needed"):
        VectorStyle(STOP_STYLE.symbol, "categories", "a")
    with pytest.raises(ValueError, match="column"):
        VectorStyle(fill.symbol, "categories", "", (fill,))


def test_text_is_escaped() -> None:
    symbol = Symbol("fill", "#ff0000", outline="#00ff00", hatch="diagonal")
    style = VectorStyle(
        symbol, "categories", "a<b", (StyleClass("<&>\"'\x07\n.", symbol, value="ü"),)
    )
    entry = drawn(style).find(".//category")
    assert entry is not None
    assert (entry.get("label"), entry.get("value")) == ("<&>\"'\n.", "ü")
    assert FieldInfo("Height", "m").label == "Height (m)"
