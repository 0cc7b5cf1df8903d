"""How the layers go into the classes of an INTERLIS model: names, order, types, structures.

Names are compared without case and underscores. The model's files rule: what they ask for is
written, in their spelling and order, or there is an error that says why it cannot be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from sassgis.io.interlis.ili_models import (
    IliAttribute,
    IliClass,
    IliLibrary,
    IliModel,
    IliType,
    normalised,
)
from sassgis.io.interlis.ili_parser import read_models
from sassgis.io.write.layers.federal_model import (
    DECIMALS,
    FEDERAL_CLASSES,
    FEDERAL_EXTENT,
    NOT_ASSESSED,
    FederalClass,
)
from sassgis.model.errors import InputError

#: Names used where no model files are given: not taken from the model, unverified.
DEFAULT_MODEL, DEFAULT_TOPIC = "HazardMapping_V1_3", "HazardMapping"
#: Part of the model's name that distinguishes its version from older ones in the same folder.
_MODEL_VERSION = "v13"


@dataclass(frozen=True, slots=True)
class Step:
    """A structure around a value: its name, the attribute in it, and whether it may repeat."""

    structure: str
    attribute: str
    many: bool
    #: Attribute for the language, with the code to write.
    language: tuple[str, str] | None = None


@dataclass(frozen=True, slots=True)
class Slot:
    """An attribute of the model, with the column that fills it.

    ``column`` is a column of the layer; None for an attribute that always gets ``constant``.
    """

    name: str
    type: IliType
    steps: tuple[Step, ...]
    column: str | None
    constant: str = ""
    geometry: bool = False
    decimals: int = DECIMALS


@dataclass(frozen=True, slots=True)
class ClassPlan:
    """A class: its full name, its attributes in the order of the transfer, its identifiers."""

    tag: str
    slots: tuple[Slot, ...]
    identifier: Literal["uuid", "number"]
    #: Columns that the model has no attribute for.
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ModelName:
    """A model as the header of a file names it."""

    name: str
    version: str
    uri: str


@dataclass(frozen=True, slots=True)
class TransferPlan:
    """Where everything goes; ``classes`` and ``topics`` by the name of the layer."""

    model: ModelName
    others: tuple[ModelName, ...]
    #: Topic of each layer.
    topics: Mapping[str, str]
    classes: Mapping[str, ClassPlan]
    from_model: bool
    notes: tuple[str, ...]
    known_classes: tuple[str, ...] = ()


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def default_plan() -> TransferPlan:
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
            Slot(kind.geometry, IliType("surface", mandatory=True), (), None, geometry=True)
        ] + [
            Slot(
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
        classes[kind.name] = ClassPlan(tag, tuple(slots), "uuid", ())
    return TransferPlan(
        ModelName(DEFAULT_MODEL, "unverified", "https://www.bafu.admin.ch"),
        (),
        dict.fromkeys(FEDERAL_CLASSES, f"{DEFAULT_MODEL}.{DEFAULT_TOPIC}"),
        classes,
        False,
        (
            "Names of the model, its topic, classes and attributes are unverified: no model files "
            "were given. The file was checked for its structure only; it may not be accepted.",
        ),
    )


def plan_of(folder: Path, language: str) -> TransferPlan:
    """Names, order, codes and types of the model whose files are in a folder.

    Parameters
    ----------
    folder : Path
    language : str
        Of texts, where the model has them in several languages.

    Returns
    -------
    TransferPlan

    Raises
    ------
    InputError
        If no model in the folder has classes for the layers, several do, or the one that does asks
        for something that cannot be written.
    """
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
    return TransferPlan(
        ModelName(model.name, model.version, model.uri),
        tuple(ModelName(m.name, m.version, m.uri) for m in others),
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
) -> tuple[IliType, tuple[Step, ...], tuple[tuple[float, float, int], ...]] | None:
    """Type, structures around and axes of a surface; None where it is none."""
    return _surface_in(library, attribute.type, attribute.scope, 0)


def _surface_in(
    library: IliLibrary, kind: IliType, scope: str, depth: int
) -> tuple[IliType, tuple[Step, ...], tuple[tuple[float, float, int], ...]] | None:
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
        (Step(structure.name, within.name, resolved.many), *steps),
        axes_of,
    )


def _class_plan(
    library: IliLibrary, kind: IliClass, ours: FederalClass, language: str, notes: list[str]
) -> ClassPlan:
    columns = {normalised(a.name): a for a in ours.attributes}
    attributes = library.attributes(kind)
    surfaces = {a.name: s for a in attributes if (s := _surface(library, a)) is not None}
    zone = _zone_attribute(library, kind, ours, list(surfaces), notes)
    slots: list[Slot] = []
    used: set[str] = set()
    for attribute in attributes:
        if attribute.name == zone:
            surface, steps, axes = surfaces[zone]
            if axes and not _contains(axes, *FEDERAL_EXTENT[:2]):
                raise _unfit(library, kind, attribute.name, "is for other coordinates")
            decimals = min([DECIMALS, *(axis[2] for axis in axes)])
            slots.append(Slot(zone, surface, steps, None, geometry=True, decimals=decimals))
            continue
        match = columns.get(normalised(attribute.name))
        resolved, steps_or_reason = _value_type(library, attribute, language)
        if match is not None and not isinstance(steps_or_reason, str):
            used.add(match.name)
            slots.append(Slot(attribute.name, resolved, steps_or_reason, match.name))
        elif match is None and _is_state(ours, attribute.name, resolved):
            code = code_of(resolved, NOT_ASSESSED)
            slots.append(Slot(attribute.name, resolved, (), None, str(code)))
            notes.append(f"{kind.simple_name}.{attribute.name}: filled in as {code}.")
        elif resolved.mandatory:
            reason = steps_or_reason if match is not None else "has no counterpart in the layer"
            raise _unfit(library, kind, attribute.name, f"is mandatory, but {reason}")
        else:
            notes.append(f"{kind.simple_name}.{attribute.name} of the model: left empty.")
    left_out = tuple(a.name for a in ours.attributes if a.name not in used)
    return ClassPlan(kind.name, tuple(slots), _identifier(library, kind), left_out)


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
        and code_of(kind, NOT_ASSESSED) is not None
    )


def _value_type(
    library: IliLibrary, attribute: IliAttribute, language: str
) -> tuple[IliType, tuple[Step, ...] | str]:
    """Type of the value with the structures around it, or why it cannot be written."""
    kind, scope = attribute.type, attribute.scope
    steps: list[Step] = []
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
            code = code_of(codes, language) if codes.kind == "enumeration" else language
            if code is not None:
                spoken = (tongue.name, code)
            elif codes.mandatory:
                break
        steps.append(Step(structure.name, others[0].name, resolved.many, spoken))
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


def code_of(kind: IliType, value: str) -> str | None:
    """The model's spelling of a code."""
    wanted = normalised(value)
    exact = [code for code in kind.codes if code == value]
    alike = [code for code in kind.codes if normalised(code) == wanted]
    return next(iter([*exact, *alike]), None)
