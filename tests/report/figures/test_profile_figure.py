from __future__ import annotations

import numpy as np
import pytest
from helpers.figure_parts import find, texts

from sassgis.report.figures import ProfilePanel, profile_figure
from sassgis.report.figures.profile_figure import runs_of
from sassgis.settings.results import ControlLine

S = np.array([0.0, 40.0, 80.0, 120.0, 170.0])
Z = np.array([1800.0, 1755.0, 1720.0, 1670.0, 1650.0])
PATHS = [(S[:3] + 1.0, Z[:3] + 2.0), (S, Z + 3.0)]


def one(*args, **kwargs):
    return profile_figure([ProfilePanel(*args, **kwargs)])


CONTROL_LINES = [
    (ControlLine("camera 2", "station"), 60.0, 1737.5),
    (ControlLine("1", "wall", 5.0), 80.0, 1720.0),
    (ControlLine("2", "net", 4.0), 120.0, 1670.0),
]


def test_profile_shows_what_was_given() -> None:
    figure = one(
        S,
        Z,
        PATHS,
        ground=np.array([0, 0, 1, 1]),
        ground_names=("rock", "debris"),
        control_lines=CONTROL_LINES,
        stops=np.array([60.0, np.nan, 165.0]),
        title="Bedrina 1",
    )
    (ax,) = figure.axes
    assert ax.get_aspect() == 1.0
    np.testing.assert_allclose(find(figure, "slope")[0].get_xydata(), np.column_stack([S, Z]))
    segments = find(figure, "trajectories")[0].get_segments()
    assert [len(p) for p in segments] == [3, 5]
    np.testing.assert_allclose(segments[0][:, 1], Z[:3] + 2.0)
    np.testing.assert_allclose(
        find(figure, "stops")[0].get_xydata(), [[60.0, 1737.5], [165.0, 1652.0]]
    )
    np.testing.assert_allclose(find(figure, "ground-0")[0].get_xdata(), S[:3])
    np.testing.assert_allclose(find(figure, "ground-1")[0].get_xdata(), S[2:])
    words = texts(figure)
    for word in ("Bedrina 1", "rock", "debris", "chainage (m)", "height (m)", "camera 2"):
        assert word in words
    assert "2 paths of the centre of mass" in words
    assert "where 2 blocks stopped" in words


def test_barriers_stand_at_their_true_height() -> None:
    figure = one(S, Z, [], control_lines=CONTROL_LINES)
    np.testing.assert_allclose(find(figure, "control_line-1")[0].get_ydata(), [1720.0, 1725.0])
    np.testing.assert_allclose(find(figure, "control_line-2")[0].get_ydata(), [1670.0, 1674.0])
    assert find(figure, "control_line-camera 2")[0].get_ydata()[0] == 1737.5
    words = texts(figure)
    assert "1 (wall, 5 m)" in words and "2 (net, 4 m)" in words


def test_many_short_stretches_go_to_a_legend() -> None:
    s = np.arange(0.0, 400.0, 4.0)
    ground = np.arange(s.size - 1) % 3
    names = ("rock", "coarse debris", "forest floor with stones")
    figure = one(s, 1000.0 - 0.6 * s, [], ground=ground, ground_names=names)
    (legend,) = figure.legends
    assert [t.get_text() for t in legend.get_texts()] == list(names)


def test_comparison_shares_scale_and_limits() -> None:
    before = ProfilePanel(S, Z, PATHS, title="without measures")
    after = ProfilePanel(S, Z, PATHS[:1], control_lines=CONTROL_LINES, title="with measures")
    figure = profile_figure([before, after])
    upper, lower = figure.axes
    assert upper.get_xlim() == lower.get_xlim()
    assert upper.get_ylim() == lower.get_ylim()
    assert [len(c.get_segments()) for c in find(figure, "trajectories")] == [2, 1]
    words = texts(figure)
    assert "a without measures" in words and "b with measures" in words
    for n in (1, 2, 4):
        figure = profile_figure([ProfilePanel(S, Z, title="t")] * n)
        assert figure.get_size_inches()[1] <= 9.7


def test_runs_of_equal_ground() -> None:
    assert runs_of(np.array([2, 2, 0, 2])) == [(2, 0, 2), (0, 2, 3), (2, 3, 4)]
    assert runs_of(np.empty(0, int)) == []
    assert "class 7" in texts(one(S, Z, [], ground=np.full(4, 7)))


def test_axes_are_drawn_at_one_scale_and_hold_everything() -> None:
    high = [(S, Z + 40.0)]
    figure = one(S, Z, high, control_lines=[(ControlLine("W", "wall", 90.0), 5.0, 1794.0)])
    figure.canvas.draw()
    (ax,) = figure.axes
    assert ax.get_ylim()[0] < 1650.0 and ax.get_ylim()[1] > 1884.0
    box = ax.get_window_extent()
    per_metre = box.width / np.ptp(ax.get_xlim()), box.height / np.ptp(ax.get_ylim())
    assert per_metre[0] == pytest.approx(per_metre[1], rel=1e-6)


def test_many_paths_are_bands_with_some_of_them() -> None:
    heights = np.linspace(1.0, 41.0, 81)
    figure = one(S, Z, [(S, Z + up) for up in heights])
    assert len(find(figure, "trajectories")[0].get_segments()) == 30
    outer, inner = find(figure, "band")
    for band, low, high in ((outer, 3.0, 39.0), (inner, 11.0, 31.0)):
        corners = band.get_paths()[0].vertices
        at = corners[np.isclose(corners[:, 0], S[0])][:, 1] - Z[0]
        assert (at.min(), at.max()) == (pytest.approx(low), pytest.approx(high))
    words = texts(figure)
    assert "81 paths" in words and "30 of them as lines" in words
