"""Results appear whole or not at all, and replace nothing but what sassgis wrote.

A result is prepared next to its place and renamed when it is whole. A folder lists its files with
their digests in its manifest, single files are listed in ``.sassgis-written`` next to them: what is
not listed, or has changed since, is never deleted.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from sassgis.errors import OutputError, chain, shown
from sassgis.files.digests import content_digest, json_digest

#: The file of a result that lists the others with their digests, and its digest of itself.
MANIFEST_NAME, MANIFEST_DIGEST = "manifest.json", "manifest_sha256"
#: Files and folders of this stem are the saved state of a simulation and outlive a failed run.
CHECKPOINT_STEM = "checkpoint"
#: Marks a working folder, and is locked while a run writes into it.
MARKER_NAME = ".sassgis-partial"
#: Lists, in any folder, the single files that commands have written there.
WRITTEN_NAME = ".sassgis-written"
_PARTIAL = ".partial"
#: What GDAL puts next to a raster that is only looked at, and file managers into a folder.
_SIDECAR, _BESIDE = ".aux.xml", (".DS_Store", "Thumbs.db", WRITTEN_NAME)
#: What SQLite keeps next to a database that is open: parts of it, without which it is damaged.
_OPEN = ("-wal", "-shm", "-journal")
#: What the system, GDAL and SQLite say, in other words.
_REASONS = {
    "no space left": "the disk is full",
    "disk is full": "the disk is full",
    "disk quota": "the disk quota is used up",
    "read-only file system": "the disk is read-only",
    "permission denied": "permission denied",
    "not a directory": "a part of the path is a file, not a folder",
    "i/o error": "the disk reports an error (it may be full)",
}
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
_LIBRARIES = ("rasterio", "pyogrio", "sqlite3")
#: What a list of files may raise that sassgis has not written, or that is not there.
_NO_LIST = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)


def is_text(path: Path) -> bool:
    """Return whether a path, from the root, is UTF-8: GDAL, SQLite, XML and JSON take no other."""
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError:
        return False
    return True


@contextmanager
def writing(path: Path, within: Path | None = None) -> Iterator[None]:
    """Turn trouble with the disk while ``path`` is written into an OutputError that names it.

    That takes the place of any OSError and any error of rasterio, pyogrio, GDAL or SQLite in the
    block; with ``within`` only of those about what lies in that folder, or about the disk.
    """
    if not is_text(path):
        raise OutputError(f"{shown(path)}: has a name or lies in a folder that is not UTF-8")
    try:
        yield
    except Exception as error:
        of_system = isinstance(error, OSError)
        of_disk = isinstance(error, OSError) and error.errno in _DISK
        kinds = {kind.__module__.partition(".")[0] for kind in type(error).__mro__}
        if not (of_system or kinds.intersection(_LIBRARIES)):
            raise
        if within is not None and not of_disk and str(within) not in str(error):
            raise
        raise OutputError(f"{path}: cannot be written: {_reason(error)}") from error


def _reason(error: BaseException) -> str:
    """State why the disk refused, in one line."""
    said = " ".join(str(own) for own in chain(error)).lower()
    detail = (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
    known = (reason for words, reason in _REASONS.items() if words in said)
    return next(known, " ".join(detail.split()))


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all; OutputError where the disk refuses."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        work = path.with_name(path.name + _PARTIAL)
        work.write_text(text, encoding="utf-8", newline="\n")
        work.replace(path)


def write_json(path: Path, content: object) -> None:
    """Write plain values as JSON; OutputError where the disk refuses."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


@contextmanager
def staged_file(target: Path, overwrite: bool = False) -> Iterator[Path]:
    """Give the place of a file that becomes ``target`` if the block ends well, and nothing if not.

    The place has the same name, in a folder next to the target that is deleted after. Missing
    parents are made. A file that is there already is replaced with ``overwrite`` only, and only as
    a command wrote it; else, and where the disk is full or not writable, OutputError.
    """
    target = Path(os.path.realpath(target))
    _check_file(target, overwrite)
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.stem}-", dir=target.parent))
    try:
        with writing(target, within=work):
            yield work / target.name
        with writing(target):
            _check_file(target, overwrite)
            _list_written(target, work / target.name)
            os.replace(work / target.name, target)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def write_new(file: Path, text: str, overwrite: bool) -> None:
    """Write a text to a separate file; OutputError if it is there already and must stay."""
    with staged_file(file, overwrite) as work:
        work.write_text(text, encoding="utf-8", newline="\n")


def _check_file(target: Path, overwrite: bool) -> None:
    if not os.path.lexists(target):
        return
    if not overwrite:
        raise OutputError(f"{target}: exists already; choose another name, or --overwrite")
    _refuse_open(target, target)
    known = _written(target.parent).get(target.name, ())
    if not target.is_file() or content_digest(target) not in known:
        raise OutputError(
            f"{target}: has changed since sassgis wrote it, or is not of sassgis, and is not "
            "deleted even with --overwrite; move it away, or choose another name"
        )


def _written(folder: Path) -> dict[str, list[str]]:
    """Return digests of the single files that commands wrote into a folder, by their names."""
    try:
        content = json.loads((folder / WRITTEN_NAME).read_text(encoding="utf-8"))
        return {name: list(digests) for name, digests in content.items()}
    except _NO_LIST:
        return {}


def _list_written(target: Path, fresh: Path) -> None:
    """List what a file holds and is about to hold: a command that is killed leaves the older."""
    held = [content_digest(file) for file in (target, fresh) if file.is_file()]
    listed = {**_written(target.parent), target.name: held}
    # In a folder of all users the list may be that of another.
    with suppress(PermissionError):
        work = fresh.with_name(WRITTEN_NAME)
        work.write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
        os.replace(work, target.parent / WRITTEN_NAME)


def partial_folder(target: Path) -> Path:
    """Return the working folder of a result: next to it, so that a rename can put it in place."""
    target = Path(os.path.realpath(target))
    if not target.name:
        raise OutputError(f"{target}: is the root of a disk; choose a folder within it")
    return target.with_name(target.name + _PARTIAL)


@contextmanager
def staged_output(target: Path, overwrite: bool, parts: Sequence[str] = ()) -> Iterator[Path]:
    """Give a working folder, ``<target>.partial``, that becomes ``target`` if the block ends well.

    An older result is moved aside first and deleted after. When the block fails, or a run was
    killed, the folder is cleared, except for a file or folder named ``checkpoint`` (any suffix),
    which the next run into the same target finds in it. Missing parents of the target are made.

    A result that is there already is replaced with ``overwrite`` only, and only if it holds nothing
    but what its manifest lists, as it was written; ``parts`` are folders in it in which another
    command may have put a separate result. Else, if the place of the working folder is taken, if
    another run is writing it, or if the disk is full, not writable, or fails, OutputError.
    """
    work = partial_folder(target)
    _check_target(target, overwrite, parts)
    with alone(target):
        with writing(target, within=work):
            yield work
        with writing(target):
            _flush_to_disk(work)
            _clear(work, keep_saved=False)
        try:
            with writing(target):
                _put_in_place(work, target, overwrite, parts)
        except OutputError as error:
            # The result is whole: better left where it is than computed again.
            raise OutputError(f"{error}; the finished result is in {work}") from error


@contextmanager
def output_if_asked(
    target: str | Path | None, overwrite: bool, parts: Sequence[str] = ()
) -> Iterator[Path]:
    """Open as ``staged_output`` does; without a target a folder for the time of the block."""
    if target is not None:
        with staged_output(Path(target), overwrite, parts) as work:
            yield work
        return
    with tempfile.TemporaryDirectory(prefix="sassgis-") as folder:
        yield Path(folder)


def check_output(target: Path, overwrite: bool) -> None:
    """Raise OutputError where ``staged_output`` would; nothing is touched."""
    _check_target(target, overwrite)
    _check_work(partial_folder(target))


def result_files(folder: Path) -> list[Path]:
    """Return files of a result but for its manifest, and what a working folder does not pass on."""
    tops = {f: f.relative_to(folder).parts[0] for f in _files(folder)}
    own = (MANIFEST_NAME, MARKER_NAME)
    return [f for f, top in tops.items() if top not in own and not _is_saved(top)]


def _files(folder: Path) -> list[Path]:
    """List all that lies in a folder and is no folder; links are files."""
    return sorted(p for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())


def _check_target(target: Path, overwrite: bool, parts: Sequence[str] = ()) -> None:
    """Refuse a target that is there and must not be replaced."""
    with writing(target):
        if not os.path.lexists(target):
            return
        if not target.is_dir() or os.path.ismount(target):
            raise OutputError(f"{target}: is a file or a disk; the result needs a folder")
        if not any(target.iterdir()):
            return
        if not overwrite:
            raise OutputError(
                f"{target}: exists and is not empty; choose another folder, or --overwrite"
            )
        _own_files(target, target, parts)


def _own_files(folder: Path, shown: Path, parts: Sequence[str]) -> list[Path]:
    """List the files of a result; OutputError for the first that no run wrote in this state."""
    listed = _listed(folder)
    if listed is None:
        raise OutputError(
            f"{shown}: is not a result of sassgis that lists its files (in {MANIFEST_NAME}) and is "
            "not deleted even with --overwrite; delete it or move it away by hand, or choose "
            "another folder"
        )
    for part in parts:
        listed |= {f"{part}/{name}": own for name, own in (_listed(folder / part) or {}).items()}
    found = _files(folder)
    for file in found:
        name, why = file.relative_to(folder).as_posix(), ""
        _refuse_open(file, shown / name)
        beside = name.removesuffix(_SIDECAR) in listed or file.name in _BESIDE
        if file.is_symlink() or not file.is_file() or not (name in listed or beside):
            why = f"is not a file that {MANIFEST_NAME} lists"
        elif name in listed and listed[name] != content_digest(file):
            why = "has changed since sassgis wrote it"
        if why:
            raise OutputError(
                f"{shown / name}: {why}, and --overwrite deletes only what sassgis wrote; "
                "move it away, or choose another folder"
            )
    return found


def _listed(folder: Path) -> dict[str, str] | None:
    """Return digests of the files of a result; None where no manifest of sassgis lists any."""
    file = folder / MANIFEST_NAME
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        listed = {str(own["path"]): str(own["sha256"]) for own in content["files"]}
        whole = content.pop(MANIFEST_DIGEST, None) in (None, json_digest(content))
        listed[MANIFEST_NAME] = content_digest(file) if whole else "another"
        return listed if "sassgis" in content else None
    except _NO_LIST:
        return None


def _refuse_open(file: Path, shown: Path) -> None:
    """Raise OutputError if a GeoPackage is open in another program."""
    beside = [end for end in _OPEN if os.path.lexists(f"{file}{end}")]
    if file.suffix.lower() == ".gpkg" and beside:
        raise OutputError(
            f"{shown}: is open in another program, such as QGIS ({file.name}{beside[0]} lies "
            "beside it): close it there; if none has it open any more, open it once and close it"
        )


def _check_work(work: Path) -> None:
    """Refuse the place of a working folder if it is taken by anything else."""
    marker = work / MARKER_NAME
    with writing(work):
        marked = marker.is_file() and not marker.is_symlink()
        empty = not os.path.lexists(work) or (work.is_dir() and not any(work.iterdir()))
        if work.is_symlink() or not (marked or empty):
            raise OutputError(
                f"{work}: exists already: the result is prepared in a folder of this name; "
                "move it away or delete it"
            )


@contextmanager
def alone(target: Path) -> Iterator[None]:
    """Keep other runs from writing into a folder, which may also grow part by part.

    The lock is on the working folder ``<target>.partial``, which is cleared before and after, and
    deleted where nothing is kept. OutputError as of ``staged_output``.
    """
    work = partial_folder(target)
    _check_work(work)
    # A message names the folder that the user gave.
    with writing(target):
        work.mkdir(parents=True, exist_ok=True)
        lock = FileLock(work / MARKER_NAME)
        try:
            lock.acquire(timeout=0)
        except Timeout as error:
            raise OutputError(f"{target}: another run is writing this result") from error
    # Open files that clearing takes, where what failed has found that the system allows no more.
    spare = ExitStack()
    try:
        _clear(work)
        with writing(target):
            for _ in range(4):
                spare.enter_context(open(os.devnull, "rb"))  # noqa: SIM115
        yield
    finally:
        spare.close()
        # Without its marker it has become a result.
        if (work / MARKER_NAME).exists():
            _clear(work)
            with suppress(OSError):
                if os.listdir(work) == [MARKER_NAME]:
                    shutil.rmtree(work)
        lock.release()


def _is_saved(name: str) -> bool:
    return name.split(".")[0] == CHECKPOINT_STEM


def _clear(work: Path, keep_saved: bool = True) -> None:
    """Delete unfinished files, and keep marker and saved states; or delete only these."""
    with suppress(OSError):
        for entry in list(work.iterdir()):
            if (entry.name == MARKER_NAME or _is_saved(entry.name)) == keep_saved:
                continue
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                entry.unlink()


def _flush_to_disk(work: Path) -> None:
    """Wait for the disk: some file systems report only now that they are full."""
    for file in _files(work):
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())


def _put_in_place(work: Path, target: Path, overwrite: bool, parts: Sequence[str]) -> None:
    """Rename ``work`` to ``target``; what was there is deleted after, or put back on failure."""
    place = Path(os.path.realpath(target))
    if not (overwrite and place.is_dir() and any(place.iterdir())):
        # Also in the place of an empty folder; the system refuses any other.
        os.rename(work, place)
        return
    aside = Path(tempfile.mkdtemp(prefix=f"{place.name}.replaced-", dir=place.parent))
    os.rename(place, aside)
    try:
        # Where nobody looks for it: with what has come or changed during the run it is put back.
        own = _own_files(aside, target, parts)
        os.rename(work, place)
    except BaseException:
        os.rename(aside, place)
        raise
    for file in own:
        file.unlink()
    for folder, _, _ in os.walk(aside, topdown=False):
        with suppress(OSError):
            os.rmdir(folder)
