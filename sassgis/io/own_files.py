"""Which files sassgis wrote, and nobody has changed since: these alone may be deleted."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from sassgis.io.digests import Stamp, content_digest, json_digest, stamp_of
from sassgis.model.errors import OutputError
from sassgis.model.noted_files import PARTIAL, notes_of

#: The file of a result that lists the others with their digests.
MANIFEST_NAME = "manifest.json"
#: Its digest of itself.
MANIFEST_DIGEST = "manifest_sha256"
#: Lists, in any other folder, the single files that commands have written there.
WRITTEN_NAME = ".sassgis-written"
#: What GDAL puts beside a raster that is only looked at, and file managers into a folder.
SIDECAR, LITTER = ".aux.xml", (".DS_Store", "Thumbs.db")
#: What SQLite keeps beside a database that is open: parts of it, without which it is damaged.
_OPEN = ("-wal", "-shm", "-journal")


def entries(folder: Path) -> Iterator[tuple[str, os.stat_result]]:
    """All that lies in a folder and is no folder, by its path from there; links are entries."""
    for name in sorted(os.listdir(folder)):
        state = os.lstat(folder / name)
        if stat.S_ISDIR(state.st_mode):
            yield from ((f"{name}/{deeper}", own) for deeper, own in entries(folder / name))
        else:
            yield name, state


def own_files(
    folder: Path, shown: Path, seen: Mapping[str, Stamp], parts: Sequence[str] = ()
) -> dict[str, Stamp]:
    """Stamps of the files of a result, if a run wrote each as it is.

    If not, an OutputError names the first file that no run has written, or that has changed.

    Parameters
    ----------
    shown : Path
        Its name in messages.
    seen : mapping of str to Stamp
        What an earlier call found: only what is not so any more is read again.
    parts : sequence of str
        Folders in it that may hold a result of their own, or have begun to.
    """

    def refusal(name: str, why: str) -> OutputError:
        return OutputError(
            f"{shown / name}: {why}, and --overwrite deletes only what sassgis wrote; "
            "move it away, or choose another folder"
        )

    listed = _listed(folder)
    if listed is None:
        raise OutputError(
            f"{shown}: is not a result of sassgis that lists its files (in {MANIFEST_NAME}) and is "
            "not deleted even with --overwrite; delete it or move it away by hand, or choose "
            "another folder"
        )
    begun: set[str] = set()
    for part in parts:
        listed |= {f"{part}/{name}": own for name, own in (_listed(folder / part) or {}).items()}
        half = f"{part}{PARTIAL}"
        begun |= {f"{half}/{name}" for name in notes_of(folder / half)}
    found = dict(entries(folder))
    for name in found:
        refuse_open(folder / name, shown / name)
    for name, state in found.items():
        known = name in begun or name in listed or name.removesuffix(SIDECAR) in listed
        known |= Path(name).name in (*LITTER, WRITTEN_NAME)
        if not (known and stat.S_ISREG(state.st_mode)):
            raise refusal(name, f"is not a file that {MANIFEST_NAME} lists")
    for name, state in found.items():
        own = listed.get(name)
        if own is not None and seen.get(name) != stamp_of(state):
            size, digest = own
            if state.st_size != size or content_digest(folder / name) != digest:
                raise refusal(name, "has changed since sassgis wrote it")
    return {name: stamp_of(state) for name, state in found.items()}


def refuse_open(file: Path, shown: Path) -> None:
    """Raise OutputError if a GeoPackage is open in another program."""
    beside = [end for end in _OPEN if os.path.lexists(f"{file}{end}")]
    if file.suffix.lower() == ".gpkg" and beside:
        raise OutputError(
            f"{shown}: is open in another program, such as QGIS ({file.name}{beside[0]} lies "
            "beside it): close it there; if none has it open any more, open it once and close it"
        )


def _listed(folder: Path) -> dict[str, tuple[int, str]] | None:
    """Size and digest of the files of a result; None where no manifest of sassgis lists any."""
    file = folder / MANIFEST_NAME
    if not file.is_file():
        return None
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        listed = {e["path"]: (int(e["size"]), str(e["sha256"])) for e in content["files"]}
        whole = content.pop(MANIFEST_DIGEST, None) in (None, json_digest(content))
        own = file.stat().st_size, content_digest(file) if whole else "another"
        return listed | {MANIFEST_NAME: own} if "sassgis" in content else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def delete_files(folder: Path, own: Mapping[str, Stamp]) -> None:
    """Delete files of a folder, each unless it is no more as stated."""
    for name, state in list(entries(folder)):
        if own.get(name) == stamp_of(state):
            with suppress(OSError):
                (folder / name).unlink()


def remove_empty(folder: Path) -> None:
    """Remove a folder and those in it, each unless it holds anything."""
    for place, _, _ in os.walk(folder, topdown=False):
        with suppress(OSError):
            os.rmdir(place)


# --- single files ----------------------------------------------------------------------------


def is_own(file: Path) -> bool:
    """Whether a single file is as a command wrote it."""
    regular = stat.S_ISREG(os.lstat(file).st_mode)
    return regular and content_digest(file) in _written(file.parent).get(file.name, ())


def remember(file: Path, fresh: Path) -> None:
    """List what a file is about to become: ``fresh``, of the same name in a folder beside it."""
    known = _written(file.parent)
    # A command that is killed before the file is replaced leaves the older one.
    held = [content_digest(own) for own in (file, fresh) if own.is_file()]
    known[file.name] = list(dict.fromkeys(held))
    work = fresh.with_name(WRITTEN_NAME)
    work.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    # In a folder of all users the list may be that of another.
    with suppress(PermissionError):
        os.replace(work, file.parent / WRITTEN_NAME)


def _written(folder: Path) -> dict[str, list[str]]:
    """Digests of the single files that commands wrote into a folder, by their names."""
    try:
        content = json.loads((folder / WRITTEN_NAME).read_text(encoding="utf-8"))
        return {name: list(digests) for name, digests in content.items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}
