"""Many release areas over a large terrain model: each by itself, and all of them on one map.

Each area is zoned on the part of the terrain model that its fall lines need, and keeps its sums in
its folder. The mosaic is added up from these files: frequencies of areas add. Areas are taken in
the order of their names, so that neither the order of files nor the number of threads matters.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sassgis.batches.batch_area import (
    AREAS_NAME,
    Candidate,
    Setting,
    kept_areas,
    read_setting,
    run_area,
    shared_digest,
)
from sassgis.batches.batch_mosaic import MOSAIC_NAME, write_mosaic
from sassgis.batches.batch_window import RECORD_NAME, Record
from sassgis.errors import ConfigError, InputError, OutputError, SassgisError, chain, of_the_system
from sassgis.files.atomic_output import check_output, writing
from sassgis.files.saved_arrays import UNFIT
from sassgis.hazard.assess import Assessment, Rules
from sassgis.inputs.config import load_config
from sassgis.inputs.vectors import release_features
from sassgis.outputs.zone_tables import BatchSummary
from sassgis.runs.resumable_run import Workplace, configured, workers_asked
from sassgis.settings.hazard_rules import SHEET_SCALES
from sassgis.settings.map_run import Config
from sassgis.settings.results import file_stems
from sassgis.settings.schema import InMemory, Input
from sassgis.settings.settings import ReleaseSettings
from sassgis.simulation.workers import Jobs, OnProgress, task_map

log = logging.getLogger(__name__)

SUMMARY_NAME = "summary.csv"
#: Vector files of a folder by their suffix; those that the configuration names do not count.
VECTOR_SUFFIXES = (".gpkg", ".shp", ".geojson", ".json", ".fgb", ".kml")
_CHANGED = (
    "A file that all release areas share changed while the batch ran. Areas may come from "
    "different versions of it. Run the batch again with --overwrite."
)
#: Bytes of a process that runs small areas.
_PROCESS = 800 << 20
#: From so many areas for each core on, every core has separate areas.
_AREAS_PER_CORE = 4


#: Outcome of an area: its record, or why it is skipped; the seconds that it took; and what there
#: was to say of saved states in a process that nobody listens to.
AreaOutcome = tuple[Record | None, str, float, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Result of a batch."""

    folder: Path
    summary: Any  # DataFrame with a row per release area, as in ``summary.csv``
    found: Assessment | None  # of the mosaic; None if it was there already
    warnings: tuple[str, ...]  # of the mosaic, and the areas that were skipped


def batch(
    releases: str | Path | Config,
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
) -> BatchResult:
    """Zone many release areas one by one, and put them together on one map.

    Results that are complete and were made from the same settings and inputs are kept.

    Parameters
    ----------
    releases : path or Config
        A vector file, a folder of vector files, or a configuration, whose release areas are run.
    out : path
        Folder to write: ``areas/<name>/`` for each area, ``mosaic/`` and ``summary.csv``.
    config : path, optional
        Everything else; default the only TOML file in the folder, or next to the file.
    dem : path, optional
        In place of that of the configuration: a raster, a VRT or a folder of tiles.
    overwrite : bool
        Whether results that were made from other settings or inputs may be replaced.
    mosaic_only : bool
        Whether areas keep only their sums, without maps, zones and a separate report.
    memory_gb : float, optional
        Memory that all processes together may take (GB): it limits the number of areas at work,
        and larger mosaics are made block by block. The part of the terrain that one area needs
        is not divided.
    seed, jobs, on_progress, say
        As for sassgis.runs.run.run; chunks are those of one area.

    Raises
    ------
    ConfigError, InputError, OutputError
    Interrupted
        If the user stops the batch; what was computed is kept.
    """
    tell = say or (lambda _text: None)
    folder = Path(out)
    loaded = batch_config(releases, config, dem, seed)
    # Zones of neighbouring areas, and those of the mosaic, are drawn alike.
    loaded = replace(loaded, zones=loaded.zones.at_scale(SHEET_SCALES[0]))
    candidates = find_areas(loaded)
    setting, notices = read_setting(loaded, candidates, mosaic_only)
    if loaded.run.ground_uncertainty:
        notices += ("run.ground_uncertainty applies to run and zone. The batch ignores it.",)
    _check_folder(folder)
    memory_bytes = None if memory_gb is None else int(memory_gb * 1e9)
    # A look at one takes a tenth of the time of a run.
    looking = _at_once(setting, jobs, memory_bytes, len(candidates) // 10)
    kept = kept_areas(setting, candidates, folder, overwrite, tell, looking)
    waiting = [c for c in candidates if c.stem not in kept]
    for own in (*map(_folder, waiting), *([MOSAIC_NAME] if waiting else [])):
        check_output(folder / own, overwrite=True)
    summary = _summary(folder, loaded, candidates, setting.rules, kept)
    records = dict(kept)
    place = Workplace(folder, jobs, on_progress, tell)
    running = outcomes(setting, waiting, place, memory_bytes)
    try:
        with closing(running):
            for candidate, (record, reason, seconds, _) in zip(waiting, running, strict=True):
                if record is None:
                    tell(f"{candidate.name} is skipped: {reason}")
                    summary.skipped(_folder(candidate), reason)
                else:
                    _note(summary, candidate, record, seconds)
                    records[candidate.stem] = record
                summary.write_now_and_then()
    finally:
        summary.write()
    if not records:
        first = next(iter(summary.reasons().values()))
        raise InputError(
            f"no release area could be run; the first: {first}", file=loaded.release_source
        )
    if shared_digest(loaded) != setting.digest:
        notices += (_CHANGED,)
    skipped = tuple(f"{name} is skipped: {why}" for name, why in summary.reasons().items())
    stale = _stale(folder, records)
    found, warnings = write_mosaic(
        setting, [c for c in candidates if c.stem in records], records, folder,
        notices=(*notices, *skipped), tell=tell, memory_bytes=memory_bytes, jobs=jobs,
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
    """Return results of areas that are not part of the mosaic."""
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
    """Return the table of all areas, with those that are there already."""
    given = config.release_source
    base = Path() if isinstance(given, InMemory) else given if given.is_dir() else given.parent
    summary = BatchSummary(
        folder / SUMMARY_NAME,
        {_folder(c): (c.name, _relative(c.release.file, base)) for c in candidates},
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


def _relative(file: Input | None, base: Path) -> str:
    if file is None or isinstance(file, InMemory) or not file.is_relative_to(base):
        return str(file or "")
    return file.relative_to(base).as_posix()


def batch_config(
    given: str | Path | Config, config: str | Path | None, dem: str | Path | None, seed: int | None
) -> Config:
    """Return the configuration, with the release areas in it."""
    if isinstance(given, Config):
        return configured(given, seed)
    releases = Path(given)
    overrides: dict[str, object] = {} if seed is None else {"run.seed": seed}
    if dem is not None:
        overrides["terrain.dem"] = str(Path(dem).expanduser().resolve())
    if releases.suffix.lower() == ".toml":
        if config is not None:
            raise ConfigError(
                "two configurations", file=releases, found=str(config), expected="one of them"
            )
        return load_config(releases, overrides)
    if not releases.exists():
        raise InputError(
            "file not found",
            file=releases,
            expected="a vector file of release areas, a folder of them, or a configuration",
        )
    overrides["release.file"] = str(releases.expanduser().resolve())
    return load_config(_beside(releases) if config is None else config, overrides)


def _beside(releases: Path) -> Path:
    """Return the only configuration in the folder of the release areas."""
    folder = releases if releases.is_dir() else releases.parent
    found = sorted(folder.glob("*.toml"))
    if len(found) != 1:
        raise ConfigError(
            "no configuration is given",
            file=folder,
            found=", ".join(f.name for f in found) or "no TOML file",
            expected="--config FILE, or one TOML file there",
        )
    return found[0]


def find_areas(config: Config) -> list[Candidate]:
    """Return all release areas that the configuration names, by name; shapes are not looked at.

    ``release.file`` may be a folder: then an area is named by its ``name_field`` or, in files
    without it, by the file. InputError: a single file cannot be used, or a folder holds none.
    """
    path = config.release_source
    named: list[tuple[str, ReleaseSettings, int, str]] = []
    several = isinstance(path, Path) and path.is_dir()
    for file in _release_files(config, path) if isinstance(path, Path) and several else [path]:
        release = replace(config.release, file=file)
        try:
            named += _named(release, by_file=several)
        except InputError as error:
            if not several:
                raise
            named.append((file.stem, release, 0, str(error)))
    counts = Counter(name for name, _, _, _ in named)
    named.sort(key=lambda n: (n[0], str(n[1].file), n[2]))
    found = []
    stems = file_stems([name for name, _, _, _ in named])
    for (name, release, number, problem), stem in zip(named, stems, strict=True):
        if not problem and counts[name] > 1:
            times = f"{counts[name]} times ({name!r}; expected names that differ)"
            problem = f"{release.file}: name is used {times}"
        found.append(Candidate(name, stem, release, number, problem))
    return found


def _release_files(config: Config, folder: Path) -> list[Path]:
    """Return vector files of the folder of release areas that serve no other purpose."""
    others = {
        f.resolve()
        for f in (
            config.ground.file,
            *((config.trees.file, config.trees.single_trees) if config.trees is not None else ()),
            config.edits.file,
            *(item.file for item in (*config.stations, *config.barriers)),
            *(item.file for item in config.objects),
        )
        if isinstance(f, Path)
    }
    files = sorted(
        f
        for f in folder.iterdir()
        if f.suffix.lower() in VECTOR_SUFFIXES and f.resolve() not in others
    )
    if not files:
        raise InputError(
            "holds no file of release areas",
            file=folder,
            field="release.file",
            expected="vector files (" + ", ".join(VECTOR_SUFFIXES) + ")",
        )
    return files


def _named(release: ReleaseSettings, by_file: bool) -> list[tuple[str, ReleaseSettings, int, str]]:
    """Return name, settings, number and problem of each area of a file."""
    assert release.file is not None
    stem = release.file.stem if by_file else "area"
    try:
        features = release_features(release)
    except InputError as error:
        if not by_file or error.field != "release.name_field":
            raise
        release = replace(release, name_field=None)
        features = release_features(release)
    out = []
    for feature in features:
        problem = ""
        if release.name_field is None:
            single = by_file and len(features) == 1
            name = stem if single else f"{stem} {feature.number}"
        else:
            name = feature.text(release.name_field) or ""
            if not name:
                name = f"{stem}, feature {feature.number}"
                problem = f"{release.file}: {release.name_field}: feature has no name"
        out.append((name, release, feature.number, problem))
    return out


def outcomes(
    setting: Setting,
    candidates: Sequence[Candidate],
    place: Workplace,
    memory_bytes: int | None = None,
) -> Generator[AreaOutcome, None, None]:
    """Run areas into the folder of the batch; outcomes come in the order of the areas.

    A few areas share all cores one after the other. Of many, as many are at work as there are
    cores, and progress is that of the batch: areas done, areas in all, blocks.
    """
    n = len(candidates)
    at_once = _at_once(setting, place.jobs, memory_bytes, n)
    if at_once < 2:
        for i, candidate in enumerate(candidates, start=1):
            place.tell(f"Area {i} of {n}: {candidate.name}")
            yield _outcome(setting, candidate, place)
        return
    place.tell(f"Running {n} areas, {at_once} at a time")
    rocks = 0
    with task_map((setting, place.folder), at_once) as each:
        for i, outcome in enumerate(each(one_at_work, candidates), start=1):
            record, _, _, stated = outcome
            for text in stated:
                place.tell(text)
            rocks += 0 if record is None else record.rocks
            if place.on_progress is not None:
                place.on_progress(i, n, rocks)
            yield outcome


def _at_once(setting: Setting, jobs: Jobs, memory_bytes: int | None, n: int) -> int:
    """Count the areas at work at the same time, each on one core; 1 if few."""
    asked = workers_asked(setting.config, jobs)
    at_once = asked if isinstance(asked, int) else 1
    if memory_bytes is not None:
        at_once = min(at_once, memory_bytes // _PROCESS - 1)
    return max(at_once, 1) if n >= _AREAS_PER_CORE * at_once else 1


def one_at_work(common: tuple[Setting, Path], candidate: Candidate) -> AreaOutcome:
    """Zone one area in a separate process on one core."""
    setting, folder = common
    stated: list[str] = []
    place = Workplace(folder, 1, None, stated.append)
    record, reason, seconds, _ = _outcome(setting, candidate, place)
    return record, reason, seconds, tuple(text for text in stated if text.startswith(UNFIT))


def _outcome(setting: Setting, candidate: Candidate, place: Workplace) -> AreaOutcome:
    """Zone one area; ``place`` has the folder of the batch."""
    began = time.perf_counter()
    record, reason = None, ""
    assert place.folder is not None
    own = replace(place, folder=place.folder / AREAS_NAME / candidate.stem)
    try:
        record = run_area(setting, candidate, own)
    except Exception as error:
        reason = _why_skipped(error)
    return record, reason, time.perf_counter() - began, ()


def _why_skipped(error: Exception) -> str:
    """State why an area is skipped; errors that are not about the area are raised again."""
    if isinstance(error, InputError):
        return str(error)
    # Compiled code that Ctrl-C strikes turns it into a SystemError.
    stopped = any(isinstance(link, KeyboardInterrupt) for link in chain(error))
    limit = of_the_system(error)
    if isinstance(error, SassgisError) or stopped or (limit and isinstance(error, OSError)):
        raise error
    if limit:
        return limit
    log.debug("", exc_info=error)
    text = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {text} (a fault of sassgis; --debug shows more)"
