from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from helpers.figure_parts import axes_of, find, texts
from matplotlib.colors import to_hex, to_rgb

from sassgis.grid import Grid
from sassgis.hazard.curves import rate_interval
from sassgis.hazard.levels import LEVEL_CHANGES
from sassgis.inputs.presets import read_preset
from sassgis.report import figures
from sassgis.report.figures.hazard_figures import MAX_SOURCES, amount, leading_sources
from sassgis.settings.hazard_rules import HazardCurves
from sassgis.settings.languages import in_language
from sassgis.settings.results import Band, RasterClass, RasterLayer

LEVELS = (
    RasterClass(1, "residuo", "#ffe34d", hatched=True),
    RasterClass(2, "basso", "#ffe34d"),
    RasterClass(4, "elevato", "#d7262b"),
)


def level_of(grid: Grid) -> RasterLayer:
    values = np.full(grid.shape, np.nan, np.float32)
    values[8:24, 20:30] = 1.0
    values[10:20, 20:30] = 2.0
    values[12:18, 22:28] = 4.0
    return RasterLayer(
        "hazard_level", "Hazard level", "By the matrix.", (Band("level", "", "class", values),),
        (), "", LEVELS,
    )  # fmt: skip


def classes_in(figure) -> list[str]:
    """Names of the signs in the legends."""
    (first, *_) = axes_of(figure, "map")
    legends = [*([first.get_legend()] if first.get_legend() else []), *figure.legends]
    return [text.get_text() for legend in legends for text in legend.get_texts()]


def classes_on(ax) -> np.ndarray:
    (image,) = [i for i in ax.get_images() if i.get_gid() == "layer"]
    return np.ma.filled(image.get_array().astype(float), np.nan)


def test_a_map_of_classes_has_their_colours_and_names(valley: Grid) -> None:
    figure = figures.map_figure(valley, level_of(valley))
    (image,) = find(figure, "layer")
    values = classes_on(axes_of(figure, "map")[0])
    assert [np.count_nonzero(values == k) for k in (0, 1, 2)] == [60, 64, 36]
    # A hatched class is striped on white.
    colours = [to_hex(image.cmap(image.norm(k))) for k in range(3)]
    assert colours == ["#ffffff", "#ffe34d", "#d7262b"]
    assert classes_in(figure) == ["elevato", "basso", "residuo"]
    words = texts(figure)
    assert "Hazard level" in words and "By the matrix." not in words
    assert "class |" not in words


def test_translated_names_of_classes_have_room(valley: Grid) -> None:
    layer = replace(level_of(valley), classes=(replace(LEVELS[0], label="residual"),))
    with in_language("de"):
        figure = figures.map_figure(valley, layer)
        figure.canvas.draw()
    (name,) = axes_of(figure, "map")[0].get_legend().get_texts()
    assert name.get_text() == "Restgefährdung"
    assert name.get_window_extent().x1 < figure.bbox.x1


def test_stripes_lie_on_the_hatched_cells_alone(valley: Grid) -> None:
    figure = figures.map_figure(valley, level_of(valley))
    (stripes,) = find(figure, "stripes")
    assert stripes.get_hatch() and to_hex(stripes.get_edgecolor()) == "#ffe34d"
    # All cells of the class, and no others.
    hatched = np.isclose(level_of(valley).bands[0].values, 1.0)
    rows, cols = np.indices(valley.shape).reshape(2, -1)
    centres = np.column_stack([valley.west + 5.0 * (cols + 0.5), valley.north - 5.0 * (rows + 0.5)])
    inside = stripes.get_path().contains_points(centres).reshape(valley.shape)
    np.testing.assert_array_equal(inside, hatched)


def test_zones_are_drawn_in_place_of_cells(valley: Grid) -> None:
    ring = np.array([[100.0, -50.0], [150.0, -50.0], [150.0, -90.0]])
    ring += [valley.west, valley.north]
    marks = figures.MapMarks(zones=[(shapely.Polygon(ring), LEVELS[0])])
    (zone,) = find(figures.map_figure(valley, level_of(valley), marks), "zone")
    np.testing.assert_allclose(sorted(zone.get_path().vertices[:3].tolist()), sorted(ring.tolist()))


def test_intensities_side_by_side(valley: Grid) -> None:
    first = level_of(valley)
    rare = np.where(np.isfinite(first.bands[0].values), 4.0, np.nan).astype(np.float32)
    second = replace(
        first, stem="b", title="Extreme", bands=(replace(first.bands[0], values=rare),)
    )
    ring = np.array([[80.0, -10.0], [110.0, -10.0], [110.0, -30.0]])
    ring += [valley.west, valley.north]
    figure = figures.intensity_figure(valley, [first, second], figures.MapMarks([ring]))
    one, two = axes_of(figure, "map")
    assert (one.get_xlim(), one.get_ylim()) == (two.get_xlim(), two.get_ylim())
    assert np.nanmax(classes_on(one)) == 2.0 and np.nanmin(classes_on(one)) == 0.0
    assert set(np.unique(classes_on(two)[np.isfinite(classes_on(two))])) == {2.0}
    assert [ax.get_title(loc="left") for ax in (one, two)] == ["Hazard level", "Extreme"]
    assert classes_in(figure) == ["elevato", "basso", "residuo"]
    assert len(find(figure, "release-areas")) == 2
    assert len(find(figure, "scale")) == 1
    words = texts(figure)
    assert "release area" in words


def test_the_scale_bar_has_the_scale_of_the_maps(valley: Grid) -> None:
    figure = figures.intensity_figure(valley, [level_of(valley)] * 2, figures.MapMarks())
    figure.canvas.draw()
    (label,) = find(figure, "scale")
    ax = axes_of(figure, "map")[0]
    # Below the map at its left, where a narrow screen shows it whole, and in front of nothing.
    west, top = ax.get_window_extent().p0
    halves = [half.get_window_extent() for half in find(figure, "scale-bar")]
    assert min(half.x0 for half in halves) == pytest.approx(west, abs=3.0)
    assert max(half.y1 for half in halves) < top
    metres = float(label.get_text().split()[0])
    bar = sum(half.width for half in halves)
    pixels = ax.transData.transform([[valley.west, 0.0], [valley.west + metres, 0.0]])
    assert bar == pytest.approx(np.ptp(pixels[:, 0]), rel=0.02)


def test_uncertain_cells_have_lines_over_them(valley: Grid) -> None:
    open_ = np.zeros(valley.shape, bool)
    open_[10:14, 22:26] = True
    open_[30:, :] = True  # No block arrives here.
    figure = figures.confidence_figure(valley, level_of(valley), open_, figures.MapMarks())
    (lines,) = find(figure, "uncertain")
    # They fall to the right, where the stripes of classes rise.
    (stripes,) = find(figure, "stripes")
    assert (set(lines.get_hatch()), set(stripes.get_hatch())) == ({"\\"}, {"/"})
    corners = lines.get_path().vertices
    assert corners[:, 0].min() <= valley.west + 110.0
    assert "10.0 % of the cells" in texts(figure)
    assert "statistically uncertain" in classes_in(figure)


def test_before_after_and_what_changed(valley: Grid) -> None:
    before = level_of(valley)
    values = before.bands[0].values.copy()
    values[12:18, 22:28] = 2.0
    values[8:10, 20:30] = np.nan
    values[30, 30] = 1.0
    after = replace(before, bands=(replace(before.bands[0], values=values),))
    figure = figures.change_figure(
        valley, before, after, figures.MapMarks(), names=("before", "after")
    )
    titles = [ax.get_title(loc="left") for ax in axes_of(figure, "map")]
    assert titles == ["before", "after", "Change"]
    change = classes_on(axes_of(figure, "map")[2])
    # 25 m² a cell: 36 + 20 cells lower, one higher, the other 104 as before.
    assert [np.count_nonzero(change == k) for k in (0, 1, 2)] == [56, 104, 1]
    words = texts(figure)
    assert "Lower level: 1 400 m²" in words and "higher level: 25 m²" in words
    assert classes_in(figure)[-3:] == ["Higher level", "Same level", "Lower level"]
    green = axes_of(figure, "map")[2].get_images()[1].cmap(0)
    assert to_hex(green) == LEVEL_CHANGES["lower"][1]


PRESET = read_preset("ch-so")
ENERGIES = np.array([0.0, 10.0, 30.0, 100.0, 300.0, 1000.0])


def curves(rate: list[float], per_rock: float = 1e-4) -> HazardCurves:
    rates = np.array([[0.0] * 6, rate])
    return HazardCurves(
        np.array([3, 8]), ENERGIES, rates, per_rock * rates, np.array([0.0, per_rock])
    )


CURVE = curves([0.05, 0.03, 0.02, 0.008, 0.001, 0.0])


def test_the_curve_is_drawn_with_band_sources_and_fields() -> None:
    sources = {"A / small": CURVE.rate[1] * 0.75, "A / large": CURVE.rate[1] * 0.25}
    figure = figures.hazard_curve_figure(
        CURVE.part([1]), PRESET, by_source=sources, note="Width 5 m."
    )
    (total,) = find(figure, "total")
    x, y = total.get_xdata(), total.get_ydata()
    np.testing.assert_allclose(y[:5], CURVE.rate[1, :5])
    assert np.isnan(y[5])
    np.testing.assert_allclose(x[1:], ENERGIES[1:])
    # No energy at all stands at the left edge, below every energy drawn.
    (ax,) = axes_of(figure, "curve")
    assert x[0] == ax.get_xlim()[0] < 10.0
    (band,) = find(figure, "band")
    low, high = (limit[1] for limit in rate_interval(CURVE))
    corners = band.get_paths()[0].vertices
    at = corners[np.isclose(corners[:, 0], 30.0)][:, 1]
    assert at.min() == pytest.approx(low[2]) and at.max() == pytest.approx(high[2])
    np.testing.assert_allclose(
        find(figure, "source-A / small")[0].get_ydata()[:5], 0.75 * CURVE.rate[1, :5]
    )
    (dots,) = find(figure, "thresholds")
    np.testing.assert_allclose(dots.get_xdata()[1:], [30.0, 300.0])
    np.testing.assert_allclose(dots.get_ydata(), [0.05, 0.02, 0.001])
    words = texts(figure)
    for word in ("A / large", "all release areas and scenarios", "95 % interval", "Width 5 m."):
        assert word in words
    assert {"30", "100", "300"} <= set(words.split(" | "))


def test_the_fields_are_those_of_the_matrix() -> None:
    figure = figures.hazard_curve_figure(CURVE.part([1]), PRESET)
    (ax,) = axes_of(figure, "curve")

    def level_at(energy: float, years: float) -> str:
        for level in PRESET.levels:
            for field in find(figure, f"field-{level.code}"):
                corners = field.get_paths()[0].vertices
                (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
                if left <= energy <= right and bottom <= 1.0 / years <= top:
                    return level.code
        raise AssertionError((energy, years))

    for i, energy in enumerate((5.0, 60.0, 500.0)):
        for j, years in enumerate((20.0, 60.0, 200.0, 1000.0)):
            assert level_at(energy, years) == PRESET.levels[PRESET.matrix[i][j]].code
    red = next(level for level in PRESET.levels if level.code == "substantial")
    colour = find(figure, "field-substantial")[0].get_facecolor()[0][:3]
    np.testing.assert_allclose(colour, to_rgb(red.colour), atol=0.01)
    named = {t.get_text() for t in ax.texts}
    assert named == {level.label for level in PRESET.levels}


def test_the_note_tells_the_level_and_what_decides_it() -> None:
    # 30 kJ and more once in 50 years: moderate; all rocks once in 20 years: so by low intensity.
    often = curves([0.05, 0.04, 0.04, 0.008, 0.001, 0.0])
    unknown = replace(CURVE, variance=np.full_like(CURVE.variance, np.nan))
    for known, row, words in (
        (CURVE, 1, "Level: moderate (blue), from blocks of any energy, once in 20 years."),
        (often, 1, "from blocks of 30 kJ and more, once in 25 years."),
        (CURVE, 0, "No block arrives here."),
        (unknown, 1, "does not give the error"),
    ):
        assert words in texts(figures.hazard_curve_figure(known.part([row]), PRESET))


def test_many_sources_are_brought_together() -> None:
    sources = {f"s{k}": ENERGIES * 0.0 + k for k in range(10)}
    leading = leading_sources(sources)
    assert list(leading) == ["s9", "s8", "s7", "s6", "s5", "others (4)"]
    assert len(leading) == MAX_SOURCES
    assert leading["others (4)"][0] == 4 + 3 + 2 + 1
    assert "s0" not in leading_sources({"s0": ENERGIES * 0.0, "s1": ENERGIES})


def test_the_largest_risks_stand_on_top() -> None:
    names = ["a", "b", "c", "nobody", "d"]
    risk = np.array([2e-5, 5e-5, 1e-5, 0.0, 3e-5])
    low = np.array([1.8e-5, 0.5e-5, 1e-6, 0.0, np.nan])
    high = np.array([2.3e-5, 13e-5, 2e-6, 0.0, np.nan])
    figure = figures.risk_figure(names, risk, (low, high), quantity="deaths", unit="1/year", top=3)
    (ax,) = axes_of(figure, "risk")
    assert [t.get_text() for t in ax.get_yticklabels()] == ["b", "d", "a"]
    low, high = ax.get_ylim()
    assert np.all(np.diff(ax.get_yticks()) > 0.0) and low > high
    widths = sorted(bar.get_width() for bar in ax.patches)
    np.testing.assert_allclose(widths, [2e-5, 3e-5, 5e-5])
    (intervals,) = find(figure, "intervals")
    spans = [segment[:, 0] for segment in intervals.get_segments()]
    np.testing.assert_allclose(spans[0], [0.5e-5, 13e-5])
    # Where the error cannot be told, there is no line.
    assert len(spans) == 2
    np.testing.assert_allclose(spans[1], [1.8e-5, 2.3e-5])
    words = texts(figure)
    assert "deaths (10⁻⁶ 1/year)" in words
    assert "Sum of all 5 objects: 1.10 × 10⁻⁴ 1/year." in words
    assert "Not drawn: 1 object of lower risk (1.00 × 10⁻⁵ 1/year)." in words


def test_amounts() -> None:
    shown = [amount(v) for v in (0.0, 12345.0, 4.5678, 0.0012, 1.204e-5)]
    assert shown == ["0", "12\u202f300", "4.57", "0.0012", "1.20\u2009×\u200910⁻⁵"]
