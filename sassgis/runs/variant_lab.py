"""Simulations of one configuration with other values, each kept as found; draws of the ground."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from sassgis.errors import Interrupted
from sassgis.files.atomic_output import CHECKPOINT_STEM, writing
from sassgis.files.saved_arrays import read_saved, write_saved
from sassgis.hazard.assess import Rules
from sassgis.inputs.ground_map import read_ranges
from sassgis.runs.inputs import cells_of_wholes
from sassgis.runs.resumable_run import (
    Job,
    Simulation,
    Workplace,
    simulate_saved,
    state_fingerprint,
    workers_asked,
)
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.ground import ParameterRange, RangeRule, acting, ranges_of, with_values
from sassgis.settings.map_run import Config, MapRun, ObjectCells
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.checkpoint import Checkpoint
from sassgis.studies import variants as study
from sassgis.studies.variants import GroundSpread, Variant, VariantFinding

_KEPT = [f.name for f in fields(VariantFinding)]
#: Folder of the draws among the saved states of a run.
DRAWS = "ground_draws"


class VariantLab:
    """Simulates variants; results are kept next to the result, by what was asked.

    ``part`` distinguishes what is kept from the states of other simulations for the same result. Of
    the stops of the job none is kept. ``total`` is the number of simulations that are planned.
    """

    def __init__(
        self,
        job: Job,
        rules: Rules | None,
        place: Workplace,
        part: str = "",
        exposed: ObjectCells | None = None,
    ) -> None:
        self.run = replace(job.run, stop_points_max=0)
        self.total = 0
        self._job, self._rules, self._place, self._exposed = job, rules, place, exposed
        judged = None if rules is None else (rules.preset, rules.frequencies)
        asked = repr((self.run.release.rocks_per_point, judged, _KEPT))
        self._fingerprint = state_fingerprint(job.config, self.run, asked)
        assert place.folder is not None
        self._folder = place.folder / CHECKPOINT_STEM / part
        # What remains of a stopped simulation, of use only to the same one.
        self._under_way = partial(Checkpoint, place.folder, part=str(Path(part, "under_way")))
        self._workers = workers_asked(job.config, place.jobs)
        self._seen: set[str] = set()
        self._blocks = 0

    def names(self, objects: Sequence[str]) -> study.Names:
        """Return the names to the numbers of findings."""
        levels = [] if self._rules is None else [c.label for c in self._rules.preset.levels]
        return levels, [line.name for line, _ in self.run.control_lines], objects

    def ranges(
        self, rules: Sequence[RangeRule], cells: np.ndarray | None = None
    ) -> tuple[ParameterRange, ...]:
        """Return ranges of values that act, of the classes on cells; default all with a height."""
        if cells is None:
            cells = np.flatnonzero(np.isfinite(self.run.grid.values))
        return ranges_of(self.run.table, self.classes(cells), rules, acting(self.run.engine))

    def classes(self, cells: np.ndarray) -> list[str]:
        """Return names of the ground classes on some cells (flat indices)."""
        return [self.run.table.names[i] for i in np.unique(self.run.ground.ravel()[cells])]

    def found(self, variant: Variant) -> VariantFinding:
        """Return the results of the variant, computed now or in an earlier call."""
        asked = [self._fingerprint, sorted([*k, v] for k, v in variant.values.items())]
        digest = hashlib.sha256(json.dumps([*asked, variant.seed]).encode()).hexdigest()
        file = self._folder / f"{digest}.npz"
        kept = read_saved(file, digest, self._place.tell)
        if kept is not None:
            found = VariantFinding(**{name: kept[name] for name in _KEPT})
        else:
            found = self._simulated(variant, digest)
            with writing(file):
                file.parent.mkdir(parents=True, exist_ok=True)
                write_saved(file, {name: getattr(found, name) for name in _KEPT}, digest)
            self._under_way(digest).forget()
        if variant.name not in self._seen:
            self._seen.add(variant.name)
            self._blocks += found.blocks
            if self._place.on_progress is not None:
                done = len(self._seen)
                self._place.on_progress(done, max(self.total, done), self._blocks)
        return found

    def _simulated(self, variant: Variant, digest: str) -> VariantFinding:
        run = replace(
            self.run,
            table=with_values(self.run.table, variant.values),
            seed=self.run.seed if variant.seed is None else variant.seed,
        )
        under_way = self._under_way(digest)
        progress = under_way.restore(run, self._place.tell) or Progress.fresh(run)
        try:
            simulate_saved(run, self._job.planned, progress, under_way, self._workers)
        except Interrupted:
            raise Interrupted(
                f"stopped by the user after {len(self._seen)} simulations; they are kept in "
                f"{self._folder}: run the same command to resume"
            ) from None
        return study.finding_of(run, progress, self._rules, self._exposed)


# ---------------------------------------------------------------------------------------------
# Draws of the ground classes


#: Results of the draws of a run.
DrawnGround = tuple[GroundSpread, study.CellMaps, study.Answers]


def spread_rules(config: Config, run: MapRun) -> tuple[RangeRule, ...]:
    """Return rules of the spread of ground classes; none where no draws are wanted."""
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
    """Simulate the draws that a configuration asks for, given spread_rules; None for none."""
    draws = done.config.run.ground_uncertainty
    if not draws:
        return None
    place.tell(f"Simulating {draws} draws of the ground classes")
    # Of a road the whole, as in the report: a band of each stretch says less.
    wholes, exposed = cells_of_wholes(placed, done.run.grid)
    job = Job(done.config, done.run, done.planned, ())
    lab = VariantLab(job, rules, place, DRAWS, exposed)
    base = study.finding_of(done.run, done.progress, rules, exposed)
    return draws_in(lab, known, draws, base, wholes)


def draws_in(
    lab: VariantLab,
    known: tuple[RangeRule, ...],
    draws: int,
    base: VariantFinding,
    exposed: Sequence[str] = (),
) -> DrawnGround:
    """Simulate draws and return their results and the base's; ``exposed`` are names of objects."""
    ranges = lab.ranges(known)
    variants = [study.draw_of(ranges, lab.run.seed, k) for k in range(draws)]
    lab.total += draws
    names, cell_m2 = lab.names(exposed), lab.run.grid.cell_size**2
    # Only one is held at a time.
    table = study.answers(base, ((v, lab.found(v)) for v in variants), names, cell_m2)
    maps = study.spread_maps(base, lambda: map(lab.found, variants))
    areas = study.level_areas(maps, cell_m2) if names[0] else None
    met = lab.ranges(known, maps[0])
    return GroundSpread(draws, met, study.spread_bands(table), areas), maps, table
