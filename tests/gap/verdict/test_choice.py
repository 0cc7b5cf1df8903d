"""Draws of hypotheses, and the choice between causes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from helpers.model_files import model_from_json
from helpers.simulated_slope import with_observed

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.trees import Trees as Forest
from sassgis.gap.causes.all_causes import CAUSES, FAMILIES, STATISTICS
from sassgis.gap.causes.cause import ParameterDraws, reaches_between
from sassgis.gap.diagnosis import CauseGain, Fingerprint, GapFinding
from sassgis.gap.fit.hypothesis_fit import CONTACT_LAW, NONE, UNKNOWN, draw, families_to_try
from sassgis.gap.fit.site_data import SiteData, scale_of
from sassgis.gap.forward.observation_operator import rock_quantities
from sassgis.gap.forward.released_rocks import model_as_json
from sassgis.gap.observations.case import Case, LearnedContacts, observed_campaign
from sassgis.gap.verdict.verdict import (
    Thresholds,
    adequate,
    confidence_of,
    confusion_set,
    decide,
    group_of,
    second_of,
    seen_of,
)
from sassgis.inputs.observation_values import cause_weights_of, read_thresholds
from sassgis.settings.blocks import EffectSettings


@pytest.mark.parametrize("family", [None, *FAMILIES])
def test_the_same_parameter_draws_make_the_same_draw(problem: SiteData, family: str | None) -> None:
    families = () if family is None else (family,)
    made = draw(problem.case, families, ParameterDraws(np.random.default_rng(8)))
    again = draw(
        problem.case, families, ParameterDraws(np.random.default_rng(9), made.parameter_draws)
    )
    assert again == made
    assert model_from_json(json.loads(json.dumps(model_as_json(made.model)))) == made.model


def test_effects_that_are_on_already_are_not_tried(problem: SiteData) -> None:
    with_trees = replace(problem.case, effects=EffectSettings(Forest()))
    assert "trees" not in families_to_try(with_trees)
    assert len(families_to_try(problem.case)) == len(FAMILIES)


def without_columns(case: Case, table: str, *columns: str) -> Case:
    rows = getattr(case.observations, table)
    blind = {name: np.full(len(rows), np.nan) for name in columns}
    return with_observed(case, **{table: replace(rows, **blind)})


def test_not_measured_stays_not_measured(problem: SiteData) -> None:
    """As against absent: such a rock was at the station, and no score counts what it lacks."""
    whole = rock_quantities(problem.case, problem.observed)
    blind = without_columns(problem.case, "passages", "rotation_hz")
    seen = rock_quantities(blind, observed_campaign(blind))
    assert np.isfinite(whole["S0:rotation"]).any() and "S0:rotation" in problem.scale.names
    assert np.isnan(seen["S0:rotation"]).all()
    np.testing.assert_array_equal(seen["S0:passed"], whole["S0:passed"])
    np.testing.assert_array_equal(seen["S0:speed"], whole["S0:speed"])
    expected = [name for name in problem.scale.names if not name.endswith(":rotation")]
    assert list(scale_of(blind, seen).names) == expected


def test_rotations_have_a_factor_of_their_own_where_they_were_seen(
    problem: SiteData,
) -> None:
    shares = {
        "rotation_factor": 0.9, "rotation_noise": 0.5, "seen.turns": 0.1, "seen.log_turns": 0.2,
    }  # fmt: skip
    base = draw(problem.case, (), ParameterDraws(None, shares))
    scale = base.model.measurement.rotation_scale
    assert scale == base.parameters["rotation_factor"] > 1.2
    # The error of an instrument comes on top of how blocks turn.
    seen = draw(problem.case, ("measurement_error",), ParameterDraws(None, shares))
    error = seen.parameters["rotation_scale"]
    assert error < 0.9
    assert seen.model.measurement.rotation_scale == pytest.approx(scale * error)
    scatter = base.parameters["rotation_noise"]
    assert seen.model.measurement.rotation_noise == scatter == pytest.approx(0.126, abs=0.001)
    # Spins at contacts have theirs from the contacts, and the error as well.
    own = LearnedContacts(problem.case.table, 0.8, 0.3)
    with_contacts = replace(problem.case, learned=own)
    base, seen = (
        draw(with_contacts, own, ParameterDraws(None, shares)).model.measurement
        for own in ((), ("measurement_error",))
    )
    assert base.spin_scale == 0.8 and seen.spin_scale == pytest.approx(0.8 * error)
    assert base.spin_noise == seen.spin_noise == 0.3
    blind = without_columns(problem.case, "passages", "rotation_hz")
    without = draw(blind, (), ParameterDraws(None, shares))
    assert "rotation_factor" not in without.parameters
    assert without.model.measurement.rotation_scale == 1.0
    assert without.model.measurement.rotation_noise == 0.0
    assert without.model.measurement.spin_scale == 1.0


def test_settings_of_the_motion_are_drawn_no_higher_than_they_may_be(
    problem: SiteData,
) -> None:
    case = problem.case
    high = {"side_tilt_deg": 30.0, "drift_deg": 20.0, "rolling_friction_sd": 0.8}
    case = replace(
        case, engine=replace(case.engine, **high), terrain=cast(Any, case.terrain or "followed")
    )
    for share, expected in ((0.99, (45.0, 30.0, 1.0)), (0.5, tuple(high.values()))):
        base = draw(case, (), ParameterDraws(None, dict.fromkeys(high, share)))
        moving = base.model.engine_of(case.engine)
        assert tuple(getattr(moving, key) for key in high) == pytest.approx(expected)


def test_deflection_that_is_configured_stays(problem: SiteData) -> None:
    on = replace(problem.case, effects=EffectSettings(LateralDeflection()))
    # On fall lines blocks cannot leave these.
    base = draw(on, (), ParameterDraws(np.random.default_rng(1)))
    assert base.model.effects.get(LateralDeflection) is None
    assert "lateral_deflection" not in families_to_try(on)


def test_reaches_between_chainages(problem: SiteData) -> None:
    case = problem.case
    assert reaches_between(case, -5.0, 1e9) == case.reaches
    assert reaches_between(case, 0.0, 1.0) == case.reaches[:1]


def printed(effect: str, z: float, p: float = 0.001, statistic: str = "") -> Fingerprint:
    return Fingerprint(effect, statistic or f"what shows {effect}", 1.0, z, p, True, 30)


def statistic_of(cause: str, clear: bool) -> str:
    return next(s.name for s in CAUSES[cause].statistics if s.clear is clear)


def gap(size: float, p: float = 0.001) -> GapFinding:
    """A gap of 30 rocks whose scatter is 1."""
    half = 1.96 / 30**0.5
    return GapFinding(
        "S1", "flight", "speed_mps", size, "m/s", (size - half, size + half), p, p, 30, size, 0.0,
        "free run", 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


def shares(**p: float) -> dict[str, float]:
    """Probabilities, the rest shared by all other families and "none" at most."""
    rest = (1.0 - sum(p.values())) / (len(FAMILIES) + 1 - len(p))
    own = {name: p.get(name, rest) for name in (*FAMILIES, NONE)}
    return dict(sorted(own.items(), key=lambda item: -item[1]))


FROZEN = Thresholds(named=0.6, grouped=0.7)
STEMS = "speed lost above the ground, where no contact takes it"
FLIGHTS = "energy lost at once, on few flights"
FILM = "speeds against distances in time, all rocks alike"


def answer(prints: list[Fingerprint], p: dict[str, float], gaps: list[GapFinding],
           closes: float | None = None, *gains: CauseGain) -> tuple[str, str]:  # fmt: skip
    law = any(f.effect == CONTACT_LAW for f in prints)
    by_name = {gain.effect: gain for gain in gains}
    return decide(prints, by_name, p, adequate(gaps), closes, FROZEN, law)[:2]


def test_none_is_answered_only_where_the_base_is_adequate() -> None:
    nothing = shares(none=0.9)
    assert answer([], nothing, [gap(0.2)]) == (NONE, "")
    assert answer([], nothing, [gap(0.8, 0.2)]) == (NONE, "")
    assert answer([], nothing, [gap(0.8)]) == ("unknown", "")
    law = [printed(CONTACT_LAW, 6.0)]
    assert answer(law, nothing, [gap(0.8)]) == (CONTACT_LAW, "contact")
    assert answer(law, nothing, [gap(0.2)]) == (NONE, "")
    # Where a cause is as probable as none these data cannot answer which, unless it is at the
    # contact itself.
    assert answer(law, shares(none=0.4, trees=0.4), [gap(0.8)]) == ("unknown", "")
    assert answer(law, shares(none=0.4, soft_ground=0.4), [gap(0.8)]) == (CONTACT_LAW, "contact")
    assert answer(law, shares(none=0.3, soft_ground=0.4), [gap(0.8)]) == ("unknown", "")
    assert adequate([gap(0.2)]) and not adequate([gap(-0.8)])
    # The same at all rocks: a station that each of them passed, and none in the model.
    assert not adequate([replace(gap(1.0), ci95=(1.0, 1.0))])
    assert adequate([replace(gap(0.0), ci95=(0.0, 0.0))])


def test_a_family_is_named_where_it_is_probable_and_closes_something() -> None:
    trees, struck = shares(trees=0.8), printed("trees", 5.0, statistic=FLIGHTS)
    assert answer([struck], trees, [gap(1.0)], 0.5) == ("trees", "along the way")
    # Not where it closes none of the gap: then the group is certain all the same.
    assert answer([struck], trees, [gap(1.0)], -0.1) == ("unknown", "along the way")
    # A cause that is alone in its group is named, or nothing is: that group has no other.
    start = shares(release_error=0.8)
    early = printed("release_error", 5.0, statistic=statistic_of("release_error", True))
    _, group, reason = decide([early], {}, start, False, -0.1, FROZEN, False)
    assert group == "start" and "a cause of the group" not in reason
    # What hangs on no contact names it all the same, if it is certain.
    for z, named in ((5.0, "unknown"), (7.0, "trees")):
        stems = printed("trees", z, statistic=STEMS)
        assert answer([stems], trees, [gap(1.0)], -0.1) == (named, "along the way")
    flights = printed("trees", 9.0, statistic=FLIGHTS)
    assert answer([flights], trees, [gap(1.0)], -0.1)[0] == "unknown"
    two = shares(trees=0.45, air_drag=0.4)
    assert answer([struck], two, [gap(1.0)]) == ("unknown", "along the way")


def test_the_confidence_of_another_law_is_the_probability_of_no_cause() -> None:
    p = {NONE: 0.6, "trees": 0.3, UNKNOWN: 0.1}
    assert confidence_of(CONTACT_LAW, [], p, FROZEN) == pytest.approx(
        min(0.6, FROZEN.right.get(CONTACT_LAW, 1.0))
    )
    assert math.isnan(confidence_of(UNKNOWN, [], p, FROZEN))


def test_a_cause_that_is_certain_by_itself_takes_nothing_from_another() -> None:
    two = shares(lateral_deflection=0.5, measurement_error=0.45)
    turned = printed("lateral_deflection", 9.0, statistic=statistic_of("lateral_deflection", True))
    for z, named in ((5.0, "unknown"), (9.0, "lateral_deflection")):
        film = printed("measurement_error", z, statistic=FILM)
        assert answer([turned, film], two, [gap(1.0)], 0.5)[0] == named
        sure = confidence_of("lateral_deflection", [turned, film], two, FROZEN)
        assert (sure >= FROZEN.named) == (named == "lateral_deflection")


def test_what_masses_show_is_not_contested_by_what_a_contact_leaves() -> None:
    two = shares(fragmentation=0.45, trees=0.5)
    lie = printed("fragmentation", 9.0, statistic=CAUSES["fragmentation"].statistics[-1].name)
    for clear, named in ((False, "fragmentation"), (True, "unknown")):
        lost = printed("trees", 5.0, statistic=statistic_of("trees", clear))
        assert answer([lie, lost], two, [gap(1.0)], -0.1)[0] == named


def test_a_cause_at_the_contact_need_not_close_what_a_free_contact_closes() -> None:
    for effect, named in (("soft_ground", "soft_ground"), ("air_drag", "unknown")):
        seen = printed(effect, 5.0, statistic=statistic_of(effect, True))
        assert answer([seen], shares(**{effect: 0.9}), [gap(1.0)], -0.1)[0] == named


def test_fingerprints_that_no_contact_leaves_count_together() -> None:
    weights = cause_weights_of(read_thresholds())
    names = [one.name for one in CAUSES["fragmentation"].statistics]

    def odds(*z: float) -> float:
        seen = [
            printed("fragmentation", own, statistic=name)
            for own, name in zip(z, names, strict=True)
        ]
        found = weights.shares(seen, {}, FAMILIES)
        return found["fragmentation"] / found[NONE]

    assert odds(4.0, 3.0) == pytest.approx(odds(5.0, 0.0))
    # One that is not seen by itself adds nothing.
    assert odds(4.0, 2.9) == odds(4.0, 0.0)


def gained(effect: str, sureness: float, power: float = 1.0) -> CauseGain:
    return CauseGain(effect, 0.5, sureness, power, 1.2)


@pytest.mark.parametrize("effect", FAMILIES)
def test_a_cause_is_named_by_what_no_contact_could_leave(effect: str) -> None:
    kinds = {s.clear: s.name for s in CAUSES[effect].statistics}
    usual = [printed(effect, 9.0, statistic=name) for clear, name in kinds.items() if not clear]
    likely, gaps = shares(**{effect: 0.9}), [gap(1.0)]
    assert answer(usual, likely, gaps, 0.5)[0] == "unknown"
    for z, named in ((2.9, False), (3.1, True)):
        seen = [printed(effect, z, statistic=name) for clear, name in kinds.items() if clear]
        found = answer([*usual, *seen], likely, gaps, 0.5)[0]
        assert (found == effect) == (named and bool(seen))
    # Or by what it certainly closes beyond ground and law, unless masses alone show it, or another
    # law of the contact closes as much.
    closes = CAUSES[effect].closes and group_of(effect) != "contact"
    for sureness, named in ((4.9, False), (5.1, closes)):
        found = answer([], likely, gaps, 0.5, gained(effect, sureness))[0]
        assert (found == effect) == named


def test_a_nil_gain_speaks_against_a_cause() -> None:
    weights = cause_weights_of(read_thresholds())
    seen = [printed("trees", 3.0, statistic=statistic_of("trees", True))]
    sure, nil = (
        weights.shares(seen, {"trees": gained("trees", own)}, FAMILIES)["trees"]
        for own in (8.0, -2.0)
    )
    assert nil < sure
    # The odds against it are several times as high.
    assert (1.0 - nil) / nil > 4.0 * (1.0 - sure) / sure


PAIRS = [(a, b) for a in FAMILIES for b in FAMILIES if a != b]


@pytest.mark.parametrize("pair", PAIRS, ids="+".join)
def test_every_second_cause_is_nameable_if_it_is_left_beside_the_first(
    pair: tuple[str, str],
) -> None:
    first, second = pair
    left = {name: p for name, p in shares(**{second: 0.8}).items() if name != first}
    frozen = Thresholds(named=0.6, second=6.0)
    assert second_of([printed(second, 8.0)], left, frozen) == second
    # Not if little of it is left, or if something else is as probable.
    assert second_of([printed(second, 5.0)], left, frozen) == ""
    assert second_of([printed(second, 8.0)], shares(**{second: 0.4}), frozen) == ""


def test_what_these_data_could_not_show_is_likely_all_the_same() -> None:
    weights = cause_weights_of(read_thresholds())
    # Of a place, and too weak to be told from the scatter of the rocks.
    growth = "growth of the lateral offset below the first station"
    prints = [
        printed("trees", 9.0, statistic=statistic_of("trees", True)),
        printed("lateral_deflection", 2.9, 0.01, growth),
    ]
    gains = {"air_drag": gained("air_drag", 4.9, 0.7), "roughness": gained("roughness", 0.0, 0.9)}
    # What a cause at the contact could close, another law of the contact closes as well.
    assert seen_of(prints, gains, FAMILIES) == ("trees",)
    rough = statistic_of("roughness", False)
    printed_too = [*prints, printed("roughness", 4.0, 0.002, rough)]
    assert seen_of(printed_too, gains, FAMILIES) == ("trees", "roughness")
    p = weights.shares(printed_too, gains, FAMILIES)
    assert {*p} == {*FAMILIES, NONE, "unknown"} and sum(p.values()) == pytest.approx(1.0)
    # What certainly closes something is seen, if some of its draws could; so is a certain place.
    assert "air_drag" in seen_of(prints, {"air_drag": gained("air_drag", 5.0, 0.2)}, FAMILIES)
    assert "lateral_deflection" in seen_of([replace(prints[1], z=3.0)], {}, FAMILIES)
    # What a contact leaves as well shows nothing by itself.
    lost = "rebound lost with the normal speed, on one ground alone"
    assert seen_of([printed("soft_ground", 9.0, statistic=lost)], {}, FAMILIES) == ()
    # Where much mass is missing nothing is known of what came in addition.
    more = printed("entrainment", 0.0, 1.0, "mass that lies beyond what was released")
    assert seen_of([more], {}, FAMILIES) == ("entrainment",)
    assert seen_of([replace(more, z=-4.0)], {}, FAMILIES) == ()
    # A gap that is left speaks for what has no name.
    nothing, gaps = (weights.shares([], {}, FAMILIES, sound) for sound in (True, False))
    assert gaps[NONE] < nothing[NONE] and gaps["unknown"] > nothing["unknown"]


def test_the_confusion_set_is_ordered_and_holds_what_is_as_likely_as_the_answer() -> None:
    p = {"trees": 0.4, "air_drag": 0.3, "none": 0.2, "roughness": 0.07, "rock_shape": 0.03}
    likely = ("unknown", "trees", "air_drag", "none", "roughness")
    assert confusion_set("unknown", 0.05, p) == likely
    assert confusion_set("trees", 0.25, p) == ("trees", "air_drag")
    assert confusion_set("none", 0.5, p) == ("none", "trees", "air_drag")
    # Another law of the contact excludes no effect beside it.
    assert confusion_set("contact_law", 0.25, p) == ("contact_law", "trees", "air_drag")
    # An effect that has no name is possible as well.
    two = {"none": 0.6, "unknown": 0.1}
    assert confusion_set("none", 0.1, two) == ("none", "unknown")
    assert confusion_set("none", 0.2, two) == ("none",)
    assert group_of("trees+x") == group_of("air_drag")


def test_the_frozen_weights_follow_the_evidence() -> None:
    weights = cause_weights_of(read_thresholds())
    assert (weights.weights >= 0.0).all() and weights.offset > 0.0
    nothing = [printed(effect, 0.0, 1.0, name) for name, effect in STATISTICS.items()]
    base = weights.shares(nothing, {}, FAMILIES)
    assert sum(base.values()) == pytest.approx(1.0) and next(iter(base)) == NONE
    for effect in FAMILIES:
        sure = [replace(f, z=8.0) if f.effect == effect else f for f in nothing]
        found = weights.shares(sure, {}, FAMILIES)
        assert found[effect] > base[effect]
        # What is not tried is not named.
        assert effect not in weights.shares(sure, {}, [n for n in FAMILIES if n != effect])
