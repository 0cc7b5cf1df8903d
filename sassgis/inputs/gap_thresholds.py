"""Thresholds chosen for the diagnosis, frozen in a file."""

from __future__ import annotations

import json
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any

from sassgis.errors import InputError
from sassgis.gap.verdict.verdict import CauseWeights, Thresholds, weights_of

#: Chosen on batteries of development, and frozen for all that is reported.
THRESHOLDS = Path(str(files("sassgis").joinpath("data/gap_thresholds.json")))


def read_thresholds(file: Path | None = None) -> dict[str, Any]:
    """Return the frozen thresholds of the diagnosis; InputError if their file cannot be read.

    Its list ``battery_seeds`` names the batteries that were looked at while they were chosen.
    """
    path = file or THRESHOLDS
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("thresholds cannot be read", file=path, found=reason) from None
    seeds = content.get("battery_seeds") if isinstance(content, dict) else None
    if not isinstance(seeds, list) or not all(isinstance(s, int) for s in seeds):
        raise InputError(
            "says not on which batteries the thresholds were chosen", file=path,
            field="battery_seeds", found=seeds, expected="a list of whole numbers",
        )  # fmt: skip
    return dict(content)


def thresholds_of(content: dict[str, Any]) -> Thresholds:
    """Return thresholds in the content of their file; what it does not name keeps its default."""
    names = {field.name for field in fields(Thresholds)}
    return Thresholds(**{k: v for k, v in content.items() if k in names})


def cause_weights_of(content: dict[str, Any]) -> CauseWeights:
    """Return weights in the content of their file; InputError if they are missing or no weights."""
    try:
        return weights_of(content["weights"])
    except (KeyError, TypeError, ValueError) as error:
        problem, found = "weights of the fingerprints cannot be read", repr(error)
        raise InputError(problem, file=THRESHOLDS, field="weights", found=found) from None
