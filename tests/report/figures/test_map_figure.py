from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from helpers.figure_parts import axes_of, find, texts
from matplotlib.colors import to_hex

from sassgis.grid import FloatArray, Grid
from sassgis.report.figures import MapMarks, map_figure
from sassgis.report.figures.map_figure import class_numbers
from sassgis.report.figures.map_marks import MAX_LINES
from sassgis.report.figures.relief import coarsen, footprint, hillshade, view_of
from sassgis.report.figures.style import to_png
from sassgis.report.pictures import map_drawn
from sassgis.settings.results import Band, RasterLayer
from sassgis.settings.styles import class_colours


def layer_of(
    grid: Grid, unit: str = "kJ", breaks: tuple[float, ...] = (30.0, 300.0)
) -> RasterLayer:
    values = np.full(grid.shape, np.nan, np.float32)
    values[10:20, 20:30] = 10.0
    values[12:18, 22:28] = 100.0
    values[14:16, 24:26] = 300.0
    values[10, 20] = 0.0
    band = Band("e95", "energy, 95 %", unit, values)
    return RasterLayer("energy", "Kinetic energy", "Of passing rocks.", (band,), breaks, "YlOrRd")


def straight_lines(grid: Grid, n: int) -> list[FloatArray]:
    x = grid.west + 100.0 + np.arange(n) * 0.1
    return [np.array([[v, grid.north - 50.0], [v, grid.north - 150.0]]) for v in x]


def shown(figure):
    return np.ma.filled(find(figure, "layer")[0].get_array().astype(float), np.nan)


def test_of_a_large_terrain_only_what_a_map_shows_is_handed_on(valley: Grid) -> None:
    whole, marks = layer_of(valley), MapMarks(straight_lines(valley, 2))
    make = map_drawn(valley, whole, marks)
    cut, (band,) = make.args[0], make.args[1].bands
    assert cut.shape == band.values.shape and cut.values.size < 0.5 * valley.values.size
    assert np.isfinite(band.values).sum() == np.isfinite(whole.bands[0].values).sum()
    assert to_png(make()) == to_png(map_figure(valley, whole, marks))


def test_a_limit_belongs_to_the_class_above() -> None:
    numbers = class_numbers(np.array([[-1.0, 29.9, 30.0, 299.0, 300.0, np.nan]]), (30.0, 300.0))
    np.testing.assert_array_equal(numbers, [[0, 0, 1, 1, 2, np.nan]])
    np.testing.assert_array_equal(class_numbers(np.array([-1.0, 0.0]), (0.0, 5.0)), [np.nan, 0])


def test_layer_is_drawn_by_classes_cropped_and_placed(valley: Grid) -> None:
    figure = map_figure(valley, layer_of(valley))
    image = find(figure, "layer")[0]
    values = shown(figure)
    assert set(values[np.isfinite(values)]) == {0.0, 1.0, 2.0}
    assert np.count_nonzero(values == 2.0) == 4
    # The one cell of zero energy is no rock and stays clear.
    assert np.isfinite(values).sum() == 99
    west, east, _, north = image.get_extent()
    rows, cols = np.nonzero(values == 2.0)
    assert west + cols.min() * 5.0 == valley.west + 24 * 5.0
    assert north - rows.min() * 5.0 == valley.north - 14 * 5.0
    assert (east - west) / 5.0 < valley.shape[1]
    colours = [to_hex(image.cmap(image.norm(k))) for k in range(3)]
    assert colours == class_colours((30.0, 300.0), "YlOrRd")
    words = texts(figure)
    for word in ("Kinetic energy", "kJ", "30 – 300", "≥ 300", "east (m)"):
        assert word in words


def test_layer_without_classes_has_a_ramp_over_its_data(valley: Grid) -> None:
    figure = map_figure(valley, layer_of(valley, breaks=()))
    image = find(figure, "layer")[0]
    assert (image.norm.vmin, image.norm.vmax) == (10.0, 300.0)
    # Heights of zero are shown.
    assert np.isfinite(shown(map_figure(valley, layer_of(valley, unit="m")))).sum() == 100


def test_empty_layer_says_so_and_shows_all_terrain(valley: Grid) -> None:
    layer = layer_of(valley)
    empty = replace(
        layer, bands=(replace(layer.bands[0], values=np.full(valley.shape, np.nan, np.float32)),)
    )
    figure = map_figure(valley, empty)
    assert "no values here" in texts(figure)
    (ax,) = axes_of(figure, "map")
    assert ax.get_xlim() == (valley.bounds[0], valley.bounds[2])


def test_release_lines_and_control_lines(valley: Grid) -> None:
    corner = np.array([valley.west, valley.north])
    ring = np.array([[80.0, -60.0], [110.0, -60.0], [110.0, -50.0]]) + corner
    control_line = np.array([[90.0, -80.0], [250.0, -80.0]]) + corner
    marks = MapMarks(
        release=[ring, ring[:1]],
        lines=straight_lines(valley, MAX_LINES + 30),
        control_lines=[("road", "station", control_line), ("W1", "wall", control_line - [0, 10])],
    )
    figure = map_figure(valley, layer_of(valley), marks)
    np.testing.assert_allclose(find(figure, "release-areas")[0].get_paths()[0].vertices[:3], ring)
    np.testing.assert_allclose(find(figure, "release-points")[0].get_xydata(), ring[:1])
    assert len(find(figure, "fall-lines")[0].get_segments()) == MAX_LINES
    np.testing.assert_allclose(find(figure, "control_line-road")[0].get_xydata(), control_line)
    words = texts(figure)
    assert f"{MAX_LINES} fall lines of {MAX_LINES + 30} are drawn" in words
    assert "road" in words and "W1" in words
    # A gate that leaves the map is named inside the map.
    (ax,) = axes_of(figure, "map")
    (name,) = [t for t in ax.texts if t.get_text() == "road"]
    frame, box = ax.get_window_extent(), name.get_window_extent()
    assert frame.x0 <= box.x0 and box.x1 <= frame.x1
    assert "dashes: station" in words and "line: wall" in words and "dots: net" not in words


def test_names_do_not_overlap(valley: Grid) -> None:
    x, y = valley.west + 120.0, valley.north - 60.0
    near = [(f"house {k}", shapely.box(x, y - k, x + 1.0, y - k + 1.0)) for k in range(1, 9)]
    across = np.array([[x - 40.0, y - 4.0], [x, y - 4.0]])
    marks = MapMarks(control_lines=[("road", "station", across)], objects=near)
    figure = map_figure(valley, layer_of(valley), marks)
    (ax,) = axes_of(figure, "map")
    boxes = [t.get_window_extent() for t in ax.texts]
    assert "road" in [t.get_text() for t in ax.texts]
    # Some have room beside the place, above or below; the others are left out.
    assert 2 <= len(find(figure, "object")) < len(near)
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])


def test_large_maps_keep_single_cells_in_sight() -> None:
    grid = Grid(np.zeros((2000, 1000)), 0.0, 2000.0, 1.0)
    values = np.full(grid.shape, np.nan, np.float32)
    values[777, 333] = 50.0
    # All terrain is in sight.
    corners = [np.array([[1.0, 1.0]]), np.array([[999.0, 1999.0]])]
    layer = RasterLayer("n", "N", "", (Band("n", "n", "kJ", values),), (10.0,), "viridis")
    figure = map_figure(grid, layer, MapMarks(corners))
    image = find(figure, "layer")[0]
    assert image.get_array().count() == 1
    row, col = np.argwhere(~np.ma.getmaskarray(image.get_array()))[0]
    assert (row, col) == (777 // 3, 333 // 3)
    assert "3 × 3 cells" in texts(figure)


def test_coarsened_cells() -> None:
    values = np.array([[1.0, 2.0, np.nan], [3.0, np.nan, np.nan]])
    np.testing.assert_array_equal(coarsen(values, 2, "max"), [[3.0, np.nan]])
    np.testing.assert_array_equal(coarsen(values, 2, "mean"), [[2.0, np.nan]])


def test_relief_is_lit_from_the_north_west(valley: Grid) -> None:
    # A cone: its north-west face must be brighter than its south-east face, nodata stays nodata.
    y, x = np.mgrid[-20:21, -20:21]
    cone = Grid(-np.hypot(x, y) * 0.7, 0.0, 0.0, 1.0)
    shade = hillshade(cone)
    assert shade[10, 10] > shade[30, 30] + 0.2
    assert np.isnan(hillshade(valley)[0, -1])
    assert np.isfinite(hillshade(valley)[0, -9])
    assert np.nanmin(shade) >= 0.0 and np.nanmax(shade) <= 1.0
    flat = hillshade(Grid(np.full((5, 5), 3.0), 0.0, 0.0, 1.0))
    np.testing.assert_allclose(flat, np.sin(np.radians(45.0)))


def test_view_covers_the_extent(valley: Grid) -> None:
    west, north = valley.west, valley.north
    view = view_of(valley, (west + 12.0, north - 33.0, west + 21.0, north - 4.0))
    assert (view.rows, view.cols) == (slice(0, 7), slice(2, 5))
    assert view.grid.bounds == (west + 10, north - 35, west + 25, north)


def test_footprint_reaches_beyond_the_cells_but_not_the_grid(valley: Grid) -> None:
    values = np.full(valley.shape, np.nan)
    values[10:20, 20:40] = 1.0
    west, south, east, north = footprint(valley, values, np.empty((0, 2)))
    assert valley.west < west < valley.west + 100.0
    assert valley.west + 200.0 < east < valley.bounds[2]
    assert south < valley.north - 100.0 and north > valley.north - 50.0
    assert footprint(valley, values * np.nan, np.empty((0, 2))) == valley.bounds
