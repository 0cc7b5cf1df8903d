"""The blocks of a run once more on drawn ground classes: what their spread does to the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sassgis.hazard.assess import Rules
from sassgis.hazard.ground_spread import (
    GroundSpread,
    SpreadBand,
    SpreadMaps,
    draw_of,
    level_areas,
    spread_bands,
    spread_maps,
)
from sassgis.hazard.sensitivity import BASE, FAR, MEDIAN, Names, Variant, VariantFinding, finding_of
from sassgis.io.atomic_output import staged_output
from sassgis.io.read.ground_map import read_ranges
from sassgis.model.exposure import PlacedObjects
from sassgis.model.ground_ranges import RangeRule
from sassgis.model.map_run import MapRun
from sassgis.model.run_config import Config
from sassgis.runs.inputs import cells_of_wholes
from sassgis.runs.job import Job, Simulation, Workplace, configured, read_job
from sassgis.runs.map import check_starts
from sassgis.runs.variant_lab import VariantLab, ranges_on
from sassgis.runs.workers import Jobs, OnProgress

#: Folder of the draws among the saved states of a run.
_PART = "ground_draws"


@dataclass(frozen=True, slots=True)
class DrawnGround:
    """What the draws of a run found."""

    spread: GroundSpread
    maps: SpreadMaps
    base: VariantFinding
    names: Names
    # Gives the base and the draws one by one, as they are kept until the result is whole.
    simulations: Callable[[], Iterator[tuple[Variant, VariantFinding]]]


def spread_rules(config: Config, run: MapRun) -> tuple[RangeRule, ...]:
    """Rules of the spread of ground classes; none where no draws are wanted."""
    if not config.run.ground_uncertainty and config.ground.ranges is None:
        return ()
    return read_ranges(run.table, config.ground.ranges)


def drawn_ground(
    done: Simulation,
    place: Workplace,
    known: tuple[RangeRule, ...],
    rules: Rules | None,
    placed: PlacedObjects,
) -> DrawnGround | None:
    """Simulate the blocks of a run on the draws that the configuration asks for; None for none.

    ``known`` are those of spread_rules, from before the run itself; ``rules`` those of a zoning.
    """
    draws = done.config.run.ground_uncertainty
    if not draws:
        return None
    place.tell(f"Simulating {draws} draws of the ground classes")
    # Of a road the whole, as in the report: a band of each stretch says less.
    wholes, exposed = cells_of_wholes(placed, done.run.grid)
    job = Job(done.config, done.run, done.planned, ())
    lab = VariantLab(job, rules, place, _PART, exposed)
    base = finding_of(done.run, done.progress, rules, exposed)
    return _drawn(lab, known, draws, base, wholes)


def _drawn(
    lab: VariantLab,
    known: tuple[RangeRule, ...],
    draws: int,
    base: VariantFinding,
    exposed: Sequence[str] = (),
) -> DrawnGround:
    """Simulate draws and say what they found beside the base; ``exposed`` are names of objects."""
    run = lab.job.run
    names = lab.names(exposed)
    ranges = ranges_on(run, known, np.flatnonzero(np.isfinite(run.grid.values)))
    variants = [draw_of(ranges, run.seed, k) for k in range(draws)]
    lab.total = draws
    for variant in variants:
        # Only one is held at a time.
        lab.find(variant)

    def findings() -> Iterator[VariantFinding]:
        return (lab.found(variant) for variant in variants)

    def simulations() -> Iterator[tuple[Variant, VariantFinding]]:
        yield Variant(BASE, {}), base
        yield from zip(variants, findings(), strict=True)

    cell_m2 = run.grid.cell_size**2
    maps = spread_maps(base, findings)
    spread = GroundSpread(
        draws,
        ranges_on(run, known, maps.cells),
        spread_bands(base, findings, names, cell_m2),
        level_areas(maps, cell_m2) if names.levels else None,
    )
    return DrawnGround(spread, maps, base, names, simulations)


def runout_bands(
    config: Config | str | Path,
    draws: int,
    out: str | Path,
    *,
    jobs: Jobs = None,
    on_progress: OnProgress | None = None,
) -> tuple[SpreadBand, SpreadBand]:
    """Bands of the median and of the 90 % quantile of the run-out, without any maps.

    ``out`` is a new folder, which stays empty: while it works, what was simulated is kept beside
    it, and the same call goes on from there.
    """
    config = configured(config, None)
    with staged_output(Path(out), False) as work:
        place = Workplace(work, jobs, on_progress, lambda _text: None)
        job = read_job(config, None, place.tell)
        known = read_ranges(job.run.table, config.ground.ranges)
        check_starts(job.run, job.planned.points, lambda: job.planned, config.release.file)
        lab = VariantLab(job, None, place, _PART)
        base = lab.found(Variant(BASE, {}))
        found = _drawn(lab, known, draws, base).spread
    return found.band(MEDIAN), found.band(FAR)
