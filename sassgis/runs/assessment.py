"""What zoning needs besides the rocks, and what it makes of them: hazard and risk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.hazard.assess import (
    Hazard,
    IntensityMap,
    by_area,
    curves_of,
    hazard_of,
    level_zones,
)
from sassgis.hazard.risk import RiskTable, assess_risk
from sassgis.hazard.sources import Sampled, onset_frequencies, sampled_sources
from sassgis.hazard.zoning.generalise import ZoneSettings
from sassgis.io.read.objects import (
    PlacedObjects,
    joined_objects,
    read_objects,
    read_vulnerability,
)
from sassgis.io.read.presets import read_preset
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.exposure import Vulnerability
from sassgis.model.grid import Grid
from sassgis.model.hazard import HazardPreset
from sassgis.model.run_config import Config
from sassgis.runs.inputs import collected_notices, read_map_run
from sassgis.runs.map import MapRun, bins_of
from sassgis.runs.run import Simulation


@dataclass(frozen=True, slots=True)
class Rules:
    """What zoning needs besides the rocks.

    Attributes
    ----------
    preset : HazardPreset
    frequencies : dict of (area, scenario) to float
        Blocks per year.
    placed : PlacedObjects
        Exposed objects; may be none.
    vulnerability : Vulnerability or None
    zones : ZoneSettings
    ref_width_m : float
        Reference width of all frequencies (m): one cell or more.
    notices : tuple of str
        What the readers had to say.
    """

    preset: HazardPreset
    frequencies: dict[tuple[str, str], float]
    placed: PlacedObjects
    vulnerability: Vulnerability | None
    zones: ZoneSettings
    ref_width_m: float
    notices: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Assessment:
    """What zoning found.

    Attributes
    ----------
    hazard : Hazard
        With the walls and nets there are.
    without : Hazard or None
        Without them; None if there are none or nobody asked.
    by_area : dict of str to tuple of IntensityMap
        Intensities of each release area alone; empty unless asked for.
    risk, risk_without : RiskTable or None
    bare : tuple of Sampled
        The sources as they come to a line if no barrier holds them.
    """

    hazard: Hazard
    without: Hazard | None
    by_area: dict[str, tuple[IntensityMap, ...]]
    risk: RiskTable | None
    risk_without: RiskTable | None
    bare: tuple[Sampled, ...]


def read_rules(config: Config, run: MapRun) -> Rules:
    """Read preset, frequencies and exposed objects.

    Raises
    ------
    ConfigError, InputError
    """
    preset = named_preset(config)
    frequencies = onset_frequencies(config, run)
    with collected_notices() as notices:
        parts = [
            read_objects(
                o.file, run.grid, kind=o.kind, name=o.name, layer=o.layer, name_field=o.name_field,
                fields=o.fields, defaults=o.defaults, segment_m=o.segment_m, radius_m=o.radius_m,
            )
            for o in config.objects
        ]  # fmt: skip
        placed = joined_objects(parts, config.file)
        vulnerability = None
        if len(placed):
            if config.risk.vulnerability is None:
                raise ConfigError(
                    "missing key: objects need to know what a hit does to them",
                    file=config.file,
                    field="risk.vulnerability",
                    expected="a CSV table: kind, intensity, vulnerability, lethality, source",
                )
            codes = [c.code for c in preset.intensities]
            vulnerability = read_vulnerability(config.risk.vulnerability, codes)
            vulnerability.check_covers(placed.objects)
    z = config.zones
    # Between two fall lines nothing was computed: the gap is not a place that is safe.
    gap = max(2.0 * run.grid.cell_size, run.spacing_m)
    settings = ZoneSettings(
        min_area_m2=z.min_area_m2,
        closing_m=gap if z.closing_m is None else z.closing_m,
        min_width_m=z.min_width_m,
        tolerance_m=z.tolerance_m,
    )
    width = ref_width(config, run.grid.cell_size)
    return Rules(preset, frequencies, placed, vulnerability, settings, width, tuple(notices))


def named_preset(config: Config) -> HazardPreset:
    """The preset that the configuration names.

    Raises
    ------
    InputError
        There is none, or it cannot be used.
    """
    try:
        return read_preset(config.hazard.preset)
    except InputError as error:
        if error.field != "preset":
            raise
        raise InputError(
            error.problem,
            file=error.file or config.file,
            field="hazard.preset",
            found=error.found,
            expected=error.expected,
        ) from None


def check_rules(config: Config, grid: Grid | None = None) -> list[str]:
    """Read what zoning needs, and say what it holds.

    Parameters
    ----------
    config : Config
    grid : Grid, optional
        The DEM, if it has been read already.

    Raises
    ------
    ConfigError, InputError
        As for a zoning.
    """
    run = read_map_run(config, grid=grid)
    rules = read_rules(config, run)
    yearly = sum(rules.frequencies.values())
    lines = [
        f"zoning: preset {rules.preset.name} ({rules.preset.title})",
        f"  onset: {yearly:.4g} blocks a year in all, from {len(rules.frequencies)} sources",
        f"  reference width: {rules.ref_width_m:.4g} m",
    ]
    if len(rules.placed):
        lines.append(f"  exposed objects: {len(rules.placed)}")
    return lines + [f"  note: {text}" for text in rules.notices]


def ref_width(config: Config, cell_size: float) -> float:
    """Reference width of the hazard curves (m).

    Raises
    ------
    ConfigError
        It is below two cells, and so neither one cell nor a disk of cells.
    """
    width = config.hazard.ref_width_m
    if width is None or width == cell_size:
        return cell_size
    if width < 2.0 * cell_size:
        raise ConfigError(
            "is too narrow for the cells of the terrain model",
            file=config.file,
            field="hazard.ref_width_m",
            found=f"{width:g} m with cells of {cell_size:g} m",
            expected=f"{2.0 * cell_size:g} m or more, or nothing for one cell",
        )
    return width


def assess(config: Config, rules: Rules, done: Simulation, bare: Simulation | None) -> Assessment:
    """What simulations with and without barriers say of hazard and risk."""
    energies = bins_of(done.run).threshold
    confidence = config.hazard.confidence
    grid = done.run.grid

    runs = [done] if bare is None else [done, bare]
    sampled = [sampled_sources(s.run, s.progress, rules.frequencies) for s in runs]
    curves = [curves_of(own, energies) for own in sampled]
    zones = level_zones(curves, rules.preset, grid, rules.zones)
    after, *others = (
        hazard_of(*own, rules.preset, grid, rules.zones, confidence)
        for own in zip(sampled, curves, zones, strict=True)
    )
    before = others[0] if others else None
    alone = (
        by_area(after.sampled, energies, rules.preset, grid, rules.zones)
        if config.hazard.by_source
        else {}
    )
    return Assessment(
        after,
        before,
        alone,
        risk_of(rules, after.sampled, energies),
        None if before is None else risk_of(rules, before.sampled, energies),
        (before or after).sampled,
    )


def risk_of(rules: Rules, sampled: Sequence[Sampled], energies: np.ndarray) -> RiskTable | None:
    """Risk of the exposed objects; None if there are none."""
    if rules.vulnerability is None:
        return None
    return assess_risk(
        rules.placed.objects,
        [s.source for s in sampled],
        [s.objects for s in sampled],
        energies,
        rules.preset.thresholds_kj,
        rules.vulnerability,
    )
