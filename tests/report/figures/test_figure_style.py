from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from helpers.figure_parts import texts
from hypothesis import given
from hypothesis import strategies as st

from sassgis.errors import OutputError
from sassgis.report.figures import save, style, to_png
from sassgis.report.figures.distributions import runout_figure
from sassgis.report.figures.hazard_figures import blocks_figure
from sassgis.report.page import ReportFigure
from sassgis.report.pictures import drawn_beside, picture
from sassgis.settings.languages import in_language
from sassgis.settings.results import StopReason
from sassgis.simulation import workers

positions = st.lists(st.floats(-1e3, 1e3), min_size=0, max_size=12)


@given(positions, st.floats(0.1, 50.0))
def test_spread_labels_keep_order_and_distance(wanted: list[float], gap: float) -> None:
    placed = style.spread(wanted, gap)
    order = np.argsort(wanted, kind="stable")
    assert np.all(np.diff(placed[order]) >= gap - 1e-6)
    assert np.sum(placed) == pytest.approx(np.sum(wanted), abs=1e-6)


def test_spread_gives_labels_the_room_that_they_need() -> None:
    assert style.spread([10.0, 0.0, 5.0], 4.9).tolist() == [10.0, 0.0, 5.0]
    assert np.diff(style.spread([0.0, 0.0], np.array([2.0, 8.0]))) == pytest.approx([5.0])


@pytest.mark.parametrize(
    ("span", "parts", "step"), [(100.0, 5, 20.0), (1.0, 4, 0.2), (730.0, 8, 100.0), (0.0, 5, 1.0)]
)
def test_round_steps(span: float, parts: int, step: float) -> None:
    assert style.round_step(span, parts) == pytest.approx(step)


def test_texts_can_be_read_on_their_ground() -> None:
    assert [style.ink_on(c) for c in ("#8b0000", "#ffe34d")] == ["white", style.INK]
    assert style.ink_on("#8b0000", 0.3) == style.INK


def test_wrap_keeps_all_words_and_the_given_lines() -> None:
    text = "a long line of words that cannot stand in one line\nsecond"
    wrapped = style.wrap(text, 1.5)
    assert wrapped.split() == text.split()
    assert wrapped.splitlines()[-1] == "second"
    assert len(wrapped.splitlines()) > 2


def test_the_users_settings_do_not_change_a_figure() -> None:
    before = dict(mpl.rcParams)
    counted = np.arange(4.0), {StopReason.REST: np.array([1, 2, 4])}
    plain = to_png(runout_figure(*counted))
    assert dict(mpl.rcParams) == before
    with mpl.rc_context({"axes.facecolor": "yellow", "font.size": 20.0}):
        assert to_png(runout_figure(*counted)) == plain


def test_a_name_is_no_mathematics() -> None:
    with style.house_style():
        figure = style.new_figure(2.0, 2.0)
        figure.subplots().set_title(r"$\frac{$")
    assert r"$\frac{$" in texts(figure)
    to_png(figure)


def test_powers_of_ten_are_ticks_without_mathematics() -> None:
    assert [style.plain_tick(v) for v in (20_000.0, 0.05, 0.001, 1e-5, 2.5e-5)] == [
        "20\u202f000", "0.05", "0.001", "10⁻⁵", "2.5\u2009×\u200910⁻⁵",
    ]  # fmt: skip
    shown = texts(blocks_figure([(10_000, 0.2), (20_000, 0.1), (40_000, 0.01)], 0.05))
    assert all(f"| {tick} |" in shown for tick in ("10 000", "20 000", "50 000", "0", "10", "20"))
    with style.house_style():
        ax = style.new_figure(2.0, 2.0).subplots()
        ax.set(xscale="log", xlim=(1.0, 9.0))
        style.log_ticks(ax.xaxis, np.log10(9.0))
        shown = texts(ax.figure)
    assert "| 5 |" in shown


def test_same_figure_same_bytes_without_version(tmp_path: Path) -> None:
    counted = np.arange(4.0), {StopReason.REST: np.array([1, 2, 4])}
    first = save(runout_figure(*counted), tmp_path / "a.png").read_bytes()
    second = save(runout_figure(*counted), tmp_path / "b.png").read_bytes()
    assert first == second
    assert first.startswith(b"\x89PNG")
    assert b"Matplotlib" not in first
    with pytest.raises(OutputError, match=r"no/a\.png: the figure cannot be written"):
        save(runout_figure(*counted), tmp_path / "no" / "a.png")


def test_figures_drawn_by_another_process_are_the_same_in_each_language(tmp_path: Path) -> None:
    counted = np.arange(0.0, 16000.0, 4000.0), {StopReason.REST: np.array([1, 2, 4])}

    def drawn(name: str) -> ReportFigure:
        make = partial(runout_figure, *counted)
        return picture(tmp_path, name, "Run-out", "Where blocks end.", make)

    with in_language("de"):
        here = drawn("here").png
        with drawn_beside(2):
            beside = drawn("beside").png
    assert here == beside == (tmp_path / "beside.png").read_bytes()
    assert here != drawn("english").png


def test_figures_are_drawn_here_where_no_process_can_be_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused() -> None:
        raise OSError("not permitted")

    monkeypatch.setattr(workers, "WorkerProcess", refused)
    make = partial(blocks_figure, [(10, 0.2), (20, 0.1)], 0.05)
    with drawn_beside(2):
        assert picture(tmp_path, "figure", "Blocks", "", make).png == to_png(make())


def test_texts_that_are_translated_twice_stay() -> None:
    figure = style.new_figure(2.0, 2.0)
    # In Italian "Zones" is "Zone", which is English too.
    figure.text(0.5, 0.5, "Zones")
    with in_language("it"):
        style.translate_texts(figure)
        once = texts(figure)
        style.translate_texts(figure)
    assert texts(figure) == once
    assert "Zones" not in once


def test_what_draws_loads_neither_engine_nor_frames() -> None:
    import subprocess

    code = (
        "import sys, sassgis.report.pictures;"
        "sys.exit(any(name in sys.modules for name in ('numba', 'pandas')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_figures_do_not_load_pyplot() -> None:
    import subprocess

    code = (
        "import sys; from sassgis.report.figures import blocks_figure, to_png;"
        "to_png(blocks_figure([(10, 0.2), (20, 0.1)], 0.05));"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
