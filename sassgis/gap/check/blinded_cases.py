"""The side of a check that knows the truth: it makes cases, labels and fresh rocks."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from pathlib import Path
from typing import Any

from sassgis.gap.check.check_scores import Truth
from sassgis.gap.check.worlds import World, WorldSpec, fresh_rocks, make_world, observe, setup
from sassgis.io.write.gap_case_files import folder_digest, write_case, write_observations

#: The campaign that is observed; fresh rocks are another one.
_CAMPAIGN = 0


def make_case(spec: WorldSpec, seed: int, case: str, folder: str) -> dict[str, Any]:
    """Make a world, and write what its observers have and know.

    Parameters
    ----------
    spec : WorldSpec
    seed : int
    case : str
        Number of the world, which tells nothing.
    folder : str
        Of the case.

    Returns
    -------
    dict
        ``label`` (see ``label_of``) and ``digest`` of the files.
    """
    world = make_world(spec, seed)
    write_world(world, Path(folder), case, spec.kind, spec.n_rocks)
    return {"label": label_of(world, case), "digest": folder_digest(Path(folder))}


def write_world(world: World, folder: Path, case: str, kind: str, n_rocks: int) -> None:
    """Let rocks go in a world and write what its observers have and know."""
    seen = observe(world, kind, n_rocks, _CAMPAIGN)  # type: ignore[arg-type]
    told = setup(world)
    write_case(
        folder,
        title=f"World {case}",
        dem=told.dem,
        class_names=told.class_names,
        class_codes=told.class_codes,
        releases=told.releases,
        blocks=told.blocks,
        tables=seen.tables,
        metadata=seen.metadata,
    )


def make_label(spec: WorldSpec, seed: int, case: str) -> dict[str, Any]:
    """The label alone, from a world that is made anew."""
    return label_of(make_world(spec, seed), case)


def make_fresh(spec: WorldSpec, seed: int, rocks: int, folder: str) -> None:
    """Let fresh rocks go in a world that is made anew, and write what a case of it shows.

    Of the same kind of observations as the case: the same quantities are compared.
    """
    world = make_world(spec, seed)
    fresh = fresh_rocks(world, rocks)
    names = observe(world, spec.kind, 1, _CAMPAIGN).tables  # type: ignore[arg-type]
    shutil.rmtree(folder, ignore_errors=True)
    tables = {name: table for name, table in fresh.tables.items() if name in names}
    write_observations(Path(folder), tables, fresh.metadata)


def label_of(world: World, case: str) -> dict[str, Any]:
    """The truth of a world as plain values.

    Numbers have six digits: the last ones of a sum may differ from one processor to another.
    """
    spec = world.spec
    return {
        "case": case,
        "seed": world.seed,
        "slope": spec.slope,
        "rocks": spec.n_rocks,
        "kind": spec.kind,
        "asked": [[e.name, e.strength] for e in spec.effects],
        "verdict": spec.verdict,
        "legs": list(world.segments),
        "effects": [
            {
                "name": effect.name,
                "strength": effect.strength,
                "magnitude": _rounded(effect.magnitude),
                "size": _rounded(effect.size),
                "phase": effect.phase,
                "s0_m": _rounded(effect.s0_m),
                "s1_m": _rounded(effect.s1_m),
                "segments": list(effect.segments),
                "ground": effect.ground,
            }
            for effect in world.effects
        ],
    }


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
        legs=tuple(label["legs"]),
        slope=label["slope"],
        rocks=label["rocks"],
        kind=label["kind"],
    )


def labels_text(labels: list[dict[str, Any]]) -> str:
    """Labels as JSON that is the same for the same labels."""
    ordered = sorted(labels, key=lambda label: str(label["case"]))
    return json.dumps(ordered, sort_keys=True, indent=1) + "\n"


def seal_of(salt: str, text: str) -> str:
    """SHA-256 of salt and labels; the salt keeps anyone from trying out what labels may be."""
    return hashlib.sha256(f"{salt}\n{text}".encode()).hexdigest()


def _rounded(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None
