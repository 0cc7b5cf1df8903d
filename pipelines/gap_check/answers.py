"""What is true of a site, what a diagnosis answered, and whether the answer is right."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from gap_check.worlds import World
from sassgis.gap.causes.all_causes import GROUPS
from sassgis.gap.diagnosis import ModelGap
from sassgis.gap.fit.hypothesis_fit import CONTACT_LAW

#: Law of the sites that obey the model.
OWN_LAW = "own"


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of a site."""

    case: str  # number of the site
    verdict: str  # "none", "unknown", a family, or two joined by "+"
    effects: tuple[str, ...]  # names, of unknown ones by what they are
    strengths: tuple[str, ...]  # as measured: less than asked for where no magnitude gives that
    slope: str
    rocks: int
    kind: str  # what was observed: stations, stops, both, everything
    law: str = OWN_LAW  # how rocks move
    disturbance: str = ""  # what nature does besides, and no effect; "" if nothing

    @property
    def right(self) -> tuple[str, ...]:
        """Right answers: where the contact obeys another law, naming that is as right as none."""
        if self.part == "none" and (self.law != OWN_LAW or self.disturbance):
            return ("none", CONTACT_LAW)
        return (in_order(self.verdict),)

    @property
    def groups(self) -> frozenset[str]:
        """Groups of the known effects."""
        return frozenset(g for g, names in GROUPS.items() if {*self.effects} & {*names})

    @property
    def part(self) -> str:
        """Part of the battery: none, single, pair or unknown."""
        if self.verdict in ("none", "unknown"):
            return self.verdict
        return "pair" if "+" in self.verdict else "single"


def label_of(world: World, case: str) -> dict[str, Any]:
    """The truth of a site as plain values."""
    spec = world.spec
    return {
        "case": case,
        "seed": world.seed,
        **{key: value for key, value in asdict(spec).items() if key != "effects"},
        "verdict": spec.verdict,
        "fault_values": asdict(world.faults),
        "effects": [
            {k: round(v, 6) if isinstance(v, float) else v for k, v in asdict(e).items()}
            for e in world.effects
        ],
    }


def truth_of(label: Mapping[str, Any]) -> Truth:
    """A label in the form in which answers are scored."""
    effects = label["effects"]
    return Truth(
        verdict=label["verdict"],
        effects=tuple(effect["name"] for effect in effects),
        strengths=tuple(effect["strength"] for effect in effects),
        rocks=label["n_rocks"],
        **{key: label[key] for key in ("case", "slope", "kind", "law", "disturbance")},
    )


@dataclass(frozen=True, slots=True)
class Answer:
    """What a diagnosis answered."""

    case: str
    #: "none", "unknown", a family, or several joined by "+" in any order; "no answer" if it failed.
    effect: str
    confidence: float  # NaN if none is stated
    confusion_set: tuple[str, ...] = ()
    group: str = ""  # of the cause; "" if none is stated
    large_findings: bool = False  # whether a gap of the calibrated base is significant and large
    cannot_exclude: tuple[str, ...] = ()  # causes that the observations could not show
    failure: str = ""  # why there is no answer
    short: bool = False  # whether the model handed over falls far short, on the unsafe side
    recommended: bool = True  # whether it is recommended


def answer_from(case: str, diagnosis: Mapping[str, Any]) -> Answer:
    """Read an answer from a ``diagnosis.json``; KeyError, TypeError or ValueError if it is none."""
    verdict, advice = diagnosis["verdict"], diagnosis["advice"]
    confidence = verdict["confidence"]
    return Answer(
        case=case, effect=str(verdict["effect"]),
        confidence=math.nan if confidence is None else float(confidence),
        confusion_set=tuple(str(name) for name in verdict["confusion_set"]),
        group=str(verdict.get("group", "")),
        large_findings=not verdict["adequate"],
        cannot_exclude=tuple(verdict.get("cannot_exclude", ())),
        short=any(ModelGap(**gap).far_short for gap in advice.get("left", ())),
        recommended=advice.get("short") is None,
    )  # fmt: skip


def names_in(effect: str) -> frozenset[str]:
    """The effects that a verdict names; empty for none, unknown, contact law and no answer."""
    return frozenset(effect.split("+")) - {"none", "unknown", CONTACT_LAW, "no answer"}


def is_right(truth: Truth, answer: Answer) -> bool:
    """Whether the answer is a right one; the order of a pair does not matter."""
    return in_order(answer.effect) in truth.right


def holds(truth: Truth, answer: Answer) -> bool:
    """Whether what is answered is so: of a named effect that it acts, alone or beside another."""
    names = names_in(answer.effect)
    return names <= {*truth.effects} if names else is_right(truth, answer)


def is_covered(truth: Truth, answer: Answer) -> bool:
    """Whether the truth is in the confusion set; of a pair, one of it."""
    sets = {in_order(name) for name in answer.confusion_set}
    return bool(sets & ({*truth.right} | names_in(truth.verdict)))


def in_order(effect: str) -> str:
    """A verdict with its effects in one order."""
    return "+".join(sorted(effect.split("+")))
