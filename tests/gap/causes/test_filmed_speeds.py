"""Speeds of a film against its positions and times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import observed, with_metadata, with_observed, with_rows

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import Scoring, Unseen
from sassgis.gap.constants import FINGERPRINT_ROCKS
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.fit.hypothesis_fit import draw_of, space_of
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.verdict.verdict import z_of_scores

NO_RESIDUALS: ResidualTable = None  # type: ignore[assignment]
STATISTICS = CAUSES["measurement_error"].statistics
IN_TIME, PASSING, AGAINST_FALLS = (own.name for own in STATISTICS[:3])
all_alike, passing = (own.scores for own in STATISTICS[:2])


def sureness(case: Case, scoring: Scoring = all_alike) -> float:
    return z_of_scores(scoring(case, NO_RESIDUALS), case.group)[0]


def test_a_scale_is_seen_beyond_what_errors_of_position_make() -> None:
    seen = observed(20, 3)
    track = seen.observations.trajectories
    fast = with_observed(seen, trajectories=replace(track, speed_mps=1.3 * track.speed_mps))
    assert sureness(seen) < 0.0 and sureness(fast) > 6.0
    # Errors that are stated six times too large shorten the distances; that is no scale.
    rough = with_metadata(seen, position_error_m=1.5)
    assert all_alike(rough, NO_RESIDUALS).size > 1.05 and sureness(rough) < 2.0


def test_a_scale_of_the_stations_is_seen_where_films_state_no_speed() -> None:
    seen = observed(20, 3)
    film = replace(
        seen.observations.trajectories,
        speed_mps=np.full(len(seen.observations.trajectories), np.nan),
    )
    assert sureness(with_observed(seen, trajectories=film), passing) < 0.0
    passages = seen.observations.passages
    for scale in (0.8, 1.3):
        fast = replace(passages, speed_mps=scale * passages.speed_mps)
        scaled = with_observed(seen, trajectories=film, passages=fast)
        assert sureness(scaled, passing) > 6.0
        assert passing(scaled, NO_RESIDUALS).size == pytest.approx(scale, rel=0.03)
    # Films that begin below the last station, and of few rocks.
    late = seen.projected["trajectories"].s > seen.station_s.max()
    few = seen.observations.rock_of("trajectories") < FINGERPRINT_ROCKS - 1
    for kept in (late, few):
        with pytest.raises(Unseen):
            passing(with_rows(seen, "trajectories", kept), NO_RESIDUALS)


def test_the_scale_that_a_fingerprint_measures_is_held(problem: SiteData) -> None:
    seen = observed(20, 3)
    track = seen.observations.trajectories
    fast = with_observed(seen, trajectories=replace(track, speed_mps=1.3 * track.speed_mps))
    assert all_alike(fast, NO_RESIDUALS).size == pytest.approx(1.3, rel=0.02)

    def measured(seen: dict[str, tuple[float, float]]) -> Mapping[str, float]:
        """What is held by z and value of fingerprints."""
        prints = {
            name: Fingerprint("measurement_error", name, value, z, 0.01, True, 20)
            for name, (z, value) in seen.items()
        }
        return CAUSES["measurement_error"].measured(prints)

    # That of paths in time, which lose nothing between two points, before that of falls.
    held = measured({IN_TIME: (6.0, 0.9), PASSING: (8.0, 1.1), AGAINST_FALLS: (9.0, 1.2)})
    assert held == measured({PASSING: (3.0, 0.9), AGAINST_FALLS: (9.0, 1.2)})
    start = {"seen.scale": 0.9, "seen.log_scale": 0.7}
    space = space_of(problem.case, "measurement_error", start, held)
    assert "seen.log_scale" not in space.labels
    made = draw_of(problem.case, "measurement_error", space.shares(np.zeros(len(space.labels))))
    assert made.model.measurement.scale == pytest.approx(0.9, rel=1e-5)
    free = space_of(problem.case, "measurement_error", start, {})
    assert "seen.log_scale" in free.labels
    # Neither one that is not seen, nor one beyond what is tried.
    assert measured({IN_TIME: (2.9, 1.2)}) == measured({AGAINST_FALLS: (9.0, 1.6)}) == {}
