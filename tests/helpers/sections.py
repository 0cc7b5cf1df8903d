"""Sections of a configuration without the rest of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter


def section_of(cls: type[Any], table: Mapping[str, Any], file: Path) -> Any:
    """A section from its table, as if it stood in ``file``."""
    context = {"base": file.parent, "file": file}
    return TypeAdapter(cls).validate_python(dict(table), context=context)
