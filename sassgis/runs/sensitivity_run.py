"""How results change within the ranges of its ground classes: many small runs, one result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sassgis.errors import InputError
from sassgis.files.atomic_output import staged_output
from sassgis.hazard.assess import Rules
from sassgis.hazard.warnings import rule_warnings
from sassgis.inputs.ground_map import read_ranges
from sassgis.outputs.frames import write_table
from sassgis.outputs.layers.variant_layers import (
    answer_table,
    effect_table,
    range_table,
    sensitivity_layers,
)
from sassgis.outputs.raster import write_over_relief
from sassgis.report.change_report import sensitivity_report
from sassgis.report.page import translated_report, write_report
from sassgis.runs.inputs import read_rules, states_frequencies
from sassgis.runs.provenance import provenance, write_origin
from sassgis.runs.resumable_run import AnyConfig, Workplace, configured, read_job
from sassgis.runs.run import prepared
from sassgis.runs.variant_lab import VariantLab
from sassgis.settings.ground import ParameterRange, RangeRule
from sassgis.settings.languages import in_language, phrase, translated
from sassgis.simulation.loop import check_starts
from sassgis.simulation.workers import Jobs, OnProgress
from sassgis.studies import variants as study
from sassgis.studies.variants import BASE, CHANCE, RangeEffect, Variant, VariantFinding

#: Blocks of each release point in each simulation, as a share of those of the configuration.
_ROCKS_SHARE, _FEWEST_ROCKS = 0.2, 4


@dataclass(frozen=True, slots=True)
class SensitivityResult:
    """Result of a sensitivity."""

    folder: Path
    ranges: tuple[ParameterRange, ...]
    effects: tuple[RangeEffect, ...]
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

    Levels need onset frequencies; without them only reach and energy are compared. An interrupted
    call leaves what it simulated next to ``out``; the same call goes on from there.

    Parameters
    ----------
    samples : int
        Simulations with values that fill all ranges at once.
    rocks : int, optional
        Blocks of each release point in each simulation; default: a fifth of the configured ones.
    ranges : Path, optional
        Own table of ranges, before the built-in one; default: that of the configuration.
    on_progress : callable, optional
        As for sassgis.runs.run.run; counts simulations.
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
        lab = VariantLab(replace(job, run=run), rules, Workplace(work, jobs, on_progress, tell))
        varied, variants, findings = _simulated(lab, known, samples, tell)
        tell("Writing maps, tables and report")
        warnings = (*job.notices, *_warnings(rules, varied))
        names = lab.names(() if rules is None else [o.name for o in rules.placed.objects])
        simulations = zip(variants[1:], findings[1:], strict=True)
        table = study.answers(findings[0], simulations, names, run.grid.cell_size**2)
        found = study.effects(varied, table)
        maps = study.sensitivity_maps(findings, len(varied))
        preset = None if rules is None else rules.preset
        layers = sensitivity_layers(maps, varied, samples, run.grid.shape, preset)
        frames = {
            "ranges": range_table(varied),
            "effects": effect_table(found),
            "simulations": answer_table(table, varied),
        }
        for name, frame in frames.items():
            write_table(work / "tables" / f"{name}.csv", [frame])
        with in_language(config.project.language):
            write_over_relief(
                work, run.grid, layers, group="Sensitivity to the ground",
                title=translated(phrase("{}: sensitivity", config.project.name)),
                abstract="How results change within the ranges of the ground classes",
            )  # fmt: skip
            context = sensitivity_report(
                title=config.project.name,
                run=run,
                effects=found,
                maps=maps,
                layers=layers,
                samples=samples,
                blocks=findings[0].blocks,
                levels=rules is not None,
                folder=work / "figures",
            )
            facts = provenance(config) | {"Configuration": config.label}
            context = replace(context, warnings=warnings, provenance=tuple(facts.items()))
            write_report(work / "report.html", translated_report(context))
        counts = {
            "simulations": len(findings), "ranges": len(varied), "rocks_per_point": few,
            "rocks_per_simulation": findings[0].blocks,
        }  # fmt: skip
        write_origin(
            work, config, counts, warnings, seed=run.seed, grid=run.grid,
            inputs={} if ranges is None else {"ranges": ranges},
            preset="" if preset is None else preset.name,
            hazard_width_m=None if rules is None else run.ref_width_m,
            settings={} if areas is None else {"areas": sorted(areas)},
        )  # fmt: skip
    return SensitivityResult(Path(out), varied, tuple(found), len(findings), warnings)


def _simulated(
    lab: VariantLab, rules: Sequence[RangeRule], samples: int, tell: Callable[[str], None]
) -> tuple[tuple[ParameterRange, ...], list[Variant], list[VariantFinding]]:
    """Simulate base, another seed, farthest, two ends of each range met, and the filling."""
    tell("Simulating the classes as they are, and at their farthest")
    seed = lab.run.seed
    variants = [Variant(BASE), Variant(CHANCE, seed=seed + 1), study.farthest(lab.ranges(rules))]
    findings = [lab.found(v) for v in variants]
    reached = np.unique(np.concatenate([f.cells for f in findings]))
    ranges = lab.ranges(rules, reached)
    if not ranges:
        met = "ground classes " + ", ".join(lab.classes(reached))
        raise InputError("no range to vary", found=met, expected="ranges of them")
    more = [*study.ends_of(ranges), *study.filling(ranges, samples, seed)]
    lab.total = len(variants) + len(more)
    tell(f"Simulating {len(ranges)} ranges alone and {samples} points of all")
    return ranges, variants + more, findings + [lab.found(v) for v in more]


def _warnings(rules: Rules | None, ranges: Sequence[ParameterRange]) -> tuple[str, ...]:
    text = "The configuration states no onset frequency, so that hazard levels are not compared."
    out = [text] if rules is None else list(rule_warnings(rules.preset, rules.frequencies))
    assumed = sum(not r.verified for r in ranges)
    if assumed:
        text = (
            "{} of {} ranges are assumptions (tables/ranges.csv). Replace them with your table "
            "(--ranges)."
        )
        out.append(phrase(text, assumed, len(ranges)))
    return tuple(out)
