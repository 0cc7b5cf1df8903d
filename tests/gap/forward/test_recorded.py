"""What an observer records: which contacts, which passages; as stated, or as the tables show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import BASE, observed, with_metadata, with_passages
from hypothesis import given
from hypothesis import strategies as st

from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.rock_lines import observer_of, recorded_contacts, rock_lines_of
from sassgis.gap.observations.case import Campaign, Errors


def seen_by(problem: SiteData, count: int = 3, **observer: float) -> list[Campaign]:
    own = replace(problem.rock_lines.observer, **observer)
    lines = replace(problem.rock_lines, observer=own)
    return campaigns(problem.case, lines, BASE, count=count, seed=2)


@given(
    st.lists(st.tuples(st.integers(0, 2), st.floats(0.0, 2.0), st.floats(-1.0, 3.0)), max_size=25),
    st.floats(0.0, 1.5),
    st.floats(0.0, 1.5),
)
def test_contacts_are_hard_enough_and_apart(
    rows: list[tuple[int, float, float]], least: float, interval: float
) -> None:
    rows = sorted(rows, key=lambda r: r[:2])
    rock, time, into = (np.array([r[k] for r in rows]) for k in range(3))
    observer = Errors(contact_min_normal_speed_mps=least, contact_min_interval_s=interval)
    first, last = recorded_contacts(observer, rock.astype(np.int64), time, into)
    assert (into[first] >= least).all() and (into[first] > 0.0).all() and (first <= last).all()
    hard = np.flatnonzero((into >= least) & (into > 0.0))
    # Each hard contact is recorded, or is one with the recorded one before it.
    assert set(first.tolist()) <= set(hard.tolist())
    for row in hard.tolist():
        k = int(np.searchsorted(first, row, side="right")) - 1
        assert row <= last[k] and rock[first[k]] == rock[row]
        assert row == first[k] or time[row] - time[first[k]] < interval
    same = rock[first[1:]] == rock[first[:-1]]
    assert (np.diff(time[first])[same] >= interval).all()


def test_light_contacts_and_missed_passages_lack_in_replicas(problem: SiteData) -> None:
    everything = seen_by(problem, contact_min_normal_speed_mps=0.0, contact_min_interval_s=0.0)
    hard = seen_by(problem, contact_min_normal_speed_mps=2.0, contact_min_interval_s=0.0)
    into = [np.concatenate([-s.impacts.vn_in for s in made]) for made in (everything, hard)]
    assert into[0].min() < 1.0 and into[1].min() >= 2.0
    assert into[1].size == (into[0] >= 2.0).sum()
    some = seen_by(problem, count=20, passages_missed_share=0.3)
    all_ = seen_by(problem, count=20, passages_missed_share=0.0)
    kept = sum(s.passages.rock.size for s in some) / sum(s.passages.rock.size for s in all_)
    assert kept == pytest.approx(0.7, abs=0.04)


def test_the_tables_show_what_is_not_stated(problem: SiteData) -> None:
    case = problem.case
    impacts = case.observations.impacts
    found = observer_of(case)
    assert found.contact_min_normal_speed_mps == pytest.approx(
        np.nanmin(-impacts.vn_in_mps[impacts.vn_in_mps < 0.0])
    )
    assert found.passages_missed_share == 0.0 and found.contact_min_interval_s > 0.0
    # A third of the passages at the second station taken away.
    passages = case.observations.passages
    at = np.flatnonzero(passages.station == "S2")[::3]
    keep = np.ones(len(passages), np.bool_)
    keep[at] = False
    fewer = with_passages(case, keep)
    share = observer_of(fewer).passages_missed_share
    assert share == pytest.approx(at.size / len(passages), rel=0.15)
    own = observer_of(
        with_metadata(
            fewer, contact_min_normal_speed_mps=1.5, contact_min_interval_s=0.2,
            passages_missed_share=0.05,
        )
    )  # fmt: skip
    assert own.contact_min_normal_speed_mps == 1.5 and own.contact_min_interval_s == 0.2
    assert own.passages_missed_share == 0.05
    assert rock_lines_of(fewer).observer.passages_missed_share == share


def test_nothing_observed_is_recorded_whole() -> None:
    found = observer_of(observed(8, 3, tables=("deposits",)))
    assert found.contact_min_normal_speed_mps == found.contact_min_interval_s == 0.0
    assert found.passages_missed_share == 0.0


def test_stops_have_an_error_of_their_own(problem: SiteData) -> None:
    stated = with_metadata(problem.case, position_error_m=0.1, stop_error_m=4.0, mass_error_rel=0.3)
    errors = observer_of(stated)
    assert (errors.position_m, errors.stop_m, errors.mass_rel) == (0.1, 4.0, 0.3)
    assert observer_of(with_metadata(stated, stop_error_m=np.nan)).stop_m == 0.1
    made = seen_by(problem, count=20, position_m=0.1, stop_m=4.0)
    beside = [
        np.concatenate([getattr(s, t).lateral_m for s in made]) for t in ("deposits", "passages")
    ]
    # On fall lines there is no other.
    assert beside[0].std() == pytest.approx(4.0, rel=0.1)
    assert beside[1].std() == pytest.approx(0.1, rel=0.1)
