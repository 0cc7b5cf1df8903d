"""The report of a diagnosis: the answer in plain words, figures, tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import sassgis
from sassgis.gap import words
from sassgis.gap.diagnosis import (
    Advice,
    Diagnosis,
    GapFinding,
    ModelGap,
    Rung,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.verdict.verdict import (
    is_stretch,
    limits_on,
    line_stretch,
    observed_end,
    used_lines,
)
from sassgis.grid import FloatArray
from sassgis.report import gap_answer
from sassgis.report.figures.gap_figures import (
    GapMap,
    GapStretch,
    gap_distributions_figure,
    gap_hypotheses_figure,
    gap_ladder_figure,
    gap_map_figure,
    gap_where_figure,
)
from sassgis.report.page import Cell, ReportContext, ReportFigure, ReportTable, sensible, table_of
from sassgis.report.pictures import picture
from sassgis.settings.ground import PARAMETERS, GroundTable
from sassgis.settings.languages import Phrase, capital, counted, joined, phrase, translated
from sassgis.settings.results import ground_name

#: Below this number of rocks the report warns of it.
FEW_ROCKS = 20
#: Findings in the table of the report.
_ROWS = 40
#: In place of values that are not distinguishable from chance.
CHANCE = phrase("chance")


def report_warnings(case: Case, diagnosis: Diagnosis) -> list[str]:
    """Warn of what a reader must know before trusting the answer."""
    out: list[str] = []
    verdict = diagnosis.verdict
    if diagnosis.rocks < FEW_ROCKS:
        text = "Only {} rocks were observed. Intervals are wide, and effects may remain undetected."
        out.append(phrase(text, diagnosis.rocks))
    if verdict.effect not in gap_answer.UNNAMED and verdict.rivals:
        names = gap_answer.effect_names((verdict.effect, *verdict.rivals))
        out.append(phrase("These data allow several explanations: {}.", names))
    if diagnosis.effect.stand is not None:
        out.append(
            "The forest of the calibrated model is fitted to the observations. Compare it with "
            "the real forest."
        )
    left_out = sum(bool(f.left_out) for f in case.observations.findings)
    if left_out:
        one = (
            "{} problem in the observations excludes values, rows or tables. List it with sassgis "
            "gap validate."
        )
        more = (
            "{} problems in the observations exclude values, rows or tables. List them with "
            "sassgis gap validate."
        )
        out.append(counted(left_out, one, more, left_out))
    return out


def headline(findings: Iterable[GapFinding]) -> GapFinding | None:
    """Return the finding to map: the most important quantity among those beyond chance."""
    placed = [f for f in findings if math.isfinite(f.gap) and math.isfinite(f.s0_m)]

    def rank(finding: GapFinding) -> tuple[bool, bool, int, float, float]:
        known = finding.quantity in gap_answer.MATTERS
        return (
            words.significance(finding) == "open",
            finding.place == "all" or finding.place.startswith("ground:"),
            gap_answer.MATTERS.index(finding.quantity) if known else len(gap_answer.MATTERS),
            finding.p_adjusted,
            finding.q_value,
        )

    return min(placed, key=rank, default=None)


def map_parts(
    case: Case, diagnosis: Diagnosis
) -> tuple[list[FloatArray], dict[str, GapMap], GapFinding | None]:
    """Return fall lines, the gap of each model along them, and the main finding."""
    end = 1.1 * observed_end(case)
    lines = [line_stretch(case.traces, i, 0.0, end) for i in used_lines(case)]
    by_model = {
        "as configured": diagnosis.where_configured, "calibrated base model": diagnosis.where
    }  # fmt: skip
    by_model = {name: found for name, found in by_model.items() if found} or {"": ()}
    first = headline(finding for found in by_model.values() for finding in found)
    return lines, {name: _gap_map(case, own, first) for name, own in by_model.items()}, first


def _gap_map(case: Case, findings: Iterable[GapFinding], first: GapFinding | None) -> GapMap:
    """Return stretches and stations with the gap of the main quantity."""
    chosen = _one_per_place(findings, first)
    stretches = [
        GapStretch(trace, f.gap, words.significance(f) != "open")
        for f in chosen
        if is_stretch(f)
        for i in used_lines(case)
        if len(trace := line_stretch(case.traces, i, *limits_on(case, f, i))) > 1
    ]
    gaps = {f.place: (f.gap, words.significance(f) != "open") for f in chosen if not is_stretch(f)}
    table = case.observations.stations
    stations = {
        name: GapStretch(vertices, *gaps.get(name, (math.nan, False)))
        for name, vertices in zip(table.station.tolist(), table.vertices, strict=True)
    }
    return GapMap(stretches, stations)


def _one_per_place(findings: Iterable[GapFinding], first: GapFinding | None) -> list[GapFinding]:
    """Keep the most certain finding of the main quantity at each place, of its phase first."""
    if first is None:
        return []
    same = [
        f
        for f in findings
        if (f.quantity, f.unit) == (first.quantity, first.unit)
        and not f.place.startswith("ground:")
        and math.isfinite(f.gap)
    ]

    def rank(finding: GapFinding) -> tuple[bool, float, float]:
        return (finding.phase != first.phase, finding.p_adjusted, finding.q_value)

    return [
        min((f for f in same if f.place == place), key=rank)
        for place in dict.fromkeys(f.place for f in same)
    ]


def gap_figures(case: Case, diagnosis: Diagnosis, folder: Path) -> list[ReportFigure]:
    """Draw the figures of a diagnosis into ``folder``."""
    verdict = diagnosis.verdict
    out: list[ReportFigure] = []

    def add(name: str, title: str, caption: str, make: Callable[[], Figure]) -> None:
        out.append(picture(folder, name, title, caption, make))

    lines, maps, first = map_parts(case, diagnosis)
    table = case.observations
    release = np.column_stack([table.rocks.x, table.rocks.y])
    stops = np.column_stack([table.deposits.x, table.deposits.y])
    caption = "No gap can be placed along the fall lines."
    if first is not None and any(own.known for own in maps.values()):
        text = (
            "{}. A line across the slope shows the gap at a station, a line down the slope that "
            "on a reach. On a reach, simulated rocks usually start with the state observed at its "
            "top. Errors from above do not count again."
        )
        caption = phrase(text, capital(words.quantity_name(first.quantity)))
    drawn = partial(
        gap_map_figure,
        case.grid,
        lines=lines,
        maps=maps,
        release=np.unique(release[np.isfinite(release).all(axis=1)], axis=0),
        stops=stops[np.isfinite(stops).all(axis=1)],
        quantity=first.quantity if first is not None else "",
        unit=first.unit if first is not None else "",
    )
    add("gap_map", "Where the gap lies", caption, drawn)
    if diagnosis.where:
        add(
            "gap_where",
            "All comparisons",
            "Observed minus predicted, by place and phase.",
            partial(gap_where_figure, diagnosis.where, diagnosis.where_configured),
        )
    if diagnosis.comparisons:
        named = verdict.effect if verdict.effect not in gap_answer.UNNAMED else ""
        add(
            "gap_distributions",
            "Observed rocks and the models",
            "Step curves: observed rocks, unsmoothed. A step curve within the pale band is "
            "compatible with the base model.",
            partial(gap_distributions_figure, diagnosis.comparisons, effect=named),
        )
    if diagnosis.ladder and not gap_answer.nothing_changed(diagnosis):
        add(
            "gap_ladder",
            "How far the gap shrinks",
            "Distance between model and observed rocks, model by model. Each rock is compared "
            "with a model that was fitted without it.",
            partial(gap_ladder_figure, diagnosis.ladder),
        )
    if diagnosis.which or verdict.ranked:
        add(
            "gap_hypotheses",
            "Causes, most likely first",
            "The base model and the most probable causes were calibrated more finely than the "
            "others. All scores are those of held-out rocks.",
            partial(
                gap_hypotheses_figure,
                diagnosis.which,
                probabilities=verdict.ranked,
                verdict=verdict.effect,
                rivals=verdict.rivals,
            ),
        )
    return out


def gap_tables(case: Case, diagnosis: Diagnosis) -> list[ReportTable]:
    """Return tables of a diagnosis: where, which, how far, calibrated ground, data."""
    named = gap_answer.hypothesis_of(diagnosis.which, diagnosis.verdict.effect)
    parameters = {} if named is None else named.parameters
    return [
        _causes_table(diagnosis),
        _where_table("Where the gap lies with the configured model", diagnosis.where_configured),
        _where_table("Where the gap lies after calibration", diagnosis.where),
        table_of(
            "Calibrated models",
            "effect; form; score; gain; 95 % interval",
            (
                (
                    words.effect_name(c.effect),
                    c.form or "–",
                    c.score,
                    c.gain,
                    gap_answer.interval_text(c.ci95),
                )
                for c in diagnosis.which
            ),
            "Score: energy score of held-out rocks; lower is better. Gain: reduction of the score "
            "compared with the base model; for another contact law, with the calibrated ground.",
        ),
        table_of(
            phrase(
                "Calibrated parameters of the answer: {}",
                words.effect_name(diagnosis.verdict.effect),
            ),
            "parameter; value; 95 % interval",
            (
                (name, value, _interval_cell(named.intervals.get(name) if named else None))
                for name, value in parameters.items()
            ),
            "Units are part of the names.",
        ),
        _ladder_table(diagnosis.ladder),
        _gaps_table(diagnosis.advice),
        _shrinkage_table(diagnosis),
        _ground_table(case.table, diagnosis.effect.table),
        table_of(
            "Observations used",
            "table; rows",
            ((name, int(n)) for name, n in diagnosis.tables.items()),
        ),
    ]


def _ladder_table(ladder: tuple[Rung, ...]) -> ReportTable:
    return table_of(
        "Distance to the observed rocks by model",
        "model; energy distance; share of the gap closed | %; 95 % interval | %; added to; gain; "
        "95 % interval of the gain",
        (
            (
                words.rung_name(r.rung),
                CHANCE if words.is_chance(r, ladder) else r.distance,
                _unless_chance(_closed(r.share), r.ci95),
                _interval_cell(
                    r.ci95 and (words.closed_percent(r.ci95[0]), words.closed_percent(r.ci95[1])),
                    2,
                ),
                words.rung_name(r.over) if r.over else "–",
                _unless_chance(r.gain, r.gain_ci95),
                _interval_cell(r.gain_ci95, 2),
            )
            for r in ladder[:-1]
        ),
        "Each rock is compared with a model that was chosen and fitted without it. Energy "
        "distance: unbiased; zero on average where only chance remains; “chance”: not "
        "distinguishable from zero. Share closed: part of the gap of the configured model beyond "
        "chance; a dash: that gap may be chance. Gain: reduction of the distance compared with the "
        "model in “added to”. A model whose interval contains zero is not recommended.",
    )


def _unless_chance(value: float | None, span: tuple[float, float] | None) -> Cell:
    """Return a number whose interval clears zero from below; else that it may be chance."""
    return CHANCE if span is not None and span[0] <= 0.0 else value


def _quantity(gap: GapFinding | ModelGap) -> str:
    return words.with_unit_in_brackets(words.quantity_name(gap.quantity), gap.unit)


def _gaps_table(advice: Advice) -> ReportTable:
    left = {g.key: g for g in advice.left}

    def cells(gap: ModelGap | None) -> tuple[Cell, ...]:
        if gap is None:
            return "–", "–", "–"
        side = phrase(gap.side or "–")
        if gap.side and not gap.counts:
            side = phrase("({})", side)
        return gap.predicted, _with_interval(gap.gap, gap.ci95), side

    return table_of(
        "Observed rocks, configured model and calibrated model",
        "place; quantity; observed; relevant from; configured; gap | 95 % interval; side; "
        "calibrated model; gap | 95 % interval; side",
        (
            (
                words.place_name(g.place),
                joined(", ", (_quantity(g), phrase(g.statistic))),
                g.observed, g.limit, *cells(g), *cells(left.get(g.key)),
            )
            for g in advice.compared
        ),
        phrase(
            "Calibrated model: {}, on held-out rocks. Gap: observed minus predicted; above zero "
            "the model is unsafe. In brackets: significant but below the relevant size. "
            "Interval: rocks resampled. Width: from the 10 % to the 90 % quantile. Energy: "
            "translation.",
            words.rung_name(advice.recommended),
        ),
    )  # fmt: skip


def _with_interval(value: float, span: tuple[float, float]) -> Phrase:
    return phrase("{} ({})", sensible(value, 2), gap_answer.interval_text(span, 2))


def _closed(share: float | None) -> float | None:
    return None if share is None else words.closed_percent(share)


def _interval_cell(span: tuple[float, float] | None, digits: int = 3) -> str:
    return "–" if span is None else gap_answer.interval_text(span, digits)


def _where_table(title: str, findings: tuple[GapFinding, ...]) -> ReportTable:
    note = phrase(
        "Gap: observed minus predicted, mean over rocks. Interval: rocks resampled. p: "
        "probability that chance makes any of these gaps as large. q: false discovery rate. Tests: "
        "“free run” simulates from the release, “reach” from the state observed at its top, “one "
        "step” from one observed state to the next."
    )
    if len(findings) > _ROWS:
        more = phrase("The {} most certain of {}; all are in diagnosis.json.", _ROWS, len(findings))
        note = joined(" ", (note, more))
    return table_of(
        title,
        "place; phase; quantity; observed; predicted; gap | 95 % interval; p; q; rocks; test",
        (
            (
                words.place_name(f.place), f.phase,
                _quantity(f), f.observed,
                f.predicted, _with_interval(f.gap, f.ci95),
                gap_answer.p_text(f.p_adjusted), gap_answer.p_text(f.q_value), f.rocks, f.test,
            )
            for f in findings[:_ROWS]
        ),
        note,
    )  # fmt: skip


def _causes_table(diagnosis: Diagnosis) -> ReportTable:
    verdict = diagnosis.verdict
    separated = dict.fromkeys(verdict.rivals, "no")
    separated[verdict.effect] = "the answer"
    gains = {gain.effect: gain for gain in diagnosis.gains}
    return table_of(
        "Causes, most likely first",
        "cause; probability | %; distinguished from the answer; share of the remaining gap "
        "closed | %; z; detection rate | %",
        (
            (
                words.effect_name(name),
                100.0 * min(p, words.MOST_SURE),
                separated.get(name, "yes"),
                *((100.0 * g.share, g.sureness, 100.0 * g.power) if (g := gains.get(name))
                  else (None, None, None)),
            )
            for name, p in verdict.ranked.items()
        ),
        "Share closed: part of the gap that the cause closes after the ground is recalibrated. "
        "The gap is that of the base model with free contact, in means, scatters and trends over "
        "all rocks. z: standard errors above what chance gives with the base model. Detection "
        "rate: share of strong draws of the cause that these data would show.",
    )  # fmt: skip


def _distance(value: float | None, floor: float | None, chance: bool = False) -> Cell:
    """Return a distance, or that it is not distinguishable from chance."""
    if value is None or math.isnan(value):
        return None
    return CHANCE if chance or value <= max(floor or 0.0, 0.0) else value


def _shrinkage_table(diagnosis: Diagnosis) -> ReportTable:
    s = diagnosis.shrinkage
    added = s.effect not in gap_answer.UNNAMED
    rows: list[tuple[Cell, ...]] = [
        (
            words.quantity_name(quantity),
            _distance(v.get("base"), v.get("floor"), v.get("shrinkage") is None),
            _distance(v.get("effect"), v.get("floor")),
            _closed(v.get("shrinkage")),
        )
        for quantity, v in s.by_quantity.items()
    ]
    enough = s.ci95 is not None and s.ci95[1] >= 1.0
    together = (
        _distance(s.distance_base, s.distance_floor, s.value is None),
        _distance(s.distance_effect, s.distance_floor, enough),
        _unless_chance(_closed(s.value), s.ci95),
    )
    return table_of(
        phrase("How far the gap shrinks with {}", words.effect_name(s.effect)),
        "quantity; base model | energy distance; with the effect; reduction | %",
        (*rows, ("all together", *together)) if added else (),
        "On held-out rocks. Reduction: (base − effect) / (base − chance). “chance”: not "
        "distinguishable from it; a dash: the base model is not distinguishable from chance.",
    )


def _ground_table(before: GroundTable, after: GroundTable) -> ReportTable:
    old = {c.name: c for c in before.classes}
    rows = []
    for own in after.classes:
        first = old.get(own.name, own)
        pairs = [(getattr(first, n), getattr(own, n)) for n in PARAMETERS]
        if any(a != b for a, b in pairs):
            cells = (f"{a:.3g} → {b:.3g}" if a != b else f"{a:.3g}" for a, b in pairs)
            rows.append((ground_name(own.name), *cells))
    return table_of(
        "Calibrated ground classes",
        "class; η max; Δp/p least; Δp/p most; μ_f; μ_0; k; d* | m; e; speed at e/2 | m/s; "
        "rolling threshold; speed loss",
        rows,
        "Configured → calibrated, including the named effect, if any. Only changed classes are "
        "listed.",
    )


def gap_report(
    case: Case,
    diagnosis: Diagnosis,
    folder: Path,
    *,
    project: str,
    terrain: str,
    crs: str,
    configuration: str,
    warnings: Sequence[str],
) -> ReportContext:
    """Draw the figures into ``folder`` and put the report together."""
    rows, columns = case.grid.shape
    cells = phrase(
        "{}, {} × {} cells of {} m", terrain, columns, rows, f"{case.grid.cell_size:.4g}"
    )
    tried = gap_answer.effect_names(c.effect for c in diagnosis.which)
    tables = [phrase("{}: {}", phrase(name), int(n)) for name, n in diagnosis.tables.items()]
    said = filter(None, (phrase(diagnosis.first_sentence), gap_answer.verdict_sentence(diagnosis)))
    return ReportContext(
        title=translated(phrase("{}: observed and simulated rocks", project)),
        subtitle="Differences between field observations and the SASS model, and their causes",
        verdict=joined(" ", said),
        answer=gap_answer.answer(diagnosis),
        warnings=tuple(warnings),
        what_was_run=(
            ("Observed rocks", diagnosis.rocks),
            ("Observations", joined(", ", tables) or "none"),
            ("Terrain", cells),
            ("Coordinate system", crs),
            ("Fall lines", len(used_lines(case))),
            ("Stations", joined(", ", case.station_names) or "none"),
            ("Effects already configured", joined(", ", case.effects.names) or "none"),
            ("Explanations tested", tried or "none"),
        ),
        figures=tuple(gap_figures(case, diagnosis, folder)),
        tables=tuple(gap_tables(case, diagnosis)),
        provenance=(
            ("Program", f"sassgis {sassgis.__version__}"),
            ("Seed", str(diagnosis.seed)),
            ("Settings and inputs (SHA-256)", diagnosis.settings_hash),
            ("Configuration", configuration),
            ("Calibrated model", "model/config.toml"),
        ),
    )
