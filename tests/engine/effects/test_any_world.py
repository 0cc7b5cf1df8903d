"""What holds with any effects on any slope: energy, ground, ends, and independence of chunks."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import engine_lab as lab
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from numpy.lib.recfunctions import structured_to_unstructured

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.rock_shape import RockShape, tumbling_inertia
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.ellipse import inertia
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.settings import EngineSettings

# Not shrunk: a course of thousands of events takes its time.
QUICK = settings(
    max_examples=60, suppress_health_check=[HealthCheck.too_slow],
    derandomize=True, phases=(Phase.explicit, Phase.generate),
)  # fmt: skip


def forms(kind, *names, **ranges):
    """Settings of one family, or None."""
    return st.none() | st.builds(
        kind, st.sampled_from(names), **{k: st.floats(*v) for k, v in ranges.items()}
    )


def _those_on(**effects):
    return EffectSettings(*(own for own in effects.values() if own is not None))


EVERYTHING = st.builds(
    _those_on,
    air_drag=forms(AirDrag, "constant", "sphericity", drag_coefficient=(0.0, 10.0)),
    trees=forms(
        Trees, "stems", "full_stems", "viscous", efficiency=(0.0, 2.0), drag_kgps=(0.0, 3000.0),
        height_m=(0.0, 30.0),
    ),
    soft_ground=st.none()
    | st.builds(
        SoftGround, st.sampled_from(["velocity_scaled", "scar", "slip"]), classes=st.just(()),
        reference_speed_mps=st.floats(0.5, 20.0), depth_scale=st.floats(0.0, 20.0),
        friction=st.floats(0.0, 2.0),
    ),
    roughness=forms(Roughness, "uniform", "wave", obstacle_m=(0.0, 1.0), wavelength_m=(0.1, 5.0)),
    rock_shape=forms(RockShape, "flat_landing", "mean_inertia", strength=(0.0, 1.0)),
)  # fmt: skip
NEW_BLOCKS = st.builds(
    _those_on,
    air_drag=forms(AirDrag, "constant", drag_coefficient=(0.0, 2.0)),
    roughness=forms(Roughness, "uniform", obstacle_m=(0.0, 0.5)),
    fragmentation=forms(
        Fragmentation, "fractal", "threshold", energy_jkg=(20.0, 300.0), loss=(0.0, 0.9),
        cone_deg=(0.0, 60.0), survival_rate=(0.0, 0.9), fractal_dimension=(1.0, 2.9),
    ),
    entrainment=st.builds(
        Entrainment, st.sampled_from(["poisson", "energy"]), classes=st.just(()),
        number=st.floats(0.0, 0.5), share=st.floats(0.0, 1.0), size_ratio=st.floats(0.1, 1.0),
    ),
)  # fmt: skip


@st.composite
def slopes(draw):
    seed, step = draw(st.integers(0, 2**31)), draw(st.sampled_from([0.5, 2.0, 10.0]))
    angle, noise = draw(st.floats(5.0, 65.0)), draw(st.sampled_from([0.0, 0.1, 0.3]))
    s = np.arange(0.0, 80.0 + step, step)
    bumps = np.random.default_rng(seed).normal(0.0, 1.0, s.size) * noise * min(1.0, step / 0.5)
    return s, 500.0 - np.tan(np.radians(angle)) * np.minimum(s, 50.0) + bumps


@st.composite
def rocks(draw):
    a = draw(st.floats(0.15, 1.5))
    b = a * draw(st.floats(0.3, 1.0))
    c = b * draw(st.floats(0.2, 1.0))
    return BlockPopulation(
        axis_1_m=(a, a), axis_2_m=(b, b), axis_3_m=(c, c),
        drop_m=(0.0, draw(st.sampled_from([0.0, 0.5, 20.0]))),
        speed_mps=(0.0, draw(st.sampled_from([0.0, 10.0]))),
    )  # fmt: skip


def play(line, blocks, effects, table=None, n=8, cell=2.0, **more):
    flat = lab.profile_set(line, cell=cell)
    return lab.run(
        flat, table or lab.ground(), blocks, effects, n=n, start=(3.0, 20.0),
        forest=lab.forest(flat, 0.03), **more,
    )  # fmt: skip


@given(
    line=slopes(), blocks=rocks(), effects=EVERYTHING,
    # What loses 1e-5 in an impact bounces on for longer than the most events of a block.
    eta=st.floats(0.3, 0.99), rolling=st.sampled_from(["round", "ellipse"]),
)  # fmt: skip
@QUICK
def test_energy_never_grows_beyond_what_gravity_gives(line, blocks, effects, eta, rolling):
    out = play(
        line, blocks, effects, lab.ground(eta_max=eta), log_events=30_000, n=4,
        settings=EngineSettings(readings="1986", rolling=rolling),
    )  # fmt: skip
    assert (out.rocks["reason"] != lab.STEP_LIMIT).all()
    shape = effects.get(RockShape)
    mean = shape is not None and shape.form == "mean_inertia"
    for rock, log in zip(out.rocks, out.event_logs, strict=True):
        assert log["phase"][-1] == lab.END
        if len(log) < 2:
            continue
        assert np.isfinite(structured_to_unstructured(log)).all()
        a, b, c = (rock[f"{k}_m"] for k in "abc")
        moment = tumbling_inertia(a, b, c) if mean else inertia(a, b)
        v2 = log["vx_mps"] ** 2 + log["vz_mps"] ** 2
        energy = 0.5 * (v2 + moment * log["omega_radps"] ** 2)
        height = log["z_m"]
        total = energy + lab.G * height
        room = np.maximum(energy + lab.G * (height - height.min()), 1.0)
        worst = int(np.argmax(np.diff(total) / room[:-1]))
        gain = total[worst + 1] - total[worst]
        assert gain <= 1e-8 * room[worst], (gain, log[worst : worst + 2])
        above = height - np.interp(log["x_m"], *line)
        inside = (log["x_m"] >= 0.0) & (log["x_m"] <= line[0][-1])
        assert (above[inside] > 0.0).all()


@given(line=slopes(), blocks=rocks(), effects=NEW_BLOCKS)
@QUICK
def test_pieces_keep_mass_stay_on_the_slope_and_come_to_an_end(line, blocks, effects):
    out = play(line, blocks, effects)
    rows = np.concatenate([out.rocks, out.pieces])
    assert (rows["reason"] != lab.STEP_LIMIT).all()
    inside = (rows["runout_m"] >= 0.0) & (rows["runout_m"] <= line[0][-1])
    assert (rows["runout_z_m"][inside] > np.interp(rows["runout_m"][inside], *line)).all()
    assert out.sums["reach"].max() <= 8
    assert out.sums["stops"].sum() == np.isin(rows["reason"][inside], (0, 1)).sum()
    if effects.get(Fragmentation) is not None and effects.get(Entrainment).number == 0.0:
        whole = rows["reason"] != lab.BROKEN
        mass = np.bincount(rows["rock"][whole], rows["mass_kg"][whole], minlength=8)
        assert mass == pytest.approx(out.rocks["mass_kg"], rel=1e-12)


ALL_ON = EffectSettings(
    AirDrag(), Trees(), SoftGround(classes=()), Roughness(), RockShape(),
    Fragmentation(energy_jkg=60.0), Entrainment(classes=()),
)  # fmt: skip


def test_all_at_once_give_the_same_rocks_in_any_chunks():
    line, blocks = lab.rough_slope(2), lab.MIXED
    whole = play(line, blocks, ALL_ON, n=30)
    parts = [play(line, blocks, ALL_ON, n=15, first_rock=k) for k in (0, 15)]
    for name in ("rocks", "pieces", "passages"):
        joined = np.concatenate([getattr(p, name) for p in parts])
        assert joined.tobytes() == getattr(whole, name).tobytes()
    assert whole.pieces.size > 10
    for name in ("reach", "stops", "energy_sum", "energy"):
        assert (parts[0].sums[name] + parts[1].sums[name] == whole.sums[name]).all()
