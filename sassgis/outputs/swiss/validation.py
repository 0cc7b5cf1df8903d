"""Checks INTERLIS transfer files with ilivalidator, a native library (extra ``interlis``)."""

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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from sassgis.errors import InputError, OutputError
from sassgis.outputs.swiss.federal_model import MODEL_NAME

XTF_NAMESPACE = "http://www.interlis.ch/INTERLIS2.3"
_NS = f"{{{XTF_NAMESPACE}}}"
_MOST_LINES = 20
#: The validator is waited for no longer (s).
_TIMEOUT_S = 1800.0
#: A model as an .ili file declares it, at the beginning of a line.
_MODEL = re.compile(
    r"^\s*(?:CONTRACTED\s+)?(?:TYPE\s+|REFSYSTEM\s+|SYMBOLOGY\s+)?MODEL\s+(\w+)\s*(?:\(\w+\)\s*)?AT\b",
    re.M,
)


@dataclass(frozen=True, slots=True)
class ValidationResult:
    """Verdict of the validator; its name and version, errors and warnings as they came up."""

    path: Path
    valid: bool
    validator: str
    findings: tuple[str, ...]

    @property
    def errors(self) -> list[str]:
        """Errors that make the file invalid."""
        return [text for text in self.findings if text.startswith("error: ")]

    def lines(self) -> list[str]:
        """Return the verdict in words, with the first findings."""
        verdict = "valid" if self.valid else f"not valid, {len(self.errors)} errors"
        more = len(self.findings) - _MOST_LINES
        return [
            f"{self.validator}: {self.path} is {verdict}.",
            *(f"  {finding}" for finding in self.findings[:_MOST_LINES]),
            *([f"  and {more} more"] if more > 0 else []),
        ]


#: Runs in a separate process: the library prints what it likes, and may take the process down.
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


def validate_xtf(xtf: Path, model_folder: Path) -> ValidationResult:
    """Let ilivalidator check a transfer file against the .ili files of a folder; offline."""
    with tempfile.TemporaryDirectory(prefix="sassgis-") as name:
        work = Path(name)
        # Semicolons part its lists of files, and it knows no names beyond ASCII everywhere.
        models, data, verdict, findings_log = (
            work / name for name in ("models", "data.xtf", "verdict.json", "findings.xtf")
        )
        models.mkdir()
        copies = {str(models / f"{n}.ili"): file for n, file in enumerate(_ili_files(model_folder))}
        for copy, file in copies.items():
            shutil.copyfile(file, copy)
        try:
            os.symlink(xtf.resolve(), data)
        except OSError:
            shutil.copyfile(xtf, data)
        task = {
            "data": data, "models": models, "log": work / "log.txt", "findings": findings_log,
            "verdict": verdict,
        }  # fmt: skip
        try:
            done = subprocess.run(
                [sys.executable, "-c", _RUNNER, json.dumps(task, default=str)],
                cwd=work,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise OutputError(
                f"{xtf}: the INTERLIS validator did not end within {_TIMEOUT_S:g} s"
            ) from None
        if done.returncode != 0 or not verdict.is_file():
            raise OutputError(f"{xtf}: the INTERLIS validator broke down: {_cause(done)}")
        valid = bool(json.loads(verdict.read_text()))
        validator, findings = _findings(findings_log, copies)
    result = ValidationResult(xtf, valid, validator, tuple(findings))
    if valid or result.errors:
        return result
    last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
    reason = f"error: {last[0] if last else 'no reason is given'}"
    return ValidationResult(xtf, valid, validator, (*findings, reason))


def _cause(done: subprocess.CompletedProcess[bytes]) -> str:
    if done.returncode < 0:
        return f"signal {signal.Signals(-done.returncode).name}"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else f"exit code {done.returncode}"


def _ili_files(folder: Path) -> list[Path]:
    """Return the .ili files of a folder (not of the folders in it), by name."""
    files = sorted(folder.glob("*.[iI][lL][iI]")) if folder.is_dir() else []
    if not files:
        raise InputError("holds no model", file=folder, expected="a folder with .ili files")
    return files


def check_validator(model_folder: Path) -> None:
    """Refuse what would keep a file from being validated, before it is written."""
    if importlib.util.find_spec("ilivalidator") is None:
        raise InputError(
            "the INTERLIS validator is not installed",
            expected="the Python package ilivalidator: pip install 'sassgis[interlis]' (there is "
            "none for Macs with Apple processors)",
        )
    texts = [file.read_text(encoding="latin-1") for file in _ili_files(model_folder)]
    held = {name for text in texts for name in _MODEL.findall(text)}
    if MODEL_NAME not in held:
        raise InputError(
            "models that the file needs are missing", file=model_folder,
            found=", ".join(sorted(held)) or "no model", expected=f"the .ili file of {MODEL_NAME}",
        )  # fmt: skip


def _findings(log: Path, copies: Mapping[str, Path]) -> tuple[str, list[str]]:
    """Return the validator's name, errors and warnings from its log, with the user's file names."""
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
            line, tag, tid = (texts.get(name, "") for name in ("Line", "ObjTag", "Tid"))
            place = f"line {int(line)}" if line.isdigit() and int(line) else ""
            where = ", ".join(filter(None, (place, tag, tid)))
            found.append(": ".join(filter(None, (severity, where, text))))
        elif text.startswith("ilivalidator-"):
            validator = " ".join(text.split("-")[:2])
    return validator, found
