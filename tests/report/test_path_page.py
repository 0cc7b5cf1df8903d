from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from sassgis.hazard.along_profile import LinePaths
from sassgis.model.grid import Grid
from sassgis.model.languages import in_language
from sassgis.model.results import Band, ControlLine, RasterLayer
from sassgis.report.path_page import write_path_page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def straight(name: str, y: float) -> LinePaths:
    """A path of 80 m to the east, falling from 100 to 20 m; the block flies 2 m above it."""
    s = np.array([0.0, 80.0])
    z = np.array([100.0, 20.0])
    return LinePaths(
        area=name, scenario="one", s=s, z=z, x=10.0 + s, y=np.full(2, y), ground=np.zeros(2, int),
        ground_names=("rock",), control_lines=(), stops=s[1:],
        paths=((np.array([0.0, 40.0, 80.0]), np.array([100.0, 62.0, 20.0])),),
    )  # fmt: skip


@pytest.fixture
def page(tmp_path: Path) -> Path:
    heights = np.tile(100.0 - np.arange(0.5, 100.0), (50, 1))
    grid = Grid(heights, 0.0, 50.0, 1.0)
    values = np.full(grid.shape, np.nan, np.float32)
    values[20:30, 10:90] = 40.0
    layer = RasterLayer(
        "energy", "Kinetic energy, 95 % quantile (kJ)", "", (Band("q95", "", "kJ", values),),
        (0.0, 30.0, 300.0), "YlOrRd",
    )  # fmt: skip
    run = SimpleNamespace(
        grid=grid, control_lines=((ControlLine("net <A>", "net"), np.array([[60.0, 5], [60, 45]])),)
    )
    evil = [("</script><b>house", shapely.box(70.0, 20.0, 75.0, 25.0))]
    file = tmp_path / "paths.html"
    outlines = [np.array([[8.0, 20.0], [12.0, 20.0], [12.0, 30.0], [8.0, 20.0]])]
    paths = [straight("north", 26.0), straight("south", 24.0)]
    with in_language("de"):
        write_path_page(file, "Slope & co", run, layer, paths, outlines, evil)  # type: ignore[arg-type]
    return file


def test_nothing_is_fetched_and_names_cannot_end_the_script(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.count("</script>") == 1 and "<b>house" not in text
    assert "default-src 'none'" in text
    assert set(re.findall(r"https?://[^\"]+", text)) == {"http://www.w3.org/2000/svg"}
    assert '<html lang="de">' in text and "Bahn auf der Karte" in text
    assert "<title>Slope &amp; co</title>" in text
    assert text.count('class="sign"') == 3 and "≥ 300 kJ" in text


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed (Debian: chromium)")
def test_a_path_can_be_followed_in_a_browser(page: Path, tmp_path: Path) -> None:
    # What a reader does: choose the second path, and move the slider to its middle.
    text = page.read_text(encoding="utf-8").replace(
        "choose(0);\n</script>",
        "choose(0); document.querySelectorAll('.reach')[1].dispatchEvent(new Event('click'));"
        "get('place').value = 500; get('place').dispatchEvent(new Event('input'));\n</script>",
    )
    page.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu",
         f"--user-data-dir={tmp_path}", "--dump-dom", page.as_uri()],
        capture_output=True, text=True, timeout=180, check=False,
    )  # fmt: skip
    dom = done.stdout
    assert "Distanz 40 m; Boden auf 60 m; Block über dem Boden 2.0 m" in dom, done.stderr[-500:]
    drawn = re.findall(r'<polyline [^>]*class="path( chosen)?"', dom)
    assert drawn == ["", " chosen"]
    assert "2: south, one" in dom and "net &lt;A&gt;" in dom
    assert dom.count('class="block"') == 1 and dom.count('class="ground"') == 1
