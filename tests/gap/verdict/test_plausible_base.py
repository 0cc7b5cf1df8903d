"""A base is wrong only if none of the calibrations that the rocks leave plausible is right."""

from __future__ import annotations

from sassgis.gap.fit.hypothesis_fit import CONTACT_LAW, HypothesisDraw, HypothesisFits
from sassgis.gap.fit.linear_fit import summary_of
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.residuals.discrepancy import Discrepancy
from sassgis.gap.verdict.evidence import first_adequate, law_in_words
from sassgis.gap.verdict.verdict import large_gaps
from sassgis.simulation.workers import task_map


def test_one_right_model_is_enough(problem: SiteData) -> None:
    # The middle of all ranges is the configured ground, with which the rocks were released.
    right, *wrong = (
        HypothesisDraw(CONTACT_LAW, {"law.eta_max": share}, 0, 8) for share in (0.5, 0.25, 0.75)
    )
    with task_map(summary_of(problem), 1) as run:
        made = HypothesisFits(summary_of(problem), run, 8)
        assert first_adequate(made, wrong) is None
        left = first_adequate(made, [*wrong, right, right])
        assert left is not None and left[1]
        # What is told is where the gap lies with that model.
        assert left == first_adequate(made, [right])
        assert {f.place for f in left[0]} and not large_gaps(left[0])


def test_certain_shares_of_the_law_are_stated() -> None:
    law = (
        Discrepancy("free run", "speed_mps", 0.16, 0.0, 0.02),
        Discrepancy("reach", "rotation_hz", -0.2, 0.0, 0.03),
        Discrepancy("reach", "height_m", 0.2, 0.0, 0.15),
    )
    said = law_in_words(law)
    assert "speed +16 % (from the release), rotation \u221220 %" in said and "height" not in said
    assert law_in_words(law[2:]) == ""
