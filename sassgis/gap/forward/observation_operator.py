"""Simulated campaigns: the rocks of a case released again in a model, recorded as in the field.

The only place where simulated motion becomes tables like those of the field: passages, impacts,
contacts and stops, with errors of measurement, and without what an observer does not see.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.ellipse import mean_radius
from sassgis.engine.simulate import moving_axes
from sassgis.engine.state import END, EVENT_DTYPE, FLIGHT, IMPACT
from sassgis.gap.constants import AHEAD_SHARES, LEAVING_RUNS, LOGGED_EVENTS, PATH_STEP_S
from sassgis.gap.forward.released_rocks import (
    HypothesisModel,
    Moved,
    ReleaseError,
    all_rocks,
    in_plane,
    move,
)
from sassgis.gap.forward.rock_lines import (
    RockLines,
    dips_at,
    heights_at_chainage,
    recorded_contacts,
)
from sassgis.gap.observations.case import (
    LOOSE,
    PIECE,
    WHOLE,
    Campaign,
    Case,
    DepositRows,
    ImpactRows,
    PassageRows,
    PathRows,
    main_blocks,
)
from sassgis.gap.observations.projection import ContactRows, contact_numbers
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.results import StopReason
from sassgis.terrain.cells import heights_at
from sassgis.terrain.flatten import chainage_to_xy


def observe(
    case: Case,
    lines: RockLines,
    model: HypothesisModel,
    moved: Moved,
    count: int,
    rng: np.random.Generator,
    tables: frozenset[str],
) -> list[Campaign]:
    """Simulate what ``count`` campaigns show to the observer of the case.

    Errors of release and measurement of the model, and offsets from the fall line, come on top.
    ``moved``: every rock ``count`` times.
    """
    record = _Record(case, lines, model, moved, count, rng)
    passages = record.passages() if "passages" in tables and case.station_names else None
    deposits = record.deposits() if "deposits" in tables else None
    impacts = record.impacts() if "impacts" in tables else None
    contacts = record.contacts() if "contacts" in tables else None
    paths = record.paths() if "trajectories" in tables else None
    n = case.n_rocks
    return [
        Campaign(
            n,
            *(
                None if rows is None else _of_campaign(rows, k, n)
                for rows in (passages, deposits, impacts, contacts, paths)
            ),
        )
        for k in range(count)
    ]


def _of_campaign(rows, campaign: int, n: int):  # type: ignore[no-untyped-def]
    """Return rows of one campaign: rocks are numbered on, loose blocks below zero."""
    owner = np.where(rows.rock >= 0, rows.rock, -1 - rows.rock)
    mine = owner // n == campaign
    fields = {}
    for name in rows.__slots__:
        values = getattr(rows, name)[mine]
        fields[name] = np.where(values >= 0, values % n, -1) if name == "rock" else values
    return type(rows)(**fields)


class _Record:
    """Records of ``count`` campaigns, with the errors of the observers.

    Rocks are numbered campaign by campaign: rock + campaign * n_rocks. A loose block carries
    -1 less the number of the rock that set it off, so that it stays with its campaign.
    """

    def __init__(
        self,
        case: Case,
        rock_lines: RockLines,
        model: HypothesisModel,
        moved: Moved,
        count: int,
        rng: np.random.Generator,
    ) -> None:
        self._case, self._lines, self._model, self._moved = case, rock_lines, model, moved
        self._errors, m = rock_lines.observer, model.measurement
        self._rng, self._n, self._count = rng, case.n_rocks, count
        total = self._n * count
        first = model.release
        self._offset = first.shift_m + first.scatter_m * rng.standard_normal(total)
        self._clock = np.exp(m.clock_sd * np.clip(rng.standard_t(4, total), -4.0, 4.0))
        self._mass = self._of_rocks("mass_kg")

    def _of_rocks(self, name: str) -> FloatArray:
        """Return a number of each released rock, by their numbers."""
        values: FloatArray = self._moved.rocks[name]
        return values.reshape(self._n, self._count).T.ravel()

    def _numbers(self, rows: NDArray[np.void]) -> IntArray:
        first = int(self._moved.rocks["rock"].min()) if self._moved.rocks.size else 0
        return rows["line"] + (rows["rock"].astype(np.int64) - first) * self._n

    def _lateral_offset(self, owner: IntArray, moved: FloatArray, stated_m: float) -> FloatArray:
        """Return the measured offset from the line; ``moved``: that of the motion (m)."""
        error = np.hypot(stated_m, self._model.measurement.position_m)
        noise = error * self._rng.standard_normal(owner.size)
        measured: FloatArray = moved + self._offset[owner] + noise
        return measured

    def _speed_error(self, owner: IntArray, relative: float) -> FloatArray:
        sd = np.hypot(relative, self._model.measurement.noise_rel)
        noise: FloatArray = np.exp(sd * self._rng.standard_normal(owner.size))
        return noise / self._clock[owner]

    def _kind(self, rows: NDArray[np.void], owner: IntArray) -> IntArray:
        """Return whether fragments broke off or were set in motion: the latter have one size."""
        effects = self._model.effects
        entrainment = effects.get(Entrainment)
        if entrainment is None:
            return np.full(owner.size, PIECE, np.int64)
        if effects.get(Fragmentation) is None:
            return np.full(owner.size, LOOSE, np.int64)
        ratio = rows["mass_kg"] / self._mass[owner] / entrainment.size_ratio**3
        return np.where(np.abs(ratio - 1.0) < 1e-9, LOOSE, PIECE)

    def deposits(self) -> DepositRows:
        """Return blocks that stopped on the profiles."""
        blocks = np.concatenate([self._moved.rocks, self._moved.pieces])
        left = np.flatnonzero(blocks["reason"] != StopReason.BROKEN)
        rows = blocks[left]
        owner = self._numbers(rows)
        kind = np.where(left < self._moved.rocks.size, WHOLE, self._kind(rows, owner))
        errors, m = self._errors, self._model.measurement
        lateral = self._lateral_offset(owner, self._moved.lateral_m[left], errors.stop_m)
        first = self._case.station_s[:, 0] if self._case.station_names else np.zeros(self._n)
        anchor = np.nan_to_num(first)[owner % self._n]
        error = np.hypot(errors.stop_m, m.position_m)
        s = anchor + m.stretch * (rows["runout_m"] - anchor)
        s = s + error * self._rng.standard_normal(s.size)
        mass = rows["mass_kg"] * np.exp(errors.mass_rel * self._rng.standard_normal(s.size))
        return DepositRows(np.where(kind == LOOSE, -1 - owner, owner), kind, s, lateral, mass)

    def passages(self) -> PassageRows:
        """Return the passages at the stations."""
        moved, aside = self._moved.passages, self._moved.passed_lateral_m
        missed = self._errors.passages_missed_share
        seen = self._rng.random(moved.size) >= missed if missed > 0.0 else np.full(moved.size, True)
        rows, aside = moved[seen], aside[seen]
        owner = self._numbers(rows)
        whole = rows["mass_kg"] >= self._mass[owner] * (1.0 - 1e-9)
        kind = np.where(whole, WHOLE, self._kind(rows, owner))
        errors, m = self._errors, self._model.measurement
        speed = rows["speed_mps"] * m.scale * self._speed_error(owner, errors.speed_rel)
        turns = np.abs(rows["rotation_hz"]) * m.rotation_scale
        error = math.hypot(errors.rotation_rel, m.rotation_noise)
        rotation = turns * self._speed_error(owner, error)
        rest = self._rest(rows, owner)
        height = (rows["height_m"] + rest) * m.scale
        height = np.maximum(height + errors.height_m * self._rng.standard_normal(owner.size), 0.0)
        mass = rows["mass_kg"] * np.exp(errors.mass_rel * self._rng.standard_normal(owner.size))
        return PassageRows(
            rock=np.where(kind == LOOSE, -1 - owner, owner),
            station=rows["control_line"].astype(np.int64), kind=kind,
            lateral_m=self._lateral_offset(owner, aside, errors.position_m), speed_mps=speed,
            rotation_hz=rotation, height_m=height, mass_kg=mass,
        )  # fmt: skip

    def _rest(self, rows: NDArray[np.void], owner: IntArray) -> FloatArray:
        """Return the height of the centre of a lying block, from which heights are counted (m)."""
        stated = np.column_stack([self._of_rocks("a_m"), self._of_rocks("b_m")])
        axes = moving_axes(stated, self._case.engine)
        # The engine counts heights of flight from the shorter axis; a rock that rolls has none.
        rolling = np.array([mean_radius(*pair) for pair in axes])
        lever = np.where(rows["height_m"] > 0.0, axes[owner, 1], rolling[owner])
        size = np.cbrt(rows["mass_kg"] / self._mass[owner])
        cosine = np.cos(dips_at(self._lines.unforested, owner % self._n, rows["chainage_m"]))
        return lever * size / cosine

    def impacts(self) -> ImpactRows:
        """Return impacts of whole rocks, taken apart along the ground."""
        events, index, hit = impacts_of(self._moved.event_logs)
        before, after = events[hit], events[hit + 1]
        line, campaign = np.divmod(index[hit], self._count)
        owner = line + campaign * self._n
        order = np.argsort(owner, kind="stable")
        before, after, owner = before[order], after[order], owner[order]
        x, y, ground, dip, turned = self._under(events, index, hit[order], owner)
        cosine, sine = np.cos(dip), np.sin(dip)
        errors, m = self._errors, self._model.measurement
        spin_error = math.hypot(errors.rotation_rel, m.spin_noise)

        def apart(event: NDArray[np.void]) -> tuple[FloatArray, FloatArray, FloatArray]:
            error = m.scale * self._speed_error(owner, errors.speed_rel)
            turn = m.spin_scale * self._speed_error(owner, spin_error)
            vx, vz = event["vx_mps"], event["vz_mps"]
            return (
                (vx * cosine + vz * sine) * error,
                (vz * cosine - vx * sine) * error,
                event["omega_radps"] * turn,
            )

        vt_in, vn_in, spin_in = apart(before)
        vt_out, vn_out, spin_out = apart(after)
        first, last = recorded_contacts(self._errors, owner, before["t_s"], -vn_in)
        owner, n = owner[first], first.size
        turn = self._rng.standard_normal(n) * errors.turn_deg - turned[first]
        # Where the ground was met: the foot of the centre on the segment.
        off = ((before["z_m"] - ground) * cosine)[first]
        error = np.hypot(errors.position_m, m.position_m)
        s, place = x[first], np.full((2, x.size), np.nan)
        if self._case.terrain is not None:
            place = np.stack([x, y])
            s = in_plane(self._case, owner % self._n, x[first], y[first])[0]
        s = s + off * sine[first] + error * self._rng.standard_normal(n)
        z = before["z_m"][first] - off * cosine[first] + error * self._rng.standard_normal(n)
        turn = self._case.turns(owner % self._n, turn, vt_out[last], vn_out[last])
        # Nothing is put behind the start of a line.
        return ImpactRows(
            rock=owner, s=np.maximum(s, 0.0), z=z, vt_in=vt_in[first], vn_in=vn_in[first],
            spin_in=spin_in[first], vt_out=vt_out[last], vn_out=vn_out[last],
            spin_out=spin_out[last], turn_deg=turn, slope_deg=-np.degrees(dip[first]),
            x=place[0][first], y=place[1][first],
        )  # fmt: skip

    def contacts(self) -> ContactRows:
        """Return contacts of whole rocks in time and place; a rock that rolls stays in one."""
        events, index, _ = impacts_of(self._moved.event_logs)
        line, campaign = np.divmod(index, self._count)
        owner = line + campaign * self._n
        order = np.argsort(owner, kind="stable")
        events, owner = events[order], owner[order]
        first, after = contacts_in(events, owner)
        # What lasts is a contact however slow the rock came to it.
        into = events["vx_mps"] * events["uz"] - events["vz_mps"] * events["ux"]
        into = np.where(events["phase"] == IMPACT, into, np.inf)[first]
        kept, last = recorded_contacts(self._errors, owner[first], events["t_s"][first], into)
        first, after = first[kept], after[last]
        # The time of a rock goes on from that of the one before: all are interpolated at once.
        steps = np.diff(events["t_s"], prepend=0.0)
        clock = np.cumsum(np.where(np.diff(owner, prepend=-1) != 0, 1.0, steps))
        middle, owner = 0.5 * (clock[first] + clock[after]), owner[first]
        x, y = events["x_m"], np.zeros(events.size)
        if self._case.terrain is not None:
            x, y = _places(self._case.terrain.grid, events)
        errors, m = self._errors, self._model.measurement
        error = np.hypot(errors.position_m, m.position_m)
        x, y, z = (
            np.interp(middle, clock, v) + error * self._rng.standard_normal(owner.size)
            for v in (x, y, events["z_m"])
        )
        spin_error = math.hypot(errors.rotation_rel, m.rotation_noise)
        before, turned = (
            np.abs(events["omega_radps"][i]) / (2.0 * math.pi) * m.rotation_scale
            * self._speed_error(owner, spin_error)
            for i in (first, after)
        )  # fmt: skip
        start, end = (events["t_s"][i] for i in (first, after))
        return ContactRows(
            rock=owner, start_s=start, end_s=end, x=x, y=y, z=z, rotation_before_hz=before,
            rotation_after_hz=turned,
        )  # fmt: skip

    def paths(self) -> PathRows:
        """Return points of whole rocks at even times, as films show them."""
        logs, case = self._moved.event_logs, self._case
        line, campaign = np.divmod(np.arange(len(logs)), self._count)
        films = []
        for log, on, rock in zip(logs, case.line[line], line + campaign * self._n, strict=True):
            if case.terrain is None:
                x, y = chainage_to_xy(case.traces, np.full(log.size, on), log["x_m"])
            else:
                x, y = _places(case.terrain.grid, log)
            points = film(log, x, y, PATH_STEP_S)
            films.append(np.vstack([np.full(points.shape[1], rock), points]))
        rock, t, *places, speed, rotation = np.concatenate([np.empty((7, 0)), *films], axis=1)
        owner = rock.astype(np.int64)
        errors, m = self._errors, self._model.measurement
        error = math.hypot(errors.position_m, m.position_m)
        x, y, z = (v + error * self._rng.standard_normal(owner.size) for v in places)
        turned = m.rotation_scale * self._speed_error(
            owner, math.hypot(errors.rotation_rel, m.rotation_noise)
        )
        return PathRows(
            rock=owner, t_s=t * self._clock[owner], x=x, y=y, z=z,
            speed_mps=speed * m.scale * self._speed_error(owner, errors.speed_rel),
            rotation_hz=rotation * turned,
        )  # fmt: skip

    def _under(
        self, events: NDArray[np.void], index: IntArray, hit: IntArray, owner: IntArray
    ) -> tuple[FloatArray, ...]:
        """Return place, height and dip of the ground at impacts, and turn of the path (°)."""
        rock, x_m = owner % self._n, events["x_m"][hit]
        terrain = self._case.terrain
        if terrain is None:
            profiles = self._lines.unforested
            ground, dip = heights_at_chainage(profiles, rock, x_m), dips_at(profiles, rock, x_m)
            return x_m, x_m, ground, dip, np.zeros(rock.size)
        grid = terrain.grid
        x, y = _places(grid, events)
        turn, before = turns_of(events, index, hit)
        x, y = x[hit], y[hit]
        step = 0.5 * grid.cell_size
        behind, ahead = (
            heights_at(grid, x + k * step * np.cos(before), y + k * step * np.sin(before))
            for k in (-1.0, 1.0)
        )
        # Next to the edge of the terrain only one side is known.
        dip = np.nan_to_num(np.arctan2(ahead - behind, 2.0 * step))
        return x, y, heights_at(grid, x, y), dip, np.degrees(turn)


def impacts_of(logs: Sequence[NDArray[np.void]]) -> tuple[NDArray[np.void], IntArray, IntArray]:
    """Return events of blocks one after the other, the block of each, and the rows of impacts."""
    sizes = np.array([log.size for log in logs], np.int64)
    events = np.empty(int(sizes.sum()), EVENT_DTYPE)
    for log, end in zip(logs, np.cumsum(sizes).tolist(), strict=True):
        events[end - log.size : end] = log
    index = np.repeat(np.arange(sizes.size), sizes)
    hit = np.flatnonzero((events["phase"][:-1] == IMPACT) & (index[:-1] == index[1:]))
    return events, index, hit


def _places(grid: Grid, events: NDArray[np.void]) -> tuple[FloatArray, FloatArray]:
    """Return x and y of events on paths that are followed (m)."""
    x: FloatArray = grid.west + events["u"] * grid.cell_size
    y: FloatArray = grid.north - events["v"] * grid.cell_size
    return x, y


def film(log: NDArray[np.void], x: FloatArray, y: FloatArray, step_s: float) -> FloatArray:
    """Return time, x, y, z, speed and turns per second of a block at even times, shape (6, n).

    Between two events the path is a cubic with their speeds. ``log``: events of the block
    (EVENT_DTYPE); ``x``, ``y``: where they are (m).
    """
    t = np.arange(0.0, log["t_s"][-1], step_s) if log.size > 1 else np.empty(0)
    k = np.clip(np.searchsorted(log["t_s"], t, side="right") - 1, 0, max(log.size - 2, 0))
    a, b = log[k], log[k + 1]
    h = np.maximum(b["t_s"] - a["t_s"], 1e-9)
    u = (t - a["t_s"]) / h
    s, vs = _cubic(u, h, a["x_m"], b["x_m"], a["vx_mps"], b["vx_mps"])
    z, vz = _cubic(u, h, a["z_m"], b["z_m"], a["vz_mps"], b["vz_mps"])
    way = b["x_m"] - a["x_m"]
    share = np.where(np.abs(way) > 1e-6, (s - a["x_m"]) / np.where(way == 0.0, 1.0, way), u)
    spin = a["omega_radps"] + u * (b["omega_radps"] - a["omega_radps"])
    places = (v[k] + share * (v[k + 1] - v[k]) for v in (x, y))
    return np.stack([t, *places, z, np.hypot(vs, vz), np.abs(spin) / (2.0 * math.pi)])


def _cubic(
    u: FloatArray, h: FloatArray, a: FloatArray, b: FloatArray, va: FloatArray, vb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return value and rate of the cubic with values and rates at both ends, at a share of h."""
    way, da, db = b - a, va * h, vb * h
    c2, c3 = 3.0 * way - 2.0 * da - db, da + db - 2.0 * way
    return a + u * (da + u * (c2 + u * c3)), (da + u * (2.0 * c2 + u * 3.0 * c3)) / h


def contacts_in(events: NDArray[np.void], index: IntArray) -> tuple[IntArray, IntArray]:
    """Return the first row of each contact of blocks, and the row in which the rock has left it.

    ``events``: of several blocks, one after the other (EVENT_DTYPE); ``index``: block of each.
    """
    on = (events["phase"] != FLIGHT) & (events["phase"] != END)
    same = index[1:] == index[:-1]
    first = np.flatnonzero(on & ~np.append(False, on[:-1] & same))
    after = np.flatnonzero(~on & np.append(False, on[:-1] & same))
    return first[np.searchsorted(first, after) - 1], after


def turns_of(
    events: NDArray[np.void], index: IntArray, hit: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return anticlockwise turns of followed paths at impacts, and azimuths before (rad), (n,)."""
    azimuth, moves = [], []
    for first, last in ((np.maximum(hit - 1, 0), hit), (hit + 1, hit + 2)):
        last = np.minimum(last, events.size - 1)
        east = events["u"][last] - events["u"][first]
        north = events["v"][first] - events["v"][last]
        azimuth.append(np.arctan2(north, east))
        moves.append((index[first] == index[last]) & (np.hypot(east, north) > 1e-9))
    turn = np.remainder(azimuth[1] - azimuth[0] + np.pi, 2.0 * np.pi) - np.pi
    return np.where(moves[0] & moves[1], turn, 0.0), azimuth[0]


#: Tables of a campaign.
TABLES = frozenset({"passages", "deposits", "impacts", "contacts"})


def campaigns(
    case: Case,
    rock_lines: RockLines,
    model: HypothesisModel,
    *,
    count: int,
    seed: int,
    number: int = 0,
    tables: frozenset[str] = TABLES,
    everywhere: bool = False,
) -> list[Campaign]:
    """Release the rocks of a case ``count`` times in a model, with stated errors of measurement.

    Campaigns of another ``number`` are other draws. ``tables``: only these, of which something was
    observed, or ``everywhere``.
    """
    if not everywhere:
        tables = frozenset(name for name in tables if len(case.observations.tables[name]))
    rng = np.random.default_rng([seed, number, 77])
    moved = move(
        case, rock_lines, all_rocks(with_release(case, model.release, rock_lines.end), rock_lines),
        model, seed=seed, count=count, first_rock=number * 64,
        log_events=max((LOGGED_EVENTS.get(name, 0) for name in tables), default=0),
    )  # fmt: skip
    return observe(
        case=case, lines=rock_lines, model=model, moved=moved, count=count, rng=rng, tables=tables,
    )  # fmt: skip


def share_left(case: Case, rock_lines: RockLines, model: HypothesisModel, seed: int) -> float:
    """Return the share of rocks that still move at the terrain's edge or where lines end."""
    released = all_rocks(with_release(case, model.release, rock_lines.end), rock_lines)
    moved = move(case, rock_lines, released, model, seed=seed, count=LEAVING_RUNS)
    return float((moved.rocks["reason"] == StopReason.LEFT_PROFILE).mean())


def with_release(case: Case, error: ReleaseError, end: FloatArray) -> Case:
    """Return case with rocks that start elsewhere before ``end`` (m), or faster; offsets apart."""
    blocks, start = case.blocks, case.start
    if error.faster_mps > 0.0:
        blocks = tuple(
            replace(b, speed_mps=(b.speed_mps[0], b.speed_mps[1] + error.faster_mps))
            for b in blocks
        )
    if error.ahead_m != 0.0:
        moved = np.sort(error.ahead_m * np.array(AHEAD_SHARES))
        start = np.minimum(start + moved, end[:, None] - 1.0)
    return replace(case, blocks=blocks, start=start)


def rock_quantities(case: Case, sample: Campaign) -> dict[str, FloatArray]:
    """Return one number per rock and quantity, NaN where there is none."""
    found: dict[str, FloatArray] = {}
    if (stops := sample.deposits) is not None:
        # -1, of rocks without one, takes the last.
        main = main_blocks(stops, case.n_rocks)
        found["stop:runout"] = np.append(stops.s, np.nan)[main]
        found["stop:aside"] = np.append(stops.lateral_m, np.nan)[main]
        own = stops.rock[stops.rock >= 0]
        found["stop:blocks"] = np.bincount(own, minlength=case.n_rocks).astype(np.float64)
    if (rows := sample.passages) is not None:
        numbers = {
            "speed": np.log(np.maximum(rows.speed_mps, 0.1)),
            "rotation": rows.rotation_hz,
            "height": rows.height_m,
            "aside": rows.lateral_m,
        }
        for k in range(len(case.station_names)):
            here = np.flatnonzero((rows.station == k) & (rows.rock >= 0))
            # The heaviest of a rock's blocks represents it.
            here = here[np.argsort(np.nan_to_num(rows.mass_kg[here]), kind="stable")]
            first = np.full(case.n_rocks, -1, np.int64)
            first[rows.rock[here]] = here
            found[f"S{k}:passed"] = (first >= 0).astype(float)
            for what, values in numbers.items():
                found[f"S{k}:{what}"] = np.append(values, np.nan)[first]
    if sample.contacts is not None:
        numbers = contact_numbers(sample.contacts, case.radius_m)
        found |= {f"contacts:{name}": values for name, values in numbers.items()}
    return found
