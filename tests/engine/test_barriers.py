"""Stations, walls and nets against the course of events."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.ellipse import inertia
from sassgis.settings.results import ControlLine, ControlLineCrossings, Outcome, StopReason

G = 9.81


def past(line, lines, at, *, on=lab.ROCK, blocks=lab.MIXED, n=300, start=(10.0, 30.0), **more):
    """Blocks that meet control lines at some chainages on their way down."""
    crossings = ControlLineCrossings.same_for_all(lines, at, 1)
    return lab.run(line, on, blocks, n=n, start=start, control_lines=crossings, **more)


def at_chainage(log, x_control_line):
    """State in flight in which a block first comes to a chainage downhill, from its events alone.

    Returns (vx, vz, |omega|, z); None where it does not, or on the ground.
    """
    for i in range(log.shape[0] - 1):
        row, after = log[i], log[i + 1]
        x, vx = row["x_m"], row["vx_mps"]
        phase = int(row["phase"])
        if phase == lab.IMPACT or vx <= 0.0:
            continue
        dt = after["t_s"] - row["t_s"]
        if phase == lab.FLIGHT:
            t = (x_control_line - x) / vx
            if 0.0 < t <= dt * (1 + 1e-12):
                return (
                    vx,
                    row["vz_mps"] - G * t,
                    abs(row["omega_radps"]),
                    row["z_m"] + row["vz_mps"] * t - 0.5 * G * t * t,
                )
        elif x < x_control_line <= after["x_m"]:
            return None
    return None


@pytest.mark.parametrize(
    ("kind", "at"), [("smooth", [62.0, 75.3, 90.0]), ("rough", [35.1, 47.3, 60.0])]
)
def test_station_values_are_those_of_the_parabola(kind, at):
    line = lab.LINES[kind]
    lines = [ControlLine(f"station {i}", "station") for i in range(3)]
    out = past(line, lines, at, n=150, log_events=2000)
    checked = 0
    slope = np.diff(line[1]) / np.diff(line[0])
    for p in out.passages:
        rock = out.rocks[p["rock"]]
        got = at_chainage(out.event_logs[p["rock"]], p["chainage_m"])
        assert p["outcome"] == Outcome.PASSED
        assert p["chainage_m"] == at[p["control_line"]]
        assert p["mass_kg"] == rock["mass_kg"]
        if got is None:
            continue
        vx, vz, w, z = got
        size = 1.0 + math.hypot(vx, vz)
        assert p["vx_mps"] == pytest.approx(vx, abs=1e-9 * size)
        assert p["vz_mps"] == pytest.approx(vz, abs=1e-6 * size)
        assert p["speed_mps"] == pytest.approx(math.hypot(vx, vz), abs=1e-6 * size)
        assert p["rotation_hz"] == pytest.approx(w / (2 * math.pi), abs=1e-9)
        i = inertia(rock["a_m"], rock["b_m"])
        m = rock["mass_kg"]
        assert p["energy_trans_kj"] == pytest.approx(0.5e-3 * m * (vx**2 + vz**2), rel=1e-5)
        assert p["energy_rot_kj"] == pytest.approx(0.5e-3 * m * i * w * w, rel=1e-9, abs=1e-12)
        # Vertical, ground to centre, less the resting height b / cos β of the ground there.
        j = int(np.searchsorted(line[0], p["chainage_m"], side="left")) - 1
        ground = np.interp(p["chainage_m"], *line)
        want = max(z - ground - rock["b_m"] * math.hypot(1.0, slope[j]), 0.0)
        assert p["height_m"] == pytest.approx(want, abs=1e-6), (p["rock"], p["control_line"])
        checked += 1
    assert checked > 60


@lab.on_both_lines
@pytest.mark.parametrize("at", [80.0, 81.37, 60.0], ids=["vertex or not", "between", "vertex"])
def test_every_rock_that_passes_is_registered_once(line, at):
    lines = [ControlLine("wall of no height", "wall", 0.0), ControlLine("station", "station")]
    out = past(line, lines, [at, at], n=400, blocks=dataclasses.replace(lab.MIXED, drop_m=(0, 2)))
    beyond = set(out.rocks["rock"][out.rocks["furthest_m"] > at])
    for control_line in (0, 1):
        seen = out.passages["rock"][out.passages["control_line"] == control_line]
        assert np.unique(seen).size == seen.size
        assert set(seen) == beyond
    assert len(beyond) > 40


@lab.on_both_lines
def test_a_station_that_a_line_crosses_twice_is_passed_once(line):
    station = (ControlLine("hairpin", "station"),)
    twice = ControlLineCrossings(
        station, np.array([0, 2]), np.array([60.0, 81.37]), np.zeros(2, np.int64)
    )
    out = lab.run(line, lab.ROCK, lab.MIXED, n=300, start=(10.0, 30.0), control_lines=twice)
    assert set(out.passages["rock"]) == set(out.rocks["rock"][out.rocks["furthest_m"] > 60.0])
    assert np.unique(out.passages["rock"]).size == out.passages.size > 40
    assert (out.passages["chainage_m"] == 60.0).all()


def test_a_wall_of_no_height_stops_none():
    line = lab.valley()
    lines = [ControlLine("none", "wall", 0.0), ControlLine("s", "station")]
    plain = lab.run(line, lab.ROCK, lab.MIXED, n=300, start=(10.0, 45.0)).rocks
    wall = past(line, lines, [90.0, 120.0], start=(10.0, 45.0))
    for name in plain.dtype.names:
        assert np.array_equal(plain[name], wall.rocks[name]), name


@lab.on_both_lines
@pytest.mark.parametrize("barrier", ["wall", "net"])
@pytest.mark.parametrize("at", [80.0, 81.37, 60.0])
def test_a_barrier_higher_than_any_bounce_stops_all(line, barrier, at):
    high = ControlLine("high", barrier, 500.0, restarts_from_rest=barrier == "net")
    out = past(line, [high], [at])
    free = lab.run(line, lab.ROCK, lab.MIXED, n=300, start=(10.0, 30.0)).rocks
    arrives = set(free["rock"][free["furthest_m"] > at])
    assert set(out.passages["rock"]) == arrives
    assert out.passages.size == len(arrives)
    if barrier == "wall":
        assert (out.passages["outcome"] == Outcome.STOPPED).all()
        stopped = np.isin(out.rocks["rock"], list(arrives))
        assert (out.rocks["reason"][stopped] == StopReason.BARRIER).all()
        assert (out.rocks["runout_m"][stopped] == at).all()
        assert (out.rocks["furthest_m"] <= at).all()
    else:
        assert (out.passages["outcome"] == Outcome.HELD_BY_NET).all()


@pytest.mark.parametrize("at", [80.0, 60.0], ids=["border of cells", "border and vertex"])
def test_rocks_stopped_on_a_cell_border_count_before_it(at):
    # Cells are 2 m: what a wall on the border stops has not come to the cell behind it.
    out = past(lab.valley(), [ControlLine("high", "wall", 500.0)], [at], n=100)
    assert (out.sums["stops"] <= out.sums["reach"]).all()
    assert (out.sums["reach"][int(at / 2.0) :] == 0).all()
    assert (out.sums["stops"][int(at / 2.0) :] == 0).all()


def test_a_net_takes_all_speed_and_the_rock_goes_on_from_there():
    line = lab.slope((80.0, 40.0), (60.0, 45.0), (100.0, 0.0))
    net = ControlLine("net", "net", 50.0, restarts_from_rest=True)
    blocks = dataclasses.replace(lab.MIXED, drop_m=(1.0, 3.0))
    out = past(line, [net], [90.0], blocks=blocks, n=100, log_events=3000)
    held = out.passages["rock"][out.passages["outcome"] == Outcome.HELD_BY_NET]
    assert held.size > 30
    for rock in held:
        log = out.event_logs[rock]
        at_net = log[log["x_m"] == 90.0][0]
        assert [at_net[k] for k in ("vx_mps", "vz_mps", "omega_radps")] == [0.0, 0.0, 0.0]
    # Steeper than friction below the net: it moves on.
    on = out.rocks["furthest_m"][held]
    assert (on > 90.5).mean() > 0.5


@pytest.mark.parametrize("barrier", ["wall", "net"])
def test_what_is_left_after_a_breakthrough(barrier):
    # A rock with more energy than the capacity goes through with what is left.
    limit = 60.0
    lines = [
        ControlLine("fence", barrier, 100.0, limit, barrier == "net"),
        ControlLine("behind", "station"),
    ]
    at = [85.0, 85.0 + 1e-7]
    out = past(lab.valley(), lines, at, n=400, start=(10.0, 45.0), log_events=2000)
    p = out.passages
    energy = p["energy_trans_kj"] + p["energy_rot_kj"]
    first = p["control_line"] == 0
    through = p["outcome"] == Outcome.BROKE_THROUGH
    assert through.sum() > 20
    assert (energy[first & through] > limit).all()
    rest = first & ~through
    assert rest.sum() > 20
    assert (energy[rest] <= limit).all()
    behind = {r: e for r, e, g in zip(p["rock"], energy, p["control_line"], strict=True) if g == 1}
    for r, e in zip(p["rock"][first & through], energy[first & through], strict=True):
        assert behind[r] == pytest.approx(e - limit, rel=1e-5, abs=1e-4)
    if barrier == "wall":
        assert set(behind) == set(p["rock"][through])


def test_what_is_left_comes_to_all_lines_at_one_place_in_their_order():
    net = ControlLine("net", "net", 100.0, 60.0)
    lines = [net, ControlLine("s", "station"), net, ControlLine("high", "wall", 50.0), net]
    run = {"n": 100, "start": (10.0, 45.0)}
    out = past(lab.valley(), lines, [85.0] * 5, **run)
    p = out.passages
    energy = p["energy_trans_kj"] + p["energy_rot_kj"]
    rocks = np.unique(p["rock"])
    kinds = set()
    for rock in rocks:
        own = p["rock"] == rock
        had = dict(zip(p["control_line"][own].tolist(), energy[own], strict=True))
        left = np.maximum(had[0] - 60.0, 0.0), np.maximum(had[0] - 120.0, 0.0)
        want = {0: had[0], 1: left[0]}
        if left[0] > 0.0:
            want[2] = left[0]
        if left[1] > 0.0:
            want[3] = left[1]
        assert had == pytest.approx(want, rel=1e-9, abs=1e-9)
        kinds.add(len(had))
    assert kinds == {2, 3, 4}
    # None comes through the wall.
    assert (out.rocks["reason"][rocks] == StopReason.BARRIER).all()
    assert (out.rocks["furthest_m"] <= 85.0).all()


def test_a_wall_at_a_net_holds_what_the_net_lets_go():
    lines = [
        ControlLine("net", "net", 100.0, restarts_from_rest=True),
        ControlLine("high", "wall", 50.0),
    ]
    for at in ([85.0, 85.0], [85.0, 85.0 + 1e-7]):
        out = past(lab.valley(), lines, at, n=60, start=(10.0, 45.0))
        arrived = np.unique(out.passages["rock"])
        assert arrived.size > 20 and (out.rocks["furthest_m"] <= at[1]).all()
        assert (out.rocks["reason"][arrived] == StopReason.BARRIER).all()


@pytest.mark.parametrize("height", [0.3, 1.0, 3.0])
def test_a_rock_goes_over_only_if_its_lowest_point_is_above_the_top(height):
    line = lab.valley()
    at = 85.0
    wall = ControlLine("wall", "wall", height)
    out = past(line, [wall], [at], n=400, start=(10.0, 45.0), log_events=2000)
    top = np.interp(at, *line) + height
    seen = {int(o): 0 for o in Outcome}
    for p in out.passages:
        rock = out.rocks[p["rock"]]
        log = out.event_logs[p["rock"]]
        for i in range(log.shape[0] - 1):
            row = log[i]
            if row["phase"] == lab.FLIGHT and row["vx_mps"] > 0:
                t = (at - row["x_m"]) / row["vx_mps"]
                dt = log["t_s"][i + 1] - row["t_s"]
                if 0.0 < t <= dt * (1 + 1e-9) + 1e-12:
                    z = row["z_m"] + row["vz_mps"] * t - 0.5 * G * t * t
                    angle = row["theta_rad"] - row["omega_radps"] * t
                    low = z - math.hypot(
                        rock["a_m"] * math.sin(angle), rock["b_m"] * math.cos(angle)
                    )
                    if abs(low - top) > 1e-6:
                        want = Outcome.OVERTOPPED if low > top else Outcome.STOPPED
                        assert p["outcome"] == want
                        seen[int(want)] += 1
                    break
    assert seen[Outcome.STOPPED] > 10
    if height <= 1.0:
        assert seen[Outcome.OVERTOPPED] > 10


def test_no_rock_gets_past_a_full_wall_from_behind():
    # Rocks that run up the far side of a valley and come back meet the wall from behind.
    line = lab.slope((60.0, 45.0), (10.0, 0.0), (60.0, -35.0))
    ball = lab.sphere(0.5, drop_m=(2.0, 2.0), speed_mps=(5.0, 5.0))
    ground = lab.plain(eta_max=0.95, mu_f=0.3, mu_0=0.1)
    free = lab.run(line, ground, ball, n=100, start=(5.0, 20.0)).rocks
    back = free["furthest_m"] - free["runout_m"]
    assert (back > 3.0).sum() > 50
    run = {"on": ground, "blocks": ball, "n": 100, "start": (5.0, 20.0)}
    for barrier in ("wall", "net"):
        out = past(line, [ControlLine("low", barrier, 2.0, 1.0)], [82.0], **run).rocks
        assert np.isfinite(out["runout_m"]).all()
    # A wall that lets rocks through uphill because its capacity is small, and one that does not.
    stop = past(line, [ControlLine("w", "wall", 1e3)], [75.0], **run).rocks
    assert (stop["furthest_m"] <= 75.0).all()


def test_rolling_and_sliding_rocks_are_registered_too():
    line = lab.slope(*[(2.0, 20.0)] * 40)
    for blocks in (
        lab.sphere(0.5, speed_mps=(20.0, 20.0), spin_radps=(40.0, 40.0)),
        lab.ellipsoid(speed_mps=(20.0, 20.0)),
    ):
        lines = [ControlLine(f"s{i}", "station") for i in range(3)]
        own = {"on": lab.plain(eta_max=1.0), "blocks": blocks, "n": 20, "start": (5.0, 7.0)}
        out = past(line, lines, [20.0, 20.7, 22.0], **own)
        assert out.passages.size == 60
        mu = 0.5 if blocks.spin_radps[1] > 0 else 0.8
        beta = math.radians(20.0)
        pull = G * (math.sin(beta) - mu * math.cos(beta))
        start = out.rocks["start_m"][out.passages["rock"]]
        way = (out.passages["chainage_m"] - start) / math.cos(beta)
        assert np.allclose(out.passages["speed_mps"], np.sqrt(400.0 + 2 * pull * way), rtol=1e-9)
        assert (out.passages["height_m"] == 0.0).all()


def test_same_control_lines_on_all_lines_are_sorted_by_chainage():
    control_lines = (ControlLine("far", "station"), ControlLine("near", "station"))
    same = ControlLineCrossings.same_for_all(control_lines, [50.0, 20.0], 2)
    assert same.chainage.tolist() == [20.0, 50.0, 20.0, 50.0]
    assert same.control_line.tolist() == [1, 0, 1, 0]
    assert same.offset.tolist() == [0, 2, 4]
