"""Many release areas over a large terrain model: each alone, and all of them on one map.

Each area is zoned on the part of the terrain model that its fall lines need, and keeps its sums in
its folder. The mosaic is added up from these files: frequencies of areas add. Areas are taken in
the order of their names, so that neither the order of files nor the number of threads matters.
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

import sassgis
from sassgis.hazard.sources import onset_frequencies
from sassgis.io.read.config import SECTIONS, Config, file_digest, load_config, settings_hash
from sassgis.io.read.features import Feature
from sassgis.io.read.ground_map import ground_raster, read_ground_table
from sassgis.io.read.objects import PlacedObjects
from sassgis.io.read.sections import ReleaseSettings
from sassgis.io.read.tiles import Part, Terrain, hull, open_terrain
from sassgis.io.read.vectors import (
    ReleaseArea,
    read_control_lines,
    read_release_feature,
    release_area,
    release_features,
    warn_of_overlaps,
)
from sassgis.io.write.staging import staged_output, writing
from sassgis.model.errors import (
    ConfigError,
    InputError,
    OutputError,
    SassgisError,
)
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.ground import GroundTable
from sassgis.model.results import ControlLine
from sassgis.report.map_report import file_stems
from sassgis.runs.assessment import Assessment, Rules, read_rules
from sassgis.runs.batch_state import (
    BARE_NAME,
    RECORD_NAME,
    SIMULATION_NAME,
    Record,
    add_area,
    read_record,
    read_state,
    write_record,
    write_state,
)
from sassgis.runs.batch_window import cut_sides, windowed
from sassgis.runs.checkpoint import Checkpoint
from sassgis.runs.inputs import collected_notices, forest_of, map_run_of
from sassgis.runs.map import MapRun, Progress, plan
from sassgis.runs.run import Job, OnProgress, Simulation, warnings_of
from sassgis.runs.zone import (
    most_rounds,
    prepared,
    simulations,
    without_barriers,
    write_zones,
)

log = logging.getLogger(__name__)

SUMMARY_NAME, AREAS_NAME, MOSAIC_NAME = "summary.csv", "areas", "mosaic"
#: Vector files of a folder by their suffix; those that the configuration names do not count.
VECTOR_SUFFIXES = (".gpkg", ".shp", ".geojson", ".json", ".fgb", ".kml")
_FINGERPRINT_NAME = "batch.json"
_NOT_RUN = "not run"
#: A mosaic of more cells than this fits no common machine.
_MOST_CELLS = 100_000_000


@dataclass(frozen=True, slots=True)
class Candidate:
    """A release area that a batch is to run.

    Attributes
    ----------
    name : str
    stem : str
        Name of its folder.
    release : ReleaseSettings
        Section ``[release]`` with the file and fields of this area.
    number : int
        Place in the layer, counted from 1.
    problem : str
        Why it cannot be run; empty if nothing is known against it.
    """

    name: str
    stem: str
    release: ReleaseSettings
    number: int
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Setting:
    """What all areas of a batch share.

    Attributes
    ----------
    config : Config
    terrain : Terrain
    outline : Grid
        Of the whole terrain model, without heights.
    table : GroundTable
    gates : tuple of (Gate, float64 array of shape (k, 2))
    rules : Rules
        With all exposed objects, and no frequencies.
    names : tuple of str
        Of all areas.
    digest : str
        Of the settings and of all files but terrain and release areas.
    first_margin_m : float
        Margin around an area with which the search for its part of the terrain begins.
    """

    config: Config
    terrain: Terrain
    outline: Grid
    table: GroundTable
    control_lines: tuple[tuple[ControlLine, FloatArray], ...]
    rules: Rules
    names: tuple[str, ...]
    digest: str
    first_margin_m: float


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
    summary: pd.DataFrame
    found: Assessment | None
    warnings: tuple[str, ...]


def batch(
    releases: str | Path,
    out: str | Path,
    *,
    config: str | Path | None = None,
    dem: str | Path | None = None,
    overwrite: bool = False,
    seed: int | None = None,
    jobs: int | None = None,
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
        If a result is in the way or the disk is full or not writable.
    Interrupted
        If the user stops the batch; what was computed is kept.
    """
    tell = say or (lambda _text: None)
    folder = Path(out)
    loaded = _configured(Path(releases), config, dem, seed)
    candidates = find_areas(loaded)
    setting, notices = read_setting(loaded, candidates, first_margin_m)
    _check_folder(folder)
    kept = _kept_areas(setting, candidates, folder, overwrite, tell)
    summary = _Summary(folder, loaded, candidates, setting.rules, kept)
    records: dict[str, Record] = {}
    for i, candidate in enumerate(candidates, start=1):
        record = kept.get(candidate.stem)
        title = f"Area {i} of {len(candidates)}: {candidate.name}"
        if record is None:
            tell(title)
            began = time.perf_counter()
            try:
                record = _run_area(
                    setting, candidate, folder / AREAS_NAME / candidate.stem, jobs, on_progress,
                    tell,
                )  # fmt: skip
            except Exception as error:
                reason = _why_skipped(error)
                tell(f"{candidate.name} is skipped: {reason}")
                summary.skipped(candidate, reason)
                continue
            summary.done(candidate, record, time.perf_counter() - began)
        records[candidate.stem] = record
    if not records:
        first = next(iter(summary.reasons().values()))
        raise InputError(
            f"no release area could be run; the first: {first}", file=loaded.release_path
        )
    skipped = tuple(f"{name} is skipped: {why}" for name, why in summary.reasons().items())
    stale = _stale(folder, records)
    found, warnings = _write_mosaic(
        setting, [c for c in candidates if c.stem in records], records, folder,
        (*notices, *skipped), tell,
    )  # fmt: skip
    return BatchResult(folder, summary.frame(), found, (*warnings, *stale))


# ---------------------------------------------------------------------------------------------
# What is to be run


def _configured(
    releases: Path, config: str | Path | None, dem: str | Path | None, seed: int | None
) -> Config:
    """The configuration, with the release areas in it."""
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
    """The only configuration in the folder of the release areas."""
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
    """All release areas that the configuration names, by name; shapes are not looked at.

    ``release.file`` may be a folder: then an area is named by its ``name_field`` or, in files
    without it, by the file.

    Raises
    ------
    InputError
        If a single file cannot be used, or a folder holds no vector file.
    """
    path = config.release_path
    named: list[tuple[str, ReleaseSettings, int, str]] = []
    for file in _release_files(config) if path.is_dir() else [path]:
        release = config.release.model_copy(update={"file": file})
        try:
            named += _named(release, by_file=path.is_dir())
        except InputError as error:
            if not path.is_dir():
                raise
            named.append((file.stem, release, 0, str(error)))
    counts = Counter(name for name, _, _, _ in named)
    named.sort(key=lambda n: (n[0], str(n[1].file), n[2]))
    stems = file_stems([name for name, _, _, _ in named])
    return [
        Candidate(
            name,
            stem,
            release,
            number,
            problem or (f"{release.file}: name is used {counts[name]} times ({name!r}; expected "
                        "names that differ)" if counts[name] > 1 else ""),
        )
        for (name, release, number, problem), stem in zip(named, stems, strict=True)
    ]  # fmt: skip


def _release_files(config: Config) -> list[Path]:
    """Vector files of the folder of release areas that serve no other purpose."""
    folder = config.release_path
    others = {
        Path(f).resolve()
        for f in (
            config.ground.file,
            config.trees.file if config.trees is not None else None,
            *(item.file for item in (*config.stations, *config.barriers)),
            *(item.file for item in config.objects),
        )
        if f is not None
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
    """Name, settings, number and problem of each area of a file."""
    assert release.file is not None
    stem = release.file.stem if by_file else "area"
    try:
        features = release_features(release)
    except InputError as error:
        if not by_file or error.field != "release.name_field":
            raise
        release = release.model_copy(update={"name_field": None})
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


def read_setting(
    config: Config, candidates: Sequence[Candidate], first_margin_m: float
) -> tuple[Setting, tuple[str, ...]]:
    """Read and check what all areas share.

    Raises
    ------
    ConfigError, InputError
    """
    if not config.blocks:
        raise ConfigError(
            "no block scenario", file=config.file, field="blocks", expected="one [[blocks]] or more"
        )
    names = tuple(dict.fromkeys(c.name for c in candidates))
    with collected_notices() as notices:
        terrain = open_terrain(config.dem_path, config.terrain.crs, config.terrain.vertical_datum)
        outline = terrain.outline()
        table = read_ground_table(config.ground.classes)
        control_lines = tuple(read_control_lines(config, outline))
        bare = map_run_of(config, outline, _no_ground(outline), table, (), control_lines, None)
        # The table of frequencies is read by area, with the names of all.
        hazard = config.hazard.model_copy(update={"frequencies": None})
        rules = read_rules(replace(config, hazard=hazard), bare)
        onset_frequencies(config, bare, names)
    setting = Setting(
        config, terrain, outline, table, control_lines, replace(rules, notices=()), names,
        _shared_digest(config), first_margin_m,
    )  # fmt: skip
    return setting, tuple(dict.fromkeys((*notices, *rules.notices)))


def _shared_digest(config: Config) -> str:
    """Fingerprint of the settings and of the files that all areas share."""
    own = replace(
        config,
        terrain=config.terrain.model_copy(update={"dem": None}),
        release=config.release.model_copy(update={"file": None}),
        hazard=config.hazard.model_copy(
            update={"frequencies": None, "preset": Path(config.hazard.preset).name}
        ),
        risk=config.risk.model_copy(update={"vulnerability": None}),
    )
    sections = [s for s in SECTIONS if s != "profile"]
    parts = [sassgis.__version__, settings_hash(own, sections=sections)]
    if config.risk.vulnerability is not None:
        parts.append(file_digest(config.risk.vulnerability))
    if config.hazard.preset.endswith(".toml"):
        parts.append(file_digest(config.hazard.preset))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


# ---------------------------------------------------------------------------------------------
# One area


def _feature(setting: Setting, candidate: Candidate) -> Feature:
    if candidate.problem:
        raise InputError(candidate.problem)
    return read_release_feature(candidate.release, candidate.number, setting.outline)


def _area_on(
    setting: Setting, candidate: Candidate, feature: Feature, part: Part
) -> tuple[Grid, ReleaseArea]:
    """The terrain of a part, and the area checked against it."""
    grid = setting.terrain.read(part)
    names = setting.config.block_names
    return grid, release_area(feature, candidate.name, candidate.release, grid, names)


def _control_lines_in(setting: Setting, grid: Grid) -> tuple[int, ...]:
    """Stations and barriers that meet a part of the terrain."""
    box = shapely.box(*grid.bounds)
    return tuple(
        i
        for i, (_, xy) in enumerate(setting.control_lines)
        if shapely.LineString(xy).intersects(box)
    )


def _objects_in(setting: Setting, grid: Grid) -> tuple[int, ...]:
    """Exposed objects that meet a part of the terrain."""
    box = shapely.box(*grid.bounds)
    shapes = setting.rules.placed.geometries
    return tuple(i for i, shape in enumerate(shapes) if shape.intersects(box))


def _area_run(setting: Setting, grid: Grid, area: ReleaseArea) -> MapRun:
    """The run of an area on a part of the terrain, but for the ground and the forest."""
    control_lines = [setting.control_lines[i] for i in _control_lines_in(setting, grid)]
    ground = _no_ground(grid)
    return map_run_of(setting.config, grid, ground, setting.table, (area,), control_lines, None)


def _fingerprint(
    setting: Setting,
    part: Part,
    grid: Grid,
    area: ReleaseArea,
    frequencies: dict[tuple[str, str], float],
) -> str:
    """Of all that the result of an area hangs on."""
    head = [
        setting.digest,
        area.name,
        area.scenarios,
        sorted((*key, value) for key, value in frequencies.items()),
        shapely.to_wkb(area.geometry, hex=True, byte_order=1),
        cut_sides(part, setting.terrain),
        [grid.west, grid.north, grid.cell_size, grid.crs, grid.vertical_datum, *grid.shape],
    ]
    digest = hashlib.sha256(json.dumps(head).encode())
    digest.update(grid.values.astype("<f8").tobytes())
    return digest.hexdigest()


def _kept_areas(
    setting: Setting,
    candidates: Sequence[Candidate],
    folder: Path,
    overwrite: bool,
    tell: Callable[[str], None],
) -> dict[str, Record]:
    """Areas that are complete and were made from the same settings and inputs.

    Raises
    ------
    OutputError
        If a result is in the way.
    """
    kept = {}
    for candidate in candidates:
        own = folder / AREAS_NAME / candidate.stem
        if not own.is_dir() or not any(own.iterdir()):
            continue
        record = read_record(own)
        same = False
        if record is not None:
            # An area that cannot be used any more is told of when it is its turn.
            with suppress(InputError), collected_notices():
                part = record.part(setting.terrain)
                feature = _feature(setting, candidate)
                grid, area = _area_on(setting, candidate, feature, part)
                run = _area_run(setting, grid, area)
                frequencies = onset_frequencies(setting.config, run, setting.names)
                same = record.fingerprint == _fingerprint(setting, part, grid, area, frequencies)
        if same and record is not None:
            kept[candidate.stem] = record
        elif not overwrite:
            raise OutputError(
                f"{own}: exists and was made from other settings or inputs; choose another folder, "
                "or --overwrite"
            )
    if kept:
        tell(f"{len(kept)} of {len(candidates)} areas are there already")
    return kept


def _run_area(
    setting: Setting,
    candidate: Candidate,
    folder: Path,
    jobs: int | None,
    on_progress: OnProgress | None,
    tell: Callable[[str], None],
) -> Record:
    """Zone one area into its folder."""
    config = replace(
        setting.config,
        release=candidate.release,
        project=setting.config.project.model_copy(
            update={"name": f"{setting.config.project.name}: {candidate.name}"}
        ),
    )
    with collected_notices() as notices:
        feature = _feature(setting, candidate)

        def make(part: Part) -> MapRun:
            grid, area = _area_on(setting, candidate, feature, part)
            # Ground and forest are of no account for fall lines.
            return _area_run(setting, grid, area)

        cut = windowed(
            setting.terrain,
            feature.geometry.bounds,
            setting.rules.ref_width_m,
            make,
            most_rounds(config),
            setting.first_margin_m,
        )
        run = replace(
            cut.run,
            ground=ground_raster(config.ground, cut.run.grid, setting.table, setting.outline),
            forest=forest_of(config, cut.run.grid, setting.outline),
        )
    frequencies = onset_frequencies(config, run, setting.names)
    objects = _objects_in(setting, run.grid)
    rules = replace(
        setting.rules,
        frequencies=frequencies,
        placed=_some_objects(setting.rules.placed, objects),
    )
    if not objects:
        rules = replace(rules, vulnerability=None)
    job = prepared(Job(run, cut.planned, tuple(notices)), rules)
    with staged_output(folder, overwrite=True) as work:
        done, bare = simulations(config, work, job, rules, jobs, on_progress, tell)
        write_state(work / SIMULATION_NAME, done.progress, done.run)
        if bare is not None:
            write_state(work / BARE_NAME, bare.progress, bare.run)
        record = Record(
            fingerprint=_fingerprint(setting, cut.part, run.grid, run.areas[0], frequencies),
            area=candidate.name,
            west=run.grid.west,
            north=run.grid.north,
            n_rows=cut.part.n_rows,
            n_cols=cut.part.n_cols,
            rounds=done.run.rounds,
            points=len(cut.planned.points),
            rocks=int(done.progress.reasons.sum()),
            furthest_m=_furthest(done.progress),
            zones_m2={},
            control_lines=_control_lines_in(setting, run.grid),
            objects=objects,
            notices=tuple(notices),
        )

        def keep(found: Assessment) -> None:
            nonlocal record
            record = replace(record, zones_m2=_zones_m2(found, rules))
            write_record(work, record)

        write_zones(work, rules, done, bare, [candidate.name], tell, keep)
    return record


def _some_objects(placed: PlacedObjects, which: Sequence[int]) -> PlacedObjects:
    return PlacedObjects(
        tuple(placed.objects[i] for i in which), tuple(placed.geometries[i] for i in which)
    )


def _furthest(progress: Progress) -> float | None:
    return None if progress.furthest is None else round(progress.furthest[0], 2)


def _zones_m2(found: Assessment, rules: Rules) -> dict[str, float]:
    """Area of the zones by the code of the hazard level."""
    levels = found.hazard.levels
    return {
        level.code: round(float(sum(p.area for p in levels.polygons[levels.classes == k])), 1)
        for k, level in enumerate(rules.preset.levels, start=1)
    }


def _no_ground(grid: Grid) -> NDArray[np.int32]:
    """Ground of no account, which takes no memory."""
    return np.broadcast_to(np.zeros(1, np.int32), grid.shape)


def _why_skipped(error: Exception) -> str:
    """Why an area is skipped; errors that are not about the area are raised again."""
    if isinstance(error, InputError):
        return str(error)
    # Compiled code that Ctrl-C strikes turns it into a SystemError.
    stopped = isinstance(error.__cause__ or error.__context__, KeyboardInterrupt)
    if isinstance(error, SassgisError) or stopped:
        raise error
    if isinstance(error, MemoryError):
        return "not enough memory; fewer release points or larger cells need less"
    log.debug("", exc_info=error)
    text = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {text} (a fault of sassgis; --debug tells more)"


# ---------------------------------------------------------------------------------------------
# All areas together


def _write_mosaic(
    setting: Setting,
    candidates: Sequence[Candidate],
    records: dict[str, Record],
    folder: Path,
    notices: tuple[str, ...],
    tell: Callable[[str], None],
) -> tuple[Assessment | None, tuple[str, ...]]:
    """Add up all areas and write what they give together."""
    parts = [[records[c.stem].fingerprint for c in candidates], notices]
    fingerprint = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    target = folder / MOSAIC_NAME
    if _same_mosaic(target, fingerprint):
        tell("The mosaic is there already")
        return None, notices
    tell("Adding up the areas")
    config = replace(
        setting.config,
        output=setting.config.output.model_copy(
            update={"rock_table": "none", "passage_table": "none"}
        ),
    )
    began = time.perf_counter()
    job, place, more = _mosaic_job(setting, candidates, records)
    frequencies = onset_frequencies(config, job.run, setting.names)
    rules = replace(setting.rules, frequencies=frequencies)
    own = [(records[c.stem], folder / AREAS_NAME / c.stem) for c in candidates]
    with staged_output(target, overwrite=True) as work:

        def simulation(job: Job, bare: bool) -> Simulation:
            progress = _sum_of_areas(setting, job, place, own, bare)
            warnings = (*notices, *more, *warnings_of(job.run, job.planned, progress))
            seconds = time.perf_counter() - began
            checkpoint = Checkpoint(work, fingerprint)
            return Simulation(config, job.run, job.planned, progress, checkpoint, warnings, seconds)

        done = simulation(job, bare=False)
        bare = None
        barriers = any(g.kind != "station" for g, _ in job.run.control_lines)
        if barriers and config.hazard.compare_barriers:
            bare = simulation(without_barriers(job), bare=True)

        def keep(_found: Assessment) -> None:
            path = work / _FINGERPRINT_NAME
            with writing(path):
                path.write_text(json.dumps({"fingerprint": fingerprint}) + "\n", encoding="utf-8")

        names = [c.name for c in candidates]
        found, _, warnings = write_zones(work, rules, done, bare, names, tell, keep)
    return found, (*warnings, *done.warnings)


def _same_mosaic(folder: Path, fingerprint: str) -> bool:
    try:
        stored = json.loads((folder / _FINGERPRINT_NAME).read_text(encoding="utf-8"))
        return bool(stored["fingerprint"] == fingerprint)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _mosaic_job(
    setting: Setting, candidates: Sequence[Candidate], records: dict[str, Record]
) -> tuple[Job, Part, tuple[str, ...]]:
    """The run of all areas on the parts of the terrain that they need, and what to say of it."""
    config, terrain = setting.config, setting.terrain
    own = [records[c.stem] for c in candidates]
    place = hull([r.part(terrain) for r in own])
    if place.n_rows * place.n_cols > _MOST_CELLS:
        raise InputError(
            "the areas lie too far apart for one mosaic",
            file=config.release_path,
            found=f"{place.n_cols} x {place.n_rows} cells",
            expected=f"at most {_MOST_CELLS} cells; the results of the areas are complete, and "
            "batches of neighbouring areas give mosaics",
        )
    grid = terrain.read(place)
    # What there is to say of single areas was said when they were run.
    with collected_notices():
        areas = [_area_on_grid(setting, c, grid) for c in candidates]
    with collected_notices() as notices:
        warn_of_overlaps(areas, config.release_path)
    ground = ground_raster(config.ground, grid, setting.table, setting.outline)
    run = replace(
        map_run_of(
            config,
            grid,
            ground,
            setting.table,
            areas,
            setting.control_lines,
            forest_of(config, grid, setting.outline),
        ),
        thresholds_kj=setting.rules.preset.thresholds_kj,
        ref_width_m=setting.rules.ref_width_m,
        rounds=max(r.rounds for r in own),
    )
    planned = replace(plan(run), rounds=tuple(r.rounds for r in own))
    said = dict.fromkeys(text for r in own for text in r.notices)
    if len({r.rounds for r in own}) > 1:
        said[
            "Areas had different numbers of rounds of rocks: maps that count rocks (reach "
            "probability, energy, height) weigh them by rocks, those of hazard by frequency."
        ] = None
    return Job(run, planned, ()), place, (*said, *notices)


def _area_on_grid(setting: Setting, candidate: Candidate, grid: Grid) -> ReleaseArea:
    feature = _feature(setting, candidate)
    names = setting.config.block_names
    return release_area(feature, candidate.name, candidate.release, grid, names)


def _sum_of_areas(
    setting: Setting, job: Job, place: Part, own: Sequence[tuple[Record, Path]], bare: bool
) -> Progress:
    """Add up what the areas left; one area is in memory at a time."""
    run, planned = job.run, job.planned
    total = Progress.fresh(run)
    released = int(sum(r.rocks for r, _ in own))
    share = run.stop_points_max / released if released else 1.0
    for i, (record, folder) in enumerate(own):
        file = folder / BARE_NAME
        if not bare or not file.is_file():
            # Where an area has no walls and nets, both are the same.
            file = folder / SIMULATION_NAME
        part = record.part(setting.terrain)
        add_area(total, run, planned, place, i, record, part, read_state(file), share)
    return total


# ---------------------------------------------------------------------------------------------
# The folder and its summary


def _check_folder(folder: Path) -> None:
    """Make the folder, unless it holds something else than a batch."""
    with writing(folder):
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{folder}: is a file; the result needs a folder")
        if folder.is_dir() and any(folder.iterdir()) and not (folder / SUMMARY_NAME).is_file():
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


class _Summary:
    """The table of all areas, written anew whenever one is done."""

    def __init__(
        self,
        folder: Path,
        config: Config,
        candidates: Sequence[Candidate],
        rules: Rules,
        kept: dict[str, Record],
    ) -> None:
        self._path = folder / SUMMARY_NAME
        self._levels = [level.code for level in rules.preset.levels]
        self._before = self._seconds_before()
        base = config.release_path if config.release_path.is_dir() else config.release_path.parent
        self._rows: dict[str, dict[str, object]] = {
            c.stem: {
                "area": c.name,
                "file": "" if c.release.file is None else _relative(c.release.file, base),
                "status": _NOT_RUN,
            }
            for c in candidates
        }
        for candidate in candidates:
            if candidate.stem in kept:
                self._note(candidate, kept[candidate.stem], None)
        self._write()

    def _seconds_before(self) -> dict[str, float]:
        """Times of areas that an earlier call has run."""
        try:
            frame = pd.read_csv(self._path, dtype={"folder": str}).dropna(
                subset=["folder", "seconds"]
            )
            return dict(zip(frame["folder"], frame["seconds"].astype(float), strict=True))
        except (OSError, ValueError, KeyError):
            return {}

    def done(self, candidate: Candidate, record: Record, seconds: float) -> None:
        """Note an area that was run."""
        self._note(candidate, record, seconds)
        self._write()

    def _note(self, candidate: Candidate, record: Record, seconds: float | None) -> None:
        """An area that was run, or that was there already (``seconds`` None)."""
        own = f"{AREAS_NAME}/{candidate.stem}"
        self._rows[candidate.stem] |= {
            "status": "done",
            "folder": own,
            "points": record.points,
            "rocks": record.rocks,
            "furthest_m": record.furthest_m,
            **{f"{code}_m2": record.zones_m2.get(code) for code in self._levels},
            "seconds": self._before.get(own) if seconds is None else round(seconds, 1),
        }

    def skipped(self, candidate: Candidate, reason: str) -> None:
        """Note an area that could not be run."""
        self._rows[candidate.stem]["status"] = f"skipped: {reason}"
        self._write()

    def reasons(self) -> dict[str, str]:
        """Why areas were skipped, by their name."""
        return {
            str(row["area"]): str(row["status"]).removeprefix("skipped: ")
            for row in self._rows.values()
            if str(row["status"]).startswith("skipped: ")
        }

    def frame(self) -> pd.DataFrame:
        """The table."""
        columns = ["area", "file", "folder", "status", "points", "rocks", "furthest_m"]
        columns += [*(f"{code}_m2" for code in self._levels), "seconds"]
        frame = pd.DataFrame(list(self._rows.values()), columns=columns)
        return frame.astype({"points": "Int64", "rocks": "Int64"})

    def _write(self) -> None:
        with writing(self._path):
            fresh = self._path.with_suffix(".csv.new")
            try:
                self.frame().to_csv(fresh, index=False)
                fresh.replace(self._path)
            finally:
                fresh.unlink(missing_ok=True)


def _relative(file: Path, base: Path) -> str:
    return file.relative_to(base).as_posix() if file.is_relative_to(base) else str(file)
