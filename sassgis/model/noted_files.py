"""Names of the files that a run writes, noted in its working folder before each is opened.

By these notes what a killed run leaves half written is known from what a user keeps there.
"""

from __future__ import annotations

import os
from pathlib import Path

PARTIAL = ".partial"
#: Marks a working folder and holds its notes.
MARKER_NAME = ".sassgis-partial"


def noted(file: Path) -> Path:
    """Note a file that is about to be written, in all working folders that it lies in; the file."""
    for folder in file.parents:
        marker = folder / MARKER_NAME
        if folder.name.endswith(PARTIAL) and marker != file and os.path.isfile(marker):
            with marker.open("a", encoding="utf-8") as stream:
                stream.write(f"{file.relative_to(folder).as_posix()}\n")
    return file


def notes_of(folder: Path) -> set[str]:
    """What is noted in a working folder, relative to it, and its marker; nothing in any other."""
    marker = folder / MARKER_NAME
    if not os.path.isfile(marker):
        return set()
    # What is no text is the name of nothing that a run has written.
    return {MARKER_NAME, *marker.read_text(encoding="utf-8", errors="replace").splitlines()}
