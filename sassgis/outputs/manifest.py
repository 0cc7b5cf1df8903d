"""The manifest of a result: what went in, with which versions and settings, and what came out."""

from __future__ import annotations

import dataclasses
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from functools import cache
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import pyogrio
import rasterio

import sassgis
from sassgis.errors import InputError
from sassgis.files.atomic_output import MANIFEST_DIGEST, result_files, write_json
from sassgis.files.digests import content_digest, json_digest
from sassgis.files.input_parts import files_of
from sassgis.files.plain_file import seen_from
from sassgis.settings.results import rounded
from sassgis.settings.schema import InMemory, Input

MANIFEST_FORMAT = 1

_PACKAGES = (
    *("numpy", "numba", "scipy", "shapely", "rasterio", "pyogrio", "geopandas", "pyproj"),
    *("matplotlib", "pydantic"),
)


def write_manifest(
    path: Path,
    *,
    inputs: Mapping[str, Input],
    base: Path,
    crs: str,
    vertical_datum: str,
    seed: int,
    ref_widths_m: Mapping[str, float],
    preset: str,
    settings: object,
    counts: Mapping[str, int],
    warnings: Sequence[str],
    checks: Mapping[str, object] | None = None,
) -> Path:
    """Write the manifest of the result in ``path.parent``.

    It is the last file of a result to be written, as it lists the others with their digests: these
    files, and no others, may be replaced later. It holds no time and no path of the machine: equal
    runs give equal manifests. Inputs are by role ("dem", "release", ...) and are named relative to
    ``base`` with their sidecar files. Reference widths (m) are those of "reach_probability" and
    "hazard"; the settings have their defaults filled in.
    """
    plain_settings = plain(settings)
    content: dict[str, object] = {
        "format": MANIFEST_FORMAT,
        "sassgis": sassgis.__version__,
        "versions": software_versions(),
        "inputs": [
            {"role": role, **own}
            for role, given in inputs.items()
            for own in _input_entries(given, base)
        ],
        "crs": crs,
        "vertical_datum": vertical_datum,
        "seed": int(seed),
        "ref_widths_m": plain(ref_widths_m),
        "preset": preset,
        "settings": plain_settings,
        "settings_sha256": json_digest(plain_settings),
        "counts": plain(counts),
        "warnings": list(warnings),
        "checks": plain(checks or {}),
        "files": [
            _described(file, file.relative_to(path.parent).as_posix())
            for file in result_files(path.parent)
        ],
    }
    content[MANIFEST_DIGEST] = json_digest(content)
    write_json(path, content)
    return path


@cache
def software_versions() -> Mapping[str, str]:
    """List versions of Python, the platform and the libraries behind numbers and files."""
    versions = {
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
    }
    # Each from a separate file: read once, as a batch asks for every area.
    versions |= {package: version(package) for package in _PACKAGES}
    # Each brings its own GDAL.
    versions["gdal (rasterio)"] = str(rasterio.__gdal_version__)
    versions["gdal (pyogrio)"] = str(pyogrio.__gdal_version_string__)
    return versions


def plain(value: object, digits: int | None = None) -> Any:
    """Return the value as JSON knows it: dataclasses as objects, arrays as lists, infinity as text.

    With ``digits`` numbers are rounded to so many, and None represents what is no finite one.
    TypeError if there is no such form.
    """
    if isinstance(value, Enum):
        return value.name.lower()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if digits is not None:
            return rounded(value, digits)
        return value if math.isfinite(value) else str(value)
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist(), digits)
    if isinstance(value, PurePath):
        return value.as_posix()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = (entry.name for entry in dataclasses.fields(value))
        return {name: plain(getattr(value, name), digits) for name in names}
    if isinstance(value, Mapping):
        return {str(key): plain(entry, digits) for key, entry in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, bytes):
        return [plain(entry, digits) for entry in value]
    raise TypeError(f"no form in JSON for {type(value).__name__}")


def _input_entries(given: Input, base: Path) -> list[dict[str, object]]:
    """Return the name and digest of an input, and of what belongs to it."""
    if isinstance(given, InMemory):
        return [{"path": given.name, "size": None, "sha256": given.digest}]
    return [_described(file, seen_from(base, file)) for file in files_of(given)]


def _described(file: Path, shown: str) -> dict[str, object]:
    try:
        return {"path": shown, "size": file.stat().st_size, "sha256": content_digest(file)}
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=shown) from error
