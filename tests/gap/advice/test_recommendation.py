"""What is told first: where and how far the model is off, why, what to run, what that leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sassgis.gap.advice import recommendation
from sassgis.gap.advice.recommendation import (
    first_sentence,
    model_gaps,
    shortfall,
    values_of,
    worst_of,
)
from sassgis.gap.diagnosis import Advice, GroundSetting, ModelGap, Rung, Verdict
from sassgis.gap.fit.site_data import SiteData, model_rows
from sassgis.gap.forward.released_rocks import configured_model


@pytest.fixture(autouse=True)
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals are a bit rough."""
    monkeypatch.setattr(recommendation, "GAP_SAMPLES", 199)


def gap(size: float, half: float, statistic: str = "median", **changes: object) -> ModelGap:
    side = "unsafe" if size > half else "safe" if size < -half else ""
    made = ModelGap(
        "stop", "runout_m", statistic, "m", 100.0, 100.0 - size, size, (size - half, size + half),
        5.0, 40, side,
    )  # fmt: skip
    return replace(made, **changes)  # type: ignore[arg-type]


ENERGY = {"place": "S2", "quantity": "energy_kj", "unit": "kJ", "limit": 15.0}


def test_the_worst_is_the_surest_on_the_unsafe_side() -> None:
    long, short, low = gap(-60.0, 5.0), gap(20.0, 8.0, "90 %"), gap(40.0, 30.0, "90 %", **ENERGY)
    assert worst_of([long, low, short]) == short
    assert worst_of([long, low]) == low
    # Certain, but too small to count; too uncertain.
    assert worst_of([gap(3.0, 1.0), gap(20.0, 30.0), long]) == long
    assert worst_of([gap(3.0, 1.0), gap(20.0, 30.0)]) == gap(3.0, 1.0)
    assert worst_of([]) is None
    assert shortfall([long, short]) == short and shortfall([long, gap(8.0, 1.0)]) is None


@pytest.mark.parametrize("shift", [30.0, -30.0])
def test_every_statistic_has_its_gap_side_and_interval(problem: SiteData, shift: float) -> None:
    """Observed rocks that stop further down, and a model whose far ones lack."""
    column = problem.scale.names.index("stop:runout")
    rows = model_rows(problem, configured_model(problem.case), 7, 6)
    rows[:, :, column] -= shift / problem.scale.scale[column]
    found = {(g.place, g.statistic): g for g in model_gaps(problem, rows)}
    own = found["stop", "90 %"]
    seen = values_of(problem.scale, problem.rows, column)
    made = values_of(problem.scale, rows, column)
    assert own.observed == pytest.approx(np.nanquantile(seen, 0.9))
    assert own.predicted == pytest.approx(np.nanquantile(made, 0.9))
    assert own.gap == own.observed - own.predicted
    assert own.ci95[0] < own.gap < own.ci95[1]
    assert own.side == ("unsafe" if shift > 0.0 else "safe")
    width = found["stop", "width"]
    assert width.observed == pytest.approx(own.observed - np.nanquantile(seen, 0.1))
    # A shift moves all rocks alike.
    assert width.side == "" and width.ci95[0] < 0.0 < width.ci95[1]
    at_stations = [g for g in found.values() if g.place != "stop"]
    assert {g.quantity for g in at_stations} == {"energy_kj", "arrived"}
    k = problem.scale.names.index("S0:speed")
    speed = values_of(problem.scale, problem.rows, k)
    energy = 0.5e-3 * problem.case.mass_kg * speed**2
    first = found[problem.case.station_names[0], "median"]
    assert first.observed == pytest.approx(np.nanmedian(energy), rel=1e-3)


def test_speeds_of_a_wrong_scale_are_compared_as_they_are(problem: SiteData) -> None:
    rows = model_rows(problem, configured_model(problem.case), 7, 6)
    plain, scaled, both = (
        {g.key: g for g in model_gaps(problem, rows, observed_scale=seen, model_scale=made)}
        for seen, made in ((1.0, 1.0), (1.2, 1.0), (1.2, 1.2))
    )
    for key, own in plain.items():
        power = {"energy_kj": 2.0, "speed_mps": 1.0}.get(own.quantity, 0.0)
        assert scaled[key].observed == pytest.approx(own.observed / 1.2**power)
        assert scaled[key].predicted == own.predicted
        assert both[key].gap == pytest.approx(own.gap / 1.2**power)


SETTING = GroundSetting("debris", "eta_max", 0.8, 0.72, (0.67, 0.74), True)
RUNGS = (
    Rung("configured", 1.6),
    Rung("ground", 1.0, 0.66, (0.5, 0.8)),
    Rung("trees", 0.9, 0.66, (0.5, 0.8)),
)


def advice(recommended: str, why: str = "", left: tuple[ModelGap, ...] = ()) -> Advice:
    worst = gap(20.0, 8.0, "90 %")
    return Advice(
        worst, settings=(SETTING,), compared=(worst,), left=left, recommended=recommended, why=why
    )


NOTHING = Verdict("none", 0.8, ("none",), probabilities={"none": 0.8, "trees": 0.2})
TREES = Verdict("trees", 0.71, ("trees",), probabilities={"trees": 0.71, "none": 0.29})


def test_place_amount_side_and_cause_come_first_in_this_order() -> None:
    said = first_sentence(advice("trees"), RUNGS, TREES)
    assert said.startswith(
        "In the run-out simulated blocks stop 20 % too early, on the unsafe side (90 % quantile "
        "differs by 20 m, 95 % interval 12 to 28 m); most likely because of trees that take "
        "energy from passing rocks (71 %); with trees the gap over all quantities shrinks by 66 % "
        "(95 %: 50 to 80 %) on held-out rocks, with calibrated ground by 66 % (95 %: 50 to 80 %). "
        "Run model/config.toml (with trees)."
    )
    # What does not certainly close the gap is seen, and no reason of it.
    said = first_sentence(advice("ground"), RUNGS, TREES)
    assert "; the observations show trees that take energy" in said and "because" not in said


def test_the_most_probable_causes_are_said_where_none_is_named() -> None:
    shares = {"unknown": 0.5, "release_error": 0.3, "trees": 0.2}
    verdict = Verdict("unknown", float("nan"), ("unknown",), probabilities=shares)
    said = first_sentence(advice("ground"), RUNGS, verdict)
    assert (
        "); no cause is certain: most likely unknown or not testable with these data (50 %), then "
        "error of the release (30 %); with calibrated ground"
    ) in said
    law = Verdict("contact_law", 0.9, (), probabilities={"none": 0.999, "trees": 0.001})
    said = first_sentence(advice("ground"), RUNGS, law)
    assert "most likely another contact law (99 %); with calibrated ground" in said


def test_causes_that_cannot_be_seen_are_ranked_with_the_unknown() -> None:
    shares = {"trees": 0.4, "unknown": 0.3, "air_drag": 0.2, "none": 0.1}
    held = ("unknown", "trees", "air_drag")
    verdict = Verdict("unknown", float("nan"), held, "", (), "", shares, cannot_exclude=held[2:])
    assert list(verdict.ranked) == ["unknown", "trees", "none"]
    assert verdict.ranked["unknown"] == pytest.approx(0.5)
    assert verdict.rivals == ("trees",)


def test_stations_that_are_off_alike_are_one_place() -> None:
    def at(place: str, size: float) -> ModelGap:
        return gap(size, 5.0, **{**ENERGY, "place": place})

    alike = (at("S1", 1.0), at("S2", -40.0), at("S3", -36.0), at("S4", 1.0), at("S5", -30.0))
    made = replace(advice("ground"), configured=alike[1], compared=alike)
    said = first_sentence(made, RUNGS, NOTHING)
    assert said.startswith(
        "From S2 to S3 simulated energies are 40 % too high, on the safe side (median at S2 "
        "differs by 40 kJ, 95 % interval 35 to 45 kJ); with calibrated ground"
    )
    # Above the uppermost station nothing was measured: the gap begins above it.
    first = replace(made, configured=alike[1], compared=alike[1:])
    assert first_sentence(first, RUNGS, NOTHING).startswith("At S2 already, and down to S3, sim")
    alone = replace(made, configured=alike[4])
    assert first_sentence(alone, RUNGS, NOTHING).startswith("At S5 simulated energies are 30 %")


def test_no_more_than_all_of_the_gap_is_closed() -> None:
    rungs = (RUNGS[0], Rung("ground", -0.1, 1.18, (0.7, 1.4)))
    said = first_sentence(advice("ground"), rungs, NOTHING)
    assert "shrinks by 100 % (95 %: 70 to 100 %)" in said


def test_the_sentence_recommends_what_gains_and_says_why_not_more() -> None:
    rungs = (*RUNGS[:2], Rung("trees", 0.9, 0.7, (0.5, 0.9), "ground", 0.1, (-0.1, 0.2)))
    why = "no certain gain on held-out rocks: trees over calibrated ground"
    said = first_sentence(advice("ground", why), rungs, NOTHING)
    assert "Set debris: eta_max 0.72" in said and "shrinks by 66 %" in said
    assert "No certain gain on held-out rocks: trees over calibrated ground." in said
    assert "Run model/config.toml" not in said and "energy distance" not in said
    said = first_sentence(advice("configured", "ground closes nothing"), RUNGS, NOTHING)
    assert "Keep the configured ground. Ground closes nothing." in said and "Set" not in said


def test_a_run_out_beyond_the_terrain_is_not_called_short(problem: SiteData) -> None:
    rows = model_rows(problem, configured_model(problem.case), 1, 2)
    k = problem.scale.names.index("stop:runout")
    near = rows.copy()
    near[..., k] -= 3.0
    sides = [
        {g.statistic: g.side for g in model_gaps(problem, near, left) if g.place == "stop"}
        for left in (0.0, 0.2, 0.6)
    ]
    assert sides[0]["90 %"] == sides[0]["median"] == sides[1]["median"] == "unsafe"
    assert sides[1]["90 %"] == sides[2]["90 %"] == sides[2]["median"] == ""
    # Too narrow, but all of it farther than the rocks came.
    narrow = rows.copy()
    narrow[..., k] = rows[..., k].max() + 5.0
    found = {g.statistic: g for g in model_gaps(problem, narrow) if g.place == "stop"}
    assert found["width"].gap > 0.0 and found["width"].side == ""
    assert found["90 %"].side == "safe"


def test_a_model_that_falls_far_short_is_not_recommended() -> None:
    short = gap(107.0, 10.0)
    said = first_sentence(replace(advice("trees", left=(short,)), short=short), RUNGS, NOTHING)
    assert "Run model" not in said and "After calibration" not in said
    assert (
        "No tested model is recommended. The nearest one is trees (model/config.toml); with it, "
        "in the run-out simulated blocks stop 107 % too early, on the unsafe side (median "
        "differs by 107 m, 95 % interval 97 to 117 m). On held-out rocks, it closes 66 % "
        "(95 %: 50 to 80 %) of the gap over all quantities."
    ) in said
    said = first_sentence(replace(advice("configured", left=(short,)), short=short), RUNGS, NOTHING)
    assert said.endswith("95 % interval 12 to 28 m). No tested model is recommended.")


def test_what_is_no_part_of_the_motion_is_not_said_to_be_in_the_file() -> None:
    rungs = (*RUNGS, Rung("release_error", 0.9, 0.7, (0.6, 0.8)))
    said = first_sentence(advice("release_error"), rungs, NOTHING)
    assert "(with the calibrated base model (with error of the release in the data))" in said
    assert "Error of the release concerns the data, so the file does not contain it." in said
    assert "concerns the data" not in first_sentence(advice("trees"), RUNGS, TREES)


FAR_SAFE = (
    "Also: in the run-out simulated blocks stop 60 % too far, on the safe side (median "
    "differs by 60 m, 95 % interval 55 to 65 m)."
)


def test_what_is_far_off_on_the_safe_side_is_said_beside_the_unsafe_one() -> None:
    both = gap(40.0, 20.0, "90 %", **ENERGY), gap(-60.0, 5.0)
    made = replace(advice("ground"), configured=worst_of(both), compared=both)
    said = first_sentence(made, RUNGS, NOTHING)
    assert said.startswith(
        "At S2 simulated energies are 40 % too low, on the unsafe side (90 % quantile at S2 "
        "differs by 40 kJ, 95 % interval 20 to 60 kJ);"
    )
    assert FAR_SAFE in said
    # Once, where the configured model is the one that is handed over.
    kept = first_sentence(replace(made, recommended="configured", left=both), RUNGS, NOTHING)
    assert kept.count("60 % too far") == 1 and "After calibration" not in kept
    near = replace(made, compared=(both[0], gap(-9.0, 2.0)))
    assert "Also" not in first_sentence(near, RUNGS, NOTHING)


def test_what_the_recommended_model_leaves_is_said() -> None:
    left = (gap(40.0, 20.0, "90 %", **ENERGY), gap(-9.0, 2.0))
    said = first_sentence(advice("ground", left=left), RUNGS, NOTHING)
    assert said.endswith(
        "After calibration: at S2 simulated energies are 40 % too low, on the unsafe side (90 % "
        "quantile at S2 differs by 40 kJ, 95 % interval 20 to 60 kJ)."
    )
    # On the safe side only what is twice as large as it must be to count.
    assert "After calibration" not in first_sentence(advice("ground", left=left[1:]), RUNGS, TREES)
    far = (gap(-11.0, 2.0), gap(-7.0, 0.5))
    said = first_sentence(advice("ground", left=far), RUNGS, NOTHING)
    assert "After calibration: in the run-out simulated blocks stop 11 % too far, on the" in said
    both = (gap(40.0, 20.0, "90 %", **ENERGY), gap(-60.0, 5.0))
    assert first_sentence(advice("ground", left=both), RUNGS, NOTHING).endswith(FAR_SAFE)
    unclear = (gap(1.0, 4.0), gap(2.0, 9.0, "90 %"), gap(1.0, 9.0, "width"))
    said = first_sentence(advice("trees", left=unclear), RUNGS, TREES)
    assert said.endswith("After calibration no relevant difference remains.")
    kept = Advice(unclear[0], compared=unclear, recommended="configured")
    assert first_sentence(kept, RUNGS, NOTHING).startswith(
        "Configured model: no significant difference from 40 rocks in median, 90 % and width of "
        "run-out. Observed minus predicted (median run-out): 1 m (95 %: \u22123 to 5 m)."
    )


@pytest.mark.parametrize("none", [False, True])
def test_rocks_that_a_model_stops_too_early_count_as_a_shortfall(
    problem: SiteData, none: bool
) -> None:
    """Also where none of them arrives, so that there is no energy to compare."""
    rows = model_rows(problem, configured_model(problem.case), 1, 4)
    k = problem.scale.names.index("S0:speed")
    absent = k + len(problem.scale.names)
    as_seen = np.repeat(problem.rows[None], 4, axis=0)
    arrived = {g.place: g for g in model_gaps(problem, as_seen) if g.quantity == "arrived"}
    own = arrived[problem.case.station_names[0]]
    seen = 1.0 - problem.rows[:, absent]
    assert own.observed == own.predicted == pytest.approx(100.0 * seen.mean())
    assert own.gap == 0.0 and own.side == "" and not own.counts
    rows[..., absent] = 1.0
    if not none:
        rows[:, ::3, absent] = 0.0
    found = [g for g in model_gaps(problem, rows) if g.place == problem.case.station_names[0]]
    short = next(g for g in found if g.quantity == "arrived")
    assert short.gap == pytest.approx(100.0 * (seen - (1.0 - rows[0][:, absent])).mean())
    assert short.far_short and short.side == "unsafe"
    assert none == (len(found) == 1)
    said = first_sentence(replace(advice("trees", left=(short,)), short=short), RUNGS, NOTHING)
    of_all = f"{short.place} {short.gap:.0f} % of all simulated blocks stop too early"
    assert f"efore {of_all}" in said
    # All were seen: samples of the rocks are all alike, those of the model are not.
    lucky = replace(problem, rows=problem.rows.copy())
    lucky.rows[:, absent] = 0.0
    rows[..., absent] = 0.0
    rows[0, :, absent] = 1.0
    (own,) = [g for g in model_gaps(lucky, rows) if g.key == short.key]
    half = 196.0 * (1.0 / 4.0 / own.rocks) ** 0.5
    assert own.gap == pytest.approx(25.0)
    assert own.ci95 == pytest.approx((25.0 - half, 25.0 + half))
    # More in the model than were recorded: a station may have missed some.
    rows[..., absent] = 0.0
    fewer = problem.rows.copy()
    fewer[::2, absent] = 1.0
    missed = replace(problem, rows=fewer)
    more = [g for g in model_gaps(missed, rows) if g.quantity == "arrived"]
    assert all(g.side == "" for g in more)
    # Nor does it matter whether the masses of those are known.
    mass = np.where(fewer[:, absent] == 1.0, np.nan, problem.case.mass_kg)
    unweighed = replace(missed, case=replace(problem.case, mass_kg=mass))
    assert [g for g in model_gaps(unweighed, rows) if g.quantity == "arrived"] == more
