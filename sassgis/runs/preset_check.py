"""Whether the rules of an office are complete, do what is written, and can be read on a map."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.errors import InputError
from sassgis.files.atomic_output import staged_file, write_new
from sassgis.hazard.levels import energy_labels, levels_of_events, period_labels, preset_unverified
from sassgis.inputs.presets import preset_names, preset_text, read_preset
from sassgis.outputs.swiss.federal_model import has_federal_codes
from sassgis.report.figures.hazard_figures import preset_figure
from sassgis.report.figures.style import to_png
from sassgis.settings.hazard_rules import HazardLevel, HazardPreset
from sassgis.settings.results import thousands
from sassgis.settings.styles import rgb

#: Colours closer than this (of 255, mean of red, green and blue) look alike on a sheet: our choice.
_ALIKE = 20.0


@dataclass(frozen=True, slots=True)
class PresetReport:
    """A preset that was read, and what to check."""

    preset: HazardPreset
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the report for people, line by line."""
        own = self.preset
        names = [(c.label, span) for c, span in zip(
            own.intensities, energy_labels(own), strict=True)]  # fmt: skip
        head = ["", "", *period_labels(own.return_periods)]
        rows = [
            [*name, *(own.levels[k].label for k in row)]
            for name, row in zip(names, own.matrix, strict=True)
        ]
        table = [head, *reversed(rows)]
        widths = [max(len(row[k]) for row in table) for k in range(len(head))]
        out = [f"{own.name}: {own.title}", ""]
        out += [
            "  ".join(f"{text:<{w}}" for text, w in zip(row, widths, strict=True)).rstrip()
            for row in table
        ]
        fields = sum(map(len, own.matrix))
        rarest = own.rarest_years
        none = "" if rarest is None else f", no level beyond {thousands(rarest)} years"
        return [
            *out,
            "",
            f"good  complete: {fields} fields{none}",
            "good  more intensity or more frequency never gives a lower level",
            "good  each field is computed as it is written",
            *(f"look  {text}" for text in self.notes),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return the report for programs."""
        own = self.preset
        matrix = {
            c.code: [own.levels[k].code for k in row]
            for c, row in zip(own.intensities, own.matrix, strict=True)
        }
        return {
            "name": own.name, "title": own.title, "intensity_kj": list(own.thresholds_kj),
            "return_periods_years": list(own.return_periods), "rarest_years": own.rarest_years,
            "matrix": matrix, "notes": list(self.notes),
        }  # fmt: skip


def check_preset(name: str) -> PresetReport:
    """Read a preset (a TOML file, or a built-in one) and compute each field of its matrix.

    InputError if it is incomplete, contradicts itself, or a field is not what is written.
    """
    preset = read_preset(name)
    computed = _computed(preset)
    for intensity, row, own in zip(preset.intensities, preset.matrix, computed, strict=True):
        if list(row) != own:
            raise InputError(
                "is not computed as it is written", file=preset.file,
                field=f"matrix.{intensity.code}",
                found=", ".join(preset.levels[k].code for k in own),
                expected=", ".join(preset.levels[k].code for k in row),
            )  # fmt: skip
    return PresetReport(preset, tuple(_notes(preset)))


def write_preset_figure(file: Path, report: PresetReport, overwrite: bool = False) -> None:
    """Draw the matrix and what is computed by it as PNG."""
    with staged_file(file, overwrite) as work:
        work.write_bytes(to_png(preset_figure(report.preset)))


def new_preset(file: Path, like: str, overwrite: bool = False) -> None:
    """Write a built-in preset to a file, to be changed."""
    if file.suffix.lower() != ".toml":
        raise InputError("is no preset", file=file, expected="a name ending in .toml")
    if like not in preset_names():
        found = ", ".join(preset_names())
        raise InputError("is no built-in preset", field="--like", found=like, expected=found)
    write_new(file, preset_text(like), overwrite)


def _computed(preset: HazardPreset) -> list[list[int]]:
    """Return the level of each field: at the lower limit of its energy, its last return period."""
    last = preset.rarest_years or 2.0 * preset.return_periods[-1]
    years = np.array([*preset.return_periods, last])
    return [
        (levels_of_events(np.full(years.size, energy), years, preset) - 1).tolist()
        for energy in preset.thresholds_kj
    ]


def _notes(preset: HazardPreset) -> list[str]:
    """Return what is allowed, and perhaps not meant."""
    used = {k for row in preset.matrix for k in row}
    unused = [c.label for k, c in enumerate(preset.levels) if k not in used]
    notes = [f"level {label} is in no field of the matrix" for label in unused]
    notes += [
        f"levels {a.label} and {b.label} have nearly the same colour on maps"
        for a, b in combinations(preset.levels, 2)
        if _alike(a, b)
    ]
    if not has_federal_codes(preset):
        notes.append("other codes than those of the federal model 166.1, to which it has no export")
    return [*notes, *map(str, preset_unverified(preset))]


def _alike(one: HazardLevel, other: HazardLevel) -> bool:
    apart = np.abs(np.subtract(rgb(one.colour), rgb(other.colour))).mean()
    return one.hatched == other.hatched and bool(apart < _ALIKE)
