"""Hazard zones as an INTERLIS 2 transfer file (XTF), by the model files or by default names.

Sources: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3), chapter 3; the
Federal Office for the Environment's minimal geodata model 166.1:
:mod:`sassgis.io.write.layers.federal_model`.
"""

from __future__ import annotations

import json
import os
import re
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError

from sassgis.io.interlis.mapping import ClassPlan, Slot, code_of, default_plan, plan_of
from sassgis.io.interlis.validation import ValidationResult, check_xtf, validate_xtf
from sassgis.io.interlis.xtf_document import XtfObject, document
from sassgis.io.staging import MANIFEST_NAME, writing
from sassgis.io.write.layers.federal_model import (
    DECIMALS,
    FEDERAL_CLASSES,
    FEDERAL_EPSG,
    NOT_ASSESSED,
    FederalClass,
    is_lv95,
)
from sassgis.io.write.layers.federal_values import (
    check_extent,
    checked_values,
    surface_parts,
)
from sassgis.model.errors import ConfigError, InputError, OutputError

__all__ = ["ExportResult", "XtfSummary", "export_xtf", "validate_xtf", "write_xtf"]

PACKAGE_NAME = "hazard.gpkg"
_NAMESPACE = uuid.UUID("0a5f4c7e-6f0b-5d0e-9b56-1b6d1c8c7d15")
#: Characters that XML cannot hold.
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class XtfSummary:
    """What was written.

    Attributes
    ----------
    path : Path
    model : str
        Name of the model.
    from_model : bool
        Whether names come from the model's files, rather than from defaults.
    objects : mapping of str to int
        Objects by layer.
    notes : tuple of str
        What does not match, was left out or filled in.
    """

    path: Path
    model: str
    from_model: bool
    objects: Mapping[str, int]
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """The summary in words."""
        counts = ", ".join(f"{name} {count}" for name, count in self.objects.items())
        return [f"Wrote {self.path}, model {self.model}: {counts}.", *self.notes]


@dataclass(frozen=True, slots=True)
class ExportResult:
    """A transfer file that was written, and what the validator says of it if it was asked."""

    summary: XtfSummary
    validation: ValidationResult | None

    @property
    def accepted(self) -> bool:
        """Whether the validator accepted the file, or was not asked."""
        return self.validation is None or self.validation.valid

    def lines(self) -> list[str]:
        """Summary and verdict in words."""
        return [*self.summary.lines(), *(self.validation.lines() if self.validation else ())]


def export_xtf(
    result_folder: Path,
    xtf: Path,
    models: Path | None = None,
    validate: bool = False,
    *,
    canton: str | None = None,
    overwrite: bool = False,
) -> ExportResult:
    """Write the hazard zones of a result as INTERLIS transfer file.

    Parameters
    ----------
    result_folder : Path
        Result of a run with hazard zones.
    xtf : Path
        File to write.
    models : Path, optional
        Folder with the files of the federal model and of all models that it imports.
    validate : bool
        Whether to let the validator check the file; needs ``models``.
    canton : str, optional
        Who is responsible for the data ("TI"), where the layer of assessment areas does not say.
    overwrite : bool
        Whether a file that is there may be replaced.

    Returns
    -------
    ExportResult
        A file that the validator refuses is written all the same: see ``accepted``.

    Raises
    ------
    InputError
        If the folder is no result, has no hazard zones, lies outside Switzerland, a value is not as
        the model has it, the models cannot be used, or the validator is not installed.
    ConfigError
        If it is to be validated without models.
    OutputError
        If the file exists or cannot be written, or the validator breaks down.
    """
    if validate and models is None:
        raise ConfigError(
            "validation needs the files of the model", field="models", expected="their folder"
        )
    if not (result_folder / MANIFEST_NAME).is_file():
        raise InputError(
            "is not a result of sassgis",
            file=result_folder,
            expected=f"a folder with {MANIFEST_NAME}",
        )
    package = result_folder / PACKAGE_NAME
    if not package.is_file():
        raise InputError(
            "this result has no hazard zones",
            file=result_folder,
            expected=f"{PACKAGE_NAME} in it, which a run of hazard zones writes",
        )
    summary = write_xtf(package, xtf, model_folder=models, canton=canton, overwrite=overwrite)
    verdict = validate_xtf(xtf, models) if validate and models is not None else None
    return ExportResult(summary, verdict)


def write_xtf(
    geopackage_path: Path,
    xtf_path: Path,
    *,
    model_folder: Path | None,
    canton: str | None = None,
    language: str = "en",
    overwrite: bool = False,
) -> XtfSummary:
    """Write the five layers of the federal model as INTERLIS 2.3 transfer file.

    Equal layers give equal files: the identifiers of objects are made from what they hold.

    Parameters
    ----------
    geopackage_path : Path
        With the layers of :data:`sassgis.io.write.layers.federal_model.FEDERAL_CLASSES`.
    xtf_path : Path
    model_folder : Path or None
        Folder with the model's .ili files, from which all names, the order of attributes and the
        codes are taken; None: default names, which are unverified.
    canton, overwrite
        As for :func:`export_xtf`.
    language : str
        Of texts, where the model has them in several languages.

    Returns
    -------
    XtfSummary

    Raises
    ------
    InputError
        If the layers or the models cannot be used.
    OutputError
        If the file exists or cannot be written.
    """
    if xtf_path.exists() and not overwrite:
        raise OutputError(f"{xtf_path}: exists; choose another name, or --overwrite")
    plan = default_plan() if model_folder is None else plan_of(model_folder, language)
    layers = {
        name: _read_layer(geopackage_path, kind, plan.from_model, canton)
        for name, kind in FEDERAL_CLASSES.items()
    }
    notes = list(plan.notes)
    objects = {
        name: _objects(kind, plan.classes[name], layers[name], geopackage_path, notes)
        for name, kind in FEDERAL_CLASSES.items()
        if name in plan.classes
    }
    for name, rows in layers.items():
        if name in plan.classes:
            continue
        if rows:
            raise InputError(
                f"the model {plan.model.name} has no class for the layer {name}",
                file=model_folder,
                found=", ".join(plan.known_classes),
                expected=f"a class {name}, whatever its case and underscores",
            )
        notes.append(f"The model has no class for the layer {name}, which is empty.")
    partial = xtf_path.with_name(xtf_path.name + ".partial")
    with writing(xtf_path):
        xtf_path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with partial.open("w", encoding="utf-8", newline="\n") as stream:
                stream.writelines(document(plan, objects, _NAMESPACE))
            problems = check_xtf(partial)
            if problems:  # pragma: no cover
                raise OutputError(f"{xtf_path}: not written, a fault of sassgis: {problems[0]}")
            os.replace(partial, xtf_path)
        finally:
            partial.unlink(missing_ok=True)
    return XtfSummary(
        xtf_path,
        plan.model.name,
        plan.from_model,
        {name: len(found) for name, found in objects.items()},
        tuple(dict.fromkeys(notes)),
    )


# --- layers ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Row:
    where: str
    values: dict[str, Any]
    polygons: list[Any]


def _read_layer(file: Path, kind: FederalClass, from_model: bool, canton: str | None) -> list[_Row]:
    try:
        frame = pyogrio.read_dataframe(file, layer=kind.name, fid_as_index=True)
    except DataLayerError:
        raise InputError("layer is missing", file=file, field=kind.name) from None
    except DataSourceError as error:
        raise InputError("cannot be read", file=file, found=str(error)) from error
    if not isinstance(frame, gpd.GeoDataFrame):
        raise InputError("layer has no zones", file=file, field=kind.name, expected="polygons")
    if not is_lv95(frame.crs):
        raise InputError(
            "the federal model is for Switzerland only",
            file=file,
            field=kind.name,
            found="local coordinates" if frame.crs is None else frame.crs.name,
            expected=f"coordinates in EPSG:{FEDERAL_EPSG}",
        )
    if absent := [a.name for a in kind.attributes if a.verified and a.name not in frame]:
        raise InputError(
            "column is missing", file=file, field=f"{kind.name}.{absent[0]}", expected="it"
        )
    check_extent(frame.geometry.dropna().to_numpy(), field=kind.name, file=file)
    rows = []
    for number, (record, geometry) in enumerate(
        zip(frame.drop(columns="geometry").to_dict("records"), frame.geometry, strict=True)
    ):
        where = f"feature {frame.index[number]}"
        values: dict[str, Any] = {str(key): value for key, value in record.items()}
        if kind.name == "assessment_area":
            _complete_area(values, canton)
        # The codes of the model's own files go before those that are known here.
        checked = checked_values(kind, values, where, federal=not from_model, file=file)
        polygons = surface_parts(geometry, where=f"{kind.name}, {where}", file=file)
        if polygons:
            rows.append(_Row(where, checked, polygons))
    return rows


def _complete_area(values: dict[str, Any], canton: str | None) -> None:
    given = values.get("data_responsibility")
    if canton and (given is None or given != given or not str(given).strip()):
        values["data_responsibility"] = canton
    for attribute in FEDERAL_CLASSES["assessment_area"].attributes:
        if not attribute.verified:
            values.setdefault(attribute.name, NOT_ASSESSED)


# --- objects ---------------------------------------------------------------------------------


def _objects(
    layer: FederalClass,
    plan: ClassPlan,
    rows: Sequence[_Row],
    file: Path,
    notes: list[str],
) -> list[XtfObject]:
    zone = next(slot for slot in plan.slots if slot.geometry)
    together = any(step.many for step in zone.steps)
    _note_left_out(layer, plan, rows, notes)
    seen: dict[str, int] = {}
    objects: list[XtfObject] = []
    for row in rows:
        texts = {
            slot.name: text
            for slot in plan.slots
            if not slot.geometry and (text := _text_of(slot, row, layer.name, file)) is not None
        }
        polygons = [
            part
            for polygon in row.polygons
            for part in (
                [polygon]
                if zone.decimals == DECIMALS
                else surface_parts(polygon, where=row.where, file=file, decimals=zone.decimals)
            )
        ]
        for group in [polygons] if together else [[p] for p in polygons]:
            if not group:
                continue
            content = json.dumps([layer.name, row.values], sort_keys=True, ensure_ascii=True)
            content += "".join(shapely.to_wkb(p.normalize(), hex=True) for p in group)
            seen[content] = seen.get(content, 0) + 1
            identity = uuid.uuid5(_NAMESPACE, f"{content}|{seen[content]}")
            objects.append(XtfObject(str(identity), texts, group))
    return objects


def _note_left_out(
    layer: FederalClass, plan: ClassPlan, rows: Sequence[_Row], notes: list[str]
) -> None:
    for name in plan.left_out:
        attribute = next(a for a in layer.attributes if a.name == name)
        values = {row.values[name] for row in rows} - {None}
        if not attribute.verified and values <= {NOT_ASSESSED}:
            continue  # a guess at a name, with nothing in it to lose
        if values:
            notes.append(
                f"Column {layer.name}.{name} is left out: the model has no such attribute."
            )


def _text_of(slot: Slot, row: _Row, layer: str, file: Path) -> str | None:
    if slot.column is None:
        return slot.constant
    value = row.values[slot.column]
    kind = slot.type
    found: str | None = None
    expected = kind.text
    if value is None:
        if not kind.mandatory:
            return None
        expected = f"a value, which the model's attribute {slot.name} must have"
    elif kind.kind == "enumeration":
        found = code_of(kind, _as_code(value))
        expected = f"one of {', '.join(kind.codes)}"
    elif kind.kind == "boolean":
        found = str(value).lower() if isinstance(value, bool) else None
    elif kind.kind == "number":
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if number and kind.low <= value <= kind.high:
            found = f"{value:.{kind.decimals}f}"
    elif isinstance(value, str):
        text = _NO_XML.sub("", value)
        found = text if kind.longest is None or len(text) <= kind.longest else None
        expected = f"a text of at most {kind.longest} characters"
    if found is None:
        raise InputError(
            f"{row.where}: value cannot be written",
            file=file,
            field=f"{layer}.{slot.column}",
            found=value,
            expected=expected,
        )
    return found


def _as_code(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
