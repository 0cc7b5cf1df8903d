"""The rules of an office, checked and drawn by `sassgis preset`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.pages import shown
from matplotlib.colors import to_hex
from PIL import Image

from sassgis.hazard.levels import levels_of_events
from sassgis.inputs.presets import preset_names, read_preset
from sassgis.report.figures.hazard_figures import preset_figure


@pytest.fixture
def office(repository: Path, tmp_path: Path) -> Path:
    """The example of the page."""
    return Path(shutil.copy(repository / "docs" / "office.toml", tmp_path))


def changed(file: Path, old: str, new: str) -> Path:
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1, old
    file.write_text(text.replace(old, new), encoding="utf-8")
    return file


def test_the_page_shows_what_the_check_prints(
    office: Path, repository: Path, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(office.parent)
    said = printed("preset", "check", "office.toml", "-o", "matrix.png")
    page = (repository / "docs" / "presets.md").read_text(encoding="utf-8")
    assert said.splitlines() == shown(page, "preset")
    with Image.open("matrix.png") as picture:
        assert picture.format == "PNG" and picture.width > 1000


def test_a_new_preset_is_a_built_in_one_to_be_changed(tmp_path: Path, printed, refusal) -> None:
    file = tmp_path / "office.toml"
    printed("preset", "new", file, "--like", "ti")
    assert read_preset(file).matrix == read_preset("ti").matrix
    assert "Ticino" in printed("preset", "check", file)
    assert "expected ch-so, ti" in refusal("preset", "new", tmp_path / "b.toml", "--like", "vd")


def test_the_levels_of_events_are_those_of_the_federal_matrix() -> None:
    preset = read_preset("ch-so")
    events = {
        (1.0, 30.0): "mean", (29.9, 100.0): "mean", (29.9, 101.0): "slight",
        (30.0, 30.0): "substantial", (30.0, 31.0): "mean", (299.0, 300.0): "mean",
        (300.0, 300.0): "substantial", (300.0, 301.0): "residual_hazard",
        (5000.0, 10_000.0): "residual_hazard", (5000.0, 10_001.0): "",
    }  # fmt: skip
    energies, years = np.array(list(events)).T
    codes = ["", *(level.code for level in preset.levels)]
    found = [codes[k] for k in levels_of_events(energies, years, preset)]
    assert found == list(events.values())


@pytest.mark.parametrize("name", preset_names())
def test_both_halves_of_the_picture_show_the_matrix(name: str) -> None:
    preset = read_preset(name)
    table, plane = preset_figure(preset).axes
    fields = {own.get_gid(): own for own in table.patches}
    (mesh,) = plane.collections
    values, colours = np.asarray(mesh.get_array()), mesh.get_cmap()
    for y, row in enumerate(preset.matrix):
        for x, place in enumerate(row):
            level, field = preset.levels[place], fields[f"field-{y}-{x}"]
            assert bool(field.get_hatch()) == level.hatched
            shown_as = field.get_edgecolor() if level.hatched else field.get_facecolor()
            assert to_hex(shown_as) == level.colour
            assert place + 1 in values
            if not level.hatched:
                assert to_hex(colours(mesh.norm(place + 1))) == level.colour
    # From a corner of weak and frequent blocks; rare ones have no level.
    assert values[0, 0] == preset.matrix[0][0] + 1 and values[-1, 0] == preset.matrix[-1][0] + 1
    assert (values[:, -1] == 0).all()
    # More energy or more frequency is nowhere a lower level.
    assert (np.diff(values, axis=0) >= 0).all() and (np.diff(values, axis=1) <= 0).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('levels = ["mean", "slight", "residual_hazard"]', 'levels = ["mean", "slight"]',
         "matrix.mean: the row does not have a level for each class of return period (found 2 le"),
        ('years = 5000', 'anni = 5000', "rarest.anni: unknown key"),
        ("[matrix.mean]", "[matrix.medium]", "matrix.medium: row of no intensity class"),
        ('levels = ["substantial", "mean",', 'levels = ["mean", "substantial",',
         "matrix.high: the matrix contradicts itself: a rarer event has a higher level"),
        ('levels = ["mean", "slight",', 'levels = ["residual_hazard", "residual_hazard",',
         "matrix.mean: the matrix contradicts itself: a stronger event has a lower level"),
        ("years = 5000", "years = 100", "rarest.years: is within the classes of return period"),
    ],
)  # fmt: skip
def test_rules_that_cannot_be_are_refused_in_one_line(
    office: Path, refusal, old: str, new: str, message: str
) -> None:
    err = refusal("preset", "check", changed(office, old, new))
    assert message in err and "\n" not in err


def test_what_is_allowed_and_perhaps_not_meant_is_named(office: Path, printed) -> None:
    changed(office, 'colour = "#6a9fe3"', 'colour = "#b3141f"')
    changed(office, 'levels = ["substantial", "mean",', 'levels = ["mean", "mean",')
    changed(office, 'code = "substantial"', 'code = "H4"')
    found = json.loads(printed("preset", "check", office, "--json"))
    assert found["matrix"]["high"] == ["mean", "mean", "residual_hazard"]
    assert found["intensity_kj"] == [0.0, 50.0, 300.0]
    notes = found["notes"]
    assert notes[:2] == [
        "level H4 is in no field of the matrix",
        "levels H3 and H4 have nearly the same colour on maps",
    ]
    assert notes[2].startswith("other codes than those of the federal model 166.1")
