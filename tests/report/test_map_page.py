"""The map that can be asked, and the sheets of protection beside it, also in a browser."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from helpers.zone_slope import Case, box, place, two_areas

import sassgis
from sassgis.hazard.curves import return_period
from sassgis.outputs.qgis.run_project import onset_words
from sassgis.report.map_page import (
    Contribution,
    frames,
    in_steps,
    largest_shares,
    strongest_cells,
)
from sassgis.report.protection_page import best_words
from sassgis.runs.run import ZoneResult
from sassgis.settings.languages import in_language, translated
from sassgis.settings.results import CONTACT_DTYPE, StopReason
from sassgis.simulation.path_sample import BlockPath, sample_paths

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
browser = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: chromium)")
#: What the script below leaves for the test.
LEFT = re.compile(r'<pre id="left">(.*?)</pre>', re.S)
Zoned = tuple[ZoneResult, Path]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Two areas, a house with an evil name, a road, a net."""
    made = two_areas(tmp_path_factory.mktemp("case"), output={}, hazard={"ref_width_m": 6.0})
    made.write_layer("houses.gpkg", [box(60, 30, 3, 3)], {"name": ["</script><b>house"]})
    made.write_layer("net.gpkg", [shapely.LineString([place(50, 25), place(50, 50)])])
    rows = [
        f"building,{intensity},{loss},0.01,invented"
        for intensity, loss in (("low", 0.01), ("mean", 0.1), ("high", 0.5))
    ]
    made.write_text("v.csv", "kind,intensity,vulnerability,lethality,source", *rows)
    made.sections["risk"] = {"vulnerability": "v.csv"}
    made.lists["barriers"] = [
        {"name": "net", "kind": "net", "height_m": 3.0, "capacity_kj": 500.0, "file": "net.gpkg"}
    ]
    made.lists["objects"] = [
        {"name": "houses", "kind": "building", "file": "houses.gpkg", "name_field": "name",
         "value": 1e6, "persons": 3, "presence": 0.5}
    ]  # fmt: skip
    made.set("project.name", "Slope & co")
    return made


@pytest.fixture(scope="module")
def zoned(case: Case) -> Zoned:
    out = case.folder / "out"
    return sassgis.zone(case.config, out, jobs=1), out / "map.html"


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    def run(page: Path, script: str, width: int | None = None) -> Any:
        """Open a copy of the page, run a script once it is ready, and give what it leaves.

        A width is that of a frame: windows of a headless browser are not as narrow as a phone.
        """
        folder = tmp_path_factory.mktemp("browser")
        ready = f"""<script>
        const wait = setInterval(() => {{
          if (document.body.dataset.ready !== "true") return;
          clearInterval(wait);
          const left = document.createElement("pre");
          left.id = "left";
          try {{ left.textContent = JSON.stringify((() => {{ {script} }})()); }}
          catch (error) {{ left.textContent = JSON.stringify("failed: " + error.stack); }}
          parent.document.body.append(left);
        }}, 20);
        </script></body>"""
        text = page.read_text(encoding="utf-8").replace("</body>", ready)
        if width is not None:
            frame = f'<iframe style="width:{width}px; height:844px; border:0" srcdoc="%s"></iframe>'
            text = "<!DOCTYPE html><body>" + frame % html.escape(text)
        copy = folder / "page.html"
        copy.write_text(text, encoding="utf-8")
        assert CHROMIUM is not None
        done = subprocess.run(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
             "--no-first-run", "--disable-background-networking", "--disable-component-update",
             "--disable-sync", f"--user-data-dir={folder / 'user'}", "--window-size=1400,900",
             "--virtual-time-budget=20000", "--dump-dom", copy.as_uri()],
            capture_output=True, text=True, timeout=300, check=True,
        )  # fmt: skip
        left = LEFT.search(done.stdout)
        assert left is not None, done.stdout[-2000:]
        given = json.loads(html.unescape(left[1]))
        assert not str(given).startswith("failed: "), given
        return given

    return run


def test_nothing_is_fetched_and_names_cannot_end_the_script(zoned: Zoned) -> None:
    text = zoned[1].read_text(encoding="utf-8")
    style = text[text.index("<style>") : text.rindex("</style>")]
    assert "default-src 'none'" in text and "url(" not in style and "@import" not in style
    assert text.count("</script>") == 2 and "<b>house" not in text
    assert "Slope &amp; co" in text and "BSD 2-Clause" in text
    own = re.sub(r"(?s)<script>.*?</script>", "", text)
    assert not re.findall(r"(?:src|href)=|<link|<iframe|<object|<embed", own)
    assert zoned[1].stat().st_size < 1_500_000


def test_equal_runs_give_equal_files(case: Case, zoned: Zoned, tmp_path: Path) -> None:
    sassgis.zone(case.config, tmp_path / "out", jobs=1)
    for name in ("map.html", "manifest.json"):
        assert (tmp_path / "out" / name).read_bytes() == zoned[1].with_name(name).read_bytes()


def test_the_numbers_of_a_cell_are_kept_to_a_thousandth() -> None:
    values = np.concatenate([[0.0, 1e-9, 0.123, 1.0, 30.0, 12345.6, 1e7], np.logspace(-8, 7, 500)])
    steps = in_steps(values)
    back = np.where(steps > 0, 10.0 ** ((steps - 1.0) / 1000.0 - 10.0), 0.0)
    assert np.allclose(back, values, rtol=1.2e-3) and steps[0] == 0


def test_the_largest_sources_come_first_with_their_share_of_all() -> None:
    rng = np.random.default_rng(2)
    # In any order, as those of squares come.
    cells = rng.choice(1000, 60, replace=False)
    own: list[Contribution] = []
    for k in range(7):
        at = np.sort(rng.choice(cells, 40, replace=False))
        own.append((f"a{k}", "s", at, rng.integers(1, 5, at.size).astype(float)))
    # One that reaches other cells, too.
    own.append(("b", "s", np.arange(1000), np.full(1000, 3.0)))
    which, share = largest_shares(own, cells)
    dense = np.zeros((len(own), 1000))
    for k, (*_, reached, weight) in enumerate(own):
        dense[k, reached] = weight
    for row, cell in enumerate(cells):
        order = np.argsort(-dense[:, cell], kind="stable")[:3]
        expected = np.rint(1000.0 * dense[order, cell] / dense[:, cell].sum())
        assert which[row].tolist() == order.tolist() and share[row].tolist() == expected.tolist()


def test_of_squares_of_cells_the_strongest_stays() -> None:
    strength = np.zeros((5, 7))
    strength[0, 0], strength[1, 1], strength[4, 6], strength[2, 3] = 1.0, 2.0, 0.5, 3.0
    assert strongest_cells(strength.ravel(), (5, 7), 2).tolist() == [8, 17, 34]
    assert strongest_cells(strength.ravel(), (5, 7), 1).tolist() == [0, 8, 17, 34]


@browser
def test_a_cell_says_what_the_maps_hold(zoned: Zoned, opened: Callable[..., Any]) -> None:
    result, page = zoned
    maps, curves = result.run.maps, result.found.hazard.curves
    often = np.argsort(-curves.rate[:, 0])[[0, 7, 40, 200]]
    x, y = result.run.run.grid.cell_centres(curves.places[often])
    ask = "; ".join(
        f"ask({a}, {b}); out.push(get('found').innerText)" for a, b in zip(x, y, strict=True)
    )
    texts = opened(page, f"const out = []; {ask}; return out;")
    labels = [level.label for level in result.rules.preset.levels]

    def close(text: str, expected: float) -> None:
        assert float(text) == pytest.approx(expected, rel=0.06), text

    for k, text in zip(often, texts, strict=True):
        at = maps.isel(dict(zip("yx", np.divmod(curves.places[k], maps.sizes["x"]), strict=True)))
        assert f"Hazard level of the cell: {labels[int(at.hazard_level) - 1]}" in text
        # A zone is nowhere below its cells.
        zone = re.search(r"^Zone: (.*)$", text, re.MULTILINE)
        assert zone is not None and labels.index(zone[1]) >= int(at.hazard_level) - 1
        chance = re.search(r"with a probability of ([\d.]+) %", text)
        assert chance is not None, text
        assert float(chance[1]) == pytest.approx(100 * float(at.confidence_change_chance), abs=0.6)
        for energy, words in ((0.0, "any block"), (30.0, "30 kJ and more")):
            years = float(return_period(curves.rate[k, curves.column(energy)]))
            if np.isfinite(years):
                found = re.search(rf"{words}\s+once in ([\d.]+) years", text)
                assert found is not None, text
                close(found[1], years)
        energy = float(at.energy_at_return_period_e300)
        found = re.search(r"300 years\s+([\d.]+) kJ", text)
        assert (found is not None) == bool(energy > 0.0)
        if found is not None:
            close(found[1], energy)
        row = re.search(r"Energy \(kJ\)\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)", text)
        assert row is not None
        for shown, name in zip(row.groups(), ("q50", "q95", "max"), strict=True):
            close(shown, float(at[f"energy_{name}"]))
        blocks = re.search(r"Simulated blocks\s+(\d+)", text)
        assert blocks is not None and int(blocks[1]) == int(at.passages)
        assert re.search(r"(north|south), (frequent|rare)\s+\d+ %", text)


@browser
def test_objects_nets_areas_and_paths_can_be_asked(
    zoned: Zoned, opened: Callable[..., Any]
) -> None:
    result, page = zoned
    click = """
    const out = {};
    const drawn = () => filled.getLayers().filter(one => one._path?.isConnected).length;
    const seen = () => [drawn(), map.hasLayer(picture), boxes.zone.checked];
    out.zones = [...seen(), get("legend").innerText];
    for (const shape of data.shapes) {
      shape_found(shape);
      out[shape.kind + " " + shape.name] = get("found").innerText;
    }
    follow(0);
    out.path = [get("found").innerText, get("where").textContent, get("follow").hidden];
    // As a finger does it: on the lines that are drawn.
    const lines = [...document.querySelectorAll("path.leaflet-interactive")];
    const finger = { bubbles: true, clientX: 400, clientY: 400 };
    lines[lines.length - 1].dispatchEvent(new MouseEvent("click", finger));
    out.clicked = get("found").innerText;
    map.fire("click", { latlng: L.latLng(north - south - 1, 1) });
    out.nothing = get("found").innerText;
    choice.value = 2; choice.dispatchEvent(new Event("change"));
    out.cells = seen();
    choice.value = 0; choice.dispatchEvent(new Event("change"));
    out.again = [...seen(), get("legend").innerText];
    choice.value = 2; choice.dispatchEvent(new Event("change"));
    out.legend = get("legend").innerText;
    out.hash = location.hash;
    return out;
    """
    found = opened(page, click)
    # Zones alone at first; a map of the cells is drawn without them.
    assert found["zones"] == found["again"] and found["zones"][1:3] == [False, True]
    assert "residual" in found["zones"][3] and found["cells"][1:] == [True, False]
    assert found["zones"][0] > 0 == found["cells"][0]
    risk = result.found.risk
    assert risk is not None
    house = found["object </script><b>house"]
    years = float(re.search(r"Hits\s+once in ([\d.]+) years", house)[1])  # type: ignore[index]
    assert years == pytest.approx(1.0 / risk.of_object("hits")[0], rel=0.01)
    assert "Frequency of blocks here" in house
    assert re.search(r"Capacity\s+500 kJ", found["net net"])
    assert re.search(r"30 years\s+[\d.–]+ kJ, passing height [\d.–]+ m", found["net net"])
    north = found["release north"]
    assert re.search(r"frequent\s+0.4 blocks a year", north)
    zones = [text for key, text in found.items() if key.startswith("zone ")]
    assert zones and all("Governed by" in text for text in zones)
    about, where, hidden = found["path"]
    assert "Path of a block: " in about and not hidden
    ending = r"block above the ground [\d.]+ m; speed [\d.]+ m/s"
    assert re.fullmatch(rf"chainage \d+ m; ground at \d+ m; {ending}", where)
    assert found["clicked"] and "No simulated block arrives here." in found["nothing"]
    assert "kJ" in found["legend"] and re.fullmatch(r"#-?[\d.]+,-?[\d.]+", found["hash"])


def test_a_falling_block_is_where_it_is_at_its_time() -> None:
    """One that sinks by 4 m/s for 1.2 s, known at uneven times."""
    t = np.array([0.0, 0.3, 0.55, 1.0, 1.2])
    rest = np.zeros(t.size)
    path = BlockPath(
        "a", "s", t, rest, rest, 100.0 - 4.0 * t, StopReason.REST, 0.0, 1.2, 1.0, 1.0, 4.0, 1.0,
        contacts=np.zeros(0, CONTACT_DTYPE), contact_xy=np.zeros((0, 2)),
    )  # fmt: skip
    x, _, z, speed = frames(path, 0.5)
    assert x.tolist() == [0.0] * 4 and z.tolist() == pytest.approx([100.0, 98.0, 96.0, 95.2])
    assert speed.tolist() == pytest.approx([4.0, 4.0, 1.6, 0.0])


@browser
def test_blocks_move_in_time_and_have_the_colour_of_their_speed(
    zoned: Zoned, opened: Callable[..., Any]
) -> None:
    result, page = zoned
    script = """
    const out = { blocks: blocks.map(b => [b.area, b.scenario, b.points, b.z, b.speed]), seen: [] };
    const plain = line => line.map(p => [p.lat, p.lng]);
    const lines = () => trails.map(trail => trail.getLatLngs().map(plain));
    out.hidden = [boxes.path.checked, map.hasLayer(groups.path), boxes.point.checked];
    const to = at => { time.value = at; time.dispatchEvent(new Event("input")); };
    for (const at of [0, 4, time.max]) {
      to(at);
      out.seen.push([lines(), get("clock").textContent]);
    }
    out.shown = [boxes.path.checked, map.hasLayer(groups.path)];
    area.value = "north"; area.dispatchEvent(new Event("change"));
    out.north = shown.map(b => b.area);
    out.all = [area.options[0].text, area.options.length];
    play.focus(); play.click();
    out.play = [document.activeElement.id, play.textContent, time.tabIndex, play.tabIndex];
    play.click();
    out.pause = play.textContent;
    out.limits = limits; out.step = step; out.corner = [west, south];
    return out;
    """
    left = opened(page, script)
    run, planned = result.run.run, result.run.planned
    paths = sample_paths(run, planned, 100)
    assert len(paths) == len(left["blocks"]) > 5
    west, south = left["corner"]
    step, limits = left["step"], np.array(left["limits"])
    for path, (area, scenario, points, z, speed) in zip(paths, left["blocks"], strict=True):
        assert (area, scenario) == (path.area, path.scenario) and (np.diff(path.t) >= 0.0).all()
        times = np.minimum(np.arange(len(points)) * step, path.t[-1])
        assert 0.0 <= path.t[-1] - path.t[0] - step * (len(points) - 2) <= step
        expected = [np.interp(times, path.t, v) for v in (path.y - south, path.x - west, path.z)]
        assert np.allclose(np.column_stack([points, z]).T, expected, atol=0.06)
        assert max(speed) <= path.max_speed_mps + 0.06 and min(speed) >= 0.0
    # Each section has the colour of the class of its speed; at first there is none.
    assert left["hidden"] == [False, False, False] and left["shown"] == [True, True]
    assert [clock for _, clock in left["seen"]][:2] == ["0.0 s", "1.0 s"]
    length = [
        sum(np.hypot(*np.diff(line, axis=0).T).sum() for lines in seen for line in lines)
        for seen, _ in left["seen"]
    ]
    assert length[0] == 0.0 < length[1] < length[2]
    for number, lines in enumerate(left["seen"][2][0]):
        for line in lines:
            for begin in line[:-1]:
                own = [
                    speed[points.index(begin)]
                    for *_, points, _, speed in left["blocks"] if begin in points
                ]  # fmt: skip
                assert number in np.searchsorted(limits, own, side="right") - 1
    assert set(left["north"]) == {"north"} and left["all"] == ["All release areas", 3]
    assert left["play"] == ["play", "Pause", 0, 0] and left["pause"] == "Play"


@browser
def test_release_points_and_the_energy_line_are_layers(
    zoned: Zoned, opened: Callable[..., Any]
) -> None:
    result, page = zoned
    script = """
    const line = data.shapes.filter(shape => shape.kind === "energy_line");
    const on = map.hasLayer(groups.energy_line);
    boxes.energy_line.click();
    return [on, map.hasLayer(groups.energy_line), line.map(s => [s.rows, s.parts]), data.points];
    """
    on, then, ((rows, parts),), points = opened(page, script)
    assert (on, then) == (False, True)
    own = result.run.planned.points
    assert np.allclose(points, np.column_stack([own.x, own.y]), atol=0.06)
    layer = gpd.read_file(page.with_name("result.gpkg"), layer="energy_line")
    assert rows == [["reach angle", f"{layer['angle_deg'][0]:.1f}°"]]
    drawn = shapely.MultiPolygon([shapely.Polygon(part[0], part[1:]) for part in parts])
    assert drawn.symmetric_difference(layer.geometry[0]).area < 0.05 * drawn.area
    stops = gpd.read_file(page.with_name("result.gpkg"), layer="stops")
    at_rest = stops[stops["end"].isin(("rest", "barrier"))]
    # 99 % of the blocks are seen above the angle, so that they lie below the line.
    assert at_rest.within(layer.geometry[0].buffer(3.0)).mean() > 0.97


@browser
def test_the_page_fits_a_phone(zoned: Zoned, opened: Callable[..., Any]) -> None:
    script = """
    cell_found(...data.extent.slice(0, 2).map((v, i) => (v + data.extent[i + 2]) / 2));
    const size = get("map").getBoundingClientRect(), text = getComputedStyle(get("found"));
    const inside = one => {
        const box = document.querySelector(one).getBoundingClientRect();
        return box.left >= 0 && box.right <= innerWidth && box.height > 0;
    };
    const signs = [".leaflet-control-scale-line", "#play", "#time", "#clock", "#area"];
    const whole = signs.every(inside);
    return [innerWidth, document.documentElement.scrollWidth, size.width, size.height,
        get("found").getBoundingClientRect().top >= size.bottom, parseFloat(text.fontSize), whole];
    """
    given = opened(zoned[1], script, width=390)
    width, scrolled, map_width, map_height, below, letters, whole = given
    assert whole
    assert width == 390 and scrolled <= 390 and 370 <= map_width <= 390
    assert map_height > 250 and below and letters >= 16


@browser
def test_a_run_without_zones_says_what_comes(
    case: Case, opened: Callable[..., Any], tmp_path: Path
) -> None:
    config = sassgis.load_config(case.config, {"project.language": "de"})
    result = sassgis.run(config, tmp_path / "out", jobs=1)
    cell = int(np.nanargmax(result.maps.passages))
    x, y = result.run.grid.cell_centres(np.array([cell]))
    text = opened(
        tmp_path / "out" / "map.html", f"ask({x[0]}, {y[0]}); return get('found').innerText;"
    )
    assert "Simulierte Blöcke, die hier ankommen" in text and "Gefahrenstufe" not in text
    blocks = re.search(r"Simulierte Blöcke\s+(\d+)", text)
    assert blocks is not None and int(blocks[1]) == int(np.nanmax(result.maps.passages))


def test_sheets_of_protection_say_what_the_tables_say(zoned: Zoned) -> None:
    """Copies of the net along the slope are in their own table, and nowhere else."""
    out = zoned[1].parent
    places, design, needs = (
        pd.read_csv(out / f"tables/{name}.csv", dtype={"net_class": str, "net_class_high": str})
        for name in ("protection_places", "design", "protection")
    )
    assert list(design["line"]) == ["net"] and len(places) == 7
    here = places[places["moved_m"] == 0.0].iloc[0]
    for key in ("rocks", "arrivals_per_year", "energy_q95_kj"):
        assert here[key] == design[key][0]
    # The slope falls, and blocks come to rest on it.
    assert (np.diff(places["ground_m"]) < 0.0).all() and (places["share"] <= 1.0).all()
    below = places[places["moved_m"] >= 0.0]
    assert (np.diff(below["rocks"]) <= 0).all()
    page = (out / "protection.html").read_text(encoding="utf-8")
    text = re.sub(r"<style.*?</style>|<[^>]*>", " ", page, flags=re.S)
    words = " ".join(html.unescape(text).split())
    assert "Design of protection: net (net, 3 m) Slope & co" in words
    assert "3 m high, 500 kJ capacity" in words and "Best place along the slope" in words
    sources = pd.read_csv(out / "tables/sources.csv").drop_duplicates("scenario")
    rates = "; ".join(sources["scenario"] + " " + sources["onset_per_year"].map("{:.3g}".format))
    assert f"Onset frequencies blocks a year in each release area: {rates} Ground classes" in words
    with in_language("de"):
        german = translated(onset_words(zoned[0].rules))
    assert german == f"Blöcke pro Jahr in jedem Herkunftsgebiet: {rates}"
    for own, high in zip(needs["net_class"], needs["net_class_high"].fillna("–"), strict=True):
        assert pd.isna(own) or f" {own if own == high else f'{own} to {high}'} " in words
    assert page.count("<img ") == 2 and not re.search(r"https?:|<script", page)
    report = (out / "report.html").read_text(encoding="utf-8")
    assert '<a href="protection.html">Design of protection</a>' in report


@browser
def test_a_sheet_of_protection_is_a_page_of_a4(zoned: Zoned, tmp_path: Path) -> None:
    assert CHROMIUM is not None
    pdf = tmp_path / "sheet.pdf"
    page = zoned[1].with_name("protection.html")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer")
    command = [CHROMIUM, *options, f"--print-to-pdf={pdf}", f"file://{page}"]
    subprocess.run(command, capture_output=True, timeout=60, check=True)
    assert len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes())) == 1


def test_best_place_is_where_enough_blocks_come() -> None:
    columns = ("moved_m", "arrivals_per_year", "energy_q95_kj", "height_q95_m")
    rows = [
        (-40, 0.5, 10, 0.5), (-20, 1.1, 80, 2), (0, 1.0, 90, 3), (20, 0.9, 95, 1),
        (40, 0.9, 20, 0.2),
    ]  # fmt: skip
    places = pd.DataFrame(rows, columns=columns, dtype=float)
    places["above_objects"] = places["moved_m"] < 40.0
    said = str(best_words(places))
    assert "lowest 20 m upslope: 80 kJ (as drawn 90 kJ)" in said
    assert "lowest 20 m downslope: 1 m (as drawn 3 m)" in said
    # What an exposed object above them excludes is told.
    assert "further down (20 kJ) do not count" in said
    assert "further down" not in str(best_words(places[places["above_objects"]]))
    assert best_words(places[places["moved_m"] == 0.0]) is None
