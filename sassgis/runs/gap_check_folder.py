"""The files of a blind check."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sassgis.gap.check.worlds import WorldSpec
from sassgis.io.staging import partial_folder, writing
from sassgis.model.errors import InputError


@dataclass(frozen=True, slots=True)
class PlannedSite:
    """A site of the battery: its name, what it is, and its seed."""

    case: str
    spec: WorldSpec
    seed: int


class CheckFolder:
    """The files of a check."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.plan = root / "check.json"  # what was asked for
        self.blinding = root / "labels.sha256"  # hash of the labels
        self.case_list = root / "cases.sha256"  # digests of the cases
        self.answer_list = root / "answers.sha256"  # digests of the answers
        self.salt = root / "blinded" / "salt.txt"  # what blinds the labels
        self.labels = root / "blinded" / "labels.json"  # the truth, opened at the end
        self.cases = root / "cases"  # all cases

    def case(self, case: str) -> Path:
        """The files of a case."""
        return self.cases / case

    def answer(self, case: str) -> Path:
        """What the diagnosis wrote."""
        return self.root / "answers" / case

    def record(self, case: str) -> Path:
        """That it answered, or why not."""
        return self.root / "answers" / f"{case}.json"

    def fresh(self, case: str) -> Path:
        """Rocks that no diagnosis has seen."""
        return partial_folder(self.root / "fresh") / case

    def measured(self, case: str) -> Path:
        """The shrinkage on them."""
        return self.root / "shrinkage" / f"{case}.json"


def read_json(file: Path) -> dict[str, Any]:
    """Read an object; InputError if it is none."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("cannot be read", file=file, found=reason) from None
    if not isinstance(content, dict):
        raise InputError("cannot be read", file=file, expected="a JSON object")
    return content


def write_json(file: Path, content: Mapping[str, object]) -> None:
    """Write an object whole or not at all."""
    write_text(file, json.dumps(content, indent=1) + "\n")


def write_text(file: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        work = file.with_name(f"{file.name}.partial")
        work.write_text(text, encoding="utf-8", newline="\n")
        work.replace(file)
