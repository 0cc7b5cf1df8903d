"""Simulations of one configuration with other values of its ground classes, each kept as found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from sassgis.hazard.assess import Rules
from sassgis.hazard.progress import Progress
from sassgis.hazard.sensitivity import Names, Variant, VariantFinding, finding_of
from sassgis.io.atomic_output import CHECKPOINT_STEM, writing
from sassgis.io.saved_arrays import read_saved, write_saved
from sassgis.model.errors import Interrupted
from sassgis.model.ground_ranges import ParameterRange, RangeRule, acting, ranges_of, with_values
from sassgis.model.map_run import MapRun, ObjectCells
from sassgis.runs.checkpoint import Checkpoint
from sassgis.runs.job import Job, Workplace, simulate_saved, state_fingerprint, workers_asked

_KEPT = [f.name for f in fields(VariantFinding)]


class VariantLab:
    """Simulates variants; what was found is kept beside the result, by what was asked.

    ``part`` distinguishes what is kept from the states of other simulations for the same result. Of
    the stops of the job none is kept.
    """

    def __init__(
        self,
        job: Job,
        rules: Rules | None,
        place: Workplace,
        part: str = "",
        exposed: ObjectCells | None = None,
    ) -> None:
        run = replace(job.run, stop_points_max=0)
        self.job, self.rules, self._place = replace(job, run=run), rules, place
        self.total = 0
        judged = None if rules is None else (rules.preset, rules.frequencies)
        asked = repr((run.release.rocks_per_point, judged, _KEPT))
        self._fingerprint = state_fingerprint(job.config, run, asked)
        self._part, self._exposed = part, exposed
        assert place.folder is not None
        self._folder = place.folder / CHECKPOINT_STEM / part
        self._workers = workers_asked(job.config, place.jobs)
        self._asked, self._blocks = 0, 0

    def names(self, objects: Sequence[str]) -> Names:
        """What the numbers of findings belong to."""
        levels = () if self.rules is None else tuple(c.label for c in self.rules.preset.levels)
        lines = tuple(line.name for line, _ in self.job.run.control_lines)
        return Names(levels, lines, tuple(objects))

    def find(self, variant: Variant, seed: int | None = None) -> VariantFinding:
        """What the variant finds, now or in an earlier call; counted as progress."""
        found = self.found(variant, seed)
        self._asked += 1
        self._blocks += found.blocks
        if self._place.on_progress is not None:
            self._place.on_progress(self._asked, max(self.total, self._asked), self._blocks)
        return found

    def found(self, variant: Variant, seed: int | None = None) -> VariantFinding:
        """What the variant finds."""
        asked = [self._fingerprint, sorted([*k, v] for k, v in variant.values.items()), seed]
        digest = hashlib.sha256(json.dumps(asked).encode()).hexdigest()
        file = self._folder / f"{digest}.npz"
        arrays = read_saved(file, digest, self._place.tell)
        if arrays is not None:
            return VariantFinding.from_arrays(arrays)
        # What is left of a simulation that was stopped is of use to the same one alone.
        part = str(Path(self._part, "under_way"))
        under_way = Checkpoint(self._place.folder, digest, part)
        run = self.job.run
        table = with_values(run.table, variant.values)
        run = replace(run, table=table, seed=run.seed if seed is None else seed)
        progress = under_way.restore(run, self._place.tell) or Progress.fresh(run)
        try:
            simulate_saved(run, self.job.planned, progress, under_way, self._workers)
        except Interrupted:
            raise Interrupted(
                f"stopped by the user after {self._asked} simulations; they are kept in "
                f"{self._folder}: the same command goes on from there"
            ) from None
        found = finding_of(run, progress, self.rules, self._exposed)
        with writing(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            write_saved(file, found.arrays(), digest)
        under_way.forget()
        return found


def classes_on(run: MapRun, cells: np.ndarray) -> list[str]:
    """Names of the ground classes on some cells (flat indices)."""
    return [run.table.names[i] for i in np.unique(run.ground.ravel()[cells])]


def ranges_on(
    run: MapRun, rules: Sequence[RangeRule], cells: np.ndarray
) -> tuple[ParameterRange, ...]:
    """Ranges of the values that act in a run, of the ground classes on some cells."""
    return ranges_of(run.table, classes_on(run, cells), rules, acting(run.engine))
