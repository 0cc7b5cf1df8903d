"""How the rocks of a case move under a hypothesis: ground, effects, deviation, errors.

Where the configuration follows paths, each rock is followed over the terrain, and where it passes
stations and stops is put into the plane of its fall line as what was observed is; else it keeps to
the profile of its fall line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.trees import Trees
from sassgis.engine.simulate import Simulated, simulate
from sassgis.engine.simulate_paths import follow
from sassgis.gap.constants import DIRECTION_M, PROLONG_M, START_INSIDE_M, STRETCH_M
from sassgis.gap.forward.rock_lines import RockLines, gathered, repeated
from sassgis.gap.observations.case import Case, station_traces
from sassgis.gap.observations.projection import project, station_chainages
from sassgis.gap.observations.tables import Stations
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ControlLineCrossings, ReleasePoints
from sassgis.settings.settings import EngineSettings
from sassgis.terrain.cells import heights_at
from sassgis.terrain.flatten import chainage_to_xy

#: Keys of ``[engine]`` that a hypothesis may set.
ENGINE_KEYS = ("side_tilt_deg", "drift_deg", "rolling_friction_sd")


@dataclass(frozen=True, slots=True)
class ReleaseError:
    """Errors of the stated release."""

    #: Rocks start this much further down the line (m), or up the slope where it is below zero, each
    #: half as much to one and a half times as much, uniformly.
    ahead_m: float = 0.0
    faster_mps: float = 0.0  # added to the initial speed, uniform from 0
    shift_m: float = 0.0  # lateral offset of the start: the same for all
    scatter_m: float = 0.0  # and standard deviation


@dataclass(frozen=True, slots=True)
class MeasurementError:
    """Errors of measurement beyond those that are stated."""

    scale: float = 1.0  # lengths, and so speeds and heights, as measured over true
    clock_sd: float = 0.0  # standard deviation of the logarithm of each rock's time base
    rotation_scale: float = 1.0  # rotations at stations and on paths as measured over true
    rotation_noise: float = 0.0  # added relative error: blocks do not turn in one plane
    spin_scale: float = 1.0  # the same of spins at contacts, about the axis across the path
    spin_noise: float = 0.0  # added relative error
    noise_rel: float = 0.0  # added relative error of speeds and rotations
    stretch: float = 1.0  # distances from the first station as measured over true
    position_m: float = 0.0  # added standard error of positions


@dataclass(frozen=True, slots=True)
class ForestStand:
    """A forest between two chainages of all lines (m)."""

    s0: float
    s1: float
    stems_per_ha: float
    dbh_cm: float


@dataclass(frozen=True, slots=True)
class HypothesisModel:
    """All that a hypothesis sets."""

    table: GroundTable
    effects: EffectSettings  # on fall lines without ``lateral_deflection``: blocks keep to them
    stand: ForestStand | None = None
    release: ReleaseError = ReleaseError()
    measurement: MeasurementError = MeasurementError()
    # Of followed paths, and of all; None: as configured.
    side_tilt_deg: float | None = None
    drift_deg: float | None = None
    rolling_friction_sd: float | None = None

    @property
    def engine_keys(self) -> dict[str, float]:
        """Keys of ``[engine]`` that differ from the configuration."""
        own = {key: getattr(self, key) for key in ENGINE_KEYS}
        return {key: value for key, value in own.items() if value is not None}

    def engine_of(self, configured: EngineSettings) -> EngineSettings:
        """Return settings of the engine that move its blocks."""
        return replace(configured, **self.engine_keys)  # type: ignore[arg-type]

    def sections(self, configured: EffectSettings) -> dict[str, dict[str, Any]]:
        """Return ``[effects.*]`` sections for a configuration that has only some of these effects.

        Every effect of the model that is not configured as it is here: the form, and whatever is
        not as by default.
        """
        return {
            effect.name: {
                f.name: getattr(effect, f.name)
                for f in fields(effect)
                if f.name == "form" or getattr(effect, f.name) != f.default
            }
            for effect in self.effects
            if configured.get(type(effect)) != effect
        }


def configured_model(case: Case, table: GroundTable | None = None) -> HypothesisModel:
    """Return the configured model of a case, or one with another table of ground classes."""
    return HypothesisModel(case.table if table is None else table, moving_effects(case))


def moving_effects(case: Case) -> EffectSettings:
    """Return configured effects that move the rocks: on fall lines none deflects them."""
    return case.effects if case.terrain is not None else case.effects.without(LateralDeflection)


def model_as_json(model: HypothesisModel) -> dict[str, Any]:
    """Return a model as JSON takes it, to keep a calibrated one in a file and use it again."""
    return {**asdict(model), "effects": {own.name: asdict(own) for own in model.effects}}


@dataclass(frozen=True, slots=True)
class Releases:
    """Rocks to be released, each of the n rows as often as asked for."""

    rock: IntArray  # shape (n,); number in the case
    blocks: Sequence[BlockPopulation]
    start: FloatArray  # shape (n, 2); limits of the chainage of the start (m)
    lateral_m: FloatArray  # shape (n,); of the start; counts where paths are followed
    key: NDArray[np.uint64]  # shape (n,); identity for the random draws


@dataclass(frozen=True, slots=True)
class Moved:
    """Motion of released rocks."""

    #: ROCK_DTYPE. ``line``: row of the releases. ``runout_m``: chainage on the fall line of the
    #: rock, beyond its end straight on.
    rocks: NDArray[np.void]
    pieces: NDArray[np.void]
    #: PASSAGE_DTYPE; where fall lines cross stations. ``chainage_m``: of the station on the line.
    passages: NDArray[np.void]
    #: Where they end next to the fall line (m), shape (n_rocks + n_pieces,); 0 on profiles.
    lateral_m: FloatArray
    passed_lateral_m: FloatArray  # shape (n_passages,)
    event_logs: tuple[NDArray[np.void], ...]  # EVENT_DTYPE


def all_rocks(case: Case, lines: RockLines) -> Releases:
    """Return every rock of a case where it was released."""
    n = case.n_rocks
    return Releases(np.arange(n), case.blocks, case.start, np.zeros(n), lines.keys)


def fixed_blocks(
    blocks: Sequence[BlockPopulation], rock: IntArray, **fixed: FloatArray
) -> list[BlockPopulation]:
    """Return for each row the population of its rock, with the fixed values of the row."""
    columns: dict[str, Any] = {name: values.tolist() for name, values in fixed.items()}
    return [
        replace(blocks[i], **{name: (values[n], values[n]) for name, values in columns.items()})
        for n, i in enumerate(rock.tolist())
    ]


def move(
    case: Case,
    lines: RockLines,
    releases: Releases,
    model: HypothesisModel,
    *,
    seed: int,
    count: int,
    first_rock: int = 0,
    log_events: int = 0,
) -> Moved:
    """Release rocks ``count`` times, as the configuration of the case moves blocks.

    A stand of the model takes the place of the configured forest. ``seed``, ``first_rock``,
    ``log_events``: as for sassgis.engine.simulate.simulate.
    """
    if case.terrain is None:
        return _on_profiles(
            case=case, lines=lines, releases=releases, model=model, seed=seed, count=count,
            first_rock=first_rock, log_events=log_events,
        )  # fmt: skip
    n = releases.rock.size
    start = releases.start
    drawn = bool((start[:, 1] > start[:, 0]).any())
    if drawn:
        # Each of them starts at a separate chainage.
        rng = np.random.default_rng([seed, first_rock, 79])
        low, high = np.repeat(start, count, axis=0).T
        s = low + (high - low) * rng.random(n * count)
        row, repeated = np.repeat(np.arange(n), count), 1
        key = releases.key[row] + np.tile(np.arange(count, dtype=np.uint64), n)
    else:
        s, row, repeated, key = start[:, 0], np.arange(n), count, releases.key
    x, y = _on_map(case, releases.rock[row], s, releases.lateral_m[row])
    points = ReleasePoints(x, y, releases.rock[row], key, tuple(case.observations.rock_names))
    forest = None
    if model.effects.get(Trees) is not None:
        forest = case.forest if model.stand is None else _stand(model.stand, lines.cell_s)
    done = follow(
        replace(case.terrain, forest=forest), points, model.table,
        [releases.blocks[i] for i in row.tolist()], model.engine_of(case.engine), seed=seed,
        rocks_per_point=repeated, point_keys=key, first_rock=first_rock, log_events=log_events,
        effects=model.effects,
    )  # fmt: skip
    if drawn:
        for rows in (done.rocks, done.pieces, done.passages):
            rows["rock"] = first_rock + rows["line"] % count
            rows["line"] //= count
    return _in_planes(case, releases.rock, done)


def _in_planes(case: Case, rock: IntArray, done: Simulated) -> Moved:
    """Return followed blocks in the planes of the fall lines of their rocks."""
    ended = np.concatenate([done.rocks, done.pieces])
    s, lateral = in_plane(case, rock[ended["line"]], done.x, done.y)
    rocks, pieces = done.rocks.copy(), done.pieces.copy()
    rocks["runout_m"], pieces["runout_m"] = s[: rocks.size], s[rocks.size :]
    passages = done.passages.copy()
    owner = rock[passages["line"]]
    # A station that the fall line of a rock does not cross has no place on it.
    passages["chainage_m"] = case.station_s[owner, passages["control_line"]]
    known = np.isfinite(passages["chainage_m"])
    passages, owner = passages[known], owner[known]
    beside = in_plane(case, owner, passages["x_m"], passages["y_m"])[1]
    return Moved(rocks, pieces, passages, lateral, beside, done.event_logs)


def in_plane(case: Case, rock: IntArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Project points on the fall lines of rocks: chainage and lateral offset (m), as observed."""
    put = project(case.traces, case.line[rock], x, y, prolonged=True)
    return put.s, put.lateral_m


def with_stations_at(case: Case, places: FloatArray) -> Case:
    """Return case with other stations: straight across its commonest fall line at chainages (m)."""
    line = int(np.bincount(case.line).argmax())
    s = np.clip(
        places, DIRECTION_M, float(case.traces.s[case.traces.offset[line + 1] - 1]) - DIRECTION_M
    )
    behind, ahead = (
        np.column_stack(chainage_to_xy(case.traces, line, s + by))
        for by in (-DIRECTION_M, DIRECTION_M)
    )
    middle, along = 0.5 * (behind + ahead), 0.5 * (ahead - behind) / DIRECTION_M
    left = PROLONG_M * along[:, ::-1] * [-1.0, 1.0]
    names = np.array([f"{place:.0f} m" for place in places.tolist()])
    vertices = tuple(np.stack([middle + left, middle - left], axis=1))
    stations = Stations(np.arange(names.size), names, vertices)
    made = replace(
        case,
        observations=replace(case.observations, stations=stations),
        stations=station_chainages(case.traces, stations),
    )
    if made.terrain is None:
        return made
    return replace(made, terrain=replace(made.terrain, control_lines=station_traces(made)))


def _on_map(
    case: Case, rock: IntArray, s: FloatArray, lateral: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places beside fall lines, which go on behind; on them where no height is known."""
    traces, line = case.traces, case.line[rock]
    low, high = traces.s[traces.offset[line]], traces.s[traces.offset[line + 1] - 1]
    behind = np.minimum(s - low, 0.0)
    s = np.clip(s, low, high)
    x, y = chainage_to_xy(traces, line, s)
    x0, y0 = chainage_to_xy(traces, line, np.maximum(s - DIRECTION_M, low))
    x1, y1 = chainage_to_xy(traces, line, np.minimum(s + DIRECTION_M, high))
    size = np.maximum(np.hypot(x1 - x0, y1 - y0), 1e-9)
    east, north = (x1 - x0) / size, (y1 - y0) / size
    beside_x = x + behind * east + lateral * north
    beside_y = y + behind * north - lateral * east
    assert case.terrain is not None
    known = np.isfinite(heights_at(case.terrain.grid, beside_x, beside_y))
    return np.where(known, beside_x, x), np.where(known, beside_y, y)


def _stand(stand: ForestStand, s: FloatArray) -> Forest:
    """Return a forest on all places, stretches or cells, between two chainages."""
    inside = (s >= stand.s0) & (s <= stand.s1)
    return Forest(
        np.where(inside, stand.stems_per_ha / 1e4, 0.0), np.where(inside, stand.dbh_cm / 100.0, 0.0)
    )


# ---------------------------------------------------------------------------------------------
# On the profiles of fall lines


def _on_profiles(
    case: Case,
    lines: RockLines,
    releases: Releases,
    model: HypothesisModel,
    seed: int,
    count: int,
    first_rock: int,
    log_events: int,
) -> Moved:
    wood = None
    if model.effects.get(Trees) is not None:
        middle = lines.first_m + STRETCH_M * np.arange(0.5, lines.n_stretches)
        wood = lines.wood if model.stand is None else _stand(model.stand, middle)
    crossings = lines.control_lines
    offset, rows = gathered(crossings.offset, releases.rock)
    # Ground continues behind the stated start as far as this.
    first = lines.unforested.s[lines.unforested.offset[:-1]][releases.rock, None] + START_INSIDE_M
    done = simulate(
        repeated(lines.unforested if wood is None else lines.forested, releases.rock),
        model.table,
        releases.blocks,
        model.engine_of(case.engine),
        seed=seed,
        rocks_per_line=count,
        line_keys=releases.key,
        starts=np.clip(releases.start, first, lines.end[releases.rock, None]),
        control_lines=ControlLineCrossings(
            crossings.control_lines, offset, crossings.chainage[rows], crossings.control_line[rows]
        ),
        first_rock=first_rock,
        log_events=log_events,
        effects=model.effects,
        forest=wood,
    )
    none = np.zeros(done.rocks.size + done.pieces.size)
    return Moved(
        done.rocks, done.pieces, done.passages, none, np.zeros(done.passages.size), done.event_logs
    )
