"""All residuals of a case against one model, made once: where, which and how far read these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import with_release
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, MeasurementError
from sassgis.gap.replicas.rock_lines import rock_lines_of
from sassgis.gap.residuals.flights import path_residuals
from sassgis.gap.residuals.free_run import (
    FreeRun,
    RunModel,
    free_run,
    free_run_residuals,
    observed_at_stations,
)
from sassgis.gap.residuals.one_step import impact_residuals
from sassgis.gap.residuals.reaches import reach_residuals
from sassgis.gap.residuals.residuals import Residual
from sassgis.gap.residuals.steps import StepTable, steps_of
from sassgis.model.grid import FloatArray

#: Runs of each rock.
REPLICATES = 20


@dataclass(frozen=True, slots=True)
class ResidualTable:
    """Observed against predicted."""

    run: FreeRun  # replicates of the rocks in the model
    rows: tuple[Residual, ...]  # by place and quantity, one value per rock
    steps: StepTable  # single impacts, flights and runs, one row each


def residuals_of(
    case: Case, model: HypothesisModel, *, seed: int, replicates: int = REPLICATES
) -> ResidualTable:
    """Compare a case with a model, its errors of release and measurement apart.

    ``configured_model`` gives that of the configuration. ``replicates``: runs of each rock.
    """
    rng = np.random.default_rng([seed, 31])
    running = RunModel.of(case, model, seed)
    run = free_run(case, running, replicates)
    seen = observed_at_stations(case)
    edges = reach_edges(case, run)
    rows = [
        *free_run_residuals(case, seen, run, rng=rng),
        *reach_residuals(case, running, seen, run, edges, rng=rng),
        *path_residuals(case, running, edges, run.axes_m),
        *impact_residuals(case, model, run, edges, rng=rng),
    ]
    steps = steps_of(case, model, run, rng)
    return ResidualTable(run, tuple(rows), steps)


def residuals_with(
    case: Case, model: HypothesisModel, *, seed: int, replicates: int = REPLICATES
) -> tuple[Case, ResidualTable]:
    """Residuals of the base with a cause in it, and the case as that cause leaves it.

    Rocks start where and as fast as the error of the release has them; what instruments scale is
    scaled back. Offsets from fall lines are no part of the motion on them.
    """
    end = rock_lines_of(case).end
    case = with_release(_scaled_back(case, model.measurement), model.release, end)
    return case, residuals_of(case, model, seed=seed, replicates=replicates)


def _scaled_back(case: Case, error: MeasurementError) -> Case:
    """The case with speeds, heights and spins as they are without an error of the instruments."""
    scale, spin, rotation = error.scale, error.spin_scale, error.rotation_scale
    factors = {
        "passages": {"speed_mps": scale, "height_m": scale, "rotation_hz": rotation},
        "impacts": {
            "vt_in_mps": scale, "vn_in_mps": scale, "omega_in_radps": spin,
            "vt_out_mps": scale, "vn_out_mps": scale, "omega_out_radps": spin,
        },
        "trajectories": {"speed_mps": scale, "rotation_hz": rotation},
    }  # fmt: skip
    tables = {}
    for name, columns in factors.items():
        own = getattr(case.observations, name)
        true = {column: getattr(own, column) / factor for column, factor in columns.items()}
        tables[name] = replace(own, **true)
    return replace(case, observations=replace(case.observations, **tables))


def reach_edges(case: Case, run: FreeRun) -> FloatArray:
    """Chainages between which reaches lie, mean over rocks (m), shape (n_reaches, 2).

    The last reach ends where the last rock lies, observed or simulated.
    """
    start = float(case.start.mean())
    s = case.station_s
    known = np.isfinite(s)
    middle = np.where(known, s, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    lie = case.projected["deposits"].s
    ends = np.append(lie[np.isfinite(lie)], np.quantile(run.ends.runout_m, 0.99))
    last = max(float(ends.max()), float(middle[-1] if middle.size else start) + 1.0)
    at = np.concatenate([[start], middle, [last]])
    return np.column_stack([at[:-1], at[1:]])
