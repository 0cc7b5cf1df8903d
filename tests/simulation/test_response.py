"""Changes between two outcomes whose quantiles are known."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.settings.results import StopReason
from sassgis.settings.statistics_table import default_bins
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums
from sassgis.simulation.response import RunOutcome, ToleranceCheck, outcome_of, response

EVENLY = np.full(100, 20, np.int64)  # 2000 blocks, evenly up to 100 m


def outcome(runout: np.ndarray, energy: np.ndarray | None = None) -> RunOutcome:
    energy = np.full(30, 100.0) if energy is None else energy
    return RunOutcome(runout, np.arange(energy.size, dtype=np.int64), energy)


def test_quantiles_and_their_limits() -> None:
    made = outcome(EVENLY)
    assert made.runout_m(0.5, 0.95) == pytest.approx([50.0, 95.0])
    # Order statistics: 1.96 √(p (1 − p)/n) of the sample to either side.
    room = 100.0 * 1.96 * np.sqrt(0.25 / 2000)
    assert made.runout_limits(0.5) == pytest.approx([50.0 - room, 50.0 + room])


def test_nothing_changes_where_nothing_changed() -> None:
    for name, answer in response(outcome(EVENLY), outcome(EVENLY)).items():
        assert answer.value == 0.0, name


def test_twice_as_far_and_three_times_the_energy() -> None:
    far = np.repeat(EVENLY // 2, 2)
    found = response(outcome(EVENLY), outcome(far, np.full(60, 300.0)))
    assert found["runout_q50"] == (pytest.approx(1.0), True)
    assert found["runout_q95"] == (pytest.approx(1.0), True)
    assert found["energy_q95"] == (pytest.approx(2.0), True)


def test_few_blocks_are_not_certain_and_few_cells_unknown() -> None:
    few = np.zeros(100, np.int64)
    few[::25] = 1
    more = np.zeros(130, np.int64)
    more[::32] = 1
    found = response(outcome(few, np.full(5, 1.0)), outcome(more, np.full(5, 9.0)))
    assert found["runout_q50"].value > 0.2 and not found["runout_q50"].certain
    assert np.isnan(found["energy_q95"].value) and str(found["energy_q95"]) == "unknown"


def test_blocks_that_never_started_have_no_run_out() -> None:
    runout = np.zeros((len(StopReason), 11), np.int64)
    runout[StopReason.NEVER_STARTED, 0] = 50
    runout[StopReason.REST, 10] = 4
    progress = Progress(1, MapSums(4), ControlLineSums(()), runout=runout)
    made = outcome_of(progress, default_bins())
    assert made.blocks == 4 and made.cells.size == 0
    assert made.runout_m(0.5) == pytest.approx([10.5])


def test_the_warning_names_what_changed_beyond_a_fifth() -> None:
    far = np.full(130, round(2000 / 130), np.int64)
    base = outcome(EVENLY)
    answers = {0.1: response(base, base), 0.4: response(base, outcome(far))}
    check = ToleranceCheck(0.2, base.blocks, answers)
    (warning,) = check.warnings()
    assert "run-out (95 %) +30 % at 0.4 m" in warning and "0.1 m" not in warning
    assert check.facts()["changes"]["0.1 m"]["runout_q95"] == 0.0  # type: ignore[index]
    near = np.full(110, round(2000 / 110), np.int64)
    assert not ToleranceCheck(0.2, 2000, {0.4: response(base, outcome(near))}).warnings()
