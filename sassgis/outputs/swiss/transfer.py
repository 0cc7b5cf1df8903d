"""Hazard zones as an INTERLIS 2 transfer file (XTF) of the federal model 166.1.

Sources: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3), chapter 3; the
Federal Office for the Environment's minimal geodata model 166.1:
:mod:`sassgis.outputs.swiss.federal_model`.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, pairwise
from pathlib import Path
from typing import Any, get_args
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

import geopandas as gpd
import jinja2
import numpy as np
import shapely
from pyogrio.errors import DataLayerError

from sassgis import __version__
from sassgis.errors import ConfigError, InputError, OutputError
from sassgis.files.atomic_output import staged_file
from sassgis.files.gdal_safety import read_frame, vector_file
from sassgis.inputs.result_folder import check_is_result
from sassgis.outputs.swiss import federal_model
from sassgis.outputs.swiss.federal_model import MODEL_NAME
from sassgis.settings.hazard_rules import Canton

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


PACKAGE_NAME = "hazard.gpkg"
#: An object of the file: its "tid", its "texts" by attribute, its "polygon".
_Object = dict[str, Any]
_NAMESPACE = uuid.UUID("0a5f4c7e-6f0b-5d0e-9b56-1b6d1c8c7d15")


@dataclass(frozen=True, slots=True)
class ExportResult:
    """A transfer file that was written, its objects by class, and its verdict if asked for."""

    path: Path
    objects: Mapping[str, int]
    validation: ValidationResult | None = None

    @property
    def accepted(self) -> bool:
        """Whether the validator accepted the file, or was not asked."""
        return self.validation is None or self.validation.valid

    def lines(self) -> list[str]:
        """Return the summary and verdict in words."""
        counts = ", ".join(f"{name} {count}" for name, count in self.objects.items())
        verdict = self.validation.lines() if self.validation else ()
        return [f"Wrote {self.path}, model {MODEL_NAME}: {counts}.", *verdict]


def export_xtf(
    result_folder: Path,
    xtf: Path,
    models: Path | None = None,
    validate: bool = False,
    *,
    canton: str | None = None,
    overwrite: bool = False,
) -> ExportResult:
    """Write the hazard zones of a result as INTERLIS 2.3 transfer file.

    Equal layers give equal files: the identifiers of objects are made from what they hold. Layers
    that are not in the minimum model may be absent. The canton ("TI") is responsible for the data
    where the layers do not say.

    ``models`` is a folder with the files of the federal model and of all models that it imports,
    against which the validator checks the file; one that it refuses is written all the same. To
    ``validate`` without them is an error.
    """
    if validate and models is None:
        raise ConfigError(
            "validation needs the files of the model", field="models", expected="their folder"
        )
    if canton is not None and canton not in get_args(Canton):
        codes = ", ".join(get_args(Canton))
        raise ConfigError("is no code of a canton", field="--canton", found=canton, expected=codes)
    check_is_result(result_folder)
    package = result_folder / PACKAGE_NAME
    if not package.is_file():
        raise InputError(
            "this result has no hazard zones", file=result_folder, found=f"no {PACKAGE_NAME}",
            expected="a result of sassgis zone",
        )  # fmt: skip
    if models is not None:
        check_validator(models)
    objects = {
        name: _objects(package, kind, canton)
        for name, kind in federal_model.FEDERAL_CLASSES.items()
    }
    with (
        staged_file(xtf, overwrite) as work,
        work.open("w", encoding="utf-8", newline="\n") as stream,
    ):
        stream.writelines(_document(objects))
    counts = {name: len(found) for name, found in objects.items()}
    return ExportResult(xtf, counts, None if models is None else validate_xtf(xtf, models))


def _objects(file: Path, kind: federal_model.FederalClass, canton: str | None) -> list[_Object]:
    frame = _read_layer(file, kind)
    seen: dict[str, int] = {}
    objects: list[_Object] = []
    if frame is None:
        return objects
    records = frame.drop(columns="geometry").to_dict("records")
    for fid, record, geometry in zip(frame.index, records, frame.geometry, strict=True):
        where = f"feature {fid}"
        given: dict[str, Any] = {str(key): value for key, value in record.items()}
        given[federal_model.RESPONSIBILITY] = (
            federal_model.plain(given[federal_model.RESPONSIBILITY]) or canton
        )
        if given[federal_model.RESPONSIBILITY] is None:
            raise InputError(
                f"{where}: value is missing", file=file, found="nothing",
                field=f"{kind.name}.{federal_model.RESPONSIBILITY}",
                expected="code of a canton there, or --canton TI for all",
            )  # fmt: skip
        values = federal_model.checked_values(kind, given, where, file=file)
        texts = {a.name: text for a in kind.attributes if (text := _text(a, values[a.name]))}
        for polygon in federal_model.surface_parts(
            geometry, where=f"{kind.name}, {where}", file=file
        ):
            content = json.dumps([kind.name, values], sort_keys=True, ensure_ascii=True)
            content += shapely.to_wkb(polygon.normalize(), hex=True)
            seen[content] = seen.get(content, 0) + 1
            identity = uuid.uuid5(_NAMESPACE, f"{content}|{seen[content]}")
            # "<identifier of the canton>.<canton>.ch", as a name of XML: it begins with no digit.
            tid = f"_{identity}.{values[federal_model.RESPONSIBILITY].lower()}.ch"
            objects.append({"tid": tid, "texts": texts, "polygon": polygon})
    return objects


def _read_layer(file: Path, kind: federal_model.FederalClass) -> gpd.GeoDataFrame | None:
    """Return a layer in the coordinates of the model; None where it is absent and may be."""
    wrong = partial(InputError, file=file, field=kind.name)
    with vector_file(file, kind.name):
        try:
            frame = read_frame(file, kind.name, fid_as_index=True)
        except DataLayerError:
            if kind.name not in federal_model.MINIMUM_CLASSES:
                return None
            raise wrong("layer is missing") from None
    if not isinstance(frame, gpd.GeoDataFrame):
        raise wrong("layer has no zones", expected="polygons")
    if not federal_model.is_lv95(frame.crs):
        raise wrong(
            "the federal model is for Switzerland only",
            found="local coordinates" if frame.crs is None else frame.crs.name,
            expected=f"coordinates in EPSG:{federal_model.FEDERAL_EPSG}",
        )
    if absent := [a.name for a in kind.attributes if a.name not in frame]:
        expected = "the columns of model 166.1, as this version writes them"
        raise wrong("column is missing", field=f"{kind.name}.{absent[0]}", expected=expected)
    federal_model.check_extent(frame.geometry.dropna().to_numpy(), field=kind.name, file=file)
    return frame


def _text(attribute: federal_model.Attribute, value: Any) -> str:
    """Return a checked value as the file has it; empty for none."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if attribute.kind == "number":
        return f"{value:.{attribute.decimals}f}"
    return str(value)


def _document(objects: Mapping[str, Sequence[_Object]]) -> Iterator[str]:
    """Yield the text of a transfer file, whose basket is named after its objects."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sassgis", "data"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["xml"] = escape
    tids = [item["tid"] for inside in objects.values() for item in inside]
    return environment.get_template("federal_model.xtf.j2").generate(
        xmlns=XTF_NAMESPACE,
        version=__version__,
        model=federal_model,
        basket=uuid.uuid5(_NAMESPACE, "|".join([federal_model.TOPIC, *tids])),
        objects=[(federal_model.FEDERAL_CLASSES[name], own) for name, own in objects.items()],
        rings=touching_at_corners,
    )


def touching_at_corners(polygon: Any) -> list[list[tuple[float, float]]]:
    """Return closed rings of a valid polygon, the outline first, with corners where they touch.

    INTERLIS takes a corner on the edge of another ring for an intersection.
    """
    rings = [list(ring.coords) for ring in (polygon.exterior, *polygon.interiors)]
    if len(rings) == 1:
        return rings
    edges = np.array([edge for ring in rings for edge in pairwise(ring)])
    corners = np.unique(np.concatenate([np.array(ring) for ring in rings]), axis=0)
    tree = shapely.STRtree(shapely.linestrings(edges))  # type: ignore[arg-type]
    which, edge = tree.query(shapely.points(corners), predicate="intersects")
    inner = (corners[which] != edges[edge, 0]).any(axis=1)
    inner &= (corners[which] != edges[edge, 1]).any(axis=1)
    added: dict[int, list[tuple[float, float]]] = {}
    for corner, at in zip(corners[which[inner]].tolist(), edge[inner].tolist(), strict=True):
        added.setdefault(at, []).append((corner[0], corner[1]))
    numbers = count()
    whole = []
    for ring in rings:
        corners_of = [ring[0]]
        for start, end in pairwise(ring):
            between = [
                (math.dist(start, corner), corner) for corner in added.get(next(numbers), [])
            ]
            corners_of += [*(corner for _, corner in sorted(between)), end]
        whole.append(corners_of)
    return whole
