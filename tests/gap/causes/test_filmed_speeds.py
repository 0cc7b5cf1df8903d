"""Speeds of a film against its positions and times."""

from __future__ import annotations

from dataclasses import replace

from helpers.simulated_slope import observed, with_metadata, with_observed

from sassgis.gap.causes.measurement_error_cause import _all_alike, _speed_ratios
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.table import ResidualTable
from sassgis.gap.which.fingerprints import _tested

NO_RESIDUALS: ResidualTable = None  # type: ignore[assignment]


def sureness(case: Case) -> float:
    return _tested(_all_alike(case, NO_RESIDUALS), case.group)[0]


def test_a_scale_is_seen_beyond_what_errors_of_position_make() -> None:
    seen = observed(20, 3)
    track = seen.observations.trajectories
    fast = with_observed(seen, trajectories=replace(track, speed_mps=1.3 * track.speed_mps))
    assert sureness(seen) < 0.0 and sureness(fast) > 6.0
    # Errors that are stated six times too large shorten the distances; that is no scale.
    rough = with_metadata(seen, position_error_m=1.5)
    ratio, _, corrected = _speed_ratios(rough)
    assert ratio.mean() > 0.05 and corrected.mean() > 0.05
    assert sureness(rough) < 2.0
