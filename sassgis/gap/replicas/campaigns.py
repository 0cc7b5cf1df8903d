"""Simulated campaigns: the observed rocks released again in a model, observed in the same way.

And the numbers of a campaign that are scored.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sassgis.gap.observations.campaign import Campaign, main_blocks
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.hops import contact_numbers
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, ReleaseError
from sassgis.gap.replicas.recorded import observe
from sassgis.gap.replicas.released_rocks import all_rocks, move
from sassgis.gap.replicas.rock_lines import RockLines
from sassgis.model.grid import FloatArray
from sassgis.model.results import StopReason

#: Tables of a campaign.
TABLES = frozenset({"passages", "deposits", "impacts", "contacts"})
#: Events kept in the log of a block, by table; later ones are not seen. Contacts are counted: slow
#: rocks have many.
_MOST_EVENTS = {"impacts": 160, "contacts": 400}
#: Shares of an error along the line that rocks have at least and at most.
_AHEAD = (0.5, 1.5)
#: Times that each rock is released to count those that leave.
_COUNTED = 8


def campaigns(
    case: Case,
    rock_lines: RockLines,
    model: HypothesisModel,
    *,
    count: int,
    seed: int,
    number: int = 0,
    tables: frozenset[str] = TABLES,
    everywhere: bool = False,
) -> list[Campaign]:
    """Release the rocks of a case ``count`` times in a model.

    Parameters
    ----------
    number : int
        Campaigns of other numbers are other draws.
    tables : frozenset of str
        Those that are given, of these four.
    everywhere : bool
        Also those of which nothing was observed.

    Returns
    -------
    list of Campaign
        With these tables; errors of measurement as stated are in them.
    """
    if not everywhere:
        tables = frozenset(name for name in tables if len(case.observations.tables[name]))
    rng = np.random.default_rng([seed, number, 77])
    moved = move(
        case,
        rock_lines,
        all_rocks(with_release(case, model.release, rock_lines.end), rock_lines),
        model,
        seed=seed,
        count=count,
        first_rock=number * 64,
        log_events=max((_MOST_EVENTS.get(name, 0) for name in tables), default=0),
    )
    return observe(case, rock_lines, model, moved, count, rng, tables)


def share_left(case: Case, rock_lines: RockLines, model: HypothesisModel, seed: int) -> float:
    """Share of the rocks that still move at the edge of the terrain model, or where lines end."""
    released = all_rocks(with_release(case, model.release, rock_lines.end), rock_lines)
    moved = move(case, rock_lines, released, model, seed=seed, count=_COUNTED)
    return float((moved.rocks["reason"] == StopReason.LEFT_PROFILE).mean())


def with_release(case: Case, error: ReleaseError, end: FloatArray) -> Case:
    """The case with rocks that start elsewhere along the line, or faster; lateral offsets apart.

    ``end``: chainage before which they start (m).
    """
    blocks, start = case.blocks, case.start
    if error.faster_mps > 0.0:
        blocks = tuple(
            replace(b, speed_mps=(b.speed_mps[0], b.speed_mps[1] + error.faster_mps))
            for b in blocks
        )
    if error.ahead_m != 0.0:
        moved = np.sort(error.ahead_m * np.array(_AHEAD))
        start = np.minimum(start + moved, end[:, None] - 1.0)
    return replace(case, blocks=blocks, start=start)


def rock_quantities(case: Case, sample: Campaign) -> dict[str, FloatArray]:
    """One number per rock and quantity, NaN where there is none."""
    found: dict[str, FloatArray] = {}
    if (stops := sample.deposits) is not None:
        # -1, of rocks without one, takes the last.
        main = main_blocks(stops, case.n_rocks)
        found["stop:runout"] = np.append(stops.s, np.nan)[main]
        found["stop:aside"] = np.append(stops.lateral_m, np.nan)[main]
        own = stops.rock[stops.rock >= 0]
        found["stop:blocks"] = np.bincount(own, minlength=case.n_rocks).astype(np.float64)
    if (rows := sample.passages) is not None:
        numbers = {
            "speed": np.log(np.maximum(rows.speed_mps, 0.1)),
            "rotation": rows.rotation_hz,
            "height": rows.height_m,
            "aside": rows.lateral_m,
        }
        for k in range(len(case.station_names)):
            here = np.flatnonzero((rows.station == k) & (rows.rock >= 0))
            # The heaviest of a rock's blocks represents it.
            here = here[np.argsort(np.nan_to_num(rows.mass_kg[here]), kind="stable")]
            first = np.full(case.n_rocks, -1, np.int64)
            first[rows.rock[here]] = here
            found[f"S{k}:passed"] = (first >= 0).astype(float)
            for what, values in numbers.items():
                found[f"S{k}:{what}"] = np.append(values, np.nan)[first]
    if sample.contacts is not None:
        numbers = contact_numbers(sample.contacts, case.radius_m)
        found |= {f"contacts:{name}": values for name, values in numbers.items()}
    return found
