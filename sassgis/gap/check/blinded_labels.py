"""Labels of synthetic sites: their truth as plain values, and the hash that blinds it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

from sassgis.gap.check.answers import Truth
from sassgis.gap.check.worlds import World
from sassgis.gap.check.worlds.world import PlacedEffect
from sassgis.model.labels import rounded


def label_of(world: World, case: str) -> dict[str, Any]:
    """The truth of a site as plain values.

    Numbers have six digits: the last ones of a sum may differ from one processor to another.
    """
    spec = world.spec
    return {
        "case": case,
        "seed": world.seed,
        "slope": spec.slope,
        "rocks": spec.n_rocks,
        "kind": spec.kind,
        "law": spec.law,
        "stations": spec.n_stations,
        "named": spec.named,
        "error_factor": spec.error_factor,
        "disturbance": spec.disturbance,
        "faults": asdict(world.faults),
        "asked": [[e.name, e.strength] for e in spec.effects],
        "verdict": spec.verdict,
        "reaches": list(world.segments),
        "effects": [{**_shown(effect), "phase": effect.phase} for effect in world.effects],
    }


def _shown(effect: PlacedEffect) -> dict[str, Any]:
    values = asdict(effect)
    del values["seed"]
    return {k: rounded(v, 6) if isinstance(v, float) else v for k, v in values.items()}


def truth_of(label: dict[str, Any]) -> Truth:
    """A label in the form in which answers are scored."""
    effects = label["effects"]
    one: dict[str, Any] = effects[0] if len(effects) == 1 else {"phase": "", "segments": ()}
    return Truth(
        case=label["case"],
        verdict=label["verdict"],
        effects=tuple(effect["name"] for effect in effects),
        strengths=tuple(effect["strength"] for effect in effects),
        phase=one["phase"],
        segments=tuple(one["segments"]),
        reaches=tuple(label["reaches"]),
        slope=label["slope"],
        rocks=label["rocks"],
        kind=label["kind"],
        law=label["law"],
        disturbance=label["disturbance"],
    )


def labels_text(labels: list[dict[str, Any]]) -> str:
    """Labels as JSON that is the same for the same labels."""
    ordered = sorted(labels, key=lambda label: str(label["case"]))
    return json.dumps(ordered, sort_keys=True, indent=1) + "\n"


def blinding_hash(salt: str, text: str) -> str:
    """SHA-256 of salt and labels; the salt keeps anyone from trying out what labels may be."""
    return hashlib.sha256(f"{salt}\n{text}".encode()).hexdigest()
