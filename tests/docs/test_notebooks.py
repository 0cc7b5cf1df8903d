"""The notebooks of the documentation run, and results show themselves in them."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def shown(code: str, names: dict[str, Any]) -> Any:
    """Run a cell; what a notebook would show below it."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None


@pytest.fixture
def values(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], list[Any]]:
    """What the cells of a notebook show."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")

    def run(name: str) -> list[Any]:
        file = repository / "docs" / "notebooks" / name
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        # What is stored could be out of date.
        assert not any(cell["outputs"] for cell in code)
        names: dict[str, Any] = {}
        return [shown("".join(cell["source"]), names) for cell in code]

    return run


@pytest.mark.battery
def test_the_notebook_of_the_gap(values: Callable[[str], list[Any]]) -> None:
    passages, _, where, probability, ladder, change, _ = values("gap.ipynb")
    assert {"speed_mps", "height_m"} <= set(passages.columns)
    assert len(where) and where["p_adjusted"].between(0.0, 1.0).all()
    assert {*probability.index[:2]} == {"none", "unknown"}
    assert probability.sum() == pytest.approx(1.0, abs=0.05)
    rungs = ladder.set_index("rung")["distance"]
    assert rungs["floor"] < rungs["configured"] and rungs["ground"] < rungs["configured"]
    assert len(change) == 8 and change.notna().any().all()


@pytest.mark.battery
def test_the_notebook_of_the_valley(values: Callable[[str], list[Any]], tmp_path: Path) -> None:
    maps, drawn, zones, curve, printed, result = values("valley.ipynb")
    assert maps.energy_q95.max() > 30.0 and "Kinetic energy" in drawn.colorbar.ax.get_ylabel()
    assert zones["area_m2"].sum() > 1000.0
    assert curve[0] >= curve[30] >= curve[300] > 0.0 and printed is None
    html = result._repr_html_()
    assert all(word in html for word in ("Hazard zones", "Run-out"))
    assert html.count("<img") == 1 and len(re.findall("data:image/png", html)) == 1
    (link,) = re.findall(r'<a href="([^"]+)">', html)
    assert (tmp_path / link).is_file()
    # No arrays and pictures in the text that a terminal shows.
    assert len(repr(result)) < 2000
