"""What flattening leaves open: a sample of the blocks at half and at double the tolerance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sassgis.hazard.response import MEASURES, RelativeChange, RunOutcome, response
from sassgis.model.languages import joined, phrase

#: Change beyond which the user is warned.
LARGEST_CHANGE = 0.2
#: Reach and energy; the reached area of a sample hangs on its size.
_COMPARED = ("runout_q50", "runout_q95", "energy_q95")


@dataclass(frozen=True, slots=True)
class ToleranceCheck:
    """How results depend on the tolerance of the segments."""

    tolerance_m: float  # that of the run (m)
    blocks: int  # of the sample
    answers: Mapping[float, Mapping[str, RelativeChange]]  # by the tolerance (m) and the measure

    def sentence(self) -> str:
        """The changes in words."""
        text = "{}: median run-out {}, run-out (95 %) {}, energy (95 %) {}"
        return joined(
            "; ",
            (
                phrase(text, f"{t:g} m", *(str(found[name]) for name in _COMPARED))
                for t, found in self.answers.items()
            ),
        )

    def facts(self) -> dict[str, object]:
        """For the manifest: plain numbers, None where too few blocks tell."""
        return {
            "tolerance_m": self.tolerance_m,
            "blocks": self.blocks,
            "changes": {
                f"{t:g} m": {
                    n: None if a.value != a.value else round(a.value, 3) for n, a in found.items()
                }
                for t, found in self.answers.items()
            },
        }

    def warnings(self) -> list[str]:
        """What the user should know."""
        large = [
            phrase("{} {} at {} m", phrase(MEASURES[name]), str(answer), f"{t:g}")
            for t, found in self.answers.items()
            for name, answer in found.items()
            if answer.certain and abs(answer.value) > LARGEST_CHANGE
        ]
        if not large:
            return []
        text = (
            "Results depend on terrain.segment_tolerance_m ({} m): {} (a sample of {} blocks). "
            "Choose it so that half of it changes little."
        )
        return [phrase(text, f"{self.tolerance_m:g}", joined(", ", large), self.blocks)]


def tolerance_check(
    tolerance_m: float, base: RunOutcome, others: Mapping[float, RunOutcome]
) -> ToleranceCheck:
    """Compare the outcomes at other tolerances (m) with that of the run."""
    answers = {}
    for t, other in others.items():
        found = response(base, other)
        answers[t] = {name: found[name] for name in _COMPARED}
    return ToleranceCheck(tolerance_m, base.blocks, answers)
