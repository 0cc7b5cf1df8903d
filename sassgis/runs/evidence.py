"""The models without an effect at a site, and what speaks for causes beyond them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sassgis.gap.calibration.contact_map import learned_contacts
from sassgis.gap.calibration.problem import model_rows
from sassgis.gap.causes.trees_cause import losses_at_one_place
from sassgis.gap.diagnosis import CauseGain, Fingerprint, GapFinding, Rung
from sassgis.gap.ladder.cause_gains import cause_gains
from sassgis.gap.ladder.handover import CONFIGURED_NUMBER
from sassgis.gap.ladder.hypothesis_fit import FRESH, FittedHypothesis
from sassgis.gap.ladder.rungs import CONFIGURED, GROUND, Ladder, Step, needs_contact_law
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.gap.residuals.table import ResidualTable, residuals_with
from sassgis.gap.where.findings import where
from sassgis.gap.which.fingerprints import fingerprints
from sassgis.gap.which.hypotheses import NONE, families_to_try
from sassgis.gap.which.verdict import CONTACT_LAW, adequate, speaking
from sassgis.io.read.observation_files import AnyObservations
from sassgis.model.grid import FloatArray
from sassgis.model.languages import phrase
from sassgis.runs.gap_case import read_case
from sassgis.runs.hypothesis_fits import HypothesisFits
from sassgis.runs.job import AnyConfig


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


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of a base.

    Attributes
    ----------
    prints : tuple of Fingerprint
        The surest first.
    findings : tuple of GapFinding
        The surest first. Those of calibrated ground, if it leaves nothing that is significant and
        large, is what the rocks ask for, and a freer contact would leave more.
    gains : mapping of family to CauseGain
    notes : tuple of str
        What else the observations show.
    """

    prints: tuple[Fingerprint, ...]
    findings: tuple[GapFinding, ...]
    gains: Mapping[str, CauseGain]
    notes: tuple[str, ...]

    @property
    def speaking(self) -> Mapping[str, CauseGain]:
        """Gains that could speak for their causes."""
        return speaking(self.prints, self.gains)


def prepared_case(
    settings: AnyConfig, observations: AnyObservations, seed: int, ground: float
) -> Case:
    """A case with the contacts that were recorded, and the range of the ground."""
    case = replace(read_case(settings, observations), ground_range=ground)
    return replace(case, learned=learned_contacts(case, seed))


def evidence_beyond(
    made: HypothesisFits, base: FittedHypothesis, families: Sequence[str]
) -> Evidence:
    """What is left of a base, and what speaks for causes beyond it."""
    case, residuals = _residuals(made, base)
    return Evidence(
        fingerprints(case, residuals),
        where(case, residuals, seed=made.problem.seed),
        cause_gains(made.summary, base, families, made.run),
        _notes(residuals),
    )


def _residuals(made: HypothesisFits, fit: FittedHypothesis) -> tuple[Case, ResidualTable]:
    problem = made.problem
    return residuals_with(problem.case, fit.handed_over.draw.model, seed=problem.seed)


def evidence_of_site(made: HypothesisFits) -> tuple[Evidence, BaseRungs]:
    """Evidence beyond the base with a free contact, and the models without an effect.

    A contact that is free in wide limits may be calibrated less well than the ground alone.
    """
    found = evidence_beyond(made, made.add(CONTACT_LAW), families_to_try(made.problem.case))
    base = base_rungs(made)
    if not adequate(found.findings) and base.simplest != CONTACT_LAW:
        case, residuals = _residuals(made, made.add(NONE))
        left = where(case, residuals, seed=made.problem.seed)
        if adequate(left):
            found = replace(found, findings=left)
    return found, base


def _notes(residuals: ResidualTable) -> tuple[str, ...]:
    """What no cause explains, in words."""
    found = losses_at_one_place(residuals)
    if found is None:
        return ()
    return (
        phrase(
            "{} of the paths in time lose speed above the ground at one place, about {} m down the "
            "way: a step that the terrain model lacks, or something built. They say nothing about "
            "trees.",
            found[0],
            f"{found[1]:.0f}",
        ),
    )
