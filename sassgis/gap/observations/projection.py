"""Observed points on fall lines, and the hops between contacts.

A rock moves in space, the model in the plane of its fall line. What was observed is put into that
plane by the nearest point of the fall line that starts at the rock's release point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.gap.constants import GRAVITY_MPS2, LINE_DIRECTION_M, LINE_END_M, SPEED_OVER_S
from sassgis.gap.observations.observed import ObservationFinding, Observations, rock_radii_m
from sassgis.gap.observations.tables import POINT_TABLES, Passages, Stations
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.results import ReleasePoints, TraceSet
from sassgis.terrain.cells import heights_at
from sassgis.terrain.flatten import chainage_to_xy, crossings, xy_to_chainage
from sassgis.terrain.release import point_keys


@dataclass(frozen=True, slots=True)
class Projected:
    """Points in the plane of fall lines, one per point that was given; arrays of shape (n,)."""

    line: IntArray  # fall line; -1 where the point has none, and all else is NaN
    s: FloatArray  # chainage of the nearest point of the line (m)
    lateral_m: FloatArray  # distance from it, positive to the right looking downhill
    height_m: FloatArray  # above the ground under the point itself; NaN without a height
    ground_m: FloatArray  # height of the ground under the point
    #: 1: the line ends before it comes abreast of the point, so that the run-out is at least ``s``;
    #: -1: the point lies behind the start; 0: abreast of the line.
    beyond: NDArray[np.int8]


def observed_release_points(observations: Observations) -> tuple[ReleasePoints, IntArray]:
    """Return the release points of rocks that have one, and the place of each in ``rock_names``.

    Each rock is a separate area, named after it: its random draws do not depend on which other
    rocks were observed.
    """
    x, y = (observations.of_rocks(v) for v in (observations.rocks.x, observations.rocks.y))
    rock = np.flatnonzero(np.isfinite(x + y))
    every = observations.rock_names
    names = tuple(every[i] for i in rock.tolist())
    key = np.concatenate([np.empty(0, np.uint64), *(point_keys(name, 1) for name in names)])
    return ReleasePoints(x[rock], y[rock], np.arange(rock.size), key, names), rock


def nearest_lines(traces: TraceSet, x: FloatArray, y: FloatArray) -> IntArray:
    """Find the line nearest to each point (m), (n,), the first of equals; -1 for none."""
    lines = np.full(np.size(x), -1, np.int64)
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not len(traces) or not known.size:
        return lines
    shapes = []
    for i in range(len(traces)):
        own = slice(int(traces.offset[i]), int(traces.offset[i + 1]))
        points = np.column_stack([traces.x[own], traces.y[own]])
        shapes.append(shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0]))
    tree = shapely.STRtree(shapes)
    point, line = tree.query_nearest(shapely.points(x[known], y[known]), all_matches=True)
    first = np.full(known.size, len(traces), np.int64)
    np.minimum.at(first, point, line)
    lines[known] = first
    return lines


def project(
    traces: TraceSet,
    line: IntArray,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray | None = None,
    *,
    grid: Grid | None = None,
    prolonged: bool = False,
) -> Projected:
    """Put points into the planes of fall lines.

    ``line``: that of each point, -1 for none; ``x``, ``y``, ``z``: coordinates (m), NaN where
    missing, shape (n,). ``grid``: the ground under the points, to which heights refer: next to the
    line it has another height than on it. ``prolonged``: whether lines go straight on beyond their
    end.
    """
    x, y, line = np.asarray(x), np.asarray(y), np.asarray(line)
    n = x.size
    s, lateral, ground = np.full((3, n), np.nan)
    known = np.flatnonzero((line >= 0) & np.isfinite(x) & np.isfinite(y))
    lines = np.full(n, -1, np.int64)
    lines[known] = line[known]
    beyond = np.zeros(n, np.int8)
    if known.size:
        own, px, py = lines[known], x[known], y[known]
        if grid is not None:
            ground[known] = heights_at(grid, px, py)
        s[known], lateral[known] = xy_to_chainage(traces, own, px, py)
        beyond[known] = _beyond(traces, own, px, py, s[known])
        if prolonged:
            past = np.flatnonzero(beyond == 1)
            s[past], lateral[past] = _past_the_end(traces, lines[past], x[past], y[past])
    height = np.full(n, np.nan) if z is None else np.asarray(z, np.float64) - ground
    return Projected(lines, s, lateral, height, ground, beyond)


def _past_the_end(
    traces: TraceSet, line: IntArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the chainage and lateral offset of points beyond the ends of their lines (m)."""
    last = traces.offset[line + 1] - 1
    first_s = traces.s[traces.offset[line]]
    lx, ly, ls = traces.x[last], traces.y[last], traces.s[last]
    from_x, from_y = chainage_to_xy(traces, line, np.maximum(ls - LINE_DIRECTION_M, first_s))
    size = np.maximum(np.hypot(lx - from_x, ly - from_y), LINE_END_M)
    east, north = (lx - from_x) / size, (ly - from_y) / size
    ahead, aside = x - lx, y - ly
    return ls + ahead * east + aside * north, ahead * north - aside * east


def _beyond(
    traces: TraceSet, line: IntArray, x: FloatArray, y: FloatArray, s: FloatArray
) -> NDArray[np.int8]:
    """Project points beyond the ends of their lines along the last and first segment."""
    first, last = traces.offset[line], traces.offset[line + 1] - 1
    second, before = np.minimum(first + 1, last), np.maximum(last - 1, first)
    lx, ly, ls = traces.x, traces.y, traces.s
    ahead = (x - lx[last]) * (lx[last] - lx[before]) + (y - ly[last]) * (ly[last] - ly[before])
    behind = (x - lx[first]) * (lx[second] - lx[first]) + (y - ly[first]) * (ly[second] - ly[first])
    result = np.zeros(x.size, np.int8)
    result[(s >= ls[last] - LINE_END_M) & (ahead > LINE_END_M)] = 1
    result[(s <= ls[first] + LINE_END_M) & (behind < -LINE_END_M)] = -1
    return result


def project_observations(
    observations: Observations,
    traces: TraceSet,
    line_of_rock: IntArray,
    *,
    grid: Grid,
    prolonged: bool = False,
) -> dict[str, Projected]:
    """Put all observed points into the planes of their rocks' fall lines, by table, row by row.

    Points that belong to no rock with a line are put on the nearest line. ``line_of_rock``: -1 for
    a rock without one, shape (len(observations.rock_names),).
    """
    found = {}
    lookup = np.append(line_of_rock, -1)
    for name in POINT_TABLES:
        points = observations.tables[name].numbers
        line = lookup[observations.rock_of(name)]
        loose = np.flatnonzero(line < 0)
        line[loose] = nearest_lines(traces, points["x"][loose], points["y"][loose])
        found[name] = project(
            traces, line, points["x"], points["y"], points["z"], grid=grid, prolonged=prolonged
        )
    return found


def station_chainages(
    traces: TraceSet, stations: Stations, *, prolong_m: float = 0.0
) -> FloatArray:
    """Find where each fall line first crosses each station (m), (n_lines, n_stations); or NaN.

    Stations are prolonged by ``prolong_m``: a line may pass just next to what every rock crossed.
    """
    s = np.full((len(traces), len(stations)), np.nan)
    for j, vertices in enumerate(stations.vertices):
        if vertices.shape[0] < 2:
            continue
        line, chainage = crossings(traces, prolonged(vertices, prolong_m))
        # Crossings of a line come by rising chainage: written backwards, the first one stays.
        s[line[::-1], j] = chainage[::-1]
    return s


def prolonged(vertices: FloatArray, by_m: float) -> FloatArray:
    """Return a line prolonged straight on at both ends."""
    if by_m <= 0.0:
        return vertices
    steps = np.diff(vertices, axis=0)
    steps = steps / np.hypot(steps[:, 0], steps[:, 1])[:, None]
    return np.vstack(
        [vertices[0] - by_m * steps[0], vertices[1:-1], vertices[-1] + by_m * steps[-1]]
    )


@dataclass(frozen=True, slots=True)
class ContactRows:
    """Contacts of whole rocks by rock and time, columns of shape (n,); NaN where not measured."""

    rock: IntArray
    start_s: FloatArray
    end_s: FloatArray
    # Centre of the rock in the middle of the contact (m).
    x: FloatArray
    y: FloatArray
    z: FloatArray
    rotation_before_hz: FloatArray
    rotation_after_hz: FloatArray

    @property
    def middle_s(self) -> FloatArray:
        """Time at which the rock is where the contact is (s); its start without an end."""
        return np.where(np.isfinite(self.end_s), 0.5 * (self.start_s + self.end_s), self.start_s)


@dataclass(frozen=True, slots=True)
class Hops:
    """Motion from each contact to the next one of its rock, columns of shape (n,)."""

    first: IntArray  # row of the contact from which it goes to the next row
    rock: IntArray
    time_s: FloatArray  # from the end of one contact to the start of the next
    between_s: FloatArray  # from the middle of one contact to that of the next
    length_m: FloatArray  # of the chord between the two places
    drop_m: FloatArray  # of the chord
    speed_mps: FloatArray  # mean: the chord over the time between the middles
    height_m: FloatArray  # greatest height above the chord: g T² / 8
    rotation_hz: FloatArray


@dataclass(frozen=True, slots=True)
class _Ways:
    """Ways of rocks through the contacts of which the place is known, columns of shape (n,)."""

    row: IntArray  # of the contacts
    rock: IntArray
    #: Positions here of the first and the last contact of the rock.
    first: IntArray
    last: IntArray
    clock_s: FloatArray  # time; that of a rock goes on from that of the one before
    way_m: FloatArray  # along the chords, likewise
    level_m: FloatArray  # in plan, likewise
    z: FloatArray

    def over_a_second(self, i: IntArray, clock_s: FloatArray, values: FloatArray) -> FloatArray:
        """Return changes of ``values`` over the second around a time; NaN on shorter ways."""
        low, high = self.clock_s[self.first[i]], self.clock_s[self.last[i]]
        start = np.clip(clock_s - 0.5 * SPEED_OVER_S, low, high - SPEED_OVER_S)
        before, after = (
            np.interp(at, self.clock_s, values) for at in (start, start + SPEED_OVER_S)
        )
        return np.where(high - low >= SPEED_OVER_S, after - before, np.nan)


def contact_order(observations: Observations) -> IntArray:
    """Return rows of the table of contacts, those of whole rocks in the order of rock and time."""
    rock = observations.whole_of("contacts")
    order = np.lexsort((observations.contacts.t_start_s, rock))
    return order[rock[order] >= 0]


def contacts_of(observations: Observations) -> ContactRows:
    """Return observed contacts of whole rocks, by their place in ``observations.rock_names``."""
    table, order = observations.contacts, contact_order(observations)
    columns = (
        observations.rock_of("contacts"), table.t_start_s, table.t_end_s, table.x, table.y, table.z,
        table.rotation_before_hz, table.rotation_after_hz,
    )  # fmt: skip
    return ContactRows(*(values[order] for values in columns))  # type: ignore[arg-type]


def hops_of(contacts: ContactRows) -> Hops:
    """Return the hops between contacts that follow each other.

    A contact without a place ends a hop and begins the next one all the same: only their chords are
    NaN.
    """
    i = np.flatnonzero(contacts.rock[:-1] == contacts.rock[1:])
    j = i + 1
    dx, dy, dz = (v[j] - v[i] for v in (contacts.x, contacts.y, contacts.z))
    time, middle = contacts.start_s[j] - contacts.end_s[i], contacts.middle_s
    between = middle[j] - middle[i]
    length = np.sqrt(dx**2 + dy**2 + dz**2)
    speed = np.divide(length, between, out=np.full(i.size, np.nan), where=between > 0.0)
    # Nothing turns a rock in the air: both are the same spin.
    spins = contacts.rotation_after_hz[i], contacts.rotation_before_hz[j]
    rotation = 0.5 * (np.fmax(*spins) + np.fmin(*spins))
    return Hops(
        first=i, rock=contacts.rock[i], time_s=time, between_s=between, length_m=length, drop_m=-dz,
        speed_mps=speed, height_m=GRAVITY_MPS2 * time**2 / 8.0, rotation_hz=rotation,
    )  # fmt: skip


def contact_numbers(contacts: ContactRows, radius_m: FloatArray) -> dict[str, FloatArray]:
    """Return numbers of each rock from its contacts, shape (n_rocks,); NaN of rocks without any.

    ``contacts``: their number; ``fastest_second``: greatest speed over a second (m/s);
    ``between_contacts``: median time from the middle of one to that of the next (s); ``hop_length``
    and ``hop_height`` (m): median, and 90 % quantile with ``_90``; ``rim_ratio``: median of spin
    times radius over speed.
    """
    n = radius_m.size
    hops, ways = hops_of(contacts), _ways_of(contacts)
    number = np.bincount(contacts.rock, minlength=n).astype(np.float64)
    # On a way of straight segments the fastest second begins or ends at a contact.
    i = np.tile(np.arange(ways.row.size), 2)
    clock = ways.clock_s[i] + np.repeat([-0.5, 0.5], ways.row.size) * SPEED_OVER_S
    speed = ways.over_a_second(i, clock, ways.way_m) / SPEED_OVER_S
    with np.errstate(invalid="ignore", divide="ignore"):
        rim = 2.0 * math.pi * hops.rotation_hz * radius_m[hops.rock] / hops.speed_mps
    rim[hops.speed_mps == 0.0] = np.nan
    of_hops = {
        "between_contacts": (hops.between_s, 0.5),
        "hop_length": (hops.length_m, 0.5),
        "hop_length_90": (hops.length_m, 0.9),
        "hop_height": (hops.height_m, 0.5),
        "hop_height_90": (hops.height_m, 0.9),
        "rim_ratio": (rim, 0.5),
    }
    return {
        "contacts": np.where(number > 0.0, number, np.nan),
        "fastest_second": _quantile(ways.rock[i], speed, 1.0, n),
        **{name: _quantile(hops.rock, v, share, n) for name, (v, share) in of_hops.items()},
    }


def passages_of(observations: Observations) -> Passages:
    """Return passages of whole rocks at the stations, from their contacts.

    Where the way between two contacts first crosses a station: speed of the centre over the second
    around; spin of the hop; and height, that of the centre of a rock that rests on the slope of
    this way, and ½ g t (T - t) at the time t of a hop that takes T.
    """
    contacts, names = contacts_of(observations), np.array(observations.rock_names)
    hops, ways = hops_of(contacts), _ways_of(contacts)
    if not ways.row.size:
        return Passages.of()
    hop_at = dict(zip(hops.first.tolist(), range(hops.first.size), strict=True))
    starts = np.flatnonzero(ways.first == np.arange(ways.row.size))
    x, y = contacts.x[ways.row], contacts.y[ways.row]
    none = np.zeros(starts.size)
    traces = TraceSet(
        np.append(starts, ways.row.size), x, y, ways.level_m - ways.level_m[ways.first],
        none.astype(np.int64), none.astype(np.uint8),
    )  # fmt: skip
    stations = observations.stations
    at, station, share = [], [], []
    for name, line in zip(stations.station.tolist(), stations.vertices, strict=True):
        if len(line) < 2:
            continue
        trace, s = crossings(traces, line)
        for k in np.unique(trace, return_index=True)[1].tolist():
            low, high = starts[trace[k]], ways.last[starts[trace[k]]]
            i = low + int(np.searchsorted(traces.s[low + 1 : high], s[k], side="right"))
            at.append(i)
            share.append((s[k] - traces.s[i]) / max(traces.s[i + 1] - traces.s[i], 1e-9))
            station.append(name)
    i, part = np.array(at, np.int64), np.array(share, np.float64)
    # In the air the way in plan is covered evenly.
    x, y, z, clock = (v[i] + part * (v[i + 1] - v[i]) for v in (x, y, ways.z, ways.clock_s))
    way, fall = (ways.over_a_second(i, clock, v) for v in (ways.way_m, -ways.z))
    # Between contacts of which one has no place it is not known which hop it is.
    hop = np.array([hop_at.get(row, -1) for row in ways.row[i].tolist()], np.int64)
    hop[ways.row[i + 1] != ways.row[i] + 1] = -1
    time, rotation = (np.append(v, np.nan)[hop] for v in (hops.time_s, hops.rotation_hz))
    above = 0.5 * GRAVITY_MPS2 * time**2 * part * (1.0 - part)
    radius = rock_radii_m(observations)[ways.rock[i]]
    with np.errstate(invalid="ignore", divide="ignore"):
        rest = radius / np.sqrt(1.0 - (fall / way) ** 2)
    return Passages.of(
        rock_id=names[ways.rock[i]], station=station, x=x, y=y, z=z + above,
        speed_mps=way / SPEED_OVER_S, rotation_hz=rotation, height_m=rest + above,
    )  # fmt: skip


def with_passages(observations: Observations) -> Observations:
    """Add passages from contacts to observations that have contacts and stations but none."""
    seen = observations
    if len(seen.passages) or not len(seen.contacts) or not len(seen.stations):
        return seen
    made = passages_of(seen)
    if not len(made):
        return seen
    rocks, stations = (np.unique(v).size for v in (made.rock_id, made.station))
    notice = ObservationFinding(
        "warning",
        f"no passages were observed: those of {rocks} rocks at {stations} stations are computed "
        "from contacts",
        str(seen.files.get("contacts", "")),
        "contacts",
    )
    return replace(seen, passages=made, findings=(*seen.findings, notice))


def _ways_of(contacts: ContactRows) -> _Ways:
    """Return the ways through all places that are known."""
    row = np.flatnonzero(np.isfinite(contacts.x + contacts.y))
    rock, middle = contacts.rock[row], contacts.middle_s[row]
    x, y, z = contacts.x[row], contacts.y[row], contacts.z[row]
    i = np.arange(row.size)
    new = np.diff(rock, prepend=-1) != 0
    first = np.maximum.accumulate(np.where(new, i, 0))
    last = np.append(np.flatnonzero(new), row.size)[np.cumsum(new)] - 1
    level = np.hypot(np.diff(x, prepend=0.0), np.diff(y, prepend=0.0))
    # Without heights the way in plan.
    length = np.hypot(level, np.nan_to_num(np.diff(z, prepend=0.0)))
    steps = ((np.diff(middle, prepend=0.0), SPEED_OVER_S), (length, 0.0), (level, 0.0))
    clock, way, level = (np.cumsum(np.where(new, other, own)) for own, other in steps)
    return _Ways(
        row=row, rock=rock, first=first, last=last, clock_s=clock, way_m=way, level_m=level, z=z,
    )  # fmt: skip


def _quantile(rock: IntArray, values: FloatArray, share: float, n_rocks: int) -> FloatArray:
    """Return the quantile of the values of each rock, shape (n_rocks,); NaN where it has none."""
    known = np.isfinite(values)
    rock, values = rock[known], values[known]
    values = values[np.lexsort((values, rock))]
    count = np.bincount(rock, minlength=n_rocks)
    place = (np.cumsum(count) - count) + share * np.maximum(count - 1, 0)
    found = np.full(n_rocks, np.nan)
    has = count > 0
    found[has] = np.interp(place[has], np.arange(values.size), values)
    return found
