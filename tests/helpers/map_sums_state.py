"""All sums of a simulation as arrays, to be compared bit by bit."""

from __future__ import annotations

import numpy as np

from sassgis.simulation.accumulators import Progress, joined_rows


def state(progress: Progress) -> dict[str, np.ndarray]:
    """All sums, cells in ascending order: they come in that of the chunks."""
    sums = progress.sums.state()
    order = np.argsort(sums["cells"])
    out = {f"map {k}": v[order] for k, v in sums.items()}
    out |= {f"gates {k}": v for k, v in progress.control_lines.state().items()}
    stops = joined_rows(progress.stops)
    rocks = stops.rocks
    order = np.lexsort((rocks["piece"], rocks["rock"], stops.rock_scenario, rocks["line"]))
    out |= {"reasons": progress.reasons, "runout": progress.runout}
    out |= {"rocks": rocks[order], "x": stops.x[order], "y": stops.y[order]}
    out |= {"furthest": np.array(progress.furthest), "pieces": np.array(progress.pieces)}
    for source, tally in sorted(progress.sources.items()):
        out[f"source {source} rocks"] = np.array(tally.rocks)
        for part in ("cells", "objects", "control_lines"):
            values = getattr(tally, part).state()
            out |= {f"source {source} {part} {k}": v for k, v in values.items()}
    return out


def assert_same(one: Progress, other: Progress) -> None:
    mine, theirs = state(one), state(other)
    assert mine.keys() == theirs.keys()
    for name in mine:
        assert mine[name].dtype == theirs[name].dtype
        assert mine[name].tobytes() == theirs[name].tobytes(), name
