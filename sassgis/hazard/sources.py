"""The sources of a run with their onset frequencies: what hazard curves are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sassgis.errors import ConfigError, InputError
from sassgis.grid import Grid
from sassgis.settings.hazard_rules import Onset, Source, SourceCounts
from sassgis.settings.map_run import MapRun, ReleaseArea
from sassgis.settings.schema import Input
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.control_lines import ControlLineSums

_HECTARE_M2 = 1e4
_PLACE = {"per_year_ha": "release polygons", "per_year_m": "release lines"}


@dataclass(frozen=True, slots=True)
class Sampled:
    """Simulated blocks of one source."""

    source: Source
    # Places are flat indices of cells, and numbers of exposed objects.
    cells: SourceCounts
    objects: SourceCounts
    control_lines: ControlLineSums  # at stations and barriers


def onset_frequencies(
    areas: Sequence[ReleaseArea],
    onsets: Mapping[str, Onset],
    table: Mapping[tuple[str, str], Onset],
    table_file: Input | None,
    config_file: Path | None,
) -> dict[tuple[str, str], float]:
    """Return blocks released per year, by release area and block scenario.

    ``onsets`` are by scenario; those of single sources from a table, if there is one, go before
    them. Raises ConfigError for a scenario that is released somewhere without a frequency,
    InputError for a unit that does not go with the shape of an area.
    """
    annual = {}
    for area in areas:
        for scenario in area.scenarios:
            single = table.get((area.name, scenario))
            onset = onsets[scenario]
            if single is not None:
                onset = replace(single, share=onset.share)
            if onset.frequency is None:
                raise ConfigError(
                    "missing key: zones need to know how often blocks are released",
                    file=config_file,
                    field=f"blocks[{scenario}].onset_frequency",
                    expected="a number 0 or more"
                    + (f", or a row for {area.name} in {table_file.name}" if table_file else ""),
                )
            size = _size(area, onset)
            if size == 0.0:
                raise InputError(
                    f"release area {area.name} has no extent for this unit",
                    file=config_file if single is None else table_file,
                    field=f"blocks[{scenario}].onset_unit" if single is None else "unit",
                    found=f"{onset.unit}, {area.geometry.geom_type}",
                    expected=f"{_PLACE[onset.unit]}, or per_year",
                )
            annual[area.name, scenario] = onset.frequency * onset.share * size
    return annual


def _size(area: ReleaseArea, onset: Onset) -> float:
    """Return the factor of the frequency: the extent of the ground from which blocks start."""
    if onset.unit == "per_year_ha":
        return area.known * float(area.geometry.area) / _HECTARE_M2
    if onset.unit == "per_year_m":
        return 0.0 if area.geometry.area > 0.0 else area.known * float(area.geometry.length)
    return 1.0


def sampled_sources(
    run: MapRun, progress: Progress, frequencies: dict[tuple[str, str], float] | None
) -> list[Sampled]:
    """Return every source of a run with its counts, areas in their order, scenarios within them.

    Without frequencies the rate of each block is 1.
    """
    out = []
    for (area, scenario), tally in sorted(progress.sources.items()):
        blocks = run.blocks[scenario]
        name = run.areas[area].name
        started = float(tally.rocks - tally.never_started)
        source = Source(
            name,
            blocks.name,
            started if frequencies is None else frequencies[name, blocks.name],
            tally.rocks,
            run.release.rocks_per_point,
            run.release.placement == "random",
            blocks.mean_width_m,
            tally.never_started,
            tally.heaviest,
        )
        cells = on_known_terrain(tally.cells.counts(), run.grid)
        out.append(Sampled(source, cells, tally.objects.counts(), tally.control_lines))
    return out


def on_known_terrain(counts: SourceCounts, grid: Grid) -> SourceCounts:
    """Return counts without cells of unknown height, which nearby blocks count for as well."""
    known = np.isfinite(grid.values.ravel()[counts.places])
    if known.all():
        return counts
    return SourceCounts(counts.places[known], counts.count[known], counts.square[known])
