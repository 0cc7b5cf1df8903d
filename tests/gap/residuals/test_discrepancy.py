"""The discrepancy of the law of motion takes what is alike everywhere, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sassgis.gap.constants import LAW_SHARES
from sassgis.gap.residuals.discrepancy import without_discrepancy
from sassgis.gap.residuals.rock_residuals import Residual

ROCKS = 60


def reaches(
    shares: list[float], quantity: str = "speed_mps", score: float | None = None
) -> list[Residual]:
    """Rocks that are off by a share of what is predicted, on reaches of 50 m."""
    rng = np.random.default_rng(4)
    found = []
    for k, share in enumerate(shares):
        predicted = 10.0 + rng.uniform(0.0, 4.0, ROCKS)
        observed = predicted * (1.0 + share + 0.05 * rng.standard_normal(ROCKS))
        tested = None if score is None else score + 0.1 * rng.standard_normal(ROCKS)
        found.append(Residual(
            place=f"S{k}-S{k + 1}", phase="flight", quantity=quantity, test="reach",
            observed=observed, predicted=predicted, s0_m=50.0 * k, s1_m=50.0 * k + 50.0,
            score=tested,
        ))  # fmt: skip
    return found


def left(rows: list[Residual]) -> NDArray[np.float64]:
    return np.array([np.mean(row.gap / row.predicted) for row in without_discrepancy(rows)[0]])


@pytest.mark.parametrize("shares", [[0.15] * 5, [0.05, 0.1, 0.15, 0.2, 0.25], [-0.1]])
def test_what_changes_little_down_the_slope_is_the_law(shares: list[float]) -> None:
    assert np.abs(left(reaches(shares))).max() < 0.02
    (law,) = without_discrepancy(reaches(shares))[1]
    assert law.share == pytest.approx(np.mean(shares), abs=0.02)


def test_what_is_off_on_one_reach_stays() -> None:
    gap = left(reaches([0.0, 0.0, -0.3, 0.0, 0.0]))
    assert gap[2] < -0.15 and gap.argmin() == 2


def test_no_law_is_off_by_several_times_the_prior() -> None:
    far = 6.0 * LAW_SHARES["runout_m"]
    rows = reaches([far], "runout_m")
    # The prior holds it as the error of the mean, of 60 rocks with a scatter of 5 %, does not.
    (law,) = without_discrepancy(rows)[1]
    assert law.share < far and left(rows)[0] > 0.0


def test_scores_of_scatter_are_shifted_and_other_quantities_stay() -> None:
    wide = reaches([0.2, 0.2, 0.2], "turn_deg_spread", score=0.06)
    scores = [row.tested().mean() for row in without_discrepancy(wide)[0]]
    assert np.abs(scores).max() < 0.03
    turned = reaches([0.2, 0.2, 0.2], "turn_deg")
    assert without_discrepancy(turned) == (tuple(turned), ())
