"""Simulated campaigns: the observed rocks released again in a model, observed in the same way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.trees import Trees
from sassgis.engine.ellipse import mean_radius
from sassgis.engine.simulate import Simulated, simulate
from sassgis.engine.state import EVENT_DTYPE, IMPACT
from sassgis.gap.observations.campaign import (
    LOOSE,
    PIECE,
    WHOLE,
    Campaign,
    DepositRows,
    ImpactRows,
    PassageRows,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.replicas.rock_lines import RockLines, dips_at, heights_at_chainage
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.map_run import Forest
from sassgis.model.results import StopReason

#: Length of the stretches on which a forest stands or not (m).
STRETCH_M = 2.0
#: Step of the lateral random walks (m).
_WALK_M = 4.0
#: Events kept in the log of a block; later impacts are not seen.
_MOST_EVENTS = 160


def campaigns(
    case: Case,
    rock_lines: RockLines,
    model: HypothesisModel,
    *,
    count: int,
    seed: int,
    number: int = 0,
    impacts: bool = True,
    tables: frozenset[str] | None = None,
) -> list[Campaign]:
    """Release the rocks of a case ``count`` times in a model.

    Parameters
    ----------
    case : Case
    rock_lines : RockLines
    model : HypothesisModel
    count : int
    seed : int
    number : int
        Campaigns of other numbers are other draws.
    impacts : bool
        Whether impacts are given, where the case has any.
    tables : frozenset of str, optional
        Of "passages", "deposits" and "impacts"; default: those that the case has.

    Returns
    -------
    list of Campaign
        With these tables; errors of measurement as stated are in them.
    """
    if tables is None:
        tables = frozenset(
            name
            for name in ("passages", "deposits", "impacts")
            if len(case.observations.tables[name]) and (impacts or name != "impacts")
        )
    rng = np.random.default_rng([seed, number, 77])
    wood = _wood(rock_lines, model)
    release = model.release
    blocks = [
        replace(b, speed_mps=(b.speed_mps[0], b.speed_mps[1] + release.faster_mps))
        for b in case.blocks
    ] if release.faster_mps > 0.0 else case.blocks  # fmt: skip
    start = case.start.copy()
    start[:, 1] = np.minimum(start[:, 1] + release.ahead_m, rock_lines.end - 1.0)
    result = simulate(
        rock_lines.unforested if wood is None else rock_lines.forested,
        model.table,
        blocks,
        case.engine,
        seed=seed,
        rocks_per_line=count,
        line_keys=rock_lines.keys,
        starts=start,
        control_lines=rock_lines.control_lines,
        first_rock=number * 64,
        log_events=_MOST_EVENTS if "impacts" in tables else 0,
        effects=model.effects,
        forest=wood,
    )
    paths = _Paths(case, rock_lines, model, result, count, rng)
    stations = len(rock_lines.control_lines.control_lines) > 0
    passages = paths.passages() if "passages" in tables and stations else None
    deposits = paths.deposits() if "deposits" in tables else None
    hits = paths.impacts(case) if "impacts" in tables else None
    n = case.n_rocks
    return [
        Campaign(
            n,
            None if passages is None else _of_campaign(passages, k, n),
            None if deposits is None else _of_campaign(deposits, k, n),
            None if hits is None else _of_campaign(hits, k, n),
        )
        for k in range(count)
    ]


def passages_followed(
    case: Case, rock_lines: RockLines, result: Simulated, *, count: int, rng: np.random.Generator
) -> list[PassageRows]:
    """Passages of whole campaigns of blocks whose paths were followed, with errors of measurement.

    Lines of ``result`` are the rocks, control lines the stations of the case. Where on a station
    a block passed is not kept.
    """
    n = case.n_rocks
    rows = result.passages
    # The ground at a station is that of the rock's fall line there.
    rows["chainage_m"] = case.station_s[rows["line"], rows["control_line"]]
    known = np.isfinite(rows["chainage_m"])
    plain = HypothesisModel(case.table, case.effects)
    seen = replace(result, passages=rows[known])
    passages = _Paths(case, rock_lines, plain, seen, count, rng).passages()
    return [_of_campaign(passages, k, n) for k in range(count)]


def _wood(rock_lines: RockLines, model: HypothesisModel) -> Forest | None:
    if model.effects.get(Trees) is None:
        return None
    if model.stand is None:
        return rock_lines.wood
    middle = rock_lines.first_m + STRETCH_M * (np.arange(rock_lines.n_stretches) + 0.5)
    inside = (middle >= model.stand.s0) & (middle <= model.stand.s1)
    return Forest(
        np.where(inside, model.stand.stems_per_ha / 1e4, 0.0),
        np.where(inside, model.stand.dbh_cm / 100.0, 0.0),
    )


def _of_campaign(rows, campaign: int, n: int):  # type: ignore[no-untyped-def]
    """Rows of one campaign; rocks were numbered campaign by campaign, loose blocks below zero."""
    owner = np.where(rows.rock >= 0, rows.rock, -1 - rows.rock)
    mine = owner // n == campaign
    fields = {}
    for name in rows.__slots__:
        values = getattr(rows, name)[mine]
        fields[name] = np.where(values >= 0, values % n, -1) if name == "rock" else values
    return type(rows)(**fields)


class _Paths:
    """What ``count`` campaigns left, with the errors of those who look.

    Rocks are numbered campaign by campaign: rock + campaign * n_rocks. A loose block carries
    -1 less the number of the rock that set it off, so that it stays with its campaign.
    """

    def __init__(
        self,
        case: Case,
        rock_lines: RockLines,
        model: HypothesisModel,
        result: Simulated,
        count: int,
        rng: np.random.Generator,
    ) -> None:
        self._case, self._lines, self._model, self._result = case, rock_lines, model, result
        self._rng = rng
        self._n = case.n_rocks
        self._count = count
        total = self._n * count
        walk = model.lateral_walk
        reach = float(rock_lines.end.max())
        self._knots = int(np.ceil(reach / _WALK_M)) + 2
        sd = np.tan(np.radians(walk.angle_deg)) * np.sqrt(walk.hop_m * _WALK_M)
        self._sd = sd
        first = model.release
        self._offset = first.shift_m + first.scatter_m * rng.standard_normal(total)
        self._heading = 0.01 * walk.width_percent * (rng.random(total) - 0.5)
        self._walks = self._walk(total)
        m = model.measurement
        self._clock = np.exp(m.clock_sd * np.clip(rng.standard_t(4, total), -4.0, 4.0))
        self._mass: FloatArray = result.rocks["mass_kg"].reshape(self._n, count).T.ravel()

    def _walk(self, total: int) -> FloatArray | None:
        if self._sd <= 0.0:
            return None
        steps = self._sd * self._rng.standard_normal((total, self._knots))
        walks: FloatArray = np.cumsum(steps, axis=1)
        return walks

    def _numbers(self, rows: NDArray[np.void]) -> IntArray:
        first = int(self._result.rocks["rock"].min()) if self._result.rocks.size else 0
        numbers: IntArray = rows["line"] + (rows["rock"].astype(np.int64) - first) * self._n
        return numbers

    def _lateral_offset(
        self, owner: IntArray, s: FloatArray, own_walk: NDArray[np.bool_]
    ) -> FloatArray:
        """Lateral offset from the line, measured; fragments walk on paths of their own."""
        along = np.maximum(s, 0.0)
        lateral: FloatArray = self._offset[owner] + self._heading[owner] * along
        if self._walks is not None:
            k = np.clip((s / _WALK_M).astype(np.int64), 0, self._knots - 1)
            lateral = lateral + self._walks[owner, k]
            scatter = self._sd * np.sqrt(along / _WALK_M)
            lateral = lateral + np.where(own_walk, scatter * self._rng.standard_normal(s.size), 0.0)
        error = np.hypot(self._lines.errors.position_m, self._model.measurement.position_m)
        measured: FloatArray = lateral + error * self._rng.standard_normal(s.size)
        return measured

    def _speed_error(self, owner: IntArray, relative: float) -> FloatArray:
        sd = np.hypot(relative, self._model.measurement.noise_rel)
        noise: FloatArray = np.exp(sd * self._rng.standard_normal(owner.size))
        return noise / self._clock[owner]

    def _kind(self, rows: NDArray[np.void], owner: IntArray) -> IntArray:
        """Whether pieces broke off or were set in motion: the latter have one size."""
        effects = self._model.effects
        entrainment = effects.get(Entrainment)
        if entrainment is None:
            return np.full(owner.size, PIECE, np.int64)
        if effects.get(Fragmentation) is None:
            return np.full(owner.size, LOOSE, np.int64)
        ratio = rows["mass_kg"] / self._mass[owner] / entrainment.size_ratio**3
        return np.where(np.abs(ratio - 1.0) < 1e-9, LOOSE, PIECE).astype(np.int64)

    def deposits(self) -> DepositRows:
        """Blocks that stopped on the profiles."""
        rocks, pieces = self._result.rocks, self._result.pieces
        rocks = rocks[rocks["reason"] != StopReason.BROKEN]
        pieces = pieces[pieces["reason"] != StopReason.BROKEN]
        owner = np.concatenate([self._numbers(rocks), self._numbers(pieces)])
        n_whole = rocks.size
        kind = np.concatenate(
            [np.full(n_whole, WHOLE), self._kind(pieces, owner[n_whole:])]
        ).astype(np.int64)
        s = np.concatenate([rocks["runout_m"], pieces["runout_m"]])
        mass = np.concatenate([rocks["mass_kg"], pieces["mass_kg"]])
        lateral = self._lateral_offset(owner, s, kind != WHOLE)
        m = self._model.measurement
        first = self._case.station_s[:, 0] if self._case.station_names else np.zeros(self._n)
        anchor = np.nan_to_num(first)[owner % self._n]
        error = np.hypot(self._lines.errors.position_m, m.position_m)
        s = anchor + m.stretch * (s - anchor) + error * self._rng.standard_normal(s.size)
        mass = mass * np.exp(self._lines.errors.mass_rel * self._rng.standard_normal(mass.size))
        return DepositRows(np.where(kind == LOOSE, -1 - owner, owner), kind, s, lateral, mass)

    def passages(self) -> PassageRows:
        """What the stations saw."""
        rows = self._result.passages
        owner = self._numbers(rows)
        whole = rows["mass_kg"] >= self._mass[owner] * (1.0 - 1e-9)
        kind = np.where(whole, WHOLE, self._kind(rows, owner)).astype(np.int64)
        errors, m = self._lines.errors, self._model.measurement
        speed = rows["speed_mps"] * m.scale * self._speed_error(owner, errors.speed_rel)
        turns = np.abs(rows["rotation_hz"]) * m.rotation_scale
        rotation = turns * self._speed_error(owner, errors.rotation_rel)
        rest = self._rest(rows, owner)
        height = (rows["height_m"] + rest) * m.scale
        height = np.maximum(height + errors.height_m * self._rng.standard_normal(owner.size), 0.0)
        mass = rows["mass_kg"] * np.exp(errors.mass_rel * self._rng.standard_normal(owner.size))
        return PassageRows(
            np.where(kind == LOOSE, -1 - owner, owner),
            rows["control_line"].astype(np.int64),
            kind,
            self._lateral_offset(owner, rows["chainage_m"], kind != WHOLE),
            speed,
            rotation,
            height,
            mass,
        )

    def _rest(self, rows: NDArray[np.void], owner: IntArray) -> FloatArray:
        """Height of the centre of a lying block above the ground: heights are counted from it."""
        a, b = (
            self._result.rocks[name].reshape(self._n, self._count).T.ravel()
            for name in ("a_m", "b_m")
        )
        # The engine counts heights of flight from the shorter axis; a rock that rolls has none.
        rolling = np.array([mean_radius(*axes) for axes in zip(a, b, strict=True)])
        lever = np.where(rows["height_m"] > 0.0, b[owner], rolling[owner])
        size = np.cbrt(rows["mass_kg"] / self._mass[owner])
        cosine = np.cos(dips_at(self._lines.unforested, owner % self._n, rows["chainage_m"]))
        rest: FloatArray = lever * size / cosine
        return rest

    def impacts(self, case: Case) -> ImpactRows:
        """Impacts of whole rocks, taken apart along the ground."""
        logs = self._result.event_logs
        sizes = np.array([log.size for log in logs], np.int64)
        events = np.concatenate([np.empty(0, EVENT_DTYPE), *logs])
        index = np.repeat(np.arange(sizes.size), sizes)
        hit = np.flatnonzero((events["phase"][:-1] == IMPACT) & (index[:-1] == index[1:]))
        before, after = events[hit], events[hit + 1]
        line, campaign = np.divmod(index[hit], self._count)
        owner = line + campaign * self._n
        order = np.argsort(owner, kind="stable")
        before, after, owner = before[order], after[order], owner[order]
        dip = dips_at(self._lines.unforested, owner % self._n, before["x_m"])
        cosine, sine = np.cos(dip), np.sin(dip)
        errors, m = self._lines.errors, self._model.measurement

        def apart(event: NDArray[np.void]) -> tuple[FloatArray, FloatArray, FloatArray]:
            error = m.scale * self._speed_error(owner, errors.speed_rel)
            turn = m.rotation_scale * self._speed_error(owner, errors.rotation_rel)
            vx, vz = event["vx_mps"], event["vz_mps"]
            return (
                (vx * cosine + vz * sine) * error,
                (vz * cosine - vx * sine) * error,
                event["omega_radps"] * turn,
            )

        vt_in, vn_in, spin_in = apart(before)
        vt_out, vn_out, spin_out = apart(after)
        kick = np.hypot(self._model.lateral_walk.angle_deg, self._model.turn_noise_deg)
        turn = self._rng.standard_normal(owner.size) * kick
        # Where the ground was met: the foot of the centre on the segment.
        ground = heights_at_chainage(self._lines.unforested, owner % self._n, before["x_m"])
        off = (before["z_m"] - ground) * cosine
        error = np.hypot(errors.position_m, m.position_m)
        s = before["x_m"] + off * sine + error * self._rng.standard_normal(owner.size)
        # Nothing is put behind the start of a line.
        s = np.maximum(s, 0.0)
        z = before["z_m"] - off * cosine + error * self._rng.standard_normal(owner.size)
        rows = ImpactRows(owner, s, z, vt_in, vn_in, spin_in, vt_out, vn_out, spin_out, turn)
        approaching = vn_in < 0.0
        return ImpactRows(*(getattr(rows, f)[approaching] for f in ImpactRows.__slots__))
