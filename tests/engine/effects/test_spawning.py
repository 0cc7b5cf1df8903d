"""Breaking and blocks set in motion: mass, energy, numbers, and how they count."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import engine_lab as lab
from scipy import stats

from sassgis.engine.draws import block_of
from sassgis.engine.effects import fragmentation
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.hooks import BLOCK_DTYPE, prepare
from sassgis.engine.ellipse import empty_table, inertia
from sassgis.engine.state import SPAWNED_DTYPE
from sassgis.errors import InputError
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.results import ControlLine, ControlLineCrossings

FLAT = lab.slope((100.0, 0.0))
ROUGH = lab.rough_slope(6)
TALUS = GroundTable((lab.ground("talus"),))


def breaking(*args, **settings):
    return EffectSettings(Fragmentation(*args, **settings))


def as_read(settings):
    """Fragmentation as the kernel reads it."""
    effects = prepare(EffectSettings(settings), False)
    assert effects is not None
    return effects


def broken(effects, block, number, vx, vz, theta, omega):
    """Fragments of a block that breaks at (5, 80)."""
    state = np.zeros(1, BLOCK_DTYPE)[0]
    state.x, state.z, state.vx, state.vz, state.theta, state.omega = 5.0, 80.0, vx, vz, theta, omega
    spawned = empty_table(1000, SPAWNED_DTYPE)
    assert fragmentation.break_up(effects.breaking, spawned, block, number, state)
    return spawned.rows[: spawned.n[0]]


def ended(out):
    """Rocks and pieces that have not broken."""
    rows = np.concatenate([out.rocks, out.pieces])
    return rows[rows["reason"] != lab.BROKEN]


BREAKABLE = [
    Fragmentation(energy_jkg=20.0, survival_rate=0.2),
    Fragmentation(energy_jkg=20.0, survival_rate=0.0, fractal_dimension=2.8, smallest_m3=0.001),
    Fragmentation(energy_jkg=20.0, shape=2.0, fractal_dimension=1.0, smallest_m3=0.05, loss=0.5),
    Fragmentation("threshold", energy_jkg=25.0, pieces=4),
]


# --- breaking ---


@pytest.mark.parametrize("settings", BREAKABLE)
def test_pieces_have_the_mass_and_volume_of_their_block_and_are_not_too_small(settings):
    out = lab.run(ROUGH, lab.ground(), lab.MIXED, EffectSettings(settings), n=200, start=(3, 20))
    assert (out.rocks["reason"] == lab.BROKEN).sum() > 20
    rows = ended(out)
    mass = np.bincount(rows["rock"], rows["mass_kg"], minlength=200)
    assert np.abs(mass / out.rocks["mass_kg"] - 1.0).max() < 1e-12
    pieces = out.pieces["mass_kg"] / out.pieces["density_kgm3"]
    assert pieces.min() >= settings.smallest_m3 * (1 - 1e-12)
    volume = 4.0 / 3.0 * np.pi * rows["a_m"] * rows["b_m"] * rows["c_m"]
    assert volume * rows["density_kgm3"] == pytest.approx(rows["mass_kg"], rel=1e-12)
    # Numbered one by one in each rock's course; all keep its shape.
    for rock in range(200):
        own = out.pieces[out.pieces["rock"] == rock]
        assert (own["piece"] == np.arange(1, own.size + 1)).all()
        for axis in ("b_m", "c_m"):
            ratio = out.rocks[axis][rock] / out.rocks["a_m"][rock]
            assert own[axis] / own["a_m"] == pytest.approx(ratio, rel=1e-12)


def test_there_are_more_stops_than_rocks_and_each_is_counted_where_it_is():
    flat = lab.profile_set(ROUGH)
    out = lab.run(
        flat,
        lab.ground(),
        lab.MIXED,
        breaking(energy_jkg=20.0, survival_rate=0.0),
        n=200,
        start=(3, 20),
    )
    rows = ended(out)
    rows = rows[rows["reason"] <= 1]
    assert out.sums["stops"].sum() == rows.size > 250
    inside = (rows["runout_m"] >= 0.0) & (rows["runout_m"] <= flat.s[-1])
    cell = np.searchsorted(flat.cell_s, rows["runout_m"][inside], side="right") - 1
    assert (np.bincount(cell, minlength=flat.cell.size) == out.sums["stops"]).all()


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.6])
@pytest.mark.parametrize("form", ["fractal", "threshold"])
def test_a_break_makes_neither_energy_nor_momentum(form, loss):
    settings = Fragmentation(form, loss=loss, cone_deg=40.0, smallest_m3=1e-3, pieces=6)
    effects = as_read(settings)
    block = block_of(0.7, 0.5, 0.4, 2700.0, 4 / 3 * math.pi * 0.14 * 2700.0, np.uint64(3))
    vx, vz, theta, omega = 9.0, -2.0, 0.4, 11.0
    before = 0.5 * block.mass * (vx**2 + vz**2)
    turning = 0.5 * block.mass * inertia(block.a, block.b) * omega**2
    sideways = []
    for number in range(40):
        rows = broken(effects, block, number, vx, vz, theta, omega)
        assert len(rows) == 6 if form == "threshold" else len(rows) >= 2
        mass = rows["mass"]
        assert mass.sum() == pytest.approx(block.mass, rel=1e-12)
        v2 = rows["vx"] ** 2 + rows["vz"] ** 2
        moving = 0.5 * (mass * v2).sum()
        spin = 0.5 * (mass * inertia_of(rows) * rows["omega"] ** 2).sum()
        assert moving == pytest.approx((1.0 - loss) * before, rel=1e-12)
        assert spin <= (1.0 - loss) * turning * (1 + 1e-12)
        side = mass * (rows["vz"] * vx - rows["vx"] * vz)
        ahead = (mass * (rows["vx"] * vx + rows["vz"] * vz)).sum()
        assert abs(side.sum()) < 1e-9 * abs(side).max()
        assert 0.0 < ahead <= block.mass * (vx**2 + vz**2) * (1 + 1e-12)
        assert (rows["theta"] == theta).all()
        aside = mass * rows["vx"] * np.sin(rows["aside"])
        assert abs(aside.sum()) < 1e-9 * abs(aside).max()
        assert np.abs(np.sin(rows["aside"])).max() <= 2.0 * math.sin(math.radians(40.0))
        sideways.append(abs(side).max())
    assert np.unique(sideways).size == 40


def inertia_of(rows):
    return np.array([inertia(a, b) for a, b in zip(rows["a"], rows["b"], strict=True)])


def test_without_a_cone_pieces_go_on_as_the_whole():
    settings = Fragmentation(cone_deg=0.0, loss=0.0)
    block = block_of(0.7, 0.5, 0.4, 2700.0, 1500.0, np.uint64(3))
    rows = broken(as_read(settings), block, 1, 9.0, -2.0, 0.4, 11.0)
    assert rows["vx"] == pytest.approx(9.0, rel=1e-14)
    assert rows["vz"] == pytest.approx(-2.0, rel=1e-14)
    assert rows["omega"] == pytest.approx(11.0, rel=1e-14)
    assert (rows["aside"] == 0.0).all()


def drawn_shares(settings, volume, n):
    """Shares of the fragments of n breaks of a block of some volume (m³)."""
    read = as_read(settings).breaking
    made = []
    for number in range(n):
        out = np.zeros(fragmentation.most_fragments(read, volume))
        count = fragmentation.shares(read, np.uint64(7), number, volume, out)
        made.append(out[:count])
    return made


def test_equal_shares_are_not_below_the_smallest():
    (shares,) = drawn_shares(Fragmentation("threshold", pieces=7, smallest_m3=0.1), 0.45, 1)
    assert shares == pytest.approx([0.25] * 4, rel=1e-12)
    (shares,) = drawn_shares(Fragmentation("threshold", pieces=7, smallest_m3=0.3), 0.45, 1)
    assert shares.size == 0


@pytest.mark.parametrize("dimension", [1.5, 2.5])
def test_volumes_follow_the_power_law_down_to_the_smallest(dimension):
    """Over the smallest of k, the k - 1 others are a sample of Pareto's law with b = D/3."""
    b = dimension / 3.0
    settings = Fragmentation(fractal_dimension=dimension, smallest_m3=1e-5)
    volume = 0.1 if dimension == 2.5 else 30.0
    made = [s for s in drawn_shares(settings, volume, 300) if s.size]
    for shares in made:
        assert shares.sum() == pytest.approx(1.0, rel=1e-12)
        assert (np.diff(shares) <= 0.0).all()
        assert volume * shares[-1] >= settings.smallest_m3 * (1 - 1e-12)
    first = np.concatenate([s[:9] / s[9] for s in made if s.size > 40])
    assert first.size > 2000
    assert stats.kstest(first, stats.pareto(b).cdf).pvalue > 1e-3
    # The exponent is the same decade by decade over two decades.
    volumes = volume * np.concatenate(made)
    counts = [np.sum(volumes >= v) for v in (2e-5, 2e-4, 2e-3)]
    slopes = -np.diff(np.log10(counts))
    assert slopes == pytest.approx([b, b], abs=0.04)


@pytest.mark.parametrize(("survival", "shape"), [(0.7, 0.0), (0.7, 2.0), (0.3, 1.0)])
def test_the_survival_rate_is_the_share_of_blocks_that_stay_whole(survival, shape):
    # A sphere that falls straight down on level ground loses all its energy: g h per kg.
    blocks = lab.sphere(0.5, drop_m=(6.0, 6.0))
    effects = breaking(energy_jkg=50.0, survival_rate=survival, shape=shape, smallest_m3=1e-4)
    out = lab.run(FLAT, lab.plain(), blocks, effects, n=3000)
    whole = int((out.rocks["reason"] != lab.BROKEN).sum())
    expected = survival ** ((6.0 * lab.G / 50.0) ** shape)
    assert stats.binomtest(whole, 3000, expected).pvalue > 1e-3


@pytest.mark.parametrize("form", ["threshold", "fractal"])
def test_the_threshold_is_one(form):
    for limit, breaks in ((0.99, True), (1.01, False)):
        effects = breaking(form, limit * lab.G * 3.0, survival_rate=0.0, smallest_m3=1e-3)
        out = lab.run(FLAT, lab.plain(), lab.sphere(0.5, drop_m=(3.0, 3.0)), effects, n=20)
        assert ((out.rocks["reason"] == lab.BROKEN) == breaks).all()


def test_endless_breaking_is_told_and_not_cut_off():
    effects = breaking("threshold", 0.0, pieces=20, smallest_m3=1e-5)
    with pytest.raises(InputError, match="spawns too many") as caught:
        lab.run(ROUGH, lab.ground(), lab.MIXED, effects, n=3)
    assert caught.value.field == "effects"


# --- on the map ---


@pytest.mark.parametrize(
    "effects",
    [
        breaking(energy_jkg=20.0, survival_rate=0.2, smallest_m3=0.005),
        EffectSettings(Entrainment(number=0.5, size_ratio=0.9, share=1.0)),
        EffectSettings(Fragmentation(energy_jkg=20.0, survival_rate=0.2), Entrainment(number=0.3)),
    ],
)
def test_a_rock_and_its_pieces_count_once_with_the_largest_energy(effects):
    """Brute force: stations every 5 cm see each block by itself."""
    flat = lab.profile_set(ROUGH)
    table = GroundTable((lab.ground("talus"), lab.ground("debris")))
    at = np.arange(21.0, 129.0, 0.05) + 0.01
    control_lines = ControlLineCrossings.same_for_all(
        [ControlLine(f"{c:.2f}", "station") for c in at], list(at), 1
    )
    whole = lab.run(flat, table, lab.MIXED, effects, n=12, start=(3, 20))
    assert whole.sums["reach"].max() <= 12
    reach = np.zeros_like(whole.sums["reach"])
    energy = np.zeros_like(whole.sums["energy_sum"])
    by_piece, ratios = 0, []
    for rock in range(12):
        one = {"first_rock": rock, "start": (3, 20), "control_lines": control_lines}
        out = lab.run(flat, table, lab.MIXED, effects, **one)
        reach += out.sums["reach"]
        energy += out.sums["energy_sum"]
        assert set(np.unique(out.sums["reach"])) <= {0, 1}
        seen = out.passages
        joule = seen["energy_trans_kj"] + seen["energy_rot_kj"]
        cell = np.searchsorted(flat.cell_s, seen["chainage_m"], side="right") - 1
        for k in np.unique(cell):
            own = cell == k
            largest = joule[own].max()
            assert out.sums["energy_max"][k] >= largest * (1 - 1e-9)
            count = np.bincount(np.searchsorted(at, seen["chainage_m"][own]))
            if count.max() > 1 and out.sums["energy_max"][k] > 1.0:
                by_piece += int(seen["mass_kg"][own][joule[own].argmax()] < out.rocks["mass_kg"][0])
                ratios.append(out.sums["energy_max"][k] / largest)
    assert (reach == whole.sums["reach"]).all()
    assert (energy == whole.sums["energy_sum"]).all()
    # More only where it is reached between two stations: before an impact, or going back.
    assert len(ratios) > 20
    assert np.mean(np.array(ratios) < 1.02) > 0.8
    if effects.get(Fragmentation):
        assert by_piece > 5


def test_passages_of_pieces_carry_their_mass():
    control_lines = ControlLineCrossings.same_for_all([ControlLine("S", "station")], [60.0], 1)
    effects = breaking(energy_jkg=20.0, survival_rate=0.2)
    own = {"n": 200, "start": (3, 20), "control_lines": control_lines}
    out = lab.run(ROUGH, lab.ground(), lab.MIXED, effects, **own)
    rows = np.concatenate([out.rocks, out.pieces])
    known = {(r["rock"], r["mass_kg"]) for r in rows}
    assert {(p["rock"], p["mass_kg"]) for p in out.passages} <= known
    broken = out.rocks["reason"] == lab.BROKEN
    whole = out.rocks["mass_kg"][out.passages["rock"]]
    assert (out.passages["mass_kg"] < whole).sum() > 10
    assert broken.any()


# --- blocks set in motion ---


def loose(*args, **settings):
    settings.setdefault("classes", ())
    return EffectSettings(Entrainment(*args, **settings))


def set_off(effects, drop=3.0, n=3000, radius=0.5):
    """Blocks set off by one impact of each of n spheres, and what that impact took (J)."""
    blocks = lab.sphere(radius, drop_m=(drop, drop))
    out = lab.run(FLAT, lab.plain(), blocks, effects, n=n, log_events=6)
    assert all((c["phase"] == lab.IMPACT).sum() == 1 for c in out.event_logs)
    return out, np.bincount(out.pieces["rock"], minlength=n), lab.sphere_mass(radius) * lab.G * drop


def chi2_of_poisson(counts, mean, top):
    seen = np.bincount(np.minimum(counts, top), minlength=top + 1)
    expected = stats.poisson(mean).pmf(np.arange(top))
    return stats.chisquare(seen, counts.size * np.append(expected, 1 - expected.sum())).pvalue


@pytest.mark.parametrize("mean", [0.3, 2.0])
def test_numbers_are_poisson(mean):
    _, counts, _ = set_off(loose(number=mean))
    assert chi2_of_poisson(counts, mean, 3 if mean < 1 else 7) > 1e-3


def test_the_number_grows_with_the_energy_lost():
    for drop in (1.0, 4.0):
        _, counts, lost = set_off(loose("energy", number=0.2, energy_kj=10.0), drop)
        assert chi2_of_poisson(counts, 0.2 * lost / 1e4, 4) > 1e-3


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_they_have_no_more_energy_than_the_impact_took(share):
    out, counts, lost = set_off(loose(number=3.0, share=share), n=300)
    # On level ground nothing is gained after the start: the largest energy is that of the start.
    own = np.bincount(out.pieces["rock"], 1e3 * out.pieces["max_energy_kj"], minlength=300)
    some = counts > 0
    expected = np.minimum(share * counts, 1.0)[some] * lost
    # The contact is found to a millionth of a metre, and the fall to it gives the energy.
    assert own[some] == pytest.approx(expected, rel=1e-8)
    assert own.max() <= lost * (1 + 1e-8)


def test_they_are_as_large_as_told_and_start_from_the_ground():
    out, _, _ = set_off(loose(number=2.0, size_ratio=0.3), n=100)
    assert out.pieces["a_m"] == pytest.approx(0.15, rel=1e-12)
    assert out.pieces["mass_kg"] == pytest.approx(0.3**3 * lab.sphere_mass(0.5), rel=1e-12)
    assert (out.pieces["start_m"] == 5.0).all()
    # Thrown up by at most v²/(2 g) at 45 degrees, from where they lay.
    speed2 = 2e3 * out.pieces["max_energy_kj"] / out.pieces["mass_kg"]
    assert (out.pieces["max_height_m"] <= 0.5 * speed2 / (2.0 * lab.G) + 1e-6).all()


def test_only_where_loose_blocks_lie():
    table = GroundTable((lab.ground("rock"), lab.ground("talus")))
    for kind, some in ((0, False), (1, True)):
        flat = lab.profile_set(ROUGH, classes=kind)
        out = lab.run(
            flat, table, lab.MIXED, loose(number=1.0, classes=("talus",)), n=20, start=(3, 20)
        )
        assert (out.pieces.size > 0) == some


def test_blocks_set_in_motion_set_off_no_others():
    out = lab.run(ROUGH, TALUS, lab.MIXED, loose(number=10.0), n=20, start=(3, 20))
    counts = np.bincount(out.pieces["rock"], minlength=20)
    assert out.pieces["impacts"].sum() > 1000
    assert (counts <= 20 * out.rocks["impacts"]).all()
    mean = counts.sum() / out.rocks["impacts"].sum()
    assert mean == pytest.approx(10.0, rel=0.1)


def test_the_rock_itself_goes_on_as_before():
    base = lab.run(ROUGH, TALUS, lab.MIXED, n=50, start=(3, 20))
    out = lab.run(ROUGH, TALUS, lab.MIXED, loose(number=1.0), n=50, start=(3, 20))
    assert out.rocks.tobytes() == base.rocks.tobytes()
    assert out.sums["stops"].sum() > base.sums["stops"].sum()
