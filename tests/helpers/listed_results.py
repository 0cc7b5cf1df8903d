"""Results with a manifest, without a run."""

from __future__ import annotations

from pathlib import Path

from sassgis.io.write.manifest import write_manifest


def list_files(folder: Path) -> None:
    """Write the manifest of what is in a folder."""
    write_manifest(
        folder / "manifest.json", inputs={}, base=folder, crs="", vertical_datum="", seed=1,
        ref_widths_m={}, preset="", settings={}, counts={}, warnings=(),
    )  # fmt: skip
