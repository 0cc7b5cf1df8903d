"""Everything that the diagnosis tries: one row for each cause.

Hypotheses, fingerprints, groups, weights, words and the tables of docs/gap.md follow from the row.
"""

from __future__ import annotations

from collections.abc import Mapping

from sassgis.gap.causes import (
    air_drag_cause,
    contact_law_cause,
    extra_blocks,
    lateral_deflection_cause,
    measurement_error_cause,
    release_error_cause,
    rock_shape_cause,
    roughness_cause,
    soft_ground_cause,
    trees_cause,
)
from sassgis.gap.causes.cause import Cause

_ROWS = (
    measurement_error_cause.CAUSE,
    release_error_cause.CAUSE,
    air_drag_cause.CAUSE,
    trees_cause.CAUSE,
    extra_blocks.FRAGMENTATION,
    extra_blocks.ENTRAINMENT,
    lateral_deflection_cause.CAUSE,
    soft_ground_cause.CAUSE,
    roughness_cause.CAUSE,
    rock_shape_cause.CAUSE,
    contact_law_cause.CAUSE,
)

#: The causes by name, in the order in which their fingerprints are listed.
CAUSES: Mapping[str, Cause] = {row.name: row for row in _ROWS}

#: Causes that are weighed against each other, by number.
FAMILIES: tuple[str, ...] = tuple(
    row.name for row in sorted(_ROWS, key=lambda row: row.number) if row.weighed
)

#: Groups of causes with similar traces.
GROUPS: Mapping[str, tuple[str, ...]] = {
    group: tuple(row.name for row in _ROWS if row.group == group)
    for group in dict.fromkeys(row.group for row in _ROWS)
}

#: Every fingerprint, and the cause that it speaks for.
STATISTICS: Mapping[str, str] = {own.name: row.name for row in _ROWS for own in row.statistics}
