"""The time at which rocks first enter a cell: closed forms, and event logs looked at one by one."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.statistics_table import default_bins
from sassgis.simulation.map_sums import MapSums

G = 9.81


def borders_ahead(profiles, start: float, end: float) -> np.ndarray:
    """Cell borders that lie between two chainages (m)."""
    s = profiles.cell_s
    return s[(s > start) & (s < end)]


def arrivals_at(profiles, out, borders: np.ndarray) -> np.ndarray:
    """Recorded times in the cells that begin at some borders."""
    cell = profiles.cell[np.searchsorted(profiles.cell_s, borders)]
    return out.sums["arrival_min"][np.searchsorted(out.cells, cell)]


# --- Closed forms --------------------------------------------------------------------------------


def test_a_flight_crosses_borders_at_even_speed():
    # A ball is thrown down a slope of 60° from 40 m above it: x is linear in time until it lands.
    beta, speed, x0 = math.radians(60.0), 5.0, 6.3
    profiles = lab.profile_set(lab.slope((200.0, 60.0)))
    ball = lab.sphere(drop_m=(40.0, 40.0), speed_mps=(speed, speed))
    out = lab.run(profiles, lab.ROCK, ball, start=x0, log_events=50)
    impact = out.event_logs[0][1]
    assert impact["phase"] == lab.IMPACT
    borders = borders_ahead(profiles, x0, impact["x_m"])
    assert borders.size >= 3
    want = (borders - x0) / (speed * math.cos(beta))
    assert arrivals_at(profiles, out, borders) == pytest.approx(want, rel=1e-12)
    assert out.sums["arrival_min"][3] == 0.0  # the cell of the release, [6, 8)


@pytest.mark.parametrize(
    ("speed", "mu"), [(0.0, 0.5), (4.0, 0.5), (4.0, math.tan(0.6)), (6.0, 1.2)]
)
def test_a_sliding_ball_crosses_borders_as_under_constant_acceleration(speed, mu):
    # From rest, pushed, at constant speed where friction balances the slope, and slowing to a stop.
    x0, beta = 5.5, 0.6
    profiles = lab.profile_set(lab.slope((60.0, math.degrees(beta))))
    ball = lab.sphere(speed_mps=(speed, speed))
    out = lab.run(profiles, lab.plain(mu_f=mu), ball, start=x0, log_events=50)
    pull = G * (math.sin(beta) - mu * math.cos(beta))
    furthest = min(out.rocks["furthest_m"][0], 59.0)
    borders = borders_ahead(profiles, x0, furthest)
    assert borders.size >= 2
    d = (borders - x0) / math.cos(beta)
    # d = v t + a t²/2; the smaller root, written so that a = 0 needs no case of its own.
    want = 2.0 * d / (speed + np.sqrt(speed**2 + 2.0 * pull * d))
    assert (out.event_logs[0][0]["phase"]) == lab.SLIDING
    assert arrivals_at(profiles, out, borders) == pytest.approx(want, rel=1e-9)


def test_a_rolling_ball_crosses_borders_as_under_constant_acceleration():
    x0, beta, mu = 5.5, 0.5, 0.3
    profiles = lab.profile_set(lab.slope((60.0, math.degrees(beta))))
    out = lab.run(profiles, lab.plain(mu_f=0.9, mu_0=mu), lab.sphere(), start=x0, log_events=9)
    assert out.event_logs[0][0]["phase"] == lab.ROLLING
    start = out.event_logs[0][0]["x_m"]
    borders = borders_ahead(profiles, start, 59.0)
    pull = G * (math.sin(beta) - mu * math.cos(beta))
    want = np.sqrt(2.0 * (borders - start) / math.cos(beta) / pull)
    assert borders.size > 20
    assert arrivals_at(profiles, out, borders) == pytest.approx(want, rel=1e-9)


# --- Event logs ----------------------------------------------------------------------------------


def entries(profiles, log) -> dict[int, float]:
    """First entry of a rock into each cell, from its event log: {cell: time (s)}."""
    s = profiles.cell_s
    found: dict[int, float] = {}

    def enter(x: float, t: float) -> None:
        k = int(np.clip(np.searchsorted(s, x, side="right") - 1, 0, s.size - 2))
        found.setdefault(int(profiles.cell[k]), t)

    for row, after in itertools.pairwise(log):
        t0, x0, vx = row["t_s"], row["x_m"], row["vx_mps"]
        dt = after["t_s"] - t0
        flies = row["phase"] == lab.FLIGHT
        # Setting a rock upright as it begins to roll moves its centre, in no time.
        x1 = x0 + vx * dt if flies or dt == 0.0 else after["x_m"]
        enter(x0, t0)
        ahead = borders_ahead(profiles, *sorted((x0, x1)))
        if x1 < x0:
            ahead = ahead[::-1]
        for border in ahead:
            share = (border - x0) / (x1 - x0)
            if not flies:
                # s = v t + a t²/2, with the acceleration that makes the stretch last as it did.
                speed = math.hypot(vx, row["vz_mps"])
                length = abs(x1 - x0) * math.hypot(1.0, row["uz"] / row["ux"])
                a = 2.0 * (length - speed * dt) / dt**2
                both = speed + math.sqrt(max(speed**2 + 2.0 * a * share * length, 0.0))
                share = 2.0 * share * length / both / dt
            enter(border + math.copysign(1e-9, x1 - x0), t0 + share * dt)
        enter(after["x_m"], after["t_s"])
    return found


@lab.on_both_lines
def test_times_are_those_of_the_event_logs(line):
    profiles = lab.profile_set(line)
    blocks = dataclasses.replace(lab.MIXED, drop_m=(0.5, 2.0))
    out = lab.run(profiles, lab.ROCK, blocks, n=60, start=(10.0, 30.0), log_events=4000)
    times: dict[int, list[float]] = {}
    for log in out.event_logs:
        for cell, t in entries(profiles, log).items():
            times.setdefault(cell, []).append(t)
    sums = MapSums(int(out.cells.max()) + 1)
    sums.add(out.cells, out.sums)
    assert sums.column("reach").tolist() == [len(times[cell]) for cell in sums.cells.tolist()]
    edges = default_bins().edges["arrival"]
    counts, earliest = sums.column("arrival"), sums.column("arrival_min")
    exact = 0
    for k, cell in enumerate(sums.cells.tolist()):
        own = np.sort(times[cell])
        same = np.array_equal(counts[k], np.histogram(own, edges)[0])
        # The log does not say how far a stretch on the ground came where the rock is set upright
        # at its end: it may be a little off for one rock.
        exact += same and abs(earliest[k] - own[0]) < 1e-9
    assert exact >= 0.95 * sums.cells.size > 30


# --- Spawned blocks ------------------------------------------------------------------------------


def test_fragments_arrive_as_long_after_the_release_as_the_rock_and_they_took():
    # Without a cone and a loss all fragments go on as the whole rock would have gone.
    x0, speed = 6.3, 12.0
    profiles = lab.profile_set(lab.slope((300.0, 35.0)))
    rock = lab.sphere(drop_m=(10.0, 10.0), speed_mps=(speed, speed))
    run = {"start": x0, "log_events": 50}
    flights = [e for e in lab.run(profiles, lab.ROCK, rock, **run).event_logs[0] if e["phase"] == 0]
    after = flights[1]
    effects = EffectSettings(
        Fragmentation("threshold", 1e-3, loss=0.0, cone_deg=0.0, smallest_m3=0.1)
    )
    out = lab.run(profiles, lab.ROCK, rock, effects=effects, **run)
    assert out.pieces.size == 5 and (out.pieces["start_m"] == after["x_m"]).all()
    assert out.rocks["time_s"][0] == after["t_s"] > 1.0
    before = borders_ahead(profiles, x0, after["x_m"])
    want = (before - x0) / flights[0]["vx_mps"]
    assert arrivals_at(profiles, out, before) == pytest.approx(want, rel=1e-9)
    # Smaller fragments fly on for a little longer than the whole rock.
    beyond = borders_ahead(profiles, after["x_m"], flights[2]["x_m"])
    assert beyond.size >= 2
    want = after["t_s"] + (beyond - after["x_m"]) / after["vx_mps"]
    assert arrivals_at(profiles, out, beyond) == pytest.approx(want, rel=1e-9)
    assert out.sums["reach"].max() == 1 and out.sums["arrival"].sum(axis=1).max() == 1


def test_a_rock_and_its_entrained_blocks_are_one_arrival_the_earliest():
    # An entrained block may overtake its rock, or go further.
    line = lab.rough(3, amplitude=0.1)
    profiles = lab.profile_set(line)
    effects = EffectSettings(Entrainment(number=1.0, size_ratio=0.9, share=1.0, classes=()))
    run = {"start": (3.0, 20.0), "n": 1, "seed": 4}
    ahead = 0
    for rock in range(15):
        own = lab.run(profiles, lab.ROCK, lab.MIXED, first_rock=rock, **run).sums
        both = lab.run(profiles, lab.ROCK, lab.MIXED, first_rock=rock, effects=effects, **run)
        reached = own["reach"] == 1
        # The rock itself moves as without the effect.
        assert (both.sums["arrival_min"][reached] <= own["arrival_min"][reached]).all()
        assert both.sums["reach"].max() <= 1
        more = (both.sums["reach"] == 1) & ~reached
        ends = both.rocks["time_s"][0] + both.pieces["time_s"].sum()
        assert (both.sums["arrival_min"][more] > 0.0).all()
        assert (both.sums["arrival_min"][more] <= ends).all()
        ahead += int(more.sum())
        ahead += int((both.sums["arrival_min"] < own["arrival_min"])[reached].sum())
    assert ahead > 5
