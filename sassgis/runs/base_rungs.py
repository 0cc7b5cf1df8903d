"""The base of a diagnosis: the configured model, calibrated ground, another law of the contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sassgis.gap.calibration.problem import model_rows
from sassgis.gap.diagnosis import Rung
from sassgis.gap.ladder.handover import CONFIGURED_NUMBER
from sassgis.gap.ladder.hypothesis_fit import FRESH
from sassgis.gap.ladder.rungs import CONFIGURED, GROUND, Ladder, Step, needs_contact_law
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.gap.which.hypotheses import NONE
from sassgis.gap.which.verdict import CONTACT_LAW
from sassgis.model.grid import FloatArray
from sassgis.runs.hypothesis_fits import HypothesisFits


@dataclass(frozen=True, slots=True)
class BaseRungs:
    """The models without an effect, and which of them the observed rocks ask for.

    Attributes
    ----------
    rows : mapping of rung to float64, shape (FRESH, n_rocks, p)
        Of rocks left out.
    law : bool
        Whether another law of the contact is needed.
    """

    ladder: Ladder
    rows: Mapping[str, FloatArray]
    rungs: tuple[Rung, ...]
    law: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Rungs that may be recommended."""
        return (CONFIGURED, GROUND, *([CONTACT_LAW] if self.law else []))

    @property
    def simplest(self) -> str:
        """The last of them whose gain is certain."""
        return self.ladder.recommended(*self.names)[0]


def base_rungs(made: HypothesisFits) -> BaseRungs:
    """The ladder as far as it has no effect."""
    problem = made.problem
    rows = {
        CONFIGURED: model_rows(problem, configured_model(problem.case), CONFIGURED_NUMBER, FRESH),
        GROUND: made.rows(NONE),
        CONTACT_LAW: made.rows(CONTACT_LAW),
    }
    over = {CONFIGURED: "", GROUND: CONFIGURED, CONTACT_LAW: GROUND}
    ladder = Ladder(problem, [Step(name, over[name], own) for name, own in rows.items()])
    rungs = ladder.rungs(*rows)
    return BaseRungs(ladder, rows, rungs, needs_contact_law(rungs))
