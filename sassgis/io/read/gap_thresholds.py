"""What was chosen for the diagnosis, frozen in a file."""

from __future__ import annotations

import json
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any

from sassgis.gap.which.cause_weights import CauseWeights, weights_of
from sassgis.gap.which.verdict import Thresholds
from sassgis.io.digests import content_digest
from sassgis.model.errors import InputError

#: Chosen on batteries of development, and frozen for all that is reported.
THRESHOLDS = Path(str(files("sassgis").joinpath("data/gap_thresholds.json")))


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
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("thresholds cannot be read", file=path, found=reason) from None
    seeds = content.get("battery_seeds") if isinstance(content, dict) else None
    if not isinstance(seeds, list) or not all(isinstance(s, int) for s in seeds):
        problem = "says not on which batteries the thresholds were chosen"
        raise InputError(
            problem,
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


def cause_weights_of(content: dict[str, Any]) -> CauseWeights:
    """The weights in the content of their file.

    Raises
    ------
    InputError
        If they are missing or no weights.
    """
    try:
        return weights_of(content["weights"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "weights of the fingerprints cannot be read",
            file=THRESHOLDS,
            field="weights",
            found=repr(error),
        ) from None


def frozen_digest(file: Path | None = None) -> str:
    """SHA-256 of the thresholds."""
    return content_digest(file or THRESHOLDS)
