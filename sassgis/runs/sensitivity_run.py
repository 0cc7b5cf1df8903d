"""How results change within the ranges of its ground classes: many small runs, one result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sassgis.hazard.assess import Rules
from sassgis.hazard.sensitivity import (
    BASE,
    CHANCE,
    RangeEffect,
    SensitivityMaps,
    Variant,
    VariantFinding,
    design,
    effects,
    farthest,
    sensitivity_maps,
)
from sassgis.hazard.warnings import rule_warnings
from sassgis.io.atomic_output import staged_output
from sassgis.io.read.ground_map import read_ranges
from sassgis.io.write.frames import write_table
from sassgis.io.write.layers.ground_spread_maps import sensitivity_layers
from sassgis.io.write.sensitivity_tables import effect_table, range_table, simulation_table
from sassgis.model.errors import InputError
from sassgis.model.ground_ranges import ParameterRange, RangeRule
from sassgis.model.languages import in_language, phrase, translated
from sassgis.report.page import translated_report, write_report
from sassgis.report.sensitivity_report import sensitivity_report
from sassgis.runs.inputs import read_rules, states_frequencies
from sassgis.runs.job import AnyConfig, Workplace, configured, read_job
from sassgis.runs.map import check_starts
from sassgis.runs.origin import Origin, provenance, write_origin
from sassgis.runs.relief_project import write_over_relief
from sassgis.runs.variant_lab import VariantLab, classes_on, ranges_on
from sassgis.runs.workers import Jobs, OnProgress
from sassgis.runs.zone import prepared

#: Blocks of each release point in each simulation, as a share of those of the configuration.
_ROCKS_SHARE, _FEWEST_ROCKS = 0.2, 4


@dataclass(frozen=True, slots=True)
class SensitivityResult:
    """What a sensitivity left."""

    folder: Path
    ranges: tuple[ParameterRange, ...]
    effects: tuple[RangeEffect, ...]
    maps: SensitivityMaps
    simulations: int
    warnings: tuple[str, ...]


def sensitivity(
    config: AnyConfig,
    out: str | Path,
    *,
    samples: int = 32,
    rocks: int | None = None,
    ranges: Path | None = None,
    overwrite: bool = False,
    areas: Sequence[str] | None = None,
    seed: int | None = None,
    jobs: Jobs = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> SensitivityResult:
    """Simulate a configuration with the values that its ground classes might have.

    Levels need onset frequencies; without them reach and energy alone are compared.

    Parameters
    ----------
    out : path
        Folder of the result; appears whole or not at all. An interrupted call leaves what it
        simulated beside it; the same call goes on from there.
    samples : int
        Simulations with values that fill all ranges at once.
    rocks : int, optional
        Blocks of each release point in each simulation; default: a fifth of the configured ones.
    ranges : Path, optional
        Own table of ranges, before the built-in one; default: that of the configuration.
    overwrite, areas, seed, jobs, on_progress, say
        As for sassgis.runs.run.run; progress counts simulations.
    """
    config = configured(config, seed)
    tell = say or (lambda _text: None)
    with staged_output(Path(out), overwrite) as work:
        job = read_job(config, areas, tell)
        known = read_ranges(job.run.table, ranges or config.ground.ranges)
        rules = read_rules(config, job.run) if states_frequencies(config) else None
        if rules is not None:
            job = prepared(job, rules)
        given = config.release.rocks_per_point
        few = max(_FEWEST_ROCKS, round(_ROCKS_SHARE * given)) if rocks is None else rocks
        run = replace(job.run, release=replace(job.run.release, rocks_per_point=few))
        check_starts(run, job.planned.points, lambda: job.planned, config.release.file)
        place = Workplace(work, jobs, on_progress, tell)
        lab = VariantLab(replace(job, run=run), rules, place)
        varied, done = _simulated(lab, known, samples, tell)
        tell("Writing maps, tables and report")
        warnings = (*job.notices, *_warnings(rules, varied))
        grid = run.grid
        # As _simulated puts them: three, two ends of each range, the filling.
        last_end = 3 + 2 * len(varied)
        base, chance, _, *ends = (found for _, found in done[:last_end])
        filled = done[last_end:]
        names = lab.names(() if rules is None else [o.name for o in rules.placed.objects])
        cell_m2 = grid.cell_size**2
        found = effects(varied, base, chance, ends, filled, names, cell_m2)
        maps = sensitivity_maps(base, chance, ends, [finding for _, finding in filled])
        preset = None if rules is None else rules.preset
        layers = sensitivity_layers(maps, varied, len(filled), grid.shape, preset)
        with in_language(config.project.language):
            write_over_relief(
                work,
                grid,
                layers,
                group="Sensitivity to the ground",
                title=translated(phrase("{}: sensitivity", config.project.name)),
                abstract="How results change within the ranges of the ground classes",
            )
        write_table(work / "tables" / "ranges.csv", [range_table(varied)])
        write_table(work / "tables" / "effects.csv", [effect_table(found)])
        simulations = simulation_table(base, done, varied, names, cell_m2)
        write_table(work / "tables" / "simulations.csv", [simulations])
        facts = provenance(config) | {"Configuration": config.label}
        with in_language(config.project.language):
            context = sensitivity_report(
                config.project.name, run, found, maps, layers, len(filled), base.blocks, names,
                work / "figures",
            )  # fmt: skip
            context = replace(context, warnings=tuple(warnings), provenance=tuple(facts.items()))
            write_report(work / "report.html", translated_report(context))
        write_origin(
            work,
            config,
            {
                "simulations": len(done),
                "ranges": len(varied),
                "rocks_per_point": run.release.rocks_per_point,
                "rocks_per_simulation": base.blocks,
            },
            warnings,
            seed=run.seed,
            grid=grid,
            origin=Origin(
                {} if ranges is None else {"ranges": ranges},
                "" if preset is None else preset.name,
                {} if rules is None else {"hazard": run.ref_width_m},
            ),
            settings={} if areas is None else {"areas": sorted(areas)},
        )
    return SensitivityResult(Path(out), varied, tuple(found), maps, len(done), warnings)


def _simulated(
    lab: VariantLab, rules: Sequence[RangeRule], samples: int, tell: Callable[[str], None]
) -> tuple[tuple[ParameterRange, ...], list[tuple[Variant, VariantFinding]]]:
    """Find the classes that blocks may meet, and simulate the design for their ranges.

    Simulations are: the base, another seed and the farthest, two ends of each range, the filling.
    """
    run = lab.job.run
    tell("Simulating the classes as they are, and at their farthest")
    everywhere = ranges_on(run, rules, np.flatnonzero(np.isfinite(run.grid.values)))
    first = [
        (Variant(BASE, {}), None),
        (Variant(CHANCE, {}), run.seed + 1),
        (farthest(everywhere), None),
    ]
    done = [(v, lab.find(v, seed)) for v, seed in first]
    reached = np.unique(np.concatenate([f.cells for _, f in done]))
    ranges = ranges_on(run, rules, reached)
    if not ranges:
        met = classes_on(run, reached)
        raise InputError(
            "no range to vary", found=f"ground classes {', '.join(met)}", expected="ranges of them"
        )
    ends, filling = design(ranges, samples, run.seed)
    lab.total = len(first) + len(ends) + len(filling)
    tell(f"Simulating {len(ranges)} ranges alone and {samples} points of all")
    return ranges, done + [(v, lab.find(v)) for v in (*ends, *filling)]


def _warnings(rules: Rules | None, ranges: Sequence[ParameterRange]) -> tuple[str, ...]:
    out = []
    if rules is None:
        out.append(
            "The configuration states no onset frequency: reach and energy are compared, levels "
            "are not."
        )
    else:
        out += rule_warnings(rules.preset, rules.frequencies)
    assumed = sum(not r.verified for r in ranges)
    if assumed:
        text = (
            "{} of {} ranges are assumptions (tables/ranges.csv). A range in a table of your own "
            "(--ranges) replaces it."
        )
        out.append(phrase(text, assumed, len(ranges)))
    return tuple(out)
