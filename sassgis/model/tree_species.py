"""Built-in energy ratios of tree species: what a stem takes over what one of fir takes."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib import resources

#: Power of the diameter at breast height with which the energy that a stem takes grows.
ENERGY_EXPONENT = 2.31


@cache
def energy_ratios() -> Mapping[str, float]:
    """Ratio by species, from sassgis/data/tree_species.csv, which has the sources."""
    file = resources.files("sassgis").joinpath("data", "tree_species.csv")
    rows = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    return {row["species"]: float(row["energy_ratio"]) for row in rows}
