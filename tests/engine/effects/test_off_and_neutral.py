"""Off is off, and effects without strength give the base model."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.engine_lab import MIXED, forest, ground, profile_set, rough_slope, run, same, sphere
from numpy.lib.recfunctions import structured_to_unstructured as matrix

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import Wind
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.results import ControlLine, ControlLineCrossings

FLAT = profile_set(rough_slope(3))
CONTROL_LINES = ControlLineCrossings.same_for_all(
    [ControlLine("S", "station"), ControlLine("N", "net", 2.0, 80.0)], [40.0, 70.0], 1
)


def play(effects=None, stems=0.0, **more):
    return run(
        FLAT, ground(), MIXED, effects, n=120, start=(3.0, 20.0), control_lines=CONTROL_LINES,
        forest=forest(FLAT, stems), **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def base():
    return play()


def test_nothing_on_is_the_base_to_the_last_bit(base):
    assert base.rocks.size == 120
    assert base.passages.size > 50
    for off in (EffectSettings(), EffectSettings(LateralDeflection())):
        assert same(play(off), base)


NEUTRAL = {
    "no drag": EffectSettings(AirDrag(drag_coefficient=0.0)),
    "no wind": EffectSettings(Wind(0.0)),
    "no air": EffectSettings(AirDrag(air_density_kgm3=0.0)),
    "stems that take nothing": EffectSettings(Trees(efficiency=0.0)),
    "forest without drag": EffectSettings(Trees("viscous", drag_kgps=0.0)),
    "forest without height": EffectSettings(Trees(height_m=0.0)),
    "no obstacles": EffectSettings(Roughness(obstacle_m=0.0)),
    "no waves": EffectSettings(Roughness("wave", obstacle_m=0.0)),
    "never flat": EffectSettings(RockShape(strength=0.0)),
    "unbreakable": EffectSettings(Fragmentation(energy_jkg=1e6)),
    "below the threshold": EffectSettings(Fragmentation("threshold", 1e6)),
    "all survive": EffectSettings(Fragmentation(energy_jkg=0.0, survival_rate=1.0)),
    "too small to break": EffectSettings(Fragmentation(smallest_m3=10.0)),
    "nothing loose": EffectSettings(Entrainment(number=0.0, classes=())),
    "no energy, nothing loose": EffectSettings(Entrainment("energy", 0.0, classes=())),
}


@pytest.mark.parametrize("name", NEUTRAL)
def test_effects_without_strength_are_the_base_to_the_last_bit(base, name):
    assert same(play(NEUTRAL[name], stems=0.05), base)


def test_trees_without_a_forest_are_the_base_to_the_last_bit(base):
    assert same(play(EffectSettings(Trees())), base)


# Here numbers are multiplied with what is 1 but for rounding, and paths magnify that: close over
# the first contacts, and in the mean.
ALMOST = {
    "fast reference": SoftGround(reference_speed_mps=1e6, classes=()),
    "no scar": SoftGround("scar", depth_scale=0.0, classes=()),
    "no drag in the scar": SoftGround("scar", drag_coefficient=0.0, classes=()),
    "no slip": SoftGround("slip", friction=100.0, classes=()),
}


@pytest.mark.parametrize("name", ALMOST)
def test_soft_ground_without_strength_is_the_base_but_for_rounding(base, name):
    # The rule "slip" cannot hold a contact in which the impulse is nearly along the ground.
    events = {"log_events": 12}
    hard, soft = play(**events), play(EffectSettings(ALMOST[name]), **events)
    close = 0
    for one, other in zip(hard.event_logs, soft.event_logs, strict=True):
        k = min(6, len(one), len(other))
        close += int(
            np.allclose(
                matrix(one[:k])[:, :8],
                matrix(other[:k])[:, :8],
                rtol=1e-6,
                atol=1e-6,
            )
        )
    assert close >= 118


def test_mean_inertia_of_a_sphere_is_its_own(base):
    one = run(FLAT, ground(), sphere(0.5), n=40, log_events=8)
    other = run(
        FLAT, ground(), sphere(0.5), EffectSettings(RockShape("mean_inertia")), n=40,
        log_events=8,
    )  # fmt: skip
    for a, b in zip(one.event_logs, other.event_logs, strict=True):
        k = min(6, len(a), len(b))
        assert np.allclose(
            matrix(a[:k]),
            matrix(b[:k]),
            rtol=1e-9,
            atol=1e-9,
        )


def test_an_effect_leaves_the_draws_of_others_alone():
    # Weak drag moves every impact by rounding only: sizes, tilts and stems met stay the same.
    drag = AirDrag(air_density_kgm3=1e-9)
    one, both = (
        play(
            EffectSettings(Trees(), Roughness(), *air),
            stems=0.05, log_events=400,
        )
        for air in ((), (drag,))
    )  # fmt: skip
    for name in ("start_m", "a_m", "b_m", "c_m", "density_kgm3", "mass_kg"):
        assert (one.rocks[name] == both.rocks[name]).all()
    close = [
        bool(np.allclose(_impacts(a)[:2], _impacts(b)[:2], rtol=1e-5, atol=1e-5))
        for a, b in zip(one.event_logs, both.event_logs, strict=True)
        if len(_impacts(a)) >= 2 and len(_impacts(b)) >= 2
    ]
    assert len(close) > 20
    assert np.mean(close) > 0.97


def _impacts(log):
    return matrix(log[log["phase"] == 1])[:, 2:]
