"""Results appear whole or not at all, and a failure of the disk is one line."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sqlite3
import stat
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import IO

import pyogrio.errors
import rasterio.errors

from sassgis.io.digests import Stamp, stamp_of
from sassgis.io.own_files import (
    LITTER,
    MANIFEST_NAME,
    SIDECAR,
    delete_files,
    entries,
    is_own,
    own_files,
    refuse_open,
    remember,
    remove_empty,
)
from sassgis.io.read.plain_file import is_text
from sassgis.model.errors import OutputError, SassgisError, chain, shown
from sassgis.model.noted_files import MARKER_NAME, PARTIAL, noted, notes_of

try:  # Advisory locks exist on POSIX only; elsewhere two runs into one folder are not caught.
    import fcntl
except ImportError:  # pragma: no cover
    _LOCKS = False
else:
    _LOCKS = True

#: Files and folders of this stem are the saved state of a simulation and outlive a failed run.
CHECKPOINT_STEM = "checkpoint"
#: Open files that clearing a working folder takes, at most.
_SPARE = 4
#: What GDAL and SQLite put beside a file while they write it.
_BESIDE = (SIDECAR, "-journal", ".ovr.tmp")

_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would be larger than the system allows",
    errno.EROFS: "the disk is read-only",
    errno.EACCES: "permission denied",
    errno.EPERM: "permission denied",
    errno.EIO: "the disk reports an error",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.ENAMETOOLONG: "the path is too long",
    errno.EBUSY: "the folder is in use",
    errno.EXDEV: "the folder is on another disk than the one beside it",
}
#: What GDAL and SQLite say instead of an error number.
_PHRASES = {
    "no space left": "the disk is full",
    "disk is full": "the disk is full",
    "disk quota": "the disk quota is used up",
    "file too large": "the file would be larger than the system allows",
    "permission denied": "permission denied",
    "read-only file system": "the disk is read-only",
    "readonly database": "permission denied",
    "disk i/o error": "the disk reports an error (it may be full)",
}
_LIBRARY_ERRORS = (
    rasterio.errors.RasterioError,
    pyogrio.errors.DataSourceError,
    pyogrio.errors.DataLayerError,
    pyogrio.errors.FeatureError,
    pyogrio.errors.GeometryError,
    sqlite3.Error,
)
#: Below this many free bytes a failure without a stated reason is put down to a full disk.
_NEARLY_NOTHING = 1 << 16
#: Below this many the line at least asks.
_LITTLE = 1 << 31


def _is_library_error(error: BaseException) -> bool:
    # GDAL's own errors live in a private module of rasterio and of pyogrio: known by their name.
    return isinstance(error, _LIBRARY_ERRORS) or any(
        kind.__name__ == "CPLE_BaseError" for kind in type(error).__mro__
    )


def _free_bytes(path: Path) -> int | None:
    for folder in (path, *path.parents):
        if folder.is_dir():
            with suppress(OSError):
                return shutil.disk_usage(folder).free
    return None


def _reason(error: BaseException, path: Path) -> str | None:
    """Why the disk refused; None where the error does not speak of the disk."""
    for link in chain(error):
        if isinstance(link, OSError) and link.errno in _REASONS:
            return _REASONS[link.errno]
        text = str(link).lower()
        for phrase, reason in _PHRASES.items():
            if phrase in text:
                return reason
    free = _free_bytes(path)
    if free is not None and free < _NEARLY_NOTHING:
        return "the disk is full"
    return None


def output_error(error: BaseException, path: Path) -> OutputError:
    """One clear line for what the system, GDAL or SQLite raised while ``path`` was written."""
    reason = _reason(error, path)
    if reason is None:
        detail = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        reason = " ".join(detail.split()) or type(error).__name__
        free = _free_bytes(path)
        if free is not None and free < _LITTLE and _is_library_error(error):
            # GDAL may say no more than that a transaction failed, and have cleared up by now.
            reason += f"; is the disk full? {free / 1e6:.1f} MB are free"
    return OutputError(f"{path}: cannot be written: {reason}")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn trouble with the disk while ``path`` is written into an OutputError that names it.

    That takes the place of any OSError and any error of rasterio, pyogrio, GDAL or SQLite in the
    block. The path is noted as written by the run, if it lies in a working folder.
    """
    if not is_text(path):
        raise OutputError(f"{shown(path)}: has a name or lies in a folder that is not UTF-8")
    try:
        noted(path)
        yield
    except OSError as error:
        raise output_error(error, path) from error
    except Exception as error:
        if _is_library_error(error):
            raise output_error(error, path) from error
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all; OutputError where the disk refuses."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        work = path.with_name(path.name + PARTIAL)
        work.write_text(text, encoding="utf-8", newline="\n")
        work.replace(path)


def write_json(path: Path, content: object) -> None:
    """Write plain values as JSON; OutputError where the disk refuses."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def partial_folder(target: Path) -> Path:
    """The working folder of a result: beside it, so that a rename can put it in place."""
    target = Path(os.path.realpath(target))
    if not target.name:
        raise OutputError(f"{target}: is the root of a disk; choose a folder within it")
    return target.with_name(target.name + PARTIAL)


@contextmanager
def staged_output(target: Path, overwrite: bool, parts: Sequence[str] = ()) -> Iterator[Path]:
    """Give a working folder that becomes ``target`` if the block ends well.

    The working folder is ``<target>.partial``. When the block ends it is renamed to ``target``; an
    older result is moved aside first and deleted after. When the block fails, what it wrote is
    deleted, except for a file or folder named ``checkpoint`` (any suffix), which the next run into
    the same target finds in its working folder.

    Files are deleted only if a run wrote them and they are still as it did: those of an older
    result by its manifest, those of a working folder by the notes of ``writing``.

    Missing parents of the target are made. A result that is there already is replaced with
    ``overwrite`` only; ``parts`` are folders of the result in which another command may have put a
    result of its own. The working folder that is given holds nothing but a checkpoint, if an
    earlier run left one.

    Raises
    ------
    OutputError
        If the target exists and must not be replaced, if it or the working folder holds anything
        that no run wrote, if another run is writing it, or if the disk is full, not writable, or
        fails.
    """
    shown = target
    target = Path(os.path.realpath(target))
    work = partial_folder(target)
    seen = _check_target(target, shown, overwrite, parts)
    with _open_work(work) as spare:
        try:
            yield work
            with writing(work):
                _flush_to_disk(work)
        except BaseException as error:
            spare.close()
            _clear(work)
            if isinstance(error, Exception) and _speaks_of_output(error, work):
                raise output_error(error, shown) from error
            raise
        try:
            seen = _check_target(target, shown, overwrite, parts, seen)
            delete_files(work, _noted_files(work, saved=True))
            remove_empty(work / CHECKPOINT_STEM)
            for name, _ in entries(work):
                noted(target / name)
            _swap(work, target, shown, seen, parts)
        except (OSError, OutputError) as error:
            # The result is whole: better left where it is than computed again.
            line = str(output_error(error, shown)) if isinstance(error, OSError) else str(error)
            raise OutputError(f"{line}; the finished result is in {work}") from error


@contextmanager
def output_if_asked(
    target: str | Path | None, overwrite: bool, parts: Sequence[str] = ()
) -> Iterator[Path]:
    """As ``staged_output``; without a target a folder for the time of the block."""
    if target is not None:
        with staged_output(Path(target), overwrite, parts) as work:
            yield work
        return
    with tempfile.TemporaryDirectory(prefix="sassgis-") as folder:
        yield Path(folder)


@contextmanager
def alone(target: Path) -> Iterator[None]:
    """Keep other runs from writing into a folder that grows part by part.

    The lock is on the working folder ``<target>.partial``, which is deleted after. OutputError if
    another run is writing it, or the disk is full or not writable.
    """
    work = partial_folder(target)
    with _open_work(work) as spare:
        try:
            yield
        finally:
            spare.close()
            _clear(work)


@contextmanager
def staged_file(target: Path, overwrite: bool = False) -> Iterator[Path]:
    """Give the place of a file that becomes ``target`` if the block ends well, and nothing if not.

    The place has the same name, in a folder beside the target that is deleted after. Missing
    parents are made. A file that is there already is replaced with ``overwrite`` only.

    Raises
    ------
    OutputError
        If the target exists and must not be replaced, or the disk is full or not writable.
    """
    target = Path(os.path.realpath(target))
    _check_file(target, overwrite)
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.stem}-", dir=target.parent))
    try:
        yield work / target.name
        with writing(target):
            _check_file(target, overwrite)
            remember(target, work / target.name)
            os.replace(work / target.name, target)
    except Exception as error:
        if _speaks_of_output(error, work):
            raise output_error(error, target) from error
        raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def write_new(file: Path, text: str, overwrite: bool) -> None:
    """Write a text to a file of its own; OutputError if it is there already and must stay."""
    with staged_file(file, overwrite) as work:
        work.write_text(text, encoding="utf-8", newline="\n")


def _check_file(target: Path, overwrite: bool) -> None:
    if not os.path.lexists(target):
        return
    if not overwrite:
        raise OutputError(f"{target}: exists already; choose another name, or --overwrite")
    refuse_open(target, target)
    if not is_own(target):
        raise OutputError(
            f"{target}: has changed since sassgis wrote it, or is not of sassgis, and is not "
            "deleted even with --overwrite; move it away, or choose another name"
        )


def check_output(target: Path, overwrite: bool) -> None:
    """Raise OutputError where ``staged_output`` would; nothing is touched."""
    _check_target(Path(os.path.realpath(target)), target, overwrite)
    work = partial_folder(target)
    if os.path.lexists(work):
        _check_work(work)
        _check_notes(work)


def _check_target(
    target: Path,
    shown: Path,
    overwrite: bool,
    parts: Sequence[str] = (),
    seen: Mapping[str, Stamp] | None = None,
) -> dict[str, Stamp]:
    """Files of the result that is there and may be replaced; none where there is nothing."""
    with writing(shown):
        if not os.path.lexists(target):
            return {}
        if not target.is_dir():
            raise OutputError(f"{shown}: is a file; the result needs a folder")
        if os.path.ismount(target):
            raise OutputError(f"{shown}: is the root of a disk; choose a folder within it")
        if not any(target.iterdir()):
            return {}
        if not overwrite:
            raise OutputError(
                f"{shown}: exists and is not empty; choose another folder, or --overwrite"
            )
        return own_files(target, shown, seen or {}, parts)


def result_files(folder: Path) -> list[Path]:
    """The files of a result but for its manifest; of a working folder what the run has noted."""
    if (folder / MARKER_NAME).is_file():
        own: Mapping[str, object] = _noted_files(folder)
    else:
        own = dict(entries(folder))
    return [folder / n for n in own if n != MANIFEST_NAME and not _outlives_failure(n)]


def _noted_files(work: Path, saved: bool | None = None) -> dict[str, Stamp]:
    """Files that runs have noted in their working folder: all, only what is saved, or all else."""
    notes = notes_of(work)
    return {
        name: stamp_of(state)
        for name, state in entries(work)
        if stat.S_ISREG(state.st_mode)
        and any(name.removesuffix(end) in notes for end in ("", *_BESIDE))
        and saved in (None, _outlives_failure(name))
    }


def _check_work(work: Path) -> None:
    """Refuse the place of a working folder if it is taken by anything else."""
    with writing(work):
        taken = os.path.islink(work) or (os.path.lexists(work) and not work.is_dir())
        marker = work / MARKER_NAME
        if (
            taken
            or os.path.islink(marker)
            or (work.is_dir() and any(work.iterdir()) and not marker.is_file())
        ):
            raise OutputError(
                f"{work}: exists already: the result is prepared in a folder of this name; "
                "move it away or delete it"
            )


def _check_notes(work: Path) -> None:
    """Refuse a working folder that holds a file which no run has noted."""
    with writing(work):
        own = _noted_files(work)
        for name, _ in entries(work):
            if name not in own and Path(name).name not in LITTER:
                raise OutputError(
                    f"{work / name}: is not noted as written by sassgis, which clears this folder; "
                    "move it away or delete it"
                )


@contextmanager
def _open_work(work: Path) -> Iterator[ExitStack]:
    """Make, mark and lock the working folder; leave no empty one behind.

    Gives open files that are closed before the folder is cleared, which needs a few: what failed
    may have found that the system allows no more.
    """
    _check_work(work)
    with ExitStack() as spare:
        with writing(work):
            for _ in range(_SPARE):
                spare.enter_context(open(os.devnull, "rb"))
            work.mkdir(parents=True, exist_ok=True)
            try:
                marker = noted(work / MARKER_NAME).open("a", encoding="utf-8")
            except OSError:
                with suppress(OSError):
                    work.rmdir()
                raise
        with marker:
            _lock(marker, work)
            try:
                _check_notes(work)
                _clear(work)
                yield spare
            finally:
                spare.close()
                if work.is_dir() and [entry.name for entry in work.iterdir()] == [MARKER_NAME]:
                    delete_files(work, _noted_files(work, saved=True))
                    remove_empty(work)


def _lock(marker: IO[str], work: Path) -> None:
    if not _LOCKS:  # pragma: no cover
        return
    try:
        fcntl.flock(marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise OutputError(f"{work}: another run is writing this result") from error
    except OSError:
        # Some network disks know no locks; a run must not fail for that.
        return


def _outlives_failure(name: str) -> bool:
    return name == MARKER_NAME or name.split("/")[0].split(".")[0] == CHECKPOINT_STEM


def _clear(work: Path) -> None:
    """Delete what is half written, and its notes; marker and saved states stay."""
    with suppress(OSError):
        delete_files(work, _noted_files(work, saved=False))
        remove_empty(work)
        kept = _noted_files(work, saved=True)
        # In place, as the file is locked; no longer than before, as the disk may be full.
        with (work / MARKER_NAME).open("r+", encoding="utf-8") as marker:
            marker.writelines(f"{name}\n" for name in kept if name != MARKER_NAME)
            marker.truncate()


def _flush_to_disk(work: Path) -> None:
    """Wait for the disk: some file systems report only now that they are full."""
    # Windows flushes only what is open for writing.
    mode = os.O_RDONLY if os.name == "posix" else os.O_RDWR
    for name, state in entries(work):
        if stat.S_ISREG(state.st_mode):
            descriptor = os.open(work / name, mode)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def _swap(
    work: Path, target: Path, shown: Path, seen: Mapping[str, Stamp], parts: Sequence[str]
) -> None:
    """Rename ``work`` to ``target``; what was there is deleted after, or put back on failure."""
    if not target.is_dir():
        os.rename(work, target)
        return
    # Never a name in use: it could be the user's own, or what a run that was killed left here.
    names = (target.with_name(f"{target.name}.replaced{n or ''}") for n in count())
    aside = next(name for name in names if not os.path.lexists(name))
    os.rename(target, aside)
    try:
        # Once more where nobody looks for it: what has come or changed in between is put back.
        seen = _check_target(aside, shown, True, parts, seen)
        os.rename(work, target)
    except BaseException:
        if not os.path.lexists(target):
            os.rename(aside, target)
        raise
    delete_files(aside, seen)
    remove_empty(aside)


def _speaks_of_output(error: Exception, work: Path) -> bool:
    """Whether an error that escaped the block is about writing, not about some input."""
    if isinstance(error, SassgisError):
        return False
    if isinstance(error, OSError):
        if error.filename is not None:
            return Path(os.path.realpath(os.fsdecode(error.filename))).is_relative_to(work)
        return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
    return _is_library_error(error) and (
        str(work) in str(error) or _reason(error, work) is not None
    )
