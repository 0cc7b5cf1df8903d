"""Histogram bins that are wide enough for what can happen on a terrain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sassgis.model.blocks import BlockPopulation
from sassgis.model.map_run import MapRun
from sassgis.model.settings import EngineSettings
from sassgis.model.statistics_table import Bins, default_bins


def bins_of(run: MapRun) -> Bins:
    """Bins of a run on the map."""
    relief = float(np.nanmax(run.grid.values) - np.nanmin(run.grid.values))
    return bins_for(relief, run.blocks, run.engine, run.thresholds_kj)


def bins_for(
    relief_m: float,
    blocks: Sequence[BlockPopulation],
    engine: EngineSettings,
    thresholds_kj: Sequence[float] = (),
) -> Bins:
    """Bins for blocks that fall through a relief, between the highest and the lowest place (m).

    The initial drop and speed of the blocks count too; ``thresholds_kj`` are energies that hazard
    curves must have a value for.
    """
    g = engine.gravity_mps2
    drop = relief_m + max(b.drop_m[1] for b in blocks)
    speed = max(b.speed_mps[1] for b in blocks)
    mass = max(b.largest_mass_kg for b in blocks)
    energy = 1e-3 * mass * (g * drop + 0.5 * speed * speed)
    fastest = float(np.sqrt(2.0 * g * drop + speed * speed))
    return default_bins(2.0 * energy, min(drop, 300.0), min(fastest, 150.0), tuple(thresholds_kj))
