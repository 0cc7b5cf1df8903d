"""Many release areas over a large terrain model: each alone, and all of them on one map.

Each area is zoned on the part of the terrain model that its fall lines need, and keeps its sums in
its folder. The mosaic is added up from these files: frequencies of areas add. Areas are taken in
the order of their names, so that neither the order of files nor the number of threads matters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sassgis.hazard.assess import Assessment, Rules
from sassgis.io.staging import check_output, writing
from sassgis.io.write.batch_summary import BatchSummary
from sassgis.model.errors import InputError, OutputError
from sassgis.model.run_config import Config
from sassgis.runs.batch_area import AREAS_NAME, kept_areas, read_setting
from sassgis.runs.batch_areas import Candidate, batch_config, find_areas
from sassgis.runs.batch_mosaic import MOSAIC_NAME, write_mosaic
from sassgis.runs.batch_outcomes import outcomes
from sassgis.runs.batch_state import RECORD_NAME, Record
from sassgis.runs.job import OnProgress
from sassgis.runs.workers import Jobs

SUMMARY_NAME = "summary.csv"


@dataclass(frozen=True, slots=True)
class BatchResult:
    """What a batch left.

    Attributes
    ----------
    folder : Path
    summary : DataFrame
        A row per release area, as in ``summary.csv``.
    found : Assessment or None
        Of the mosaic; None if it was there already.
    warnings : tuple of str
        Of the mosaic, and the areas that were skipped.
    """

    folder: Path
    summary: Any
    found: Assessment | None
    warnings: tuple[str, ...]


def batch(
    releases: str | Path,
    out: str | Path,
    *,
    config: str | Path | None = None,
    dem: str | Path | None = None,
    overwrite: bool = False,
    mosaic_only: bool = False,
    memory_gb: float | None = None,
    seed: int | None = None,
    jobs: Jobs = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
    first_margin_m: float = 200.0,
) -> BatchResult:
    """Zone many release areas one by one, and put them together on one map.

    Results that are complete and were made from the same settings and inputs are kept.

    Parameters
    ----------
    releases : path
        A vector file, a folder of vector files, or a configuration, whose release areas are run.
    out : path
        Folder to write: ``areas/<name>/`` for each area, ``mosaic/`` and ``summary.csv``.
    config : path, optional
        Everything else; default the only TOML file in the folder, or beside the file.
    dem : path, optional
        In place of that of the configuration: a raster, a VRT or a folder of tiles.
    overwrite : bool
        Whether results that were made from other settings or inputs may be replaced.
    mosaic_only : bool
        Whether areas keep only their sums, without maps, zones and a report of their own.
    memory_gb : float, optional
        Memory that all processes together may take (GB): it limits the number of areas at work,
        and larger mosaics are made block by block. The part of the terrain that one area needs
        is not divided.
    seed, jobs, on_progress, say
        As for sassgis.runs.run.run; chunks are those of one area.
    first_margin_m : float
        Margin around an area with which the search for its part of the terrain begins.

    Returns
    -------
    BatchResult

    Raises
    ------
    ConfigError, InputError
        If what all areas share cannot be used, or no area could be run.
    OutputError
        If a result exists already, or one that is due to be replaced holds a file that no run
        wrote; or the disk is full or not writable.
    Interrupted
        If the user stops the batch; what was computed is kept.
    """
    tell = say or (lambda _text: None)
    folder = Path(out)
    loaded = batch_config(Path(releases), config, dem, seed)
    candidates = find_areas(loaded)
    setting, notices = read_setting(loaded, candidates, first_margin_m, mosaic_only)
    _check_folder(folder)
    kept = kept_areas(setting, candidates, folder, overwrite, tell)
    waiting = [c for c in candidates if c.stem not in kept]
    for own in (*map(_folder, waiting), *([MOSAIC_NAME] if waiting else [])):
        check_output(folder / own, overwrite=True)
    summary = _summary(folder, loaded, candidates, setting.rules, kept)
    records = dict(kept)
    memory_bytes = None if memory_gb is None else int(memory_gb * 1e9)
    running = outcomes(setting, waiting, folder, jobs, on_progress, tell, memory_bytes)
    try:
        with closing(running):
            for candidate, outcome in zip(waiting, running, strict=True):
                if outcome.record is None:
                    tell(f"{candidate.name} is skipped: {outcome.reason}")
                    summary.skipped(_folder(candidate), outcome.reason)
                else:
                    _note(summary, candidate, outcome.record, outcome.seconds)
                    records[candidate.stem] = outcome.record
                summary.write_now_and_then()
    finally:
        summary.write()
    if not records:
        first = next(iter(summary.reasons().values()))
        raise InputError(
            f"no release area could be run; the first: {first}", file=loaded.release_path
        )
    skipped = tuple(f"{name} is skipped: {why}" for name, why in summary.reasons().items())
    stale = _stale(folder, records)
    found, warnings = write_mosaic(
        setting, [c for c in candidates if c.stem in records], records, folder,
        (*notices, *skipped), tell, memory_bytes, jobs,
    )  # fmt: skip
    return BatchResult(folder, summary.frame(), found, (*warnings, *stale))


def _check_folder(folder: Path) -> None:
    """Make the folder, unless it holds something else than a batch."""
    with writing(folder):
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{folder}: is a file; the result needs a folder")
        known = any((folder / name).exists() for name in (SUMMARY_NAME, AREAS_NAME))
        if folder.is_dir() and any(folder.iterdir()) and not known:
            raise OutputError(
                f"{folder}: is not empty and not of a batch (it has no {SUMMARY_NAME}); choose "
                "another folder"
            )
        folder.mkdir(parents=True, exist_ok=True)


def _stale(folder: Path, records: dict[str, Record]) -> tuple[str, ...]:
    """Results of areas that are not part of the mosaic."""
    areas = folder / AREAS_NAME
    return tuple(
        f"{f} is left from an earlier batch and not part of the mosaic."
        for f in sorted(areas.iterdir())
        if f.name not in records and (f / RECORD_NAME).is_file() and f.suffix != ".partial"
    )


def _summary(
    folder: Path,
    config: Config,
    candidates: Sequence[Candidate],
    rules: Rules,
    kept: Mapping[str, Record],
) -> BatchSummary:
    """The table of all areas, with those that are there already."""
    base = config.release_path if config.release_path.is_dir() else config.release_path.parent
    files = [c.release.file for c in candidates]
    summary = BatchSummary(
        folder / SUMMARY_NAME,
        {
            _folder(c): (c.name, "" if file is None else _relative(file, base))
            for c, file in zip(candidates, files, strict=True)
        },
        [level.code for level in rules.preset.levels],
    )
    for candidate in candidates:
        if candidate.stem in kept:
            _note(summary, candidate, kept[candidate.stem], None)
    summary.write()
    return summary


def _folder(candidate: Candidate) -> str:
    return f"{AREAS_NAME}/{candidate.stem}"


def _note(
    summary: BatchSummary, candidate: Candidate, record: Record, seconds: float | None
) -> None:
    facts = {n: getattr(record, n) for n in ("points", "rocks", "furthest_m")}
    summary.done(_folder(candidate), facts, record.zones_m2, seconds)


def _relative(file: Path, base: Path) -> str:
    return file.relative_to(base).as_posix() if file.is_relative_to(base) else str(file)
