"""Hazard zones as an INTERLIS 2 transfer file (XTF), by the model files or by default names.

Sources: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3), chapter 3; the
Federal Office for the Environment's minimal geodata model 166.1: :mod:`sassgis.io.federal`.
"""

from __future__ import annotations

import json
import os
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import escape, quoteattr

import geopandas as gpd
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError

from sassgis import __version__
from sassgis.core.errors import ConfigError, InputError, OutputError
from sassgis.io.federal import (
    DECIMALS,
    FEDERAL_CLASSES,
    FEDERAL_EPSG,
    FEDERAL_EXTENT,
    NOT_ASSESSED,
    FederalClass,
    check_extent,
    checked_values,
    is_lv95,
    surface_parts,
)
from sassgis.io.interlis_check import XTF_NAMESPACE, ValidationResult, check_xtf, validate_xtf
from sassgis.io.interlis_model import (
    IliAttribute,
    IliClass,
    IliLibrary,
    IliModel,
    IliType,
    normalised,
    read_models,
)
from sassgis.io.staging import MANIFEST_NAME, writing

__all__ = ["ExportResult", "XtfSummary", "export_xtf", "validate_xtf", "write_xtf"]

PACKAGE_NAME = "hazard.gpkg"
#: Names used where no model files are given: not taken from the model, unverified.
DEFAULT_MODEL, DEFAULT_TOPIC = "HazardMapping_V1_3", "HazardMapping"
#: Part of the model's name that tells its version from older ones in the same folder.
_MODEL_VERSION = "v13"
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
        With the layers of :data:`sassgis.io.federal.FEDERAL_CLASSES`.
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
    plan = _default_plan() if model_folder is None else _plan_of(model_folder, language)
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
                stream.writelines(_document(plan, objects))
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


# --- what the model asks for -----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Step:
    """A structure around a value: its name, the attribute in it, and whether it may repeat."""

    structure: str
    attribute: str
    many: bool
    #: Attribute for the language, with the code to write.
    language: tuple[str, str] | None = None


@dataclass(frozen=True, slots=True)
class _Slot:
    """An attribute of the model, with the column that fills it.

    ``column`` is the name of ours; None for an attribute that always gets ``constant``.
    """

    name: str
    type: IliType
    steps: tuple[_Step, ...]
    column: str | None
    constant: str = ""
    geometry: bool = False
    decimals: int = DECIMALS


@dataclass(frozen=True, slots=True)
class _ClassPlan:
    tag: str
    slots: tuple[_Slot, ...]
    identifier: Literal["uuid", "number"]
    #: Columns that the model has no attribute for.
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _ModelName:
    name: str
    version: str
    uri: str


@dataclass(frozen=True, slots=True)
class _Plan:
    model: _ModelName
    others: tuple[_ModelName, ...]
    #: Topic of each layer.
    topics: Mapping[str, str]
    classes: Mapping[str, _ClassPlan]
    from_model: bool
    notes: tuple[str, ...]
    known_classes: tuple[str, ...] = ()


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _default_plan() -> _Plan:
    """Names of the layers and columns in the style of INTERLIS; simple surfaces."""
    types = {
        "code": "other",
        "text": "text",
        "whole": "number",
        "number": "number",
        "boolean": "boolean",
    }
    classes = {}
    for kind in FEDERAL_CLASSES.values():
        slots = [
            _Slot(kind.geometry, IliType("surface", mandatory=True), (), None, geometry=True)
        ] + [
            _Slot(
                a.name,
                IliType(
                    types[a.kind],  # type: ignore[arg-type]
                    mandatory=a.required,
                    low=a.low,
                    high=a.high,
                    decimals=0 if a.kind == "whole" else 3,
                    longest=a.longest,
                ),
                (),
                a.name,
            )
            for a in kind.attributes
        ]
        tag = f"{DEFAULT_MODEL}.{DEFAULT_TOPIC}.{_camel(kind.name)}"
        classes[kind.name] = _ClassPlan(tag, tuple(slots), "uuid", ())
    return _Plan(
        _ModelName(DEFAULT_MODEL, "unverified", "https://www.bafu.admin.ch"),
        (),
        dict.fromkeys(FEDERAL_CLASSES, f"{DEFAULT_MODEL}.{DEFAULT_TOPIC}"),
        classes,
        False,
        (
            "Names of the model, its topic, classes and attributes are unverified: no model files "
            "were given. The file was checked for its structure only; it may not be accepted.",
        ),
    )


def _plan_of(folder: Path, language: str) -> _Plan:
    library = read_models(folder)
    model, kinds = _fitting_model(library)
    if model.language_version != "2.3":
        raise InputError(
            f"the model {model.name} cannot be written",
            file=model.file,
            found=f"INTERLIS {model.language_version}",
            expected="INTERLIS 2.3",
        )
    if missing := library.missing_imports(model.name):
        raise InputError(
            f"models that {model.name} imports are missing",
            file=folder,
            found=", ".join(missing),
            expected="the .ili files of all of them in the folder",
        )
    notes: list[str] = []
    classes = {
        name: _class_plan(library, kind, FEDERAL_CLASSES[name], language, notes)
        for name, kind in kinds.items()
    }
    topics = {name: kind.scope for name, kind in kinds.items()}
    for topic in dict.fromkeys(topics.values()):
        if associations := library.topics[topic].associations:
            notes.append(f"Associations of {topic} are not written: {', '.join(associations)}.")
    used = {
        step.structure.split(".")[0]
        for plan in classes.values()
        for slot in plan.slots
        for step in slot.steps
    }
    others = [library.models[name] for name in sorted(used - {model.name})]
    return _Plan(
        _ModelName(model.name, model.version, model.uri),
        tuple(_ModelName(m.name, m.version, m.uri) for m in others),
        topics,
        classes,
        True,
        tuple(notes),
        tuple(c.simple_name for c in model.classes if not c.structure),
    )


def _fitting_model(library: IliLibrary) -> tuple[IliModel, dict[str, IliClass]]:
    """The model that has classes for most of the layers, in the coordinates of today."""
    found: list[tuple[tuple[int, int, int], IliModel, dict[str, IliClass]]] = []
    for model in library.models.values():
        kinds: dict[str, IliClass] = {}
        for name in FEDERAL_CLASSES:
            fitting = [
                c
                for c in model.classes
                if not c.structure
                and not c.abstract
                and c.scope in library.topics
                and not library.topics[c.scope].abstract
                and normalised(c.simple_name) == normalised(name)
            ]
            if len(fitting) > 1:
                raise InputError(
                    f"the model has several classes for the layer {name}",
                    file=model.file,
                    found=", ".join(c.name for c in fitting),
                    expected="one",
                )
            if fitting:
                kinds[name] = fitting[0]
        if kinds:
            today = all(_in_lv95(library, kind) for kind in kinds.values())
            named = _MODEL_VERSION in normalised(model.name)
            found.append(((len(kinds), int(today), int(named)), model, kinds))
    if not found:
        raise InputError(
            "no model here has the classes of the federal model",
            file=library.folder,
            found=", ".join(library.models),
            expected=f"classes {', '.join(FEDERAL_CLASSES)}",
        )
    best = max(score for score, _, _ in found)
    chosen = [(model, kinds) for score, model, kinds in found if score == best]
    if len(chosen) > 1:
        raise InputError(
            "several models fit",
            file=library.folder,
            found=", ".join(model.name for model, _ in chosen),
            expected="the files of one",
        )
    return chosen[0]


def _in_lv95(library: IliLibrary, kind: IliClass) -> bool:
    surfaces = [_surface(library, a) for a in library.attributes(kind)]
    extents = [surface[2] for surface in surfaces if surface is not None]
    west, south, _, _ = FEDERAL_EXTENT
    return any(not extent or _contains(extent, west, south) for extent in extents)


def _contains(axes: Sequence[tuple[float, float, int]], x: float, y: float) -> bool:
    return all(low <= value <= high for (low, high, _), value in zip(axes, (x, y), strict=False))


def _surface(
    library: IliLibrary, attribute: IliAttribute
) -> tuple[IliType, tuple[_Step, ...], tuple[tuple[float, float, int], ...]] | None:
    """Type, structures around and axes of a surface; None where it is none."""
    return _surface_in(library, attribute.type, attribute.scope, 0)


def _surface_in(
    library: IliLibrary, kind: IliType, scope: str, depth: int
) -> tuple[IliType, tuple[_Step, ...], tuple[tuple[float, float, int], ...]] | None:
    resolved, scope = library.resolve(kind, scope)
    if resolved.kind == "surface":
        axes, _ = library.resolve(IliType("name", target=resolved.target), scope)
        return resolved, (), axes.axes
    if resolved.kind != "structure" or depth > 5:
        return None
    structure = library.classes[resolved.target]
    inner = [
        (a, _surface_in(library, a.type, a.scope, depth + 1)) for a in library.attributes(structure)
    ]
    surfaces = [(a, s) for a, s in inner if s is not None]
    if len(surfaces) != 1:
        return None
    within, (surface, steps, axes_of) = surfaces[0]
    mandatory = resolved.mandatory or surface.mandatory
    return (
        replace(surface, mandatory=mandatory),
        (_Step(structure.name, within.name, resolved.many), *steps),
        axes_of,
    )


def _class_plan(
    library: IliLibrary, kind: IliClass, ours: FederalClass, language: str, notes: list[str]
) -> _ClassPlan:
    columns = {normalised(a.name): a for a in ours.attributes}
    attributes = library.attributes(kind)
    surfaces = {a.name: s for a in attributes if (s := _surface(library, a)) is not None}
    zone = _zone_attribute(library, kind, ours, list(surfaces), notes)
    slots: list[_Slot] = []
    used: set[str] = set()
    for attribute in attributes:
        if attribute.name == zone:
            surface, steps, axes = surfaces[zone]
            if axes and not _contains(axes, *FEDERAL_EXTENT[:2]):
                raise _unfit(library, kind, attribute.name, "is for other coordinates")
            decimals = min([DECIMALS, *(axis[2] for axis in axes)])
            slots.append(_Slot(zone, surface, steps, None, geometry=True, decimals=decimals))
            continue
        match = columns.get(normalised(attribute.name))
        resolved, steps_or_reason = _value_type(library, attribute, language)
        if match is not None and not isinstance(steps_or_reason, str):
            used.add(match.name)
            slots.append(_Slot(attribute.name, resolved, steps_or_reason, match.name))
        elif match is None and _is_state(ours, attribute.name, resolved):
            code = _code(resolved, NOT_ASSESSED)
            slots.append(_Slot(attribute.name, resolved, (), None, str(code)))
            notes.append(f"{kind.simple_name}.{attribute.name}: filled in as {code}.")
        elif resolved.mandatory:
            reason = steps_or_reason if match is not None else "has no counterpart in the layer"
            raise _unfit(library, kind, attribute.name, f"is mandatory, but {reason}")
        else:
            notes.append(f"{kind.simple_name}.{attribute.name} of the model: left empty.")
    left_out = tuple(a.name for a in ours.attributes if a.name not in used)
    return _ClassPlan(kind.name, tuple(slots), _identifier(library, kind), left_out)


def _zone_attribute(
    library: IliLibrary,
    kind: IliClass,
    ours: FederalClass,
    surfaces: Sequence[str],
    notes: list[str],
) -> str:
    named = [name for name in surfaces if normalised(name) == normalised(ours.geometry)]
    if not named and len(surfaces) == 1:
        named = list(surfaces)
        notes.append(f"{kind.simple_name}: the zone is written as {named[0]}.")
    if not named:
        raise _unfit(library, kind, ours.geometry, "is no surface that can be written")
    return named[0]


def _unfit(library: IliLibrary, kind: IliClass, attribute: str, problem: str) -> InputError:
    model = library.models[kind.name.split(".")[0]]
    return InputError(
        f"attribute {problem}", file=model.file, field=f"{kind.simple_name}.{attribute}"
    )


def _is_state(ours: FederalClass, name: str, kind: IliType) -> bool:
    return (
        ours.name == "assessment_area"
        and "state" in normalised(name)
        and kind.kind == "enumeration"
        and _code(kind, NOT_ASSESSED) is not None
    )


def _value_type(
    library: IliLibrary, attribute: IliAttribute, language: str
) -> tuple[IliType, tuple[_Step, ...] | str]:
    """Type of the value with the structures around it, or why it cannot be written."""
    kind, scope = attribute.type, attribute.scope
    steps: list[_Step] = []
    mandatory = attribute.type.mandatory
    for _ in range(5):
        resolved, scope = library.resolve(kind, scope)
        mandatory = mandatory if steps else mandatory or resolved.mandatory
        if resolved.kind in ("enumeration", "text", "number", "boolean"):
            return replace(resolved, mandatory=mandatory), tuple(steps)
        if resolved.kind != "structure":
            break
        structure = library.classes[resolved.target]
        inner = library.attributes(structure)
        tongue = next((a for a in inner if normalised(a.name) == "language"), None)
        others = [a for a in inner if a is not tongue]
        if structure.abstract or len(others) != 1:
            break
        spoken = None
        if tongue is not None:
            codes = library.resolve(tongue.type, tongue.scope)[0]
            code = _code(codes, language) if codes.kind == "enumeration" else language
            if code is not None:
                spoken = (tongue.name, code)
            elif codes.mandatory:
                break
        steps.append(_Step(structure.name, others[0].name, resolved.many, spoken))
        kind, scope = others[0].type, others[0].scope
    reason = f"of a type that is not written ({attribute.type.text})"
    return replace(attribute.type, kind="other", mandatory=mandatory), reason


def _identifier(library: IliLibrary, kind: IliClass) -> Literal["uuid", "number"]:
    link: IliClass | None = kind
    oid = ""
    while link is not None and not oid:
        oid, link = link.oid, library.base_of(link)
    topic = library.topics.get(kind.scope)
    while topic is not None and not oid:
        oid = topic.oid
        topic = library.topic(topic.base, topic.name.split(".")[0]) if topic.base else None
    last = oid.rsplit(".", 1)[-1]
    if last == "I32OID":
        return "number"
    if last == "STANDARDOID":
        raise _unfit(
            library, kind, "OID", "asks for identifiers with an official prefix (STANDARDOID)"
        )
    return "uuid"


def _code(kind: IliType, value: str) -> str | None:
    """The model's spelling of a code."""
    wanted = normalised(value)
    exact = [code for code in kind.codes if code == value]
    alike = [code for code in kind.codes if normalised(code) == wanted]
    return next(iter([*exact, *alike]), None)


# --- objects ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Object:
    tid: str
    texts: dict[str, str]
    polygons: list[Any]


def _objects(
    layer: FederalClass,
    plan: _ClassPlan,
    rows: Sequence[_Row],
    file: Path,
    notes: list[str],
) -> list[_Object]:
    zone = next(slot for slot in plan.slots if slot.geometry)
    together = any(step.many for step in zone.steps)
    _note_left_out(layer, plan, rows, notes)
    seen: dict[str, int] = {}
    objects: list[_Object] = []
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
            objects.append(_Object(str(identity), texts, group))
    return objects


def _note_left_out(
    layer: FederalClass, plan: _ClassPlan, rows: Sequence[_Row], notes: list[str]
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


def _text_of(slot: _Slot, row: _Row, layer: str, file: Path) -> str | None:
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
        found = _code(kind, _as_code(value))
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


# --- XML -------------------------------------------------------------------------------------


def _document(plan: _Plan, objects: Mapping[str, Sequence[_Object]]) -> Iterator[str]:
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield f'<TRANSFER xmlns="{XTF_NAMESPACE}">\n'
    yield f'<HEADERSECTION SENDER={quoteattr(f"sassgis {__version__}")} VERSION="2.3">\n<MODELS>\n'
    for model in (plan.model, *plan.others):
        yield (
            f"<MODEL NAME={quoteattr(model.name)} VERSION={quoteattr(model.version)} "
            f"URI={quoteattr(model.uri)}/>\n"
        )
    yield "</MODELS>\n"
    if not plan.from_model:
        yield f"<COMMENT>{escape(plan.notes[0])}</COMMENT>\n"
    yield "</HEADERSECTION>\n<DATASECTION>\n"
    numbers = iter(range(1, 1 + sum(len(found) for found in objects.values())))
    for topic in dict.fromkeys(plan.topics.values()):
        inside = [name for name in objects if plan.topics[name] == topic]
        tids = [item.tid for name in inside for item in objects[name]]
        basket = uuid.uuid5(_NAMESPACE, "|".join([topic, *tids]))
        yield f'<{topic} BID="{basket}">\n'
        for name in inside:
            kind = plan.classes[name]
            for item in objects[name]:
                tid = item.tid if kind.identifier == "uuid" else str(next(numbers))
                yield f'<{kind.tag} TID="{tid}">\n'
                for slot in kind.slots:
                    yield _attribute_text(slot, item)
                yield f"</{kind.tag}>\n"
        yield f"</{topic}>\n"
    yield "</DATASECTION>\n</TRANSFER>\n"


def _attribute_text(slot: _Slot, item: _Object) -> str:
    if slot.geometry:
        content = _nested_surface(slot.steps, item.polygons, slot.decimals)
    elif slot.name in item.texts:
        content = _nested_text(slot.steps, item.texts[slot.name])
    else:
        return ""
    return f"<{slot.name}>{content}</{slot.name}>\n"


def _nested_text(steps: tuple[_Step, ...], text: str) -> str:
    if not steps:
        return escape(text)
    step = steps[0]
    tongue = "" if step.language is None else "<{0}>{1}</{0}>".format(*step.language)
    inner = _nested_text(steps[1:], text)
    return (
        f"<{step.structure}>{tongue}<{step.attribute}>{inner}</{step.attribute}></{step.structure}>"
    )


def _nested_surface(steps: tuple[_Step, ...], polygons: Sequence[Any], decimals: int) -> str:
    if not steps:
        return _surface_text(polygons[0], decimals)
    step = steps[0]
    groups = [[polygon] for polygon in polygons] if step.many else [list(polygons)]
    return "".join(
        f"<{step.structure}><{step.attribute}>"
        f"{_nested_surface(steps[1:], group, decimals)}"
        f"</{step.attribute}></{step.structure}>"
        for group in groups
    )


def _surface_text(polygon: Any, decimals: int) -> str:
    """A surface: its outline and then its holes, each a closed line of straight pieces."""
    boundaries = []
    for ring in (polygon.exterior, *polygon.interiors):
        corners = "\n".join(
            f"<COORD><C1>{x:.{decimals}f}</C1><C2>{y:.{decimals}f}</C2></COORD>"
            for x, y in shapely.get_coordinates(ring).tolist()
        )
        boundaries.append(f"<BOUNDARY><POLYLINE>\n{corners}\n</POLYLINE></BOUNDARY>")
    return "<SURFACE>\n" + "\n".join(boundaries) + "\n</SURFACE>"
