"""What the diagnosis has learned and what was chosen for it, frozen in two files."""

from __future__ import annotations

import hashlib
import json
import zlib
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from sassgis.gap.which.classifier import DESIGNS, Classifier, TreeEnsemble
from sassgis.gap.which.verdict import Thresholds
from sassgis.model.errors import InputError

#: Chosen on batteries of development, and frozen for all that is reported.
THRESHOLDS = Path(str(files("sassgis").joinpath("data/gap_thresholds.json")))
#: Grown on the same worlds, and frozen with them.
CLASSIFIERS = Path(str(files("sassgis").joinpath("data/gap_classifiers.npz")))


def read_thresholds(file: Path | None = None) -> dict[str, Any]:
    """The frozen thresholds of the diagnosis.

    ``battery_seeds`` in it lists the batteries that were looked at while they were chosen.

    Raises
    ------
    InputError
        If the file cannot be read or lacks that list.
    """
    path = file or THRESHOLDS
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("thresholds cannot be read", file=path, found=reason) from None
    seeds = content.get("battery_seeds") if isinstance(content, dict) else None
    if not isinstance(seeds, list) or not all(isinstance(s, int) for s in seeds):
        raise InputError(
            "says not on which batteries the thresholds were chosen",
            file=path,
            field="battery_seeds",
            found=seeds,
            expected="a list of whole numbers",
        )
    return dict(content)


def thresholds_of(content: dict[str, Any]) -> Thresholds:
    """The thresholds in the content of their file; what it does not name keeps its default."""
    names = {field.name for field in fields(Thresholds)}
    return Thresholds(**{k: v for k, v in content.items() if k in names})


def frozen_digest(file: Path | None = None) -> str:
    """SHA-256 of thresholds and classifiers together."""
    digest = hashlib.sha256((file or THRESHOLDS).read_bytes())
    digest.update(CLASSIFIERS.read_bytes())
    return digest.hexdigest()


def read_classifier(design: str, file: Path | None = None) -> Classifier:
    """The classifier of one design.

    Raises
    ------
    InputError
        If the file cannot be read or lacks the design.
    """
    path = file or CLASSIFIERS
    try:
        with np.load(path) as content:
            held = {
                name.partition("/")[2]: content[name]
                for name in content.files
                if name.startswith(f"{design}/")
            }
            right = held["right"].astype(np.int64)
            own = np.arange(right.size)
            trees = TreeEnsemble(
                held["root"].astype(np.int64),
                held["number"].astype(np.int64),
                held["limit"].astype(np.float32),
                np.where(right == own, own, own + 1),
                right,
                held["share"].astype(np.float32) / 255.0,
            )
            return Classifier(
                tuple(held["names"].tolist()),
                tuple(held["causes"].tolist()),
                held["centre"],
                held["scale"],
                trees,
                float(held["power"]),
                held["weight"],
                float(held["caution"]),
            )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(
            "what the diagnosis has learned cannot be read",
            file=path,
            field=design,
            found=str(error) or type(error).__name__,
        ) from None


def write_classifiers(file: Path, classifiers: dict[str, Classifier]) -> None:
    """Write the classifiers of all designs: shares rounded to 1/255, limits to half precision.

    Raises
    ------
    ValueError
        If a design is missing, or a node does not stand just before what is left of it.
    """
    if set(classifiers) != set(DESIGNS):
        raise ValueError(f"designs are {', '.join(DESIGNS)}")
    arrays: dict[str, Any] = {}
    for design, classifier in classifiers.items():
        trees = classifier.trees
        own = np.arange(trees.left.size)
        if not np.array_equal(trees.left, np.where(trees.right == own, own, own + 1)):
            raise ValueError("nodes are not in the order of their trees, depth first, left first")
        arrays |= {
            f"{design}/{name}": values
            for name, values in {
                "names": np.array(classifier.names),
                "causes": np.array(classifier.causes),
                "centre": classifier.centre,
                "scale": classifier.scale,
                "power": np.array(classifier.power),
                "weight": classifier.weight,
                "caution": np.array(classifier.confidence_calibration),
                "root": trees.root.astype(np.int32),
                "number": trees.number.astype(np.int16),
                "limit": trees.limit.astype(np.float16),
                "right": trees.right.astype(np.int32),
                "share": np.round(trees.share * 255.0).astype(np.uint8),
            }.items()
        }
    np.savez_compressed(file, **arrays)
