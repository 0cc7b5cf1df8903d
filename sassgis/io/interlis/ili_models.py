"""Reads as much of INTERLIS 2 models (.ili) as it takes to write data for them.

That is: topics, classes and structures with their attributes, what they inherit, and the types.
Constraints, views, functions and graphics are passed over; the compiler and the validator of
INTERLIS look after those.

Source: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from sassgis.model.errors import InputError

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
    """All models of a folder, and what the names in them stand for.

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
        """The class or structure that a name stands for."""
        found = (self.classes.get(n) for n in self._candidates(name, scope))
        return next((c for c in found if c is not None), None)

    def find_domain(self, name: str, scope: str) -> IliDomain | None:
        """The domain that a name stands for."""
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


def read_models(folder: Path) -> IliLibrary:
    """Read all .ili files of a folder (not of the folders in it).

    Parameters
    ----------
    folder : Path

    Returns
    -------
    IliLibrary

    Raises
    ------
    InputError
        If the folder does not exist, holds no model, or a file cannot be read as one.
    """
    if not folder.is_dir():
        raise InputError("is no folder", file=folder, expected="a folder with .ili files")
    files = ili_files(folder)
    if not files:
        raise InputError("holds no model", file=folder, expected="a folder with .ili files")
    return IliLibrary([model for file in files for model in read_ili(file)], folder)


def ili_files(folder: Path) -> list[Path]:
    """The .ili files of a folder, by name."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() == ".ili" and p.is_file())


def read_ili(file: Path) -> list[IliModel]:
    """Read the models of one .ili file.

    Raises
    ------
    InputError
        If it cannot be read as a model of INTERLIS 2.
    """
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError("cannot be read", file=file, found=error.strerror) from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # what INTERLIS 2.3 was written in
    return _Parser(text, file).models()


# --- text ------------------------------------------------------------------------------------

_TOKEN = re.compile(
    r"""
    (?P<skip>\s+|!![^\n]*|/\*.*?\*/|//.*?//)
  | (?P<string>"(?:[^"\\]|\\.)*")
  | (?P<number>[+-]?\d+(?:\.\d+)?(?:[eEsS][+-]?\d+)?)
  | (?P<name>[A-Za-z]\w*(?:\.[A-Za-z]\w*)*)
  | (?P<sign>\.\.|->|:=|==|<>|!=|>=|<=|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_SECTIONS = {
    "ASSOCIATION", "CHARSET", "CLASS", "CONSTRAINTS", "CONTEXT", "DOMAIN", "END", "FUNCTION",
    "GRAPHIC", "IMPORTS", "LINE", "PARAMETER", "REFSYSTEM", "SIGN", "STRUCTURE", "SYMBOLOGY",
    "TOPIC", "UNIT", "VIEW", "XMLNS",
}  # fmt: skip
_CONSTRAINTS = {"MANDATORY", "CONSTRAINT", "UNIQUE", "EXISTENCE", "SET", "PARAMETER"}
_LONGEST_NAME, _LONGEST_URI = 255, 1023


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    kind: str
    line: int


class _Parser:
    def __init__(self, text: str, file: Path) -> None:
        self.file = file
        self.tokens: list[_Token] = []
        line = 1
        for match in _TOKEN.finditer(text):
            if match.lastgroup != "skip":
                self.tokens.append(_Token(match[0], str(match.lastgroup), line))
            line += match[0].count("\n")
        self.place = 0

    # -- tokens

    def peek(self, ahead: int = 0) -> str:
        at = self.place + ahead
        return self.tokens[at].text if at < len(self.tokens) else ""

    def at_name(self) -> bool:
        return self.place < len(self.tokens) and self.tokens[self.place].kind == "name"

    def take(self) -> _Token:
        if self.place >= len(self.tokens):
            raise self.refused("the model ends too early", "end of file", "more")
        self.place += 1
        return self.tokens[self.place - 1]

    def expect(self, *texts: str) -> str:
        token = self.take()
        if token.text not in texts:
            self.place -= 1
            raise self.refused("cannot be read as a model", token.text, " or ".join(texts))
        return token.text

    def name(self) -> str:
        token = self.take()
        if token.kind != "name":
            self.place -= 1
            raise self.refused("cannot be read as a model", token.text, "a name")
        return token.text

    def refused(self, problem: str, found: str, expected: str) -> InputError:
        at = min(self.place, len(self.tokens) - 1)
        line = self.tokens[at].line if self.tokens else 1
        return InputError(
            problem, file=self.file, field=f"line {line}", found=repr(found), expected=expected
        )

    def until(self, *ends: str) -> list[_Token]:
        """Tokens up to one of ``ends`` outside brackets, which is taken but not returned."""
        depth = 0
        taken: list[_Token] = []
        while True:
            token = self.take()
            if depth == 0 and token.text in ends:
                return taken
            depth += {"(": 1, "{": 1, "[": 1, ")": -1, "}": -1, "]": -1}.get(token.text, 0)
            taken.append(token)

    def properties(self) -> set[str]:
        if self.peek() != "(":
            return set()
        self.take()
        return {token.text for token in self.until(")")}

    # -- models

    def models(self) -> list[IliModel]:
        if self.peek() != "INTERLIS":
            raise self.refused("is no model of INTERLIS 2", self.peek(), "INTERLIS 2.3;")
        self.take()
        version = self.take().text
        self.expect(";")
        found = []
        while self.place < len(self.tokens):
            while self.peek() in ("CONTRACTED", "REFSYSTEM", "SYMBOLOGY", "TYPE"):
                self.take()
            self.expect("MODEL")
            found.append(self.model(version))
        return found

    def model(self, language_version: str) -> IliModel:
        model = IliModel(self.name(), self.file, language_version)
        while (word := self.take()).text != "=":
            if word.text == "AT":
                model.uri = self.take().text.strip('"')
            elif word.text == "VERSION":
                model.version = self.take().text.strip('"')
        self.body(model, model.name, None)
        self.expect(".")
        return model

    def body(self, model: IliModel, scope: str, associations: list[str] | None) -> None:
        """Everything up to and with the END of a model or topic."""
        while True:
            word = self.take()
            if word.text == "END":
                self.name()
                return
            if word.text == "IMPORTS":
                self.imports(model)
            elif word.text == "TOPIC" or (word.text == "VIEW" and self.peek() == "TOPIC"):
                if word.text == "VIEW":
                    self.take()
                model.topics.append(self.topic(model))
            elif word.text in ("CLASS", "STRUCTURE"):
                model.classes.append(self.class_(scope, word.text == "STRUCTURE"))
            elif word.text == "DOMAIN":
                while self.at_name() and self.peek() not in _SECTIONS:
                    model.domains.append(self.domain(scope))
            elif word.text in ("ASSOCIATION", "VIEW", "GRAPHIC"):
                name = self.skip_block()
                if word.text == "ASSOCIATION" and associations is not None:
                    associations.append(name)
            elif word.text == "CONSTRAINTS":
                self.skip_block()
            elif word.text != ";":
                # UNIT, FUNCTION, LINE FORM, CONTEXT, ...: statements that end with a semicolon.
                self.until(";")

    def imports(self, model: IliModel) -> None:
        unqualified = False
        for token in self.until(";"):
            if token.text == "UNQUALIFIED":
                unqualified = True
            elif token.kind == "name":
                model.imports.append(token.text)
                if unqualified:
                    model.unqualified.append(token.text)
                unqualified = False

    def topic(self, model: IliModel) -> IliTopic:
        name = f"{model.name}.{self.name()}"
        abstract = "ABSTRACT" in self.properties()
        base = oid = basket = ""
        if self.peek() == "EXTENDS":
            self.take()
            base = self.name()
        self.expect("=")
        while self.peek() in ("BASKET", "OID", "DEPENDS", "DEFERRED"):
            first = self.take().text
            statement = self.until(";")
            if first == "OID":
                oid = statement[-1].text
            elif first == "BASKET":
                basket = statement[-1].text
        associations: list[str] = []
        self.body(model, name, associations)
        self.expect(";")
        return IliTopic(name, abstract, base, oid, basket, tuple(associations))

    def skip_block(self) -> str:
        """Pass over an association, a view or the like; gives its name."""
        name = self.peek() if self.at_name() else ""
        while self.take().text != "END":
            pass
        self.until(";")
        return name

    def class_(self, scope: str, structure: bool) -> IliClass:
        name = self.name()
        properties = self.properties()
        base, oid = name if "EXTENDED" in properties else "", ""
        if self.peek() == "EXTENDS":
            self.take()
            base = self.name()
        self.expect("=")
        attributes: list[IliAttribute] = []
        while self.peek() != "END":
            if self.peek() == "ATTRIBUTE":
                self.take()
            elif self.peek() in ("OID", "NO"):
                oid = self.until(";")[-1].text
            elif self.starts_attribute():
                found = self.attribute(scope)
                if found is not None:
                    attributes.append(found)
            elif self.peek() in _CONSTRAINTS:
                self.until(";")
            else:
                raise self.refused("cannot be read as a model", self.peek(), "an attribute or END")
        self.take()
        self.name()
        self.expect(";")
        return IliClass(
            f"{scope}.{name}",
            scope,
            structure,
            "ABSTRACT" in properties,
            base,
            tuple(attributes),
            oid,
        )

    def starts_attribute(self) -> bool:
        words = ("CONTINUOUS", "SUBDIVISION")
        ahead = 0
        while self.peek(ahead) in words:
            ahead += 1
        return self.peek(ahead + 1) == ":" or (
            self.peek(ahead + 1) == "(" and self.peek(ahead) not in _CONSTRAINTS
        )

    def attribute(self, scope: str) -> IliAttribute | None:
        while self.peek() in ("CONTINUOUS", "SUBDIVISION"):
            self.take()
        name = self.name()
        properties = self.properties()
        self.expect(":")
        kind = _type_of(self.until(";"), self.refused)
        if "TRANSIENT" in properties:
            return None  # is not in the transfer
        return IliAttribute(name, kind, scope, "ABSTRACT" in properties)

    def domain(self, scope: str) -> IliDomain:
        name = self.name()
        properties = self.properties()
        base = name if "EXTENDED" in properties else ""
        if self.peek() == "EXTENDS":
            self.take()
            base = self.name()
        self.expect("=")
        return IliDomain(f"{scope}.{name}", scope, _type_of(self.until(";"), self.refused), base)


# --- types -----------------------------------------------------------------------------------


def _type_of(tokens: list[_Token], refused: Callable[[str, str, str], InputError]) -> IliType:
    words = [token.text for token in tokens]
    if ":=" in words:  # the factor of a computed attribute
        words = words[: words.index(":=")]
    mandatory = words[:1] == ["MANDATORY"]
    if mandatory:
        words = words[1:]
    text = " ".join(words)
    while words[:1] == ["DIRECTED"]:
        words = words[1:]
    if not words:
        return IliType("inherited", text, mandatory)
    first = words[0]
    if first == "(":
        return IliType("enumeration", text, mandatory, codes=tuple(_codes(words, refused)))
    if first in ("TEXT", "MTEXT", "NAME", "URI"):
        longest = int(words[2]) if words[1:2] == ["*"] else None
        longest = {"NAME": _LONGEST_NAME, "URI": _LONGEST_URI}.get(first, longest)
        return IliType("text", text, mandatory, longest=longest)
    if first in ("BOOLEAN", "INTERLIS.BOOLEAN"):
        return IliType("boolean", text, mandatory)
    if words[1:2] == [".."] and len(words) > 2:
        low, high, decimals = _range(first, words[2])
        return IliType("number", text, mandatory, low=low, high=high, decimals=decimals)
    if first == "COORD":
        axes = tuple(_range(words[i - 1], words[i + 1]) for i, w in enumerate(words) if w == "..")
        return IliType("coordinate", text, mandatory, axes=axes)
    if first in ("SURFACE", "AREA"):
        at = words.index("VERTEX") + 1 if "VERTEX" in words else len(words)
        corner = words[at] if at < len(words) else ""
        return IliType("surface", text, mandatory, target=corner)
    if first in ("BAG", "LIST") and "OF" in words[:-1]:
        least, most = "0", "*"
        if "}" in words:
            least, most = words[words.index("{") + 1], words[words.index("}") - 1]
        mandatory = mandatory or least not in ("0", "*")
        target = words[words.index("OF") + 1]
        return IliType("name", text, mandatory, target=target, many=most != "1")
    if words[:2] == ["ALL", "OF"] and len(words) > 2:
        return IliType("name", text, mandatory, target=words[2])
    if tokens and re.fullmatch(r"[A-Za-z][\w.]*", first) and (len(words) == 1 or words[1] == "("):
        return IliType("name", text, mandatory, target=first)
    return IliType("other", text, mandatory)


def _codes(words: list[str], refused: Callable[[str, str, str], InputError]) -> list[str]:
    codes: list[str] = []
    stack: list[str] = []
    last = ""
    finer: list[bool] = []
    for word in words:
        if word == "(":
            if last:
                stack.append(last)
            finer.append(bool(last))
            last = ""
        elif word in (",", ":", ")"):
            if last:
                codes.append(".".join([*stack, last]))
            last = ""
            if word == ")":
                if finer and finer.pop():
                    stack.pop()
                if not finer:
                    return codes
        elif word != "FINAL":
            last = word
    raise refused("an enumeration has no end", " ".join(words[:6]), "')'")


def _range(low: str, high: str) -> tuple[float, float, int]:
    numbers = [re.sub("[sS]", "e", number) for number in (low, high)]
    mantissas = [re.split("[eE]", n)[0] for n in numbers]
    decimals = max(len(m.split(".")[1]) if "." in m else 0 for m in mantissas)
    try:
        return float(numbers[0]), float(numbers[1]), decimals
    except ValueError:
        return 0.0, 0.0, 0  # limits that are named constants
