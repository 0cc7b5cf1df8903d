"""The report of a diagnosis: the answer in plain words, figures, tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

import sassgis
from sassgis.gap.diagnosis import Diagnosis, GapFinding, Hypothesis, Shrinkage
from sassgis.gap.observations.case import Case
from sassgis.gap.where.places import (
    is_stretch,
    limits_on,
    line_stretch,
    observed_end,
    used_lines,
)
from sassgis.gap.which.classifier import PAIR, UNKNOWN
from sassgis.gap.words import (
    effect_name,
    effect_phrase,
    place_words,
    quantity_name,
    significance,
    tested_by,
    with_unit,
    with_unit_in_brackets,
)
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable
from sassgis.report import figures
from sassgis.report.figures.gap_figures import GapStretch
from sassgis.report.map_report import save_figure
from sassgis.report.page import (
    Cell,
    ReportAnswer,
    ReportContext,
    ReportFigure,
    ReportTable,
    sensible,
)

#: Findings that are told in a sentence.
_TOLD = 4
#: Below this number of rocks the report warns of it.
_FEW_ROCKS = 20
#: What the map shows, if it is told from chance somewhere: reach and energy before the rest.
_MATTERS = ("speed_mps", "runout_m", "energy_kept", "height_m", "rotation_hz", "lateral_m")
#: Findings in the table of the report.
_ROWS = 40

# --- the answer ------------------------------------------------------------------------------


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The answer in one or two sentences."""
    verdict = diagnosis.verdict
    sure = f"Confidence {100 * verdict.confidence:.0f} %."
    if verdict.effect == "none":
        return (
            "No effect has to be added: once the ground is calibrated, what is left between "
            f"observed and simulated rocks is no more than chance among {diagnosis.rocks} rocks. "
            f"{sure}"
        )
    if verdict.effect == "unknown":
        return (
            "There is a gap that calibrating the ground does not close, and none of the known "
            f"effects can be named as its cause. {sure}"
        )
    return f"The gap is best explained by {effect_phrase(verdict.effect)}. {sure}"


def answer(diagnosis: Diagnosis) -> tuple[ReportAnswer, ...]:
    """What the diagnosis says, in sentences."""
    return (
        _why(diagnosis),
        _confused(diagnosis),
        _where(diagnosis.where),
        _how_far(diagnosis.shrinkage, diagnosis.verdict.effect),
        ReportAnswer("What these data cannot tell", (), diagnosis.not_identifiable),
    )


def _why(diagnosis: Diagnosis) -> ReportAnswer:
    verdict = diagnosis.verdict
    out = [_sentence(verdict.reason)] if verdict.reason else []
    if verdict.phase or verdict.segments:
        place = " and ".join(place_words(s) for s in verdict.segments)
        acts = f"It acts in the phase “{verdict.phase}”" if verdict.phase else "It acts"
        out.append(f"{acts}{' ' + place if place else ''}.")
    share = round(100 * verdict.confidence)
    out.append(
        f"A confidence of {share} % is cautious: it is set so that on made slopes whose cause is "
        "known answers with 60 % and more are right nine times in ten (whether they were: "
        "docs/gap_check.md). No real slope is like those: take it as what to look at first, not as "
        "found."
    )
    named = _hypothesis(diagnosis.which, verdict.effect)
    if named is not None and verdict.effect not in ("none", "unknown"):
        interval = (
            f"(95 % interval {_interval(named.ci95)}; the score of the calibrated base model is "
            f"{sensible(named.score + named.gain)})"
        )
        if named.gain > 0.0:
            gain = sensible(named.gain)
            out.append(f"With it, single rocks left out are predicted better by {gain} {interval}.")
        else:
            out.append(
                f"Single rocks left out are not predicted better with it {interval}: what speaks "
                "for it are patterns over all rocks, such as trends, scatter and single impacts."
            )
    return ReportAnswer("How sure this is", tuple(out))


def _hypothesis(which: Iterable[Hypothesis], effect: str) -> Hypothesis | None:
    return next((c for c in which if c.effect == effect), None)


def _confused(diagnosis: Diagnosis) -> ReportAnswer:
    verdict = diagnosis.verdict
    others = [e for e in verdict.confusion_set if e != verdict.effect]
    if not others:
        sentences = ["None of the other explanations that were tried remains possible."]
    else:
        sentences = [
            "These data cannot tell it from: " + ", ".join(effect_name(e) for e in others) + "."
        ]
    if diagnosis.measure_next and others:
        sentences.append("What would tell them apart:")
    elif diagnosis.measure_next:
        sentences.append("What would make it surer:")
    return ReportAnswer("What it may be mistaken for", tuple(sentences), diagnosis.measure_next)


def finding_sentence(finding: GapFinding) -> str:
    """A finding as a reader wants it: where, what, how much, how sure."""
    more = "more" if finding.gap > 0.0 else "less"
    low, high = sorted(abs(v) for v in finding.ci95)
    both = finding.ci95[0] * finding.ci95[1] > 0.0
    span = (
        f"{sensible(low, 2)} to {sensible(high, 2)}" if both else _interval(finding.ci95, digits=2)
    )
    place = place_words(finding.place)
    return (
        f"{_capital(quantity_name(finding.quantity))} {place}: observed "
        f"{with_unit(sensible(finding.observed), finding.unit)}, predicted "
        f"{with_unit(sensible(finding.predicted), finding.unit)}, that is "
        f"{with_unit(sensible(abs(finding.gap), 2), finding.unit)} {more} "
        f"(95 % interval {span}; {finding.rocks} rocks; {tested_by(finding.test)}; "
        f"p {_p(finding.p_adjusted)})."
    )


def _where(findings: tuple[GapFinding, ...]) -> ReportAnswer:
    heading = "Where the gap lies"
    if not findings:
        return ReportAnswer(heading, ("Nothing could be compared place by place.",))
    sure = [f for f in findings if significance(f) == "sure"]
    likely = [f for f in findings if significance(f) == "likely"]
    if not sure:
        text = (
            f"Of {len(findings)} comparisons by place, phase and quantity none differs by more "
            "than chance would let one of so many differ: the gap, if there is one, cannot be "
            "placed."
        )
        if likely:
            text += f" {len(likely)} are likely (see the figure)."
        return ReportAnswer(heading, (text,))
    told = _one_per_quantity(sure)[:_TOLD]
    text = (
        f"{len(sure)} of {len(findings)} comparisons differ by more than chance would let one of "
        "so many differ"
        + (f", {len(likely)} more are likely" if likely else "")
        + (". The most certain, one of each quantity:" if len(sure) > len(told) else ":")
    )
    return ReportAnswer(heading, (text,), tuple(finding_sentence(f) for f in told))


def _one_per_quantity(findings: Iterable[GapFinding]) -> list[GapFinding]:
    """The most certain finding of each quantity; those that matter most for the hazard first."""
    found: dict[str, GapFinding] = {}
    for finding in sorted(findings, key=lambda f: f.p_adjusted):
        found.setdefault(finding.quantity, finding)
    order = [q for q in _MATTERS if q in found] + [q for q in found if q not in _MATTERS]
    return [found[q] for q in order]


def _how_far(shrinkage: Shrinkage, effect: str) -> ReportAnswer:
    heading = "How far the gap shrinks"
    left = (
        f"Energy distance to the observed rocks: {sensible(shrinkage.distance_base)} with the "
        f"calibrated base model, {sensible(shrinkage.distance_effect)} with "
        f"{effect_name(shrinkage.effect)}, {sensible(shrinkage.distance_floor)} is the least that "
        "chance leaves."
    )
    note = (_sentence(shrinkage.note),) if shrinkage.note else ()
    if effect in ("none", "unknown") and shrinkage.effect in ("none", "unknown", ""):
        base = (
            f"No effect was named that could be added. The energy distance of the calibrated base "
            f"model to the observed rocks is {sensible(shrinkage.distance_base)}; "
            f"{sensible(shrinkage.distance_floor)} is the least that chance leaves."
        )
        return ReportAnswer(heading, (base, *note))
    if shrinkage.value is None:
        first = (
            "By what share the gap shrinks is not given, as the gap itself is not surely above "
            "what chance leaves."
        )
    else:
        span = (
            ""
            if shrinkage.ci95 is None
            else f" (95 % interval {_share(shrinkage.ci95[0])} to {_share(shrinkage.ci95[1])})"
        )
        first = (
            f"With {effect_name(shrinkage.effect)} added, {_share(shrinkage.value)} of the gap "
            f"that is not chance closes{span}, on rocks that were not used to fit it."
        )
    return ReportAnswer(heading, (first, left, *note))


def _sentence(text: str) -> str:
    text = text.strip()
    text = _capital(text)
    return text if text.endswith((".", "!", "?")) else text + "."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _share(value: float) -> str:
    return f"{100 * value:.0f} %".replace("-", "\u2212")


def _interval(span: tuple[float, float], digits: int = 3) -> str:
    # Not to be broken at the end of a line.
    return f"{sensible(span[0], digits)}\u00a0to\u00a0{sensible(span[1], digits)}"


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.2g}"


# --- warnings --------------------------------------------------------------------------------


def report_warnings(case: Case, diagnosis: Diagnosis) -> list[str]:
    """What a reader must know before trusting the answer."""
    out = []
    verdict = diagnosis.verdict
    if diagnosis.rocks < _FEW_ROCKS:
        out.append(
            f"Only {diagnosis.rocks} rocks were observed. Intervals are wide, and an effect that "
            "is not named may still be there."
        )
    if verdict.effect not in ("none", "unknown") and len(verdict.confusion_set) > 1:
        out.append(
            "More than one explanation fits these data: "
            + ", ".join(effect_name(e) for e in verdict.confusion_set)
            + "."
        )
    if diagnosis.effect.stand is not None:
        out.append(
            "The forest of the calibrated model is fitted to the observations. Compare it with the "
            "forest that stands there."
        )
    left_out = [f for f in case.observations.findings if f.left_out]
    if left_out:
        out.append(
            f"{len(left_out)} {'finding' if len(left_out) == 1 else 'findings'} about the "
            "observations made values, rows or tables be left out; sassgis gap validate lists them."
        )
    return out


# --- figures ---------------------------------------------------------------------------------


def headline(findings: Iterable[GapFinding]) -> GapFinding | None:
    """The finding whose quantity the map shows.

    Of quantities that are told from chance somewhere along the fall lines the one that matters most
    for the hazard; if there is none, the most certain.
    """
    placed = [f for f in findings if math.isfinite(f.gap) and math.isfinite(f.s0_m)]

    def rank(finding: GapFinding) -> tuple[bool, bool, int, float, float]:
        known = finding.quantity in _MATTERS
        return (
            significance(finding) == "open",
            finding.place == "all" or finding.place.startswith("ground:"),
            _MATTERS.index(finding.quantity) if known else len(_MATTERS),
            finding.p_adjusted,
            finding.q_value,
        )

    return min(placed, key=rank, default=None)


def map_parts(
    case: Case, diagnosis: Diagnosis
) -> tuple[list[FloatArray], list[GapStretch], dict[str, GapStretch], GapFinding | None]:
    """Fall lines, coloured stretches and stations of the map, and the finding that heads it."""
    end = 1.1 * observed_end(case)
    lines = [line_stretch(case.traces, i, 0.0, end) for i in used_lines(case)]
    first = headline(diagnosis.where)
    chosen = _one_per_place(diagnosis.where, first)
    stretches = [
        GapStretch(course, f.gap, significance(f) != "open")
        for f in chosen
        if is_stretch(f)
        for i in used_lines(case)
        if len(course := line_stretch(case.traces, i, *limits_on(case, f, i))) > 1
    ]
    at_station = {f.place: f for f in chosen if not is_stretch(f)}
    table = case.observations.stations
    stations = {}
    for name, vertices in zip(table.station.tolist(), table.vertices, strict=True):
        own = at_station.get(name)
        stations[name] = (
            GapStretch(vertices, math.nan, False)
            if own is None
            else GapStretch(vertices, own.gap, significance(own) != "open")
        )
    return lines, stretches, stations, first


def _one_per_place(findings: Iterable[GapFinding], first: GapFinding | None) -> list[GapFinding]:
    """Findings of the quantity that heads the map: of each place the phase that heads it, or else
    the most certain.
    """
    if first is None:
        return []
    found: dict[str, GapFinding] = {}
    for finding in findings:
        same = (finding.quantity, finding.unit) == (first.quantity, first.unit)
        if not same or finding.place.startswith("ground:") or not math.isfinite(finding.gap):
            continue
        other = found.setdefault(finding.place, finding)
        rank, rank_other = (
            (f.phase != first.phase, f.p_adjusted, f.q_value) for f in (finding, other)
        )
        if rank < rank_other:
            found[finding.place] = finding
    return list(found.values())


def gap_figures(case: Case, diagnosis: Diagnosis, folder: Path) -> list[ReportFigure]:
    """Draw the figures of a diagnosis into ``folder``."""
    verdict = diagnosis.verdict
    named = verdict.effect if verdict.effect not in ("none", "unknown") else ""
    out = []

    def add(name: str, title: str, caption: str, figure: object) -> None:
        out.append(ReportFigure(title, caption, save_figure(folder, name, figure)))  # type: ignore[arg-type]

    lines, stretches, stations, first = map_parts(case, diagnosis)
    table = case.observations
    release = np.column_stack([table.rocks.x, table.rocks.y])
    stops = np.column_stack([table.deposits.x, table.deposits.y])
    coloured = any(math.isfinite(s.gap) for s in (*stretches, *stations.values()))
    add(
        "gap_map",
        "Where the gap lies",
        (
            f"{_capital(quantity_name(first.quantity))}. Across the slope: at a station; along the "
            "fall lines: on that stretch, as a rule with the rocks started anew where it begins, "
            "so that what went wrong above does not count again."
            if first is not None and coloured
            else "No gap has a place along the fall lines."
        ),
        figures.gap_map_figure(
            case.grid,
            lines=lines,
            stretches=stretches,
            stations=stations,
            release=np.unique(release[np.isfinite(release).all(axis=1)], axis=0),
            stops=stops[np.isfinite(stops).all(axis=1)],
            quantity=first.quantity if first is not None else "",
            unit=first.unit if first is not None else "",
        ),
    )
    if diagnosis.where:
        add(
            "gap_where",
            "Every comparison",
            "Observed less predicted by the calibrated base model, by place and phase.",
            figures.gap_where_figure(diagnosis.where),
        )
    if diagnosis.comparisons:
        add(
            "gap_distributions",
            "Observed rocks and the models",
            "Curves of observed rocks are drawn as steps: nothing is smoothed. A step curve within "
            "the pale band is not told from the base model.",
            figures.gap_distributions_figure(diagnosis.comparisons, effect=named),
        )
    if diagnosis.which:
        add(
            "gap_contenders",
            "Explanations that were tried",
            "The base and the most probable ones were calibrated further than the others; all were "
            "judged on rocks left out of it.",
            figures.gap_hypotheses_figure(
                diagnosis.which, verdict=verdict.effect, confusion=verdict.confusion_set
            ),
        )
    return out


# --- tables ----------------------------------------------------------------------------------


def gap_tables(case: Case, diagnosis: Diagnosis) -> list[ReportTable]:
    """Tables of a diagnosis: where, which, how far, calibrated ground, data."""
    return [
        _where_table(diagnosis.where),
        _which_table(diagnosis),
        _parameter_table(diagnosis),
        _shrinkage_table(diagnosis.shrinkage),
        _ground_table(case.table, diagnosis.effect.table),
        _data_table(diagnosis),
    ]


def _where_table(findings: tuple[GapFinding, ...]) -> ReportTable:
    return ReportTable(
        "Where the gap lies",
        (
            ("place", ""), ("phase", ""), ("quantity", ""), ("observed", ""), ("predicted", ""),
            ("gap", "95 % interval"), ("p", ""), ("q", ""), ("rocks", ""), ("test", ""),
        ),
        tuple(
            (
                f.place.removeprefix("ground:"), f.phase,
                with_unit_in_brackets(quantity_name(f.quantity), f.unit), f.observed,
                f.predicted, f"{sensible(f.gap, 2)} ({_interval(f.ci95, 2)})", _p(f.p_adjusted),
                _p(f.q_value), f.rocks, f.test,
            )
            for f in findings[:_ROWS]
        ),
        "Gap: observed less predicted, mean over rocks. Interval: rocks resampled. p: chance that "
        "the largest of all these gaps would be as large without any. q: share of false findings "
        "among those that are as sure. Test: free run: from the release; leg: from what was "
        "observed where the stretch begins; one step: from one observed state to the next."
        + (
            f" The {_ROWS} most certain of {len(findings)}; all are in diagnosis.json."
            if len(findings) > _ROWS
            else ""
        ),
    )  # fmt: skip


def _other_causes(probabilities: Mapping[str, float]) -> str:
    """What is missing in the table from the sum of the probabilities."""
    if not probabilities:
        return ""
    pair, other = (100.0 * probabilities.get(name, 0.0) for name in (PAIR, UNKNOWN))
    return (
        f" Two of the effects at once have a probability of {pair:.0f} %, something else "
        f"{other:.0f} %."
    )


def _which_table(diagnosis: Diagnosis) -> ReportTable:
    return ReportTable(
        "Explanations",
        (
            ("effect", ""), ("form", ""), ("score", ""), ("gain", ""), ("95 % interval", ""),
            ("probability", "%"), ("told from the answer", ""),
        ),
        tuple(
            (
                effect_name(c.effect), c.form or "–", c.score, c.gain, _interval(c.ci95),
                100.0 * c.probability,
                "the answer" if c.effect == diagnosis.verdict.effect
                else "no" if c.effect in diagnosis.verdict.confusion_set else "yes",
            )
            for c in diagnosis.which
        ),
        "Score: energy score of rocks left out of the calibration; less is better. Gain: score of "
        "the calibrated base model less this one." + _other_causes(diagnosis.verdict.probabilities),
    )  # fmt: skip


def _parameter_table(diagnosis: Diagnosis) -> ReportTable:
    named = _hypothesis(diagnosis.which, diagnosis.verdict.effect)
    rows: list[tuple[Cell, ...]] = []
    if named is not None:
        for name, value in named.parameters.items():
            span = named.intervals.get(name)
            rows.append((name, value, "–" if span is None else _interval(span)))
    return ReportTable(
        f"Calibrated parameters of the answer: {effect_name(diagnosis.verdict.effect)}",
        (("parameter", ""), ("value", ""), ("95 % interval", "")),
        tuple(rows),
        "Units are part of the names.",
    )


def _shrinkage_table(shrinkage: Shrinkage) -> ReportTable:
    def row(name: str, values: Mapping[str, float | None]) -> tuple[Cell, ...]:
        share = values.get("shrinkage")
        return (
            name,
            values.get("base"),
            values.get("effect"),
            values.get("floor"),
            None if share is None else 100.0 * share,
        )

    rows = [row(quantity_name(q), v) for q, v in shrinkage.by_quantity.items()]
    rows.append(
        row(
            "all together",
            {
                "base": shrinkage.distance_base,
                "effect": shrinkage.distance_effect,
                "floor": shrinkage.distance_floor,
                "shrinkage": shrinkage.value,
            },
        )
    )
    return ReportTable(
        "How far the gap shrinks",
        (
            ("quantity", ""), ("base model", "energy distance"), ("with the effect", ""),
            ("chance alone", ""), ("shrinks by", "%"),
        ),
        tuple(rows),
        "On rocks that were not used to fit. Shrinks by: (base − effect) / (base − chance); a dash "
        "where the base model is not surely worse than chance.",
    )  # fmt: skip


def _ground_table(before: GroundTable, after: GroundTable) -> ReportTable:
    old = {c.name: c for c in before.classes}
    names = ("eta_max", "dp_min", "dp_max", "mu_f", "mu_0", "k", "d_star_m")
    heads = ("η max", "Δp/p least", "Δp/p most", "μ_f", "μ_0", "k", "d*")
    rows = []
    for own in after.classes:
        first = old.get(own.name, own)
        pairs = [(getattr(first, n), getattr(own, n)) for n in names]
        if any(a != b for a, b in pairs):
            rows.append(
                (own.name, *(f"{a:.3g} → {b:.3g}" if a != b else f"{a:.3g}" for a, b in pairs))
            )
    return ReportTable(
        "Calibrated ground classes",
        (("class", ""), *((h, "m" if h == "d*" else "") for h in heads)),
        tuple(rows),
        "Configured → calibrated, with the named effect if there is one. Classes that did not "
        "change are not listed.",
    )


def _data_table(diagnosis: Diagnosis) -> ReportTable:
    return ReportTable(
        "Observations used",
        (("table", ""), ("rows", "")),
        tuple((name, int(n)) for name, n in diagnosis.tables.items()),
    )


# --- all of it -------------------------------------------------------------------------------


def gap_report(
    case: Case,
    diagnosis: Diagnosis,
    folder: Path,
    *,
    project: str,
    terrain: str,
    crs: str,
    configuration: str,
    seconds: float | None,
) -> ReportContext:
    """Draw the figures into ``folder`` and put the report together.

    Parameters
    ----------
    case : Case
    diagnosis : Diagnosis
    folder : Path
        Of the figures.
    project, terrain, crs, configuration : str
        Names of the project, the terrain file, the coordinate system and the configuration file.
    seconds : float or None
        Computing time.
    """
    grid = case.grid
    return ReportContext(
        title=f"{project}: observed and simulated rocks",
        subtitle="What separates the field observations from the SASS model, and why",
        verdict=verdict_sentence(diagnosis),
        answer=answer(diagnosis),
        warnings=tuple(report_warnings(case, diagnosis)),
        what_was_run=(
            ("Observed rocks", diagnosis.rocks),
            ("Observations", ", ".join(f"{n} {t}" for t, n in diagnosis.tables.items()) or "none"),
            ("Terrain", f"{terrain}, {grid.shape[1]} × {grid.shape[0]} cells of "
             f"{grid.cell_size:.4g} m"),
            ("Coordinate system", crs),
            ("Fall lines", len(used_lines(case))),
            ("Stations", ", ".join(case.station_names) or "none"),
            ("Effects already configured", ", ".join(case.effects.names) or "none"),
            ("Explanations tried", ", ".join(effect_name(c.effect) for c in diagnosis.which)
             or "none"),
        ),
        figures=tuple(gap_figures(case, diagnosis, folder)),
        tables=tuple(gap_tables(case, diagnosis)),
        provenance=(
            ("Program", f"sassgis {sassgis.__version__}"),
            ("Seed", diagnosis.seed),
            ("Settings and inputs (SHA-256)", diagnosis.settings_hash),
            ("Configuration", configuration),
            ("Calibrated model", "model/config.toml"),
            *((("Computing time", f"{seconds:.0f} s"),) if seconds is not None else ()),
        ),
    )  # fmt: skip
