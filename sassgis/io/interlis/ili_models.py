"""What INTERLIS 2 models hold that it takes to write data for them, and what its names mean.

Topics, classes and structures with their attributes, what they inherit, and the types.

Source: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

TypeKind = Literal[
    "enumeration",
    "text",
    "number",
    "boolean",
    "coordinate",
    "surface",
    "structure",
    "name",
    "inherited",
    "other",
]


@dataclass(frozen=True, slots=True)
class IliType:
    """Type of an attribute or a domain.

    Attributes
    ----------
    kind : str
        "name" before it is resolved: the domain or structure called ``target``.
    text : str
        As the model has it, for messages.
    mandatory : bool
    codes : tuple of str
        Of an enumeration; those of sub-enumerations as ``b.c``.
    longest : int or None
        Characters of a text.
    low, high, decimals
        Of a number.
    target : str
        Name of a domain or structure; of a surface: of the coordinates of its corners.
    many : bool
        Whether it is a BAG or LIST that takes more than one structure.
    axes : tuple of (low, high, decimals)
        Of a coordinate.
    """

    kind: TypeKind
    text: str = ""
    mandatory: bool = False
    codes: tuple[str, ...] = ()
    longest: int | None = None
    low: float = 0.0
    high: float = 0.0
    decimals: int = 0
    target: str = ""
    many: bool = False
    axes: tuple[tuple[float, float, int], ...] = ()


@dataclass(frozen=True, slots=True)
class IliAttribute:
    """An attribute, with the scope (``Model`` or ``Model.Topic``) in which its type has meaning."""

    name: str
    type: IliType
    scope: str
    abstract: bool = False


@dataclass(frozen=True, slots=True)
class IliDomain:
    """A named type; ``base`` is the domain that it extends, empty for none."""

    name: str
    scope: str
    type: IliType
    base: str = ""


@dataclass(frozen=True, slots=True)
class IliClass:
    """A class or structure.

    Attributes
    ----------
    name : str
        With model and topic: ``Model.Topic.Class``.
    scope : str
    structure, abstract : bool
    base : str
        The class that it extends; empty for none.
    attributes : tuple of IliAttribute
        Its own.
    oid : str
        Domain of the object identifiers; empty if it states none.
    """

    name: str
    scope: str
    structure: bool
    abstract: bool
    base: str
    attributes: tuple[IliAttribute, ...]
    oid: str = ""

    @property
    def simple_name(self) -> str:
        """Name without model and topic."""
        return self.name.rsplit(".", 1)[-1]


@dataclass(frozen=True, slots=True)
class IliTopic:
    """A topic; ``associations`` are the names of those in it."""

    name: str
    abstract: bool
    base: str = ""
    oid: str = ""
    basket_oid: str = ""
    associations: tuple[str, ...] = ()


@dataclass(slots=True)
class IliModel:
    """A model: what it is called, what it imports and what it holds."""

    name: str
    file: Path
    language_version: str
    version: str = ""
    uri: str = ""
    imports: list[str] = field(default_factory=list)
    unqualified: list[str] = field(default_factory=list)
    topics: list[IliTopic] = field(default_factory=list)
    classes: list[IliClass] = field(default_factory=list)
    domains: list[IliDomain] = field(default_factory=list)


def normalised(name: str) -> str:
    """Name without case and underscores, by which names are compared."""
    return name.replace("_", "").lower()


# --- folder of models ------------------------------------------------------------------------


class IliLibrary:
    """All models of a folder, and what the names in them refer to.

    Parameters
    ----------
    models : sequence of IliModel
    folder : Path
        Where they were read, for messages.
    """

    def __init__(self, models: Sequence[IliModel], folder: Path) -> None:
        self.folder = folder
        self.models: dict[str, IliModel] = {}
        for model in models:
            self.models.setdefault(model.name, model)
        held = list(self.models.values())
        self.topics = {t.name: t for m in held for t in m.topics}
        self.classes = {c.name: c for m in held for c in m.classes}
        self.domains = {d.name: d for m in held for d in m.domains}

    def missing_imports(self, name: str) -> list[str]:
        """Models that a model needs, by itself or through others, and that are not there."""
        missing: list[str] = []
        seen: set[str] = set()
        waiting = [name]
        while waiting:
            current = waiting.pop()
            if current in seen or current == "INTERLIS":
                continue
            seen.add(current)
            if current in self.models:
                waiting += self.models[current].imports
            else:
                missing.append(current)
        return sorted(missing)

    def _candidates(self, name: str, scope: str) -> Iterator[str]:
        yield f"{scope}.{name}"
        topic = self.topics.get(scope)
        seen = {scope}
        while topic is not None and topic.base:
            base = self.topic(topic.base, topic.name.split(".")[0])
            if base is None or base.name in seen:
                break
            seen.add(base.name)
            yield f"{base.name}.{name}"
            topic = base
        model = scope.split(".")[0]
        yield f"{model}.{name}"
        yield name
        if model in self.models:
            for imported in self.models[model].unqualified:
                yield f"{imported}.{name}"

    def topic(self, name: str, model: str) -> IliTopic | None:
        """A topic by its name as used in a model."""
        return self.topics.get(f"{model}.{name}") or self.topics.get(name)

    def find_class(self, name: str, scope: str) -> IliClass | None:
        """The class or structure that a name refers to."""
        found = (self.classes.get(n) for n in self._candidates(name, scope))
        return next((c for c in found if c is not None), None)

    def find_domain(self, name: str, scope: str) -> IliDomain | None:
        """The domain that a name refers to."""
        found = (self.domains.get(n) for n in self._candidates(name, scope))
        return next((d for d in found if d is not None), None)

    def base_of(self, kind: IliClass) -> IliClass | None:
        """The class that a class extends."""
        if not kind.base:
            return None
        topic = self.topics.get(kind.scope)
        if topic is not None and topic.base and kind.base == kind.simple_name:
            base = self.topic(topic.base, topic.name.split(".")[0])
            return None if base is None else self.find_class(kind.base, base.name)
        return self.find_class(kind.base, kind.scope)

    def attributes(self, kind: IliClass) -> list[IliAttribute]:
        """All attributes in the order of the transfer: those that are inherited first."""
        chain = [kind]
        while (base := self.base_of(chain[0])) is not None and base not in chain:
            chain.insert(0, base)
        found: dict[str, IliAttribute] = {}
        for link in chain:
            for attribute in link.attributes:
                before = found.get(attribute.name)
                if before is not None:
                    mandatory = attribute.type.mandatory or before.type.mandatory
                    kept = before.type if attribute.type.kind == "inherited" else attribute.type
                    scope = before.scope if attribute.type.kind == "inherited" else attribute.scope
                    attribute = replace(
                        attribute, type=replace(kept, mandatory=mandatory), scope=scope
                    )
                found[attribute.name] = attribute
        return list(found.values())

    def resolve(self, kind: IliType, scope: str) -> tuple[IliType, str]:
        """Type behind the names of domains, and the scope in which *its* names have meaning.

        A name that is a structure's ends as kind "structure" with the full name as target; one that
        nothing is known of as "other".
        """
        for _ in range(50):
            if kind.kind != "name":
                return kind, scope
            structure = self.find_class(kind.target, scope)
            if structure is not None:
                return replace(kind, kind="structure", target=structure.name), scope
            domain = self.find_domain(kind.target, scope)
            if domain is None:
                break
            inner = self._domain_type(domain)
            kind = replace(inner, mandatory=kind.mandatory or inner.mandatory, text=kind.text)
            scope = domain.scope
        return replace(kind, kind="other"), scope

    def _domain_type(self, domain: IliDomain, depth: int = 0) -> IliType:
        if not domain.base or depth > 50:
            return domain.type
        base = self.find_domain(domain.base, domain.scope)
        if base is None or base is domain:
            return domain.type
        inherited = self._domain_type(base, depth + 1)
        own = domain.type
        mandatory = own.mandatory or inherited.mandatory
        if own.kind == "inherited":
            return replace(inherited, mandatory=mandatory)
        if own.kind == "enumeration":
            # An extension splits values of the base into finer ones.
            split = {code.rsplit(".", 1)[0] for code in own.codes if "." in code}
            codes = [c for c in inherited.codes if c not in split]
            codes += [c for c in own.codes if c not in codes]
            return replace(own, codes=tuple(codes), mandatory=mandatory)
        return replace(own, mandatory=mandatory)
