"""What manifests list."""

from __future__ import annotations

import json
from pathlib import Path

from sassgis.outputs.manifest import write_manifest


def list_files(folder: Path) -> None:
    """Write the manifest of what is in a folder."""
    write_manifest(
        folder / "manifest.json", inputs={}, base=folder, crs="", vertical_datum="", seed=1,
        ref_widths_m={}, preset="", settings={}, counts={}, warnings=(),
    )  # fmt: skip


def digests(folder: Path, suffix: str = "") -> dict[str, str]:
    """SHA-256 of the files of a result by their path, of those with the ending alone."""
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    return {f["path"]: f["sha256"] for f in manifest["files"] if f["path"].endswith(suffix)}
