from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.hazard_samples import swiss
from helpers.one_line import one_line

from sassgis.errors import InputError
from sassgis.hazard.levels import (
    energy_labels,
    period_labels,
    preset_unverified,
    unverified_in_short,
)
from sassgis.inputs.presets import preset_names, read_preset
from sassgis.settings.hazard_rules import Drawing, ZoningSettings

LEVELS = ("residual_hazard", "slight", "mean", "substantial")
FEDERAL = {
    "low": ("mean", "mean", "slight", "residual_hazard"),
    "mean": ("substantial", "mean", "mean", "residual_hazard"),
    "high": ("substantial", "substantial", "substantial", "residual_hazard"),
}


@pytest.mark.parametrize("name", preset_names())
def test_what_the_built_in_presets_share(name: str) -> None:
    preset = read_preset(name)
    assert preset.name == name
    assert preset.thresholds_kj == (0.0, 30.0, 300.0)
    assert preset.return_periods == (30.0, 100.0, 300.0)
    assert tuple(c.code for c in preset.intensities) == ("low", "mean", "high")
    assert tuple(c.code for c in preset.levels) == LEVELS
    assert [c.hatched for c in preset.levels] == [True, False, False, False]
    # Colours of intensities are none of the levels'.
    assert not {c.colour for c in preset.intensities} & {c.colour for c in preset.levels}
    provenances = [
        *(c.provenance for c in preset.intensities),
        *(c.provenance for c in preset.levels),
        preset.return_period_provenance,
        *(p for row in preset.matrix_provenance for p in row),
    ]
    assert all(p.source for p in provenances)
    matrix = {
        c.code: tuple(preset.levels[k].code for k in row)
        for c, row in zip(preset.intensities, preset.matrix, strict=True)
    }
    assert matrix == FEDERAL
    labels = [c.label for c in preset.levels]
    assert (labels == ["residuo", "basso", "medio", "elevato"]) == (name == "ti")


def test_unverified_values_are_told_once_per_source() -> None:
    limits, ours = preset_unverified(read_preset("ch-so"))
    assert limits.startswith("Preset ch-so, unverified: intensity low, intensity medium, ")
    assert ours.startswith(
        "Preset ch-so, unverified: no level beyond 10\u202f000 years, "
        "zones of at least 2 mm and 40 mm² on the sheet. Our choice"
    )
    ticino = preset_unverified(read_preset("ti"))
    assert [line.split(". ")[0] for line in ticino] == [
        "Preset ti, unverified: intensity bassa, intensity media, intensity alta",
        "Preset ti, unverified: no level beyond 10\u202f000 years, "
        "zones of at least 2 mm and 40 mm² on the sheet",
        "Preset ti, unverified: the whole matrix",
    ]
    assert unverified_in_short(read_preset("ti")) == [
        "Preset ti, unverified: intensity bassa, intensity media, intensity alta, no level beyond "
        "10\u202f000 years, zones of at least 2 mm and 40 mm² on the sheet, the whole matrix. "
        "See the report."
    ]


def test_labels() -> None:
    assert period_labels((30.0, 100.0)) == ("up to 30", "30 to 100", "beyond 100")
    assert period_labels((50.0,)) == ("up to 50", "beyond 50")
    assert energy_labels(swiss()) == ("below 30 kJ", "30 to 300 kJ", "300 kJ and more")


OWN = """
title = "Own rules"

[sources.directive]
text = "Directive 12, p. 4"
verified = true

[sources.habit]
text = "What we have always done"
verified = false

[[intensity]]
code = "weak"
label = "weak"
from_kj = 0
colour = "#aaaaaa"
source = "directive"

[[intensity]]
code = "strong"
label = "strong"
from_kj = 100
colour = "#333333"
source = "directive"

[return_periods]
limits_years = [50]
source = "directive"

[[levels]]
code = "H2"
label = "H2"
colour = "#ffff00"
source = "directive"

[[levels]]
code = "H4"
label = "H4"
colour = "#ff0000"
hatched = true
source = "directive"

[matrix.weak]
levels = ["H2", "H2"]
source = "habit"

[matrix.strong]
levels = ["H4", "H2"]
source = ["directive", "habit"]
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "own.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_own_preset(tmp_path: Path) -> None:
    file = written(tmp_path, OWN)
    preset = read_preset(file)
    assert preset == read_preset(str(file))
    assert (preset.name, preset.title, preset.file) == ("own", "Own rules", str(file))
    assert preset.thresholds_kj == (0.0, 100.0)
    assert preset.return_periods == (50.0,)
    assert preset.matrix == ((0, 0), (1, 0))
    assert [c.hatched for c in preset.levels] == [False, True]
    verified = [[p.verified for p in row] for row in preset.matrix_provenance]
    assert verified == [[False, False], [True, False]]
    ours, own = preset_unverified(preset)
    assert own == "Preset own, unverified: 3 of 4 fields of the matrix. What we have always done."
    # Rules that say nothing of sheets take those that come with sassgis.
    assert ours.startswith("Preset own, unverified: zones of at least 2 mm and 40 mm² on the sheet")
    assert preset.sheet == read_preset("ch-so").sheet


SHEET = """
[sheet]
width_mm = 1
area_mm2 = 25
gap_mm = 2
envelope_widths = 5
smoothing_widths = 2
source = "directive"
"""
RAREST = '[rarest]\nyears = 60\nsource = "habit"\n'


def test_own_rules_of_the_sheet(tmp_path: Path) -> None:
    assert read_preset(written(tmp_path, OWN + RAREST)).rarest_years == 60.0
    preset = read_preset(written(tmp_path, OWN + SHEET))
    drawing = ZoningSettings(scale=10_000.0).drawing(preset.sheet, 8.0, 3.0, 2.0)
    assert drawing == Drawing(10.0, 2500.0, 20.0, 40.0, 16.0, 3.0, 10_000.0)
    assert len(preset_unverified(preset)) == 1
    # Keys of the configuration come before the rules; wide spacing before the closing.
    own = ZoningSettings(10_000.0, min_width_m=4.0, tolerance_m=1.0)
    expected = Drawing(4.0, 2500.0, 30.0, 40.0, 16.0, 1.0, 10_000.0)
    assert own.drawing(preset.sheet, 8.0, 30.0, 2.0) == expected


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('title = "Own', 'titel = "Own', "titel: unknown key (expected one of title, sources"),
        ('title = "Own rules"', "", "title: missing key (expected a line that says whose"),
        ('title = "Own rules"', "title = 3", "title: cannot be used (found 3; expected a text"),
        ("from_kj = 100\n", "", "intensity[strong].from_kj: missing key (expected the lower limit"),
        ("from_kj = 100", "from_kJ = 100",
         "intensity[strong].from_kJ: unknown key (expected one of code, label, from_kj, colour, "
         "source (nearest: from_kj)) (and 1 more)"),
        ("from_kj = 100", 'from_kj = "100"', "intensity[strong].from_kj: cannot be used (found"),
        ("from_kj = 100", "from_kj = inf", "found inf; expected a finite number"),
        ("from_kj = 100", "from_kj = 0",
         "intensity: limits of the intensity classes do not rise from 0 (found [0.0, 0.0]"),
        ('"#aaaaaa"', '"grey"', "intensity[weak].colour: cannot be used (found 'grey'; expected a"),
        ('code = "H4"', 'code = ""', "levels[no. 2].code: cannot be used (found ''; expected a l"),
        ('[[levels]]\ncode = "H4"',
         '[[levels]]\ncode = "H2"\nlabel = "again"\ncolour = "#ffffff"\nsource = "habit"\n'
         '[[levels]]\ncode = "H4"', "levels: a code is used twice (found ['H2', 'H2', 'H4']"),
        ('label = "H4"', 'label = " "', "levels[H4].label: cannot be used"),
        ("hatched = true", 'hatched = "yes"', "levels[H4].hatched: cannot be used (found 'yes'; e"),
        ("verified = true", "", "sources.directive.verified: missing key (expected true if the"),
        ('colour = "#ff0000"', 'colour = "#ff0000"\nline = 1', "levels[H4].line: unknown key"),
        ("limits_years = [50]", "limits_years = [50, 20]", "return_periods: limits of the return"),
        ("limits_years = [50]", "limits_years = 50", "found 50; expected a list in [ ]"),
        ("limits_years = [50]", "limits_years = [50, 55]",
         "matrix.weak: the row does not have a level for each class of return period (found 2 le"),
        ('["H4", "H2"]', '["H4"]', "class of return period (found 1 levels; expected 2)"),
        ('["H4", "H2"]\nsource = ["directive", "habit"]', '["H4"]\nsource = "habit"',
         "class of return period (found 1 levels; expected 2)"),
        ('["H4", "H2"]', '["H5", "H2"]', "matrix.strong.levels: names no level (found 'H5'; exp"),
        ('["H4", "H2"]', '["H2", "H4"]', "a rarer event has a higher level"),
        ('["H2", "H2"]', '["H4", "H4"]', "a stronger event has a lower level"),
        ("[matrix.strong]", "[matrix.storng]",
         "matrix.storng: row of no intensity class (found 's"),
        ('[matrix.weak]\nlevels = ["H2", "H2"]\nsource = "habit"', "",
         "matrix: the matrix has a hole: no row for an intensity class (found strong; expected "
         "a section [matrix.weak])"),
        ('"H2"]\nsource = "habit"', '"H2"]\nsource = "habits"',
         "matrix.weak.source: names a source that is not defined (found 'habits'; expected one "
         "of directive, habit (nearest: habit))"),
        ('["directive", "habit"]', "7", "matrix.strong.source: cannot be used (found 7"),
        ("[return_periods]", "[[return_periods]]", "return_periods: cannot be used"),
        ("[[levels]]", "[[x]]", "x: unknown key (expected one of title, sources"),
        ("width_mm = 1", "width_mm = -1", "sheet.width_mm: is below 0 (found -1; expected 0 or"),
        ("gap_mm = 2\n", "", "sheet.gap_mm: missing key (expected the widest gap that is closed"),
        ("years = 60", "years = 40",
         "rarest.years: is within the classes of return period (found 40; expected more than 50"),
    ],
)  # fmt: skip
def test_bad_presets_are_told_in_one_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    text = OWN + SHEET + RAREST
    assert old in text
    file = written(tmp_path, text.replace(old, new))
    with one_line(InputError, message, match=f"^{re.escape(str(file))}: (?!.*pydantic)"):
        read_preset(file)


def test_unknown_names(tmp_path: Path) -> None:
    known = "preset: is not a known hazard preset (found 'ch-s"
    with one_line(InputError, known, "expected one of ch-so, ti", "nearest: ch-so"):
        read_preset("ch-solo")
    # A file whose name is not .toml is read all the same.
    file = tmp_path / "rules.txt"
    file.write_text(OWN)
    assert read_preset(file).name == "rules"
