"""Built-in energy ratios of tree species: what a stem takes over what one of fir takes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from sassgis.model.built_in_rows import built_in_rows

#: Power of the diameter at breast height with which the energy that a stem takes grows.
ENERGY_EXPONENT = 2.31


@cache
def energy_ratios() -> Mapping[str, float]:
    """Ratio by species, from sassgis/data/tree_species.csv, which has the sources."""
    return {row["species"]: float(row["energy_ratio"]) for row in built_in_rows("tree_species")}
