"""Reads as much of INTERLIS 2 models (.ili) as it takes to write data for them.

Constraints, views, functions and graphics are passed over; the compiler and the validator of
INTERLIS look after those.

Source: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sassgis.io.interlis.ili_models import (
    IliAttribute,
    IliClass,
    IliDomain,
    IliLibrary,
    IliModel,
    IliTopic,
    IliType,
)
from sassgis.model.errors import InputError


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
