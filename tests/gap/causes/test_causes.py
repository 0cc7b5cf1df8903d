"""Everything about a cause follows from its one row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

from sassgis.engine.effects.registry import EFFECTS
from sassgis.engine.effects.wind import Wind
from sassgis.gap.advice.measure_next import what_is_identifiable
from sassgis.gap.causes import all_causes
from sassgis.gap.causes.all_causes import CAUSES, GROUPS
from sassgis.gap.causes.cause import Cause, Fit, ParameterDraws, Range, Scores, Trace, fitted_alone
from sassgis.gap.causes.extra_blocks import FRAGMENTATION
from sassgis.gap.fit import hypothesis_fit
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.tables import TABLES
from sassgis.gap.residuals.residual_table import residuals_of
from sassgis.gap.verdict.verdict import fingerprints, place_of
from sassgis.gap.words import effect_name, effect_phrase
from sassgis.inputs.observation_values import cause_weights_of, read_thresholds

FIT = Fit({"acceleration_mps2": Range(0.1, 2.0, "log")})


def blown(case: Case, residuals: object) -> Scores:
    """Every rock scores, the more the larger its number."""
    return Scores(1.0 + 0.01 * np.arange(case.n_rocks), 1.0)


WIND = Cause(
    "wind", number=11, group="along the way", phase="flight", draw=fitted_alone(Wind, FIT),
    statistics=(Trace("rocks are blown", blown, ("trajectories",), clear=True),),
)  # fmt: skip


@pytest.fixture
def wind(monkeypatch: pytest.MonkeyPatch) -> Iterator[Cause]:
    """A row more, as an import of the registry would have it."""
    monkeypatch.setitem(all_causes.CAUSES, "wind", WIND)  # type: ignore[arg-type]
    monkeypatch.setitem(all_causes.STATISTICS, "rocks are blown", "wind")  # type: ignore[arg-type]
    monkeypatch.setattr(hypothesis_fit, "FAMILIES", (*all_causes.FAMILIES, "wind"))
    yield WIND


def test_a_row_is_a_hypothesis_a_fingerprint_a_weight_and_words(
    wind: Cause, problem: SiteData
) -> None:
    case = problem.case
    assert "wind" in hypothesis_fit.families_to_try(case)
    draws = ParameterDraws(np.random.default_rng(3))
    made = hypothesis_fit.draw(case, ("wind",), draws)
    speed = made.parameters["acceleration_mps2"]
    # Drawn values are those that a configuration states, to six digits.
    assert speed == pytest.approx(0.1 * 20.0 ** draws.used["wind.acceleration_mps2"], rel=1e-5)
    assert made.model.effects.get(Wind) == Wind(speed)
    found = fingerprints(case, residuals_of(case, configured_model(case), seed=5, replicates=4))
    shown = {f.statistic: f for f in found}["rocks are blown"]
    assert shown.effect == "wind" and shown.p_adjusted < 1e-6
    # Every cause is weighed alike, one that no site had as well.
    weights = cause_weights_of(read_thresholds())
    shares = weights.shares([shown], {}, ["wind", "trees"])
    assert next(iter(shares)) == "wind" and shares["wind"] > 0.5
    assert effect_name("wind+trees") == "wind and trees"
    assert effect_phrase("wind") == EFFECTS["wind"].summary
    assert place_of("wind", case, [made], ()) == ("flight", case.reaches)
    without = replace(case.observations, trajectories=case.observations.trajectories.take([]))
    text = what_is_identifiable(without).not_testable
    assert "wind (record trajectories)" in text


@pytest.mark.parametrize("cause", CAUSES.values(), ids=list(CAUSES))
def test_every_row_is_complete(cause: Cause) -> None:
    label, summary = cause.words
    assert label and summary
    assert bool(cause.statistics) == cause.weighed
    assert cause.name in GROUPS[cause.group]
    assert all(set(one.tables) <= set(TABLES) for one in cause.statistics)
    if cause.name in EFFECTS:
        assert cause.phase in ("flight", "impact")


def test_numbers_differ_and_fit_into_those_of_campaigns() -> None:
    numbers = {cause.number for cause in CAUSES.values()}
    assert len(numbers) == len(CAUSES) and max(numbers) < 15
    assert len(all_causes.STATISTICS) == sum(len(c.statistics) for c in CAUSES.values())


def test_what_is_drawn_are_values_that_settings_take(problem: SiteData) -> None:
    """At both ends of every range, in every form."""

    class End(ParameterDraws):
        end = 0.0

        def share(self, name: str) -> float:
            drawn = super().share(name)
            return drawn if name.endswith(".form") else self.end

    for name in set(CAUSES) & set(EFFECTS):
        forms = {None}
        keys = {f.name: f for f in fields(EFFECTS[name].settings)}
        for seed in range(20):
            draws = End(np.random.default_rng(seed))
            draws.end = float(seed % 2) * (1.0 - 1e-9)
            forms.add(CAUSES[name].draw(problem.case, draws).form)
        if "form" in keys:
            assert len(forms) > 2, name


def test_pieces_are_whole(problem: SiteData) -> None:
    for seed in range(20):
        part = FRAGMENTATION.draw(problem.case, ParameterDraws(np.random.default_rng(seed)))
        assert isinstance(part.parameters.get("pieces", 2), int)
