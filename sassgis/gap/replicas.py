"""Simulated campaigns: the observed rocks let go again in a model, and seen by the same eyes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.ellipse import mean_radius
from sassgis.engine.simulate import ControlLineCrossings, Forest, Simulated, simulate
from sassgis.engine.state import EVENT_DTYPE, IMPACT
from sassgis.gap.case import Case
from sassgis.gap.sample import (
    LOOSE,
    PIECE,
    WHOLE,
    DepositRows,
    Errors,
    ImpactRows,
    PassageRows,
    Sample,
    errors_of,
)
from sassgis.model.effects import EffectSettings
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground import GroundTable
from sassgis.model.profiles import ProfileSet
from sassgis.model.results import ControlLine, StopReason
from sassgis.terrain.release import point_keys

#: Length of the stretches on which a forest stands or not (m).
STRETCH_M = 2.0
#: Step of the random walks aside (m).
_WALK_M = 4.0
#: Events kept in the log of a block; later impacts are not seen.
_MOST_EVENTS = 160


@dataclass(frozen=True, slots=True)
class Aside:
    """How rocks leave the plane of their fall line, in distances aside (m).

    The way of a rock aside of its line is a random walk whose heading is drawn anew with the
    standard deviation ``angle_deg`` every ``hop_m`` metres between two chainages, plus a deviation
    of its own, uniform within ``width_percent`` of the chainage to both sides together, plus a
    ``drift`` that all rocks share. This is ``[effects.lateral_deflection]`` without the terrain
    beside the line.

    Attributes
    ----------
    angle_deg, hop_m, width_percent : float
    drift : float
        Metres aside per metre along.
    s0, s1 : float
        Chainages between which they walk (m).
    """

    angle_deg: float = 0.0
    hop_m: float = 10.0
    width_percent: float = 0.0
    drift: float = 0.0
    s0: float = -np.inf
    s1: float = np.inf


@dataclass(frozen=True, slots=True)
class Release:
    """Errors of the stated release.

    Attributes
    ----------
    ahead_m : float
        Rocks start up to this much further down the line, uniformly (m).
    faster_mps : float
        Added to the initial speed, uniform from 0 (m/s).
    shift_m, scatter_m : float
        Start aside of the stated point: the same for all, and standard deviation (m).
    """

    ahead_m: float = 0.0
    faster_mps: float = 0.0
    shift_m: float = 0.0
    scatter_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Measurement:
    """Errors of measurement beyond those that are stated.

    Attributes
    ----------
    scale : float
        Lengths, and so speeds and heights, as measured over true.
    clock_sd : float
        Standard deviation of the logarithm of each rock's time base.
    rotation_scale : float
        Rotations as measured over true.
    noise_rel : float
        Added relative error of speeds and rotations.
    stretch : float
        Distances from the first station as measured over true.
    position_m : float
        Added standard error of positions (m).
    """

    scale: float = 1.0
    clock_sd: float = 0.0
    rotation_scale: float = 1.0
    noise_rel: float = 0.0
    stretch: float = 1.0
    position_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Stand:
    """A forest between two chainages of all lines.

    Attributes
    ----------
    s0, s1 : float
        (m)
    stems_per_ha, dbh_cm : float
    """

    s0: float
    s1: float
    stems_per_ha: float
    dbh_cm: float


@dataclass(frozen=True, slots=True)
class Model:
    """All that a contender sets.

    Attributes
    ----------
    table : GroundTable
    effects : EffectSettings
        Those along the line; ``lateral_deflection`` is in ``aside``.
    stand : Stand or None
    aside : Aside
    release : Release
    measurement : Measurement
    turn_noise_deg : float
        Standard error of the change of azimuth at impacts.
    """

    table: GroundTable
    effects: EffectSettings
    stand: Stand | None = None
    aside: Aside = Aside()
    release: Release = Release()
    measurement: Measurement = Measurement()
    turn_noise_deg: float = 2.0


@dataclass(frozen=True, slots=True)
class Ways:
    """Lines of the rocks of a case, made ready once for many campaigns.

    Attributes
    ----------
    bare, wooded : ProfileSet
        One profile per rock, without stretches and with stretches of STRETCH_M.
    wood : Forest or None
        The configured forest on the stretches.
    first_m : float
        Chainage at which the first stretch begins (m).
    n_stretches : int
    keys : uint64, shape (n_rocks,)
    gates : GateCrossings
    end : float64, shape (n_rocks,)
        Where each profile ends (m).
    errors : Errors
    """

    bare: ProfileSet
    wooded: ProfileSet
    wood: Forest | None
    first_m: float
    n_stretches: int
    keys: NDArray[np.uint64]
    control_lines: ControlLineCrossings
    end: FloatArray
    errors: Errors


def ways_of(case: Case) -> Ways:
    """Prepare the lines of the rocks of a case."""
    first = float(np.floor(case.profiles.s.min() / STRETCH_M) * STRETCH_M)
    n_stretches = int(np.ceil((case.profiles.s.max() - first) / STRETCH_M)) + 1
    names = case.observations.rock_names
    return Ways(
        bare=_profiles_of(case, first, stretches=False),
        wooded=_profiles_of(case, first, stretches=True),
        wood=_configured_wood(case, first, n_stretches),
        first_m=first,
        n_stretches=n_stretches,
        keys=np.concatenate([point_keys(name, 1) for name in names]),
        control_lines=_control_lines(case),
        end=case.profiles.s[case.profiles.offset[1:] - 1][case.line],
        errors=errors_of(case),
    )


def _profiles_of(case: Case, first: float, *, stretches: bool) -> ProfileSet:
    """The profile of each rock, cut into stretches for a forest or not at all."""
    source = case.profiles
    s, z, ground, borders, cells = [], [], [], [], []
    for line in case.line.tolist():
        own = slice(int(source.offset[line]), int(source.offset[line + 1]))
        s.append(source.s[own])
        z.append(source.z[own])
        ground.append(source.ground[own])
        low, high = float(s[-1][0]), float(s[-1][-1])
        if stretches:
            n0 = int(np.floor((low - first) / STRETCH_M)) + 1
            n1 = int(np.ceil((high - first) / STRETCH_M)) - 1
            inner = first + STRETCH_M * np.arange(n0, n1 + 1)
            inner = inner[(inner > low + 1e-6) & (inner < high - 1e-6)]
            border = np.concatenate([[low], inner, [high]])
            middle = 0.5 * (border[1:] + border[:-1])
            cells.append(np.floor((middle - first) / STRETCH_M).astype(np.int64))
        else:
            border = np.array([low, high])
            cells.append(np.full(1, -1, np.int64))
        borders.append(border)
    return ProfileSet(
        _offsets([v.size for v in s]),
        np.concatenate(s),
        np.concatenate(z),
        np.concatenate(ground),
        _offsets([v.size for v in cells]),
        np.concatenate(borders),
        np.concatenate(cells),
    )


def _offsets(sizes: list[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _configured_wood(case: Case, first: float, n: int) -> Forest | None:
    """The forest of the configuration on the stretches: the mean over the lines."""
    if case.forest is None:
        return None
    source = case.profiles
    stems, girth, seen = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(len(source)):
        own = slice(int(source.cell_offset[i]), int(source.cell_offset[i + 1]))
        border = source.cell_s[own.start + i : own.stop + i + 1]
        k = np.floor((0.5 * (border[1:] + border[:-1]) - first) / STRETCH_M).astype(np.int64)
        known = source.cell[own] >= 0
        cell = source.cell[own][known]
        np.add.at(stems, k[known], case.forest.stems_per_m2[cell])
        np.add.at(girth, k[known], case.forest.diameter_m[cell])
        np.add.at(seen, k[known], 1.0)
    seen = np.maximum(seen, 1.0)
    return Forest(stems / seen, girth / seen)


def _control_lines(case: Case) -> ControlLineCrossings:
    """Stations on the line of each rock."""
    s = case.station_s
    control_lines = tuple(ControlLine(name, "station") for name in case.station_names)
    offset, chainage, control_line = [0], [], []
    for row in s:
        known = np.flatnonzero(np.isfinite(row))
        known = known[np.argsort(row[known], kind="stable")]
        chainage.append(row[known])
        control_line.append(known)
        offset.append(offset[-1] + known.size)
    return ControlLineCrossings(
        control_lines,
        np.array(offset, np.int64),
        np.concatenate([np.empty(0), *chainage]),
        np.concatenate([np.empty(0, np.int64), *control_line]).astype(np.int64),
    )


def campaigns(
    case: Case,
    ways: Ways,
    model: Model,
    *,
    count: int,
    seed: int,
    number: int = 0,
    impacts: bool = True,
) -> list[Sample]:
    """Let the rocks of a case go ``count`` times in a model.

    Parameters
    ----------
    case : Case
    ways : Ways
    model : Model
    count : int
    seed : int
    number : int
        Campaigns of other numbers are other draws.
    impacts : bool
        Whether impacts are told, where the case has any.

    Returns
    -------
    list of Sample
        With the tables that the case has; errors of measurement as stated are in them.
    """
    seen = case.observations
    rng = np.random.default_rng([seed, number, 77])
    with_impacts = impacts and len(seen.impacts) > 0
    wood = _wood(ways, model)
    release = model.release
    blocks = [
        replace(b, speed_mps=(b.speed_mps[0], b.speed_mps[1] + release.faster_mps))
        for b in case.blocks
    ] if release.faster_mps > 0.0 else case.blocks  # fmt: skip
    start = case.start.copy()
    start[:, 1] = np.minimum(start[:, 1] + release.ahead_m, ways.end - 1.0)
    result = simulate(
        ways.bare if wood is None else ways.wooded,
        model.table,
        blocks,
        case.engine,
        seed=seed,
        rocks_per_line=count,
        line_keys=ways.keys,
        starts=start,
        control_lines=ways.control_lines,
        first_rock=number * 64,
        log_events=_MOST_EVENTS if with_impacts else 0,
        effects=model.effects,
        forest=wood,
    )
    paths = _Paths(case, ways, model, result, count, rng)
    passages = paths.passages() if len(seen.passages) and case.station_names else None
    deposits = paths.deposits() if len(seen.deposits) else None
    hits = paths.impacts(case) if with_impacts else None
    n = case.n_rocks
    return [
        Sample(
            n,
            None if passages is None else _of_campaign(passages, k, n),
            None if deposits is None else _of_campaign(deposits, k, n),
            None if hits is None else _of_campaign(hits, k, n),
        )
        for k in range(count)
    ]


def _wood(ways: Ways, model: Model) -> Forest | None:
    if model.effects.trees is None:
        return None
    if model.stand is None:
        return ways.wood
    middle = ways.first_m + STRETCH_M * (np.arange(ways.n_stretches) + 0.5)
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
        ways: Ways,
        model: Model,
        result: Simulated,
        count: int,
        rng: np.random.Generator,
    ) -> None:
        self._case, self._ways, self._model, self._result = case, ways, model, result
        self._rng = rng
        self._n = case.n_rocks
        self._count = count
        total = self._n * count
        walk = model.aside
        reach = float(ways.end.max())
        self._knots = int(np.ceil(reach / _WALK_M)) + 2
        middle = _WALK_M * (np.arange(self._knots) + 0.5)
        inside = (middle >= walk.s0) & (middle <= walk.s1)
        sd = np.tan(np.radians(walk.angle_deg)) * np.sqrt(walk.hop_m * _WALK_M)
        self._inside = inside
        self._sd = sd
        first = model.release
        self._offset = first.shift_m + first.scatter_m * rng.standard_normal(total)
        self._heading = 0.01 * walk.width_percent * (rng.random(total) - 0.5) + walk.drift
        self._walks = self._walk(total)
        m = model.measurement
        self._clock = np.exp(m.clock_sd * np.clip(rng.standard_t(4, total), -4.0, 4.0))
        self._mass: FloatArray = result.rocks["mass_kg"].reshape(self._n, count).T.ravel()

    def _walk(self, total: int) -> FloatArray | None:
        if self._sd <= 0.0:
            return None
        steps = self._sd * self._rng.standard_normal((total, self._knots))
        walks: FloatArray = np.cumsum(steps * self._inside, axis=1)
        return walks

    def _numbers(self, rows: NDArray[np.void]) -> IntArray:
        first = int(self._result.rocks["rock"].min()) if self._result.rocks.size else 0
        numbers: IntArray = rows["line"] + (rows["rock"].astype(np.int64) - first) * self._n
        return numbers

    def _aside(self, owner: IntArray, s: FloatArray, own_way: NDArray[np.bool_]) -> FloatArray:
        """Distance aside of the line, measured; pieces walk on ways of their own."""
        walk = self._model.aside
        along = np.clip(s, max(walk.s0, 0.0), walk.s1) - max(walk.s0, 0.0)
        aside: FloatArray = self._offset[owner] + self._heading[owner] * along
        if self._walks is not None:
            k = np.clip((s / _WALK_M).astype(np.int64), 0, self._knots - 1)
            aside = aside + self._walks[owner, k]
            scatter = self._sd * np.sqrt(np.maximum(along, 0.0) / _WALK_M)
            aside = aside + np.where(own_way, scatter * self._rng.standard_normal(s.size), 0.0)
        error = np.hypot(self._ways.errors.position_m, self._model.measurement.position_m)
        measured: FloatArray = aside + error * self._rng.standard_normal(s.size)
        return measured

    def _speed_error(self, owner: IntArray, relative: float) -> FloatArray:
        sd = np.hypot(relative, self._model.measurement.noise_rel)
        noise: FloatArray = np.exp(sd * self._rng.standard_normal(owner.size))
        return noise / self._clock[owner]

    def _kind(self, rows: NDArray[np.void], owner: IntArray) -> IntArray:
        """Whether pieces broke off or were set in motion: the latter have one size."""
        effects = self._model.effects
        if effects.entrainment is None:
            return np.full(owner.size, PIECE, np.int64)
        if effects.fragmentation is None:
            return np.full(owner.size, LOOSE, np.int64)
        ratio = rows["mass_kg"] / self._mass[owner] / effects.entrainment.size_ratio**3
        return np.where(np.abs(ratio - 1.0) < 1e-9, LOOSE, PIECE).astype(np.int64)

    def deposits(self) -> DepositRows:
        """Blocks that came to rest on the profiles."""
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
        aside = self._aside(owner, s, kind != WHOLE)
        m = self._model.measurement
        first = self._case.station_s[:, 0] if self._case.station_names else np.zeros(self._n)
        anchor = np.nan_to_num(first)[owner % self._n]
        error = np.hypot(self._ways.errors.position_m, m.position_m)
        s = anchor + m.stretch * (s - anchor) + error * self._rng.standard_normal(s.size)
        mass = mass * np.exp(self._ways.errors.mass_rel * self._rng.standard_normal(mass.size))
        return DepositRows(np.where(kind == LOOSE, -1 - owner, owner), kind, s, aside, mass)

    def passages(self) -> PassageRows:
        """What the stations saw."""
        rows = self._result.passages
        owner = self._numbers(rows)
        whole = rows["mass_kg"] >= self._mass[owner] * (1.0 - 1e-9)
        kind = np.where(whole, WHOLE, self._kind(rows, owner)).astype(np.int64)
        errors, m = self._ways.errors, self._model.measurement
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
            self._aside(owner, rows["chainage_m"], kind != WHOLE),
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
        cosine = np.cos(dips_at(self._ways.bare, owner % self._n, rows["chainage_m"]))
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
        dip = dips_at(self._ways.bare, owner % self._n, before["x_m"])
        cosine, sine = np.cos(dip), np.sin(dip)
        errors, m = self._ways.errors, self._model.measurement

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
        inside = self._inside[np.clip((before["x_m"] / _WALK_M).astype(int), 0, self._knots - 1)]
        kick = np.where(inside, self._model.aside.angle_deg, 0.0)
        turn = self._rng.standard_normal(owner.size) * np.hypot(kick, self._model.turn_noise_deg)
        # Where the ground was met: the foot of the centre on the segment.
        ground = heights_at_chainage(self._ways.bare, owner % self._n, before["x_m"])
        off = (before["z_m"] - ground) * cosine
        error = np.hypot(errors.position_m, m.position_m)
        s = before["x_m"] + off * sine + error * self._rng.standard_normal(owner.size)
        # Nothing is put behind the start of a line.
        s = np.maximum(s, 0.0)
        z = before["z_m"] - off * cosine + error * self._rng.standard_normal(owner.size)
        rows = ImpactRows(owner, s, z, vt_in, vn_in, spin_in, vt_out, vn_out, spin_out, turn)
        approaching = vn_in < 0.0
        return ImpactRows(*(getattr(rows, f)[approaching] for f in ImpactRows.__slots__))


def dips_at(profiles: ProfileSet, profile: IntArray, s: FloatArray) -> FloatArray:
    """Dip of the segment of a profile at a chainage (rad), below zero downhill.

    Parameters
    ----------
    profiles : ProfileSet
    profile : int64, shape (n,)
    s : float64, shape (n,)
        Chainage (m).
    """
    k = _segments_at(profiles, profile, s)
    dips: FloatArray = np.arctan2(
        profiles.z[k + 1] - profiles.z[k], profiles.s[k + 1] - profiles.s[k]
    )
    return dips


def heights_at_chainage(profiles: ProfileSet, profile: IntArray, s: FloatArray) -> FloatArray:
    """Height of profiles at chainages (m); parameters as ``dips_at``."""
    k = _segments_at(profiles, profile, s)
    share = (np.asarray(s) - profiles.s[k]) / (profiles.s[k + 1] - profiles.s[k])
    heights: FloatArray = profiles.z[k] + share * (profiles.z[k + 1] - profiles.z[k])
    return heights


def _segments_at(profiles: ProfileSet, profile: IntArray, s: FloatArray) -> IntArray:
    # All profiles on one axis: each is shifted behind the one before.
    low = float(profiles.s.min()) - 1.0
    span = float(profiles.s.max()) - low + 1.0
    owner = np.repeat(np.arange(len(profiles)), np.diff(profiles.offset))
    axis = profiles.s - low + span * owner
    k = np.searchsorted(axis, np.asarray(s) - low + span * profile, side="right") - 1
    return np.clip(k, profiles.offset[profile], profiles.offset[profile + 1] - 2)
