"""Checks INTERLIS transfer files: their structure, and with the real validator.

The validator is ilivalidator as a native library (package ``ilivalidator``, extra ``interlis``).
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from sassgis.io.write.layers.federal_model import DECIMALS, FEDERAL_EXTENT
from sassgis.model.errors import InputError, OutputError

XTF_NAMESPACE = "http://www.interlis.ch/INTERLIS2.3"
_NS = f"{{{XTF_NAMESPACE}}}"
_MOST_LINES = 20
#: A model as an .ili file declares it, at the beginning of a line.
_MODEL = re.compile(
    r"^\s*(?:CONTRACTED\s+)?(?:TYPE\s+|REFSYSTEM\s+|SYMBOLOGY\s+)?MODEL\s+(\w+)\s*(?:\(\w+\)\s*)?AT\b",
    re.M,
)
#: An identifier as XML has it, which INTERLIS asks for.
_IDENTIFIER = re.compile(r"[A-Za-z_][\w.-]*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that the validator found.

    Attributes
    ----------
    severity : {"error", "warning"}
    text : str
    tag, tid : str
        Class and identifier of the object; empty where there is none.
    line : int
        Line of the file; 0 where it is not known.
    """

    severity: str
    text: str
    tag: str = ""
    tid: str = ""
    line: int = 0

    def __str__(self) -> str:
        place = f"line {self.line}" if self.line else ""
        where = ", ".join(part for part in (place, self.tag, self.tid) if part)
        return (
            f"{self.severity}: {where}: {self.text}" if where else f"{self.severity}: {self.text}"
        )


@dataclass(frozen=True, slots=True)
class ValidationResult:
    """Verdict of the validator.

    Attributes
    ----------
    path : Path
    valid : bool
    validator : str
        Its name and version.
    findings : tuple of Finding
        Errors and warnings in the order in which they came up.
    """

    path: Path
    valid: bool
    validator: str
    findings: tuple[Finding, ...]

    @property
    def errors(self) -> list[Finding]:
        """What makes the file invalid."""
        return [f for f in self.findings if f.severity == "error"]

    def lines(self) -> list[str]:
        """The verdict in words, with the first findings."""
        verdict = "valid" if self.valid else f"not valid, {len(self.errors)} errors"
        more = len(self.findings) - _MOST_LINES
        return [
            f"{self.validator}: {self.path} is {verdict}.",
            *(f"  {finding}" for finding in self.findings[:_MOST_LINES]),
            *([f"  and {more} more"] if more > 0 else []),
        ]


# --- the real validator ----------------------------------------------------------------------

#: Runs in a process of its own: the library prints what it likes, and may take the process down.
_RUNNER = """
import json, sys
from ilivalidator import Ilivalidator
task = json.loads(sys.argv[1])
settings = {
    Ilivalidator.SETTING_ILIDIRS: task["models"],
    Ilivalidator.SETTING_LOGFILE: task["log"],
    Ilivalidator.SETTING_XTFLOG: task["findings"],
}
valid = Ilivalidator.validate([task["data"]], settings)
with open(task["verdict"], "w") as stream:
    json.dump(bool(valid), stream)
"""


def validate_xtf(xtf: Path, model_folder: Path, *, timeout_s: float = 1800.0) -> ValidationResult:
    """Let ilivalidator check a transfer file against the models of a folder; without any network.

    Parameters
    ----------
    xtf : Path
    model_folder : Path
        With the .ili files of the model and of all models that it imports.
    timeout_s : float
        Longest time to wait (s).

    Returns
    -------
    ValidationResult

    Raises
    ------
    InputError
        If the validator is not installed, the file cannot be read, or a model is not in the folder.
    OutputError
        If the validator breaks down.
    """
    check_validator(model_folder, _header_models(xtf))
    with tempfile.TemporaryDirectory(prefix="sassgis-") as name:
        work = Path(name)
        # Semicolons part its lists of files, and it knows no names beyond ASCII everywhere.
        models = work / "models"
        models.mkdir()
        copies = {str(models / f"{n}.ili"): file for n, file in enumerate(_ili_files(model_folder))}
        for copy, file in copies.items():
            shutil.copyfile(file, copy)
        data = work / "data.xtf"
        try:
            os.symlink(xtf.resolve(), data)
        except OSError:
            shutil.copyfile(xtf, data)
        task = {
            "data": str(data),
            "models": str(models),
            "log": str(work / "log.txt"),
            "findings": str(work / "findings.xtf"),
            "verdict": str(work / "verdict.json"),
        }
        try:
            done = subprocess.run(
                [sys.executable, "-c", _RUNNER, json.dumps(task)],
                cwd=work,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise OutputError(
                f"{xtf}: the INTERLIS validator did not end within {timeout_s:g} s"
            ) from None
        verdict = work / "verdict.json"
        if done.returncode != 0 or not verdict.is_file():
            raise OutputError(f"{xtf}: the INTERLIS validator broke down: {_cause(done)}")
        valid = bool(json.loads(verdict.read_text()))
        validator, findings = _findings(work / "findings.xtf", copies)
    if not valid and not any(f.severity == "error" for f in findings):
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        findings.append(Finding("error", last[0] if last else "no reason is given"))
    return ValidationResult(xtf, valid, validator, tuple(findings))


def _cause(done: subprocess.CompletedProcess[bytes]) -> str:
    if done.returncode < 0:
        return f"signal {signal.Signals(-done.returncode).name}"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else f"exit code {done.returncode}"


def _ili_files(folder: Path) -> list[Path]:
    """The .ili files of a folder (not of the folders in it), by name."""
    files = sorted(folder.glob("*.[iI][lL][iI]")) if folder.is_dir() else []
    if not files:
        raise InputError("holds no model", file=folder, expected="a folder with .ili files")
    return files


def check_validator(model_folder: Path, models: Sequence[str]) -> None:
    """Refuse what would keep a file from being validated, before it is written.

    Parameters
    ----------
    model_folder : Path
    models : sequence of str
        That the file names; those that they import are looked for by the validator.

    Raises
    ------
    InputError
        If the validator is not installed, or a model is not in the folder.
    """
    if importlib.util.find_spec("ilivalidator") is None:
        raise InputError(
            "the INTERLIS validator is not installed",
            expected=(
                "the Python package ilivalidator: pip install 'sassgis[interlis]' (there is none "
                "for Macs with Apple processors)"
            ),
        )
    texts = [file.read_text(encoding="latin-1") for file in _ili_files(model_folder)]
    held = {name for text in texts for name in _MODEL.findall(text)}
    if absent := [name for name in models if name not in held]:
        raise InputError(
            "models that the file needs are missing",
            file=model_folder,
            found=", ".join(sorted(held)) or "no model",
            expected=f"the .ili file of {', '.join(absent)}",
        )


def _header_models(xtf: Path) -> list[str]:
    names: list[str] = []
    try:
        for _, element in ET.iterparse(xtf, events=("end",)):
            if element.tag == f"{_NS}MODEL":
                names.append(element.get("NAME", ""))
            elif element.tag == f"{_NS}HEADERSECTION":
                break
    except OSError as error:
        raise InputError("cannot be read", file=xtf, found=error.strerror) from error
    except ET.ParseError as error:
        raise InputError("is no INTERLIS transfer file", file=xtf, found=str(error)) from error
    if not names:
        raise InputError(
            "is no INTERLIS transfer file", file=xtf, expected="the names of models in its header"
        )
    return names


def _findings(log: Path, copies: Mapping[str, Path]) -> tuple[str, list[Finding]]:
    """Name of the validator, errors and warnings from its log, with the user's names of files."""
    validator, found = "ilivalidator", []
    try:
        root = ET.parse(log).getroot()
    except (OSError, ET.ParseError):
        return validator, []
    for entry in root.iter(f"{_NS}IliVErrors.ErrorLog.Error"):
        texts = {child.tag.removeprefix(_NS): child.text or "" for child in entry}
        text = " ".join(texts.get("Message", "").split())
        for copy, file in copies.items():
            text = text.replace(copy, str(file))
        severity = texts.get("Type", "").lower()
        if severity in ("error", "warning"):
            line = texts.get("Line", "")
            found.append(
                Finding(
                    severity,
                    text,
                    texts.get("ObjTag", ""),
                    texts.get("Tid", ""),
                    int(line) if line.isdigit() else 0,
                )
            )
        elif text.startswith("ilivalidator-"):
            validator = " ".join(text.split("-")[:2])
    return validator, found


# --- structure -------------------------------------------------------------------------------


def check_xtf(xtf: Path) -> list[str]:
    """What is wrong with the structure of a transfer file; no model is needed.

    Looks at the sections, the names of baskets and objects, identifiers, and surfaces: closed,
    straight, valid, on coordinates of 1 mm within the federal extent.

    Parameters
    ----------
    xtf : Path

    Returns
    -------
    list of str
        A line each; empty if nothing is wrong.

    Raises
    ------
    InputError
        If the file cannot be read or is no XML.
    """
    try:
        return list(_problems(xtf))
    except OSError as error:
        raise InputError("cannot be read", file=xtf, found=error.strerror) from error
    except ET.ParseError as error:
        raise InputError("is no INTERLIS transfer file", file=xtf, found=str(error)) from error


def _problems(xtf: Path) -> Iterator[str]:
    path: list[str] = []
    models: list[str] = []
    tids: set[str] = set()
    bids: set[str] = set()
    sections: list[str] = []
    for event, element in ET.iterparse(xtf, events=("start", "end")):
        tag = element.tag.removeprefix(_NS)
        if event == "start":
            path.append(tag)
            if len(path) == 1 and element.tag != f"{_NS}TRANSFER":
                yield f"root is {element.tag}, not TRANSFER of {XTF_NAMESPACE}"
            elif len(path) == 2:
                sections.append(tag)
            elif len(path) == 3 and path[1] == "DATASECTION":
                yield from _basket_problems(tag, element.get("BID"), models, bids)
            elif len(path) == 4 and path[1] == "DATASECTION":
                yield from _object_problems(tag, element.get("TID"), path[2], tids)
            continue
        path.pop()
        if tag == "MODEL":
            models.append(element.get("NAME", ""))
        elif tag == "SURFACE":
            yield from _surface_problems(element)
        elif len(path) == 3:
            if path[1] == "DATASECTION" and not len(element):
                yield f"{tag} {element.get('TID')}: has no attributes"
            element.clear()  # large files must not be held as a whole
    if sections != ["HEADERSECTION", "DATASECTION"]:
        yield f"sections are {', '.join(sections)}"


def _basket_problems(tag: str, bid: str | None, models: list[str], bids: set[str]) -> Iterator[str]:
    if tag.count(".") != 1 or tag.split(".")[0] not in models:
        yield f"basket {tag} is no topic of a model in the header"
    if not _IDENTIFIER.fullmatch(bid or "") or bid in bids:
        yield f"basket {tag} has no identifier of its own"
    bids.add(bid or "")


def _object_problems(tag: str, tid: str | None, basket: str, tids: set[str]) -> Iterator[str]:
    if tag.count(".") != 2:
        yield f"object {tag} in {basket} does not name model, topic and class"
    if not _IDENTIFIER.fullmatch(tid or "") or tid in tids:
        yield f"object {tag} has no identifier of its own"
    tids.add(tid or "")


def _surface_problems(surface: ET.Element) -> Iterator[str]:
    rings = []
    for boundary in surface.findall(f"{_NS}BOUNDARY"):
        corners = []
        for line in boundary.findall(f"{_NS}POLYLINE"):
            for corner in line:
                texts = [part.text or "" for part in corner]
                if corner.tag != f"{_NS}COORD" or len(texts) != 2:
                    yield f"surface: {corner.tag.removeprefix(_NS)} in place of a corner"
                    return
                if any(len(t.partition(".")[2]) > DECIMALS for t in texts):
                    yield f"surface: coordinates {texts} are finer than 1 mm"
                try:
                    corners.append([float(t) for t in texts])
                except ValueError:
                    yield f"surface: coordinates {texts} are no numbers"
                    return
        if len(corners) < 4 or corners[0] != corners[-1]:
            yield "surface: a boundary is not closed"
            return
        rings.append(np.array(corners))
    if not rings:
        yield "surface: has no boundary"
        return
    west, south, east, north = FEDERAL_EXTENT
    x, y = np.concatenate(rings).T
    if not ((west <= x) & (x <= east) & (south <= y) & (y <= north)).all():
        yield "surface: lies outside the extent of the federal model"
    polygon = shapely.Polygon(rings[0], rings[1:])
    if not polygon.is_valid:
        yield f"surface: {shapely.is_valid_reason(polygon)}"
