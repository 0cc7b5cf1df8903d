"""Hazard presets: the rules of an authority, built in or from the user's TOML file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache, partial
from importlib import resources
from os import PathLike
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, NotRequired

from pydantic import Field, TypeAdapter, ValidationError

from sassgis.errors import InputError
from sassgis.files.plain_file import read_text, toml_table
from sassgis.inputs.checked import Place, first_error, table_type
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

_Text = Annotated[str, Field(pattern=r"\S")]
_Code = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
_Colour = Annotated[str, Field(pattern=r"^#[0-9A-Fa-f]{6}$")]
_SHEET = ("width_mm", "area_mm2", "gap_mm", "envelope_widths", "smoothing_widths")
#: The keys of the sections of a file.
_SECTIONS: Mapping[str, Mapping[str, Any]] = {
    "sources": {"text": _Text, "verified": bool},
    "intensity": {
        "code": _Code, "label": _Text, "from_kj": float, "colour": _Colour, "source": str,
    },
    "return_periods": {"limits_years": list[float], "source": str},
    "levels": {
        "code": _Code, "label": _Text, "colour": _Colour, "hatched": NotRequired[bool],
        "source": str,
    },
    "matrix": {"levels": list[str], "source": str | list[str]},
    "rarest": {"years": float, "source": str},
    "sheet": {**dict.fromkeys(_SHEET, float), "source": str},
}  # fmt: skip
#: Those that are written with double brackets, and those that may be missing.
_LISTS, _OPTIONAL = ("intensity", "levels"), ("rarest", "sheet")


@cache
def _document() -> TypeAdapter[dict[str, Any]]:
    kinds: dict[str, Any] = {"title": _Text}
    for name, keys in _SECTIONS.items():
        own: Any = table_type(name, keys)
        if name in _LISTS:
            own = GenericAlias(list, own)
        elif name in ("sources", "matrix"):
            own = GenericAlias(dict, (str, own))
        kinds[name] = NotRequired[own] if name in _OPTIONAL else own
    return TypeAdapter(table_type("preset", kinds))


def preset_names() -> tuple[str, ...]:
    """Return names of the presets that come with sassgis."""
    files = (p.name for p in _FOLDER.iterdir() if p.name.endswith(".toml"))
    return tuple(sorted(name.removesuffix(".toml") for name in files))


def preset_text(name: str) -> str:
    """Return the file of a preset that comes with sassgis."""
    return (_FOLDER / f"{name}.toml").read_text(encoding="utf-8")


def read_preset(name: str | PathLike[str], key: str = "preset") -> HazardPreset:
    """Read a hazard preset: one of ``preset_names()``, or a TOML file, whose name it takes.

    docs/presets.md describes such a file. Errors say that ``key`` names it.
    """
    if isinstance(name, str) and name in preset_names():
        return _preset(preset_text(name), name, f"built-in preset {name}")
    path = Path(name)
    if path.suffix.lower() != ".toml" and not os.path.isfile(path):
        expected = f"{nearest(str(name), preset_names())}, or the path of a .toml file"
        raise InputError(
            "is not a known hazard preset", field=key, found=repr(str(name)), expected=expected
        )
    return _preset(read_text(path, key, _WHAT), path.stem, str(path))


def _preset(text: str, name: str, file: str) -> HazardPreset:
    document = toml_table(text, file, _WHAT)
    try:
        content = _document().validate_python(document)
    except ValidationError as error:
        raise first_error(
            error, file, document, _LISTS, _nearest, named_by="code", expected=_expected
        ) from None
    known = {k: Provenance(s["text"].strip(), s["verified"]) for k, s in content["sources"].items()}
    refer = partial(refuse_unknown, file=file)

    def source(key: str, where: str) -> Provenance:
        problem = "names a source that is not defined"
        refer(key, list(known), problem, field=f"{where}.source")
        return known[key]

    def entries(section: str, kind: Any, **usual: Any) -> tuple[Any, ...]:
        """Return the entries of a section, each with its source."""
        found = []
        for entry in content[section]:
            own = {**usual, **entry}
            key = own.pop("source")
            found.append(kind(**own, provenance=source(key, f"{section}[{own['code']}]")))
        return tuple(found)

    intensities = entries("intensity", IntensityClass)
    levels = entries("levels", HazardLevel, hatched=False)
    rows = _rows_of(content["matrix"], [c.code for c in intensities], file)
    codes = [c.code for c in levels]
    for where, row in rows.items():
        for code in row["levels"]:
            refer(code, codes, "names no level", field=f"{where}.levels")
    periods, rarest = content["return_periods"], content.get("rarest")
    if sheet := content.get("sheet"):
        key = sheet.pop("source")
        sheet_rules: SheetRules | None = SheetRules(**sheet, provenance=source(key, "sheet"))
    else:
        # Rules that say nothing of sheets: those that come with sassgis.
        sheet_rules = read_preset("ch-so").sheet
    return HazardPreset(
        name=name,
        title=content["title"].strip(),
        intensities=intensities,
        return_periods=tuple(periods["limits_years"]),
        return_period_provenance=source(periods["source"], "return_periods"),
        levels=levels,
        matrix=tuple(tuple(codes.index(code) for code in row["levels"]) for row in rows.values()),
        matrix_provenance=tuple(
            tuple(
                source(key, where)
                for key in _sources_of(row, len(periods["limits_years"]) + 1, where, file)
            )
            for where, row in rows.items()
        ),
        file=file,
        rarest_years=rarest and rarest["years"],
        rarest_provenance=rarest and source(rarest["source"], "rarest"),
        sheet=sheet_rules,
    )


def _rows_of(matrix: Mapping[str, Any], known: list[str], file: str) -> dict[str, Any]:
    """Return rows of the matrix by their place in the file, in the order of the intensities."""
    for code in matrix:
        problem = "row of no intensity class"
        refuse_unknown(code, known, problem, file=file, field=f"matrix.{code}")
    for code in known:
        if code not in matrix:
            raise InputError(
                "the matrix has a hole: no row for an intensity class",
                file=file,
                field="matrix",
                found=", ".join(matrix) or "no row",
                expected=f"a section [matrix.{code}]",
            )
    return {f"matrix.{code}": matrix[code] for code in known}


def _sources_of(row: Mapping[str, Any], classes: int, where: str, file: str) -> list[str]:
    """Return the source of each level of a row; a row with a hole is refused for that later."""
    given, levels = row["source"], len(row["levels"])
    if isinstance(given, str) or levels != classes:
        return [given if isinstance(given, str) else given[0]] * levels
    sources: list[str] = given
    if len(sources) != levels:
        raise InputError(
            "does not have a source for each level", file=file, field=f"{where}.source",
            found=f"{len(sources)} sources", expected=f"one source for all, or {levels}",
        )  # fmt: skip
    return sources


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


def _nearest(loc: Place) -> str:
    """Return the known key that an unknown one was probably meant to be."""
    known = _SECTIONS[str(loc[0])] if len(loc) > 1 else ("title", *_SECTIONS)
    return nearest(str(loc[-1]), list(known))


def _expected(loc: Place, kind: str) -> str | None:
    key = str(loc[-1])
    if kind == "missing":
        in_matrix = loc[0] == "matrix" and key == "levels"
        return "a level for each class of return period" if in_matrix else _KEYS.get(key)
    if kind == "string_pattern_mismatch":
        return _KEYS[key] if key in ("code", "colour") else "a text that is not empty"
    if kind == "list_type" and key in _LISTS and len(loc) == 1:
        return f"sections [[{key}]], with double brackets"
    return _KEYS.get(str(loc[0]), "a section") if kind in ("model_type", "dict_type") else None
