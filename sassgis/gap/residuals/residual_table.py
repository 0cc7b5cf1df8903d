"""Put all residuals of a case against one model into a table, which all that follows reads.

Each step stands against what the model makes of the observed state before it. A step is an impact,
a flight between two impacts, or a whole path from the release to a station or to the stop. Each row
holds what was seen, what the model foresees from the *observed* state, the standard deviation of
that, and what a cause could depend on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.constants import (
    CENTRE_M,
    FLIGHT_WAY_M,
    IMPACT_DRAWS,
    LONGEST_FLIGHT,
    REPLICATES,
    SHORTEST_FLIGHT,
)
from sassgis.gap.forward.observation_operator import with_release
from sassgis.gap.forward.released_rocks import HypothesisModel, MeasurementError
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.observations.case import Case, ImpactRows, errors_of, observed_campaign
from sassgis.gap.residuals.flights import air_of_flights, path_residuals, struck_above_ground
from sassgis.gap.residuals.impact_residuals import (
    all_impacts_in_flight,
    impact_residuals,
    rebound_draws,
    turn_error,
    turn_of_lines,
)
from sassgis.gap.residuals.rock_residuals import Residual, mean_of_draws
from sassgis.gap.residuals.station_residuals import reach_residuals
from sassgis.gap.residuals.stop_residuals import (
    FreeRun,
    free_run,
    free_run_residuals,
    observed_at_stations,
    observed_end,
    side_error,
)
from sassgis.grid import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class StepTable:
    """Residuals, one row per step and quantity; columns of shape (n,)."""

    rock: IntArray
    #: "impact", "flight", "aloft" (the surest loss above the ground on a path in time), "air" (a
    #: flight in time), "start" (from the release to the first contact), "run" (to a station) or
    #: "stop".
    step: NDArray[np.str_]
    quantity: NDArray[np.str_]
    observed: FloatArray
    predicted: FloatArray
    sd: FloatArray  # of the prediction, with errors of measurement
    ground: IntArray  # class; -1 where it does not matter
    station: IntArray  # -1 where there is none
    vn_mps: FloatArray  # normal speed before an impact
    out_mps: FloatArray  # speed after it
    #: Length of a flight; chainage of a loss, a stop, or the model's second contact.
    way_m: FloatArray
    radius_m: FloatArray
    flatness: FloatArray  # c/b of the rock
    reach: FloatArray  # length of the flight as a share of that of a free one
    clear_m: FloatArray  # how far the flight rises above the straight way
    fell_jpkg: FloatArray  # energy that gravity gives on it
    speed2: FloatArray  # speed times level speed

    def __len__(self) -> int:
        return int(self.rock.size)

    def of(self, step: str, quantity: str) -> StepTable:
        """Return rows of one quantity that have an observed and a predicted value."""
        own = (self.step == step) & (self.quantity == quantity)
        own &= np.isfinite(self.observed) & np.isfinite(self.predicted) & (self.sd > 0.0)
        return self.where(own)

    def where(self, chosen: NDArray[np.bool_]) -> StepTable:
        """Select some of the rows."""
        return StepTable(*(getattr(self, f.name)[chosen] for f in fields(self)))

    @property
    def z(self) -> FloatArray:
        """Observed less predicted, in standard deviations."""
        return (self.observed - self.predicted) / self.sd


#: Step of flights of the model itself, as the observer records them.
MODEL_FLIGHT = "flight of the model"


def steps_of(case: Case, run: FreeRun, rng: np.random.Generator) -> StepTable:
    """Return the table of residuals of a case; ``run``: its replicates of the rocks."""
    flat = run.axes_m[:, :, 2].mean(axis=1) / run.axes_m[:, :, 1].mean(axis=1)
    parts = [
        *_impacts(case, run, rng),
        *_flights(case, observed_campaign(case).impacts, "flight"),
        *(part for rows in run.impacts for part in _flights(case, rows, MODEL_FLIGHT)),
        *_paths(case, run.axes_m),
        *_first_contacts(case, observed_campaign(case).impacts, run.impacts),
        *_runs(case, run),
        *_stops(case, run),
    ]
    columns: dict[str, list[FloatArray]] = {f.name: [] for f in fields(StepTable)}
    radius = run.radius_m
    for part in parts:
        rock = part["rock"]
        part = {"radius_m": radius[rock], "flatness": flat[rock], **part}
        for name, filled in columns.items():
            missing = -1 if name in ("ground", "station") else np.nan
            filled.append(np.broadcast_to(np.asarray(part.get(name, missing)), rock.size))
    made: dict[str, Any] = {name: np.concatenate(filled) for name, filled in columns.items()}
    return StepTable(**made)


_Part = dict[str, Any]


def _impacts(case: Case, run: FreeRun, rng: np.random.Generator) -> list[_Part]:
    seen = all_impacts_in_flight(case, run.axes_m, IMPACT_DRAWS)
    if seen is None:
        return []
    draws = rebound_draws(case, run.model, seen, rng)
    own = seen.impacts
    enough = np.isfinite(draws[..., 0]).sum(axis=1) >= IMPACT_DRAWS // 4
    vt, vn, spin = np.moveaxis(np.where(enough[:, None, None], draws, np.nan), -1, 0)
    line_turn = turn_of_lines(case, seen.rock, seen.s)
    turn_deg = case.turns(seen.rock, own.turn_deg, own.vt_out_mps, own.vn_out_mps)
    return [
        {
            "rock": seen.rock, "step": "impact", "ground": seen.kind, "vn_mps": -own.vn_in_mps,
            "out_mps": np.hypot(own.vt_out_mps, own.vn_out_mps),
            "quantity": name, "observed": observed, "predicted": predicted, "sd": sd,
        }
        for name, observed, (predicted, sd) in (
            ("tangential_speed_mps", own.vt_out_mps, _mean_and_sd(vt, least=1)),
            ("normal_speed_mps", own.vn_out_mps, _mean_and_sd(vn, least=1)),
            ("spin_out_radps", own.omega_out_radps, _mean_and_sd(spin, least=1)),
            ("turn_deg", turn_deg, (line_turn, turn_error(case, line_turn))),
        )
    ]  # fmt: skip


def _mean_and_sd(draws: FloatArray, least: int = 2) -> tuple[FloatArray, FloatArray]:
    """Compute mean and deviation over the last axis without missing values; NaN where too few."""
    mean = mean_of_draws(draws, least)
    return mean, np.sqrt(mean_of_draws((draws - mean[..., None]) ** 2, least))


def _flights(case: Case, rows: ImpactRows | None, step: str) -> list[_Part]:
    """Compare energy at the end of flights between impacts with that at the start and the fall."""
    if rows is None or rows.rock.size < 2:
        return []
    errors = errors_of(case)
    _, dip = case.ground_at(rows.rock, rows.s)
    g = case.engine.gravity_mps2
    first = np.flatnonzero(rows.rock[:-1] == rows.rock[1:])
    last = first + 1
    level = rows.vt_out[first] * np.cos(dip[first]) + rows.vn_out[first] * np.sin(dip[first])
    up = rows.vn_out[first] * np.cos(dip[first]) - rows.vt_out[first] * np.sin(dip[first])
    fall = rows.z[first] - rows.z[last]
    with np.errstate(invalid="ignore", divide="ignore"):
        time = (up + np.sqrt(np.maximum(up**2 + 2.0 * g * fall, 0.0))) / g
        way = rows.s[last] - rows.s[first]
        share = way / (level * time)
    out = 0.5 * (rows.vt_out[first] ** 2 + rows.vn_out[first] ** 2)
    into = 0.5 * (rows.vt_in[last] ** 2 + rows.vn_in[last] ** 2)
    flown = (way > FLIGHT_WAY_M) & (share > SHORTEST_FLIGHT) & (share < LONGEST_FLIGHT)
    sd = np.sqrt(
        (2.0 * errors.speed_rel) ** 2 * (out**2 + into**2)
        + (g * np.hypot(CENTRE_M, errors.position_m)) ** 2
    )
    length = np.hypot(way, fall)
    return [
        {
            "rock": rows.rock[first][flown], "step": step, "quantity": "energy_jpkg",
            "observed": into[flown], "predicted": (out + g * fall)[flown], "sd": sd[flown],
            "way_m": length[flown], "reach": share[flown],
            "clear_m": g * (way[flown] / level[flown]) ** 2 / 8.0, "fell_jpkg": (g * fall)[flown],
        }
    ]  # fmt: skip


def _paths(case: Case, axes_m: FloatArray) -> list[_Part]:
    """Compute from paths in time the surest loss on each, and what air does on flights."""
    rock, s, before, after, sd = struck_above_ground(case, axes_m)
    struck: _Part = {
        "rock": rock, "step": "aloft", "quantity": "speed_mps",
        "observed": after, "predicted": before, "sd": sd, "way_m": s,
    }  # fmt: skip
    air = air_of_flights(case, axes_m)
    flights: list[_Part] = [
        {
            "rock": air.rock, "step": "air", "quantity": f"{name}_mps2", "observed": pull,
            "predicted": 0.0, "sd": sd, "speed2": air.speed2,
        }
        for name, pull, sd in (
            ("ahead", air.ahead, air.ahead_sd),
            ("lighter", air.lighter, air.ahead_sd),
            ("across", air.across, air.across_sd),
        )
    ]  # fmt: skip
    return [struck, *flights]


def _first_contacts(
    case: Case, rows: ImpactRows | None, recorded: Sequence[ImpactRows]
) -> list[_Part]:
    """Compare the chainage of the first contact with the model's as the observer records it."""
    if rows is None:
        return []
    observed = _contact_chainages(rows, case.n_rocks)[0]
    made = np.full((2, case.n_rocks, len(recorded)), np.nan)
    for k, one in enumerate(recorded):
        made[:, :, k] = _contact_chainages(one, case.n_rocks)
    predicted, second = mean_of_draws(made)
    scatter = mean_of_draws((made[0] - predicted[:, None]) ** 2)
    known = np.isfinite(observed) & np.isfinite(predicted)
    if not known.any():
        return []
    # Few runs of each rock: all of them show the scatter.
    sd = math.hypot(math.sqrt(float(scatter[known].mean())), side_error(case))
    return [
        {
            "rock": np.flatnonzero(known), "step": "start", "quantity": "chainage_m",
            "observed": observed[known], "predicted": predicted[known], "sd": sd,
            "way_m": second[known],
        }
    ]  # fmt: skip


def _contact_chainages(rows: ImpactRows, n_rocks: int) -> FloatArray:
    """Find chainages of each rock's two uppermost contacts (m), (2, n_rocks); NaN without."""
    known = np.flatnonzero((rows.rock >= 0) & np.isfinite(rows.s))
    order = known[np.lexsort((rows.s[known], rows.rock[known]))]
    rock = rows.rock[order]
    begins = np.flatnonzero(np.diff(rock, prepend=-1))
    found = np.full((2, n_rocks), np.nan)
    found[0, rock[begins]] = rows.s[order[begins]]
    more = begins[np.diff(np.append(begins, rock.size)) > 1]
    found[1, rock[more]] = rows.s[order[more + 1]]
    return found


def _runs(case: Case, run: FreeRun) -> list[_Part]:
    rows = observed_campaign(case).passages
    if rows is None:
        return []
    own = np.flatnonzero(rows.rock >= 0)
    predicted, sd = _offset(case, run.at.lateral_m[rows.rock[own], :, rows.station[own]])
    return [
        {
            "rock": rows.rock[own], "step": "run", "quantity": "lateral_m",
            "observed": rows.lateral_m[own], "predicted": predicted, "sd": sd,
            "station": rows.station[own],
        }
    ]  # fmt: skip


def _offset(case: Case, draws: FloatArray, *, stop: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return the model's mean lateral offset and its deviation, with the error of the line."""
    error = np.full(len(draws), side_error(case, stop))
    if case.terrain is None:
        return np.zeros(len(draws)), error
    mean, sd = _mean_and_sd(draws)
    return mean, np.hypot(error, sd)


def _stops(case: Case, run: FreeRun) -> list[_Part]:
    end = observed_end(case)
    rock = np.flatnonzero(np.isfinite(end.runout_m))
    if not rock.size:
        return []
    predicted, sd = _offset(case, run.ends.lateral_m[rock], stop=True)
    return [
        {
            "rock": rock, "step": "stop", "quantity": "lateral_m",
            "observed": end.lateral_m[rock], "predicted": predicted, "sd": sd,
            "way_m": end.runout_m[rock],
        }
    ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class ResidualTable:
    """Observed against predicted."""

    run: FreeRun  # replicates of the rocks in the model
    rows: tuple[Residual, ...]  # by place and quantity, one value per rock
    steps: StepTable  # single impacts, flights and runs, one row each
    #: Replicates on paths that turn no more than configured, if those of the model turn more.
    turning_less: FreeRun | None = None

    @property
    def configured_paths(self) -> FreeRun:
        """Replicates on paths that turn no more than configured."""
        return self.run if self.turning_less is None else self.turning_less


def residuals_of(
    case: Case, model: HypothesisModel, *, seed: int, replicates: int = REPLICATES
) -> ResidualTable:
    """Compare a case with a model, its errors of release and measurement apart."""
    rng = np.random.default_rng([seed, 31])
    run = free_run(case, model, seed, replicates)
    seen = observed_at_stations(case)
    edges = reach_edges(case, run)
    rows = [
        *free_run_residuals(case, seen, run, rng=rng),
        *reach_residuals(case, seen, run, edges, rng=rng),
        *path_residuals(case, run, edges),
        *impact_residuals(case, run, edges, rng=rng),
    ]
    return ResidualTable(run, tuple(rows), steps_of(case, run, rng))


def with_configured_paths(case: Case, residuals: ResidualTable) -> ResidualTable:
    """Add replicates whose tilt and drift are at most the configured ones.

    Calibrated ones follow what deflects the observed rocks, and hide it.
    """
    run, engine = residuals.run, case.engine
    model = run.model
    limits = {"side_tilt_deg": engine.side_tilt_deg, "drift_deg": engine.drift_deg}
    above = {key: own for key, own in limits.items() if model.engine_keys.get(key, 0.0) > own}
    if not above:
        return residuals
    less = free_run(case, replace(model, **above), run.seed, run.axes_m.shape[1])  # type: ignore[arg-type]
    return replace(residuals, turning_less=less)


def fingerprint_residuals(case: Case, run: FreeRun) -> ResidualTable:
    """Compare a case with existing replicates, only in the quantities of fingerprints."""
    rng = np.random.default_rng([run.seed, 31])
    rows = reach_residuals(case, observed_at_stations(case), run, reach_edges(case, run), rng=rng)
    return ResidualTable(run, tuple(rows), steps_of(case, run, rng))


def residuals_with(
    case: Case, model: HypothesisModel, *, seed: int, replicates: int = REPLICATES
) -> tuple[Case, ResidualTable]:
    """Return residuals of the base with a cause in it, and the case as that cause leaves it.

    Rocks start where and as fast as the error of the release has them; what instruments scale is
    scaled back. Offsets from fall lines are no part of the motion on them.
    """
    end = rock_lines_of(case).end
    case = with_release(_scaled_back(case, model.measurement), model.release, end)
    return case, residuals_of(case, model, seed=seed, replicates=replicates)


def _scaled_back(case: Case, error: MeasurementError) -> Case:
    """Return the case with speeds, heights and spins freed of an error of the instruments."""
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
    """Return limits of the reaches, mean over rocks (m), (n_reaches, 2), down to the last rock."""
    start = float(case.start.mean())
    s = case.station_s
    known = np.isfinite(s)
    middle = np.where(known, s, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    lie = case.projected["deposits"].s
    ends = np.append(lie[np.isfinite(lie)], np.quantile(run.ends.runout_m, 0.99))
    last = max(float(ends.max()), float(middle[-1] if middle.size else start) + 1.0)
    at = np.concatenate([[start], middle, [last]])
    return np.column_stack([at[:-1], at[1:]])
