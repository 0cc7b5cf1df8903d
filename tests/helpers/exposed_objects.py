"""Layers of exposed objects, read with attributes and numbers given by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sassgis.grid import Grid
from sassgis.inputs import objects
from sassgis.settings.exposure import ObjectKind, ObjectSettings, PlacedObjects


def read_objects(
    file: Path,
    grid: Grid,
    *,
    kind: ObjectKind,
    name: str = "objects",
    fields: Mapping[str, str] | None = None,
    defaults: Mapping[str, float] | None = None,
    **more: Any,
) -> PlacedObjects:
    columns = {f"{key}_field": column for key, column in (fields or {}).items()}
    settings = ObjectSettings(name, kind, file, **columns, **(defaults or {}), **more)
    return objects.read_objects(settings, grid)
