"""Hazard presets: the rules of an authority, built in or from the user's TOML file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sassgis.errors import InputError
from sassgis.files.plain_file import read_text, toml_table
from sassgis.inputs.checked import Messages, Place, first_of
from sassgis.inputs.vector_features import nearest, refuse_unknown
from sassgis.settings.hazard_rules import (
    HazardLevel,
    HazardPreset,
    IntensityClass,
    Provenance,
    SheetRules,
)

_WHAT = "a hazard preset, TOML"
_FOLDER = resources.files("sassgis") / "data" / "presets"


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


_Text = Annotated[str, Field(pattern=r"\S")]
_Code = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
_Colour = Annotated[str, Field(pattern=r"^#[0-9A-Fa-f]{6}$")]
_Number = Annotated[float, Field(allow_inf_nan=False)]


class _Source(_Section):
    text: _Text
    verified: bool


class _Intensity(_Section):
    code: _Code
    label: _Text
    from_kj: _Number
    colour: _Colour
    source: str


class _ReturnPeriods(_Section):
    limits_years: list[_Number]
    source: str


class _Rarest(_Section):
    years: _Number
    source: str


class _Sheet(_Section):
    width_mm: _Number
    area_mm2: _Number
    gap_mm: _Number
    envelope_widths: _Number
    smoothing_widths: _Number
    source: str


class _Level(_Section):
    code: _Code
    label: _Text
    colour: _Colour
    hatched: bool = False
    source: str


class _Row(_Section):
    levels: list[str]
    source: str | list[str]


class _File(_Section):
    title: _Text
    sources: dict[str, _Source]
    intensity: list[_Intensity]
    return_periods: _ReturnPeriods
    levels: list[_Level]
    matrix: dict[str, _Row]
    rarest: _Rarest | None = None
    sheet: _Sheet | None = None


def preset_names() -> tuple[str, ...]:
    """Return names of the presets that come with sassgis."""
    files = (p.name for p in _FOLDER.iterdir() if p.name.endswith(".toml"))
    return tuple(sorted(name.removesuffix(".toml") for name in files))


def read_preset(name: str | PathLike[str]) -> HazardPreset:
    """Read a hazard preset: one of ``preset_names()``, or a TOML file, whose name it takes.

    docs/presets.md describes such a file.
    """
    if isinstance(name, str) and name in preset_names():
        text = (_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
        return _preset(text, name, f"built-in preset {name}")
    path = Path(name)
    if path.suffix.lower() != ".toml" and not os.path.isfile(path):
        expected = f"{nearest(str(name), preset_names())}, or the path of a .toml file"
        raise InputError(
            "is not a known hazard preset", field="preset", found=repr(str(name)), expected=expected
        )
    return _preset(read_text(path, "preset", _WHAT), path.stem, str(path))


# ---------------------------------------------------------------------------------------------
# From the text to the type


def _preset(text: str, name: str, file: str) -> HazardPreset:
    document = toml_table(text, file, _WHAT)
    try:
        content = _File.model_validate(document)
    except ValidationError as error:
        messages = Messages(file, document, _LISTS, _nearest, named_by="code", expected=_expected)
        raise first_of(messages.of(error)) from None
    return _Reading(content, file).preset(name)


class _Reading:
    """Objects to which the names within a file refer."""

    def __init__(self, content: _File, file: str) -> None:
        self._content = content
        self._file = file
        self._sources = {
            k: Provenance(s.text.strip(), s.verified) for k, s in content.sources.items()
        }

    def preset(self, name: str) -> HazardPreset:
        content, source = self._content, self._source
        intensities = []
        for c in content.intensity:
            own = source(c.source, f"intensity[{c.code}]")
            intensities.append(IntensityClass(c.code, c.label, c.from_kj, c.colour, own))
        levels = []
        for k in content.levels:
            own = source(k.source, f"levels[{k.code}]")
            levels.append(HazardLevel(k.code, k.label, k.colour, k.hatched, own))
        known = [c.code for c in intensities]
        for code in content.matrix:
            self._refer(code, known, "row of no intensity class", f"matrix.{code}")
        for code in known:
            if code not in content.matrix:
                raise InputError(
                    "the matrix has a hole: no row for an intensity class", file=self._file,
                    field="matrix", found=", ".join(content.matrix) or "no row",
                    expected=f"a section [matrix.{code}]",
                )  # fmt: skip
        rows = [(content.matrix[code], f"matrix.{code}") for code in known]
        periods, rarest = content.return_periods, content.rarest
        return HazardPreset(
            name,
            content.title.strip(),
            tuple(intensities),
            tuple(periods.limits_years),
            source(periods.source, "return_periods"),
            tuple(levels),
            tuple(self._levels(*row) for row in rows),
            tuple(self._fields(*row) for row in rows),
            self._file,
            None if rarest is None else rarest.years,
            None if rarest is None else source(rarest.source, "rarest"),
            self._sheet(content.sheet),
        )

    def _sheet(self, sheet: _Sheet | None) -> SheetRules | None:
        # Rules that say nothing of sheets: those that come with sassgis.
        if sheet is None:
            return read_preset("ch-so").sheet
        own = sheet.model_dump(exclude={"source"})
        return SheetRules(**own, provenance=self._source(sheet.source, "sheet"))

    def _source(self, key: str, where: str) -> Provenance:
        problem = "names a source that is not defined"
        self._refer(key, list(self._sources), problem, f"{where}.source")
        return self._sources[key]

    def _levels(self, row: _Row, where: str) -> tuple[int, ...]:
        codes = [c.code for c in self._content.levels]
        for code in row.levels:
            self._refer(code, codes, "names no level", f"{where}.levels")
        return tuple(codes.index(code) for code in row.levels)

    def _fields(self, row: _Row, where: str) -> tuple[Provenance, ...]:
        if isinstance(row.source, str):
            return (self._source(row.source, where),) * len(row.levels)
        if len(row.source) != len(row.levels):
            raise InputError(
                "does not have a source for each level", file=self._file, field=f"{where}.source",
                found=f"{len(row.source)} sources",
                expected=f"one source for all, or {len(row.levels)}",
            )  # fmt: skip
        return tuple(self._source(key, where) for key in row.source)

    def _refer(self, name: str, known: list[str], problem: str, field: str) -> None:
        refuse_unknown(name, known, problem, file=self._file, field=field)


# ---------------------------------------------------------------------------------------------
# From what pydantic finds to one line

_MODELS: Mapping[str, type[BaseModel]] = {
    "sources": _Source,
    "intensity": _Intensity,
    "return_periods": _ReturnPeriods,
    "levels": _Level,
    "matrix": _Row,
    "rarest": _Rarest,
    "sheet": _Sheet,
}
_LISTS = ("intensity", "levels")
_KEYS = {
    "title": "a line that says whose rules these are",
    "sources": "sections [sources.KEY] with text and verified",
    "intensity": "a section [[intensity]] per class, from weak to strong",
    "return_periods": "a section [return_periods]",
    "levels": "a section [[levels]] per level, from low to high",
    "matrix": "a section [matrix.CODE] per intensity class",
    "text": "the publication, with page or section where known",
    "verified": "true if the value was read in the source, false if not",
    "code": "a letter, then letters, digits and _",
    "label": "the name on maps",
    "from_kj": "the lower limit of the energy (kJ), 0 for the lowest class",
    "colour": 'a colour such as "#d7262b"',
    "source": "the KEY of one of the sections [sources.KEY]",
    "years": "the return period (years) beyond which there is no level",
    "width_mm": "the least width of a zone on the sheet (mm)",
    "area_mm2": "the smallest zone on the sheet (mm²)",
    "gap_mm": "the widest gap that is closed on the sheet (mm)",
    "envelope_widths": "the widest gap in the outer limit that is closed (reference widths)",
    "smoothing_widths": "the width over which its frequency is averaged (reference widths)",
    "limits_years": "upper limits of the classes of return period, such as [30, 100, 300]",
}


def _meaning(loc: Place) -> str | None:
    if loc[0] == "matrix" and loc[-1] == "levels":
        return "a level for each class of return period"
    return _KEYS.get(str(loc[-1]))


def _nearest(loc: Place) -> str:
    """Return the known key that an unknown one was probably meant to be."""
    model = _MODELS[str(loc[0])] if len(loc) > 1 else _File
    return nearest(str(loc[-1]), list(model.model_fields))


def _expected(loc: Place, kind: str) -> str | None:
    key = str(loc[-1])
    if kind == "missing":
        return _meaning(loc)
    if kind == "string_pattern_mismatch":
        return _KEYS[key] if key in ("code", "colour") else "a text that is not empty"
    if kind == "list_type" and key in _LISTS and len(loc) == 1:
        return f"sections [[{key}]], with double brackets"
    return _KEYS.get(str(loc[0]), "a section") if kind in ("model_type", "dict_type") else None
