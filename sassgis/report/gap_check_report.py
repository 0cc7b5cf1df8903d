"""What a check leaves: scores, a row for each site, figures, report."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sassgis import __version__
from sassgis.gap.check.answers import Answer, Truth, is_covered, is_located, is_right
from sassgis.gap.check.check_scores import (
    AIMS,
    NAMED_CONFIDENCE,
    SHRINKAGE_TOLERANCE,
    CheckScores,
    Share,
    acceptance,
    scores_as_json,
)
from sassgis.report.figures.gap_check_figures import (
    confusion_figure,
    reliability_figure,
    shrinkage_figure,
)
from sassgis.report.page import Cell, ReportContext, ReportFigure, ReportTable, heads, write_report
from sassgis.report.pictures import picture


@dataclass(frozen=True, slots=True)
class WorldRow:
    """A site with its truth, its answer, and what was measured on fresh rocks."""

    truth: Truth
    answer: Answer
    # S, D_configured, D_base, D_effect, D_floor, failure; empty if nothing was measured.
    measured: Mapping[str, Any]
    seconds: float  # that the diagnosis took


@dataclass(frozen=True, slots=True)
class CheckRecord:
    """A whole check."""

    plan: Mapping[str, Any]  # seed, worlds, quick, development, thresholds_sha256
    programs: tuple[str, ...]  # hashes of the states of the program that gave the answers
    hashes: Mapping[str, str]  # of the blinded labels and of the answers
    rows: tuple[WorldRow, ...]
    scores: CheckScores


def write_check(folder: Path, record: CheckRecord) -> tuple[str, ...]:
    """Write scores.json, worlds.csv, figures and report.html; returns the warnings in them."""
    warnings = _warnings(record)
    scores = {
        **{key: record.plan[key] for key in ("seed", "quick", "development", "thresholds_sha256")},
        **record.hashes,
        "program_sha256": list(record.programs),
        "version": __version__,
        "warnings": list(warnings),
        **scores_as_json(record.scores),
        "seconds": round(sum(row.seconds for row in record.rows), 1),
    }
    text = json.dumps(scores, indent=1, allow_nan=False) + "\n"
    (folder / "scores.json").write_text(text, encoding="utf-8", newline="\n")
    with (folder / "worlds.csv").open("w", encoding="utf-8", newline="") as stream:
        rows = [_world_cells(row) for row in record.rows]
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    write_report(folder / "report.html", _report(record, warnings, _pictures(record, folder)))
    return warnings


def _warnings(record: CheckRecord) -> tuple[str, ...]:
    scores, lines = record.scores, []
    if record.plan["development"]:
        lines.append(
            "Run for development: thresholds may have been chosen on these very sites, and the "
            "scores may flatter."
        )
    if record.plan["quick"]:
        lines.append(
            f"A quick run of {scores.worlds} sites: it shows that everything runs, "
            "and nothing about how good the diagnosis is."
        )
    if len(record.programs) > 1:
        lines.append(
            f"The answers come from {len(record.programs)} states of the program: it was changed "
            "between two runs of this check."
        )
    if scores.failed:
        lines.append(
            f"{scores.failed} of {scores.worlds} sites have no answer, as the diagnosis failed; "
            "they count as wrong (see worlds.csv)."
        )
    broken = sum(bool(row.measured.get("failure")) for row in record.rows)
    if broken:
        lines.append(
            f"Sites whose shrinkage on fresh rocks could not be measured: {broken}. They are "
            "left out of that score (see worlds.csv)."
        )
    return tuple(lines)


def _world_cells(row: WorldRow) -> dict[str, Any]:
    """The columns of a site in worlds.csv."""
    t, a, m = row.truth, row.answer, row.measured
    return {
        "case": t.case,
        "law": t.law,
        "disturbance": t.disturbance,
        "slope": t.slope,
        "rocks": t.rocks,
        "kind": t.kind,
        "truth": t.verdict,
        "effects": "+".join(t.effects),
        "strengths": "+".join(t.strengths),
        "true_phase": t.phase,
        "true_segments": " ".join(t.segments),
        "answer": a.effect,
        "group": a.group,
        "confidence": None if math.isnan(a.confidence) else a.confidence,
        "right": is_right(t, a),
        "confusion_set": " ".join(a.confusion_set),
        "covered": is_covered(t, a),
        "phase": a.phase,
        "segments": " ".join(a.segments),
        "located": is_located(t, a) if t.local and t.kind != "stops" else None,
        "shrinkage_stated": a.shrinkage,
        "shrinkage_fresh": m.get("S"),
        "distance_configured_fresh": m.get("D_configured"),
        "distance_model_fresh": m.get("D_effect"),
        "distance_floor_fresh": m.get("D_floor"),
        "seconds": row.seconds,
        "failure": a.failure or m.get("failure", ""),
    }


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _pictures(record: CheckRecord, folder: Path) -> tuple[ReportFigure, ...]:
    scores = record.scores
    compared = [
        (row.answer.shrinkage, row.measured["S"])
        for row in record.rows
        if row.answer.shrinkage is not None and row.measured.get("S") is not None
    ]
    caption = (
        "Numbers of sites by truth and answer, shaded by their share of the row; right answers are "
        "outlined. Pairs stand together: an answer of the right column may name other effects than "
        "the true ones."
    )
    figure = confusion_figure(scores.confusion)
    pictures = [picture(folder, "confusion", "What was answered", caption, figure)]
    caption = (
        "Share of right answers by stated confidence, with 95 % intervals. Points below the "
        "diagonal claim more than they hold."
    )
    least = next(aim.limit for aim in AIMS if aim.key == "confident_right")
    figure = reliability_figure(scores.reliability, NAMED_CONFIDENCE, least)
    title = "What the confidence is worth"
    pictures.append(picture(folder, "reliability", title, caption, figure))
    if compared:
        stated, measured = ([float(v) for v in side] for side in zip(*compared, strict=True))
        caption = (
            f"Shrinkage as stated from the observed rocks, and as found on fresh rocks of the same "
            f"site. {len(compared)} sites; the band is what is required."
        )
        figure = shrinkage_figure(stated, measured, SHRINKAGE_TOLERANCE)
        pictures.append(picture(folder, "shrinkage", "How far the gap shrinks", caption, figure))
    return tuple(pictures)


def _report(
    record: CheckRecord, warnings: tuple[str, ...], figures: tuple[ReportFigure, ...]
) -> ReportContext:
    scores, plan = record.scores, record.plan
    overlap = scores.figures.numbers["location_overlap"]
    reliability = [
        replace(row.right, measure=row.right.measure.removeprefix("confidence "))
        for row in scores.reliability
    ]
    return ReportContext(
        title="Blind check of the diagnosis",
        subtitle=f"{scores.worlds} synthetic sites, blinded labels, battery of seed {plan['seed']}",
        what_was_run=(
            ("Sites", scores.worlds),
            ("Rocks observed", sum(row.truth.rocks for row in record.rows)),
            ("Sites without an answer", scores.failed),
            ("Mean overlap of the reaches of local effects", overlap),
            ("Time of all diagnoses together (h)", sum(r.seconds for r in record.rows) / 3600.0),
        ),
        warnings=warnings,
        key_results=_acceptance_table(scores),
        figures=figures,
        tables=(
            _law_table(scores),
            _share_table(
                "All measures",
                "measure",
                list(scores.measures.values()),
                "Intervals are those of Clopper and Pearson (95 %). Weak, medium and strong go by "
                "the strength that the effect came out with.",
            ),
            *(
                _share_table(f"Single effect named, by {title}", title, rows)
                for title, rows in scores.groups.items()
            ),
            _share_table("Reliability", "stated confidence", reliability),
            _shrinkage_table(scores),
            _answers_table(record),
        ),
        provenance=(
            ("Version", __version__),
            ("Seed of the battery", str(plan["seed"])),
            ("Thresholds (SHA-256)", plan["thresholds_sha256"]),
            ("Blinded labels (SHA-256)", record.hashes["labels_sha256"]),
            ("Answers (SHA-256)", record.hashes["answers_sha256"]),
            *(("Program (SHA-256)", digest) for digest in record.programs),
            (
                "To verify the blinding",
                "labels.sha256 was written before the first answer: SHA-256 of the line in "
                "blinded/salt.txt followed by blinded/labels.json",
            ),
        ),
    )


def _acceptance_table(scores: CheckScores) -> ReportTable:
    words = {True: "yes", False: "no", None: None}
    return ReportTable(
        "What is required, and what is reached",
        heads("measure; required; reached; 95 % interval; sites; met"),
        tuple(
            (
                row["measure"],
                f"{'≥' if row['asked_is'] == 'at least' else '≤'} {_value(row, 'asked')}",
                _value(row, "reached"),
                _interval(row["ci95"]) if row["worlds"] else None,
                f"{row['hits']} of {row['worlds']}" if row["is_share"] else None,
                words[row["met"]],
            )
            for row in acceptance(scores)
        ),
        "Met states whether the reached share is on the right side of what is required; it is "
        "certain only where the whole interval is.",
    )


def _law_table(scores: CheckScores) -> ReportTable:
    def reached(row: Mapping[str, Any]) -> str:
        count = f" ({row['hits']} of {row['worlds']})" if row["worlds"] else ""
        return _value(row, "reached") + count

    laws = [acceptance(scores, law) for law in scores.by_law]
    return ReportTable(
        "By law of the motion",
        (("measure", ""), *((law, "") for law in scores.by_law)),
        tuple((rows[0]["measure"], *map(reached, rows)) for rows in zip(*laws, strict=True)),
        "Where rocks obey another law than that of the model and no effect acts, “none” and "
        "“contact law” are both right.",
    )


def _value(row: Mapping[str, Any], key: str) -> str:
    """A share in per cent, or a number; nothing where there is none."""
    value = row[key]
    if math.isnan(value):
        return ""
    return _percent(value) if row["is_share"] else f"{value:.2f}"


def _share_table(title: str, head: str, rows: Sequence[Share], note: str = "") -> ReportTable:
    return ReportTable(
        title,
        ((head, ""), *heads("share; 95 % interval; sites")),
        tuple(
            (
                s.measure.replace("_", " "),
                _percent(s.value) if s.trials else None,
                _interval([s.low, s.high]) if s.trials else None,
                f"{s.hits} of {s.trials}",
            )
            for s in rows
        ),
        note,
    )


def _shrinkage_table(scores: CheckScores) -> ReportTable:
    s = scores.shrinkage
    return ReportTable(
        "Shrinkage, stated and on fresh rocks",
        heads("; sites"),
        (
            ("measured on fresh rocks", s.worlds),
            ("both given", s.compared),
            ("stated, but withheld on fresh rocks", s.only_stated),
            ("withheld, but there on fresh rocks", s.only_measured),
            ("withheld by both", s.neither),
            ("mean of stated less measured", s.bias),
            ("mean absolute difference", s.mean_error),
        ),
        "Sites in which an effect was named or a shrinkage stated.",
    )


def _answers_table(record: CheckRecord) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for row in record.rows:
        t, a = row.truth, row.answer
        truth = t.verdict if t.part != "unknown" else f"unknown ({t.effects[0]})"
        rows.append(
            (
                t.case, t.law, f"{t.rocks}, {t.kind}",
                ", ".join((truth, *t.strengths)).replace("_", " "), a.effect.replace("_", " "),
                round(a.confidence, 2), _cell(is_right(t, a)), _cell(is_covered(t, a)),
            )
        )  # fmt: skip
    return ReportTable(
        "All answers",
        heads("site; law; rocks, seen; truth; answer; confidence; right; covered"),
        tuple(rows),
        "More columns in worlds.csv.",
    )


def _percent(value: float) -> str:
    return f"{100.0 * value:.0f}\u2009%"


def _interval(limits: list[float]) -> str:
    return f"{100.0 * limits[0]:.0f}–{100.0 * limits[1]:.0f}\u2009%"
