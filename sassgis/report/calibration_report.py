"""The report of a calibration: what was fitted, how well, and what the observations do not say."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

import sassgis
from sassgis.gap.fit.class_calibration import SiteCalibration, SiteResult
from sassgis.gap.fit.distances import Interval
from sassgis.gap.fit.parameters import Fitted
from sassgis.gap.words import with_unit_in_brackets
from sassgis.report import page
from sassgis.report.figures.gap_figures import parameters_figure, quantity_curves_figure
from sassgis.report.gap_answer import interval_text
from sassgis.report.gap_report import FEW_ROCKS
from sassgis.report.pictures import picture
from sassgis.settings.languages import joined, phrase, translated
from sassgis.settings.results import ground_name

#: Panels of one site.
_PANELS = 6
#: "low" and "high" alone are words of intensities.
_LIMITS = {"low": "lower", "high": "upper", "": "–"}
_MEANING = page.ReportAnswer(
    "How to read this",
    (
        "The observed rocks were simulated with many sets of parameters. Means, scatters and "
        "trends over the rocks are regressed on the parameters. Together with the spread between "
        "sites this gives the values and their intervals. Energy score: distance of the simulated "
        "rocks from each observed one, less their scatter.",
        "Held-out rocks: the rocks were split into five parts; each part was predicted with "
        "parameters chosen on the other four.",
    ),
)


def verdict(calibration: SiteCalibration) -> str:
    """Return the result in a few sentences; the first says which ground to run."""
    stated = [f for f in calibration.fitted if f.identified]
    text = "{} rocks identify {} of {} parameters and {} combinations of them."
    numbers = calibration.rocks, len(stated), len(calibration.fitted), calibration.combinations
    sentences = [calibration.recommendation, phrase(text, *numbers)]
    for site in calibration.sites:
        if site.errors:
            e = next((own for own in site.errors if own.name == "run-out"), site.errors[0])
            crps = (page.sensible(e.crps[m], 2) for m in ("before", "after", "left out"))
            text = "{}: CRPS of the {} {} {unit} before, {} after, {} on held-out rocks."
            sentences.append(phrase(text, site.name, phrase(e.name), *crps, unit=e.unit))
    return joined(" ", sentences)


def calibration_warnings(calibration: SiteCalibration) -> list[str]:
    """Warn of what a reader must know before the classes are used; the findings first."""
    many = len(calibration.sites) > 1
    # The recommendation states the gain at one site.
    out = [f.text for f in calibration.findings if many or f.kind != "gain"]
    if calibration.contradict:
        worse = [
            phrase("{} % at {}", f"{100.0 * (s.score / s.own_score - 1.0):.0f}", s.name)
            for s in calibration.sites
        ]
        text = (
            "The sites contradict each other: the score of common parameters is {} worse than "
            "that of separate ones, more than by chance. Calibrate the sites separately, or give "
            "their ground classes different names."
        )
        out.append(phrase(text, joined(", ", worse)))
    unknown = [f.parameter.label for f in calibration.fitted if not f.identified]
    if unknown:
        text = (
            "The observations do not identify {}. These stay near the configured values, within "
            "their spread between sites."
        )
        out.append(phrase(text, ", ".join(unknown)))
    text = "The observations do not separate {} from {}."
    out += [phrase(text, one, other) for one, other in calibration.alike]
    if calibration.rocks < FEW_ROCKS:
        text = "Only {} rocks were observed: intervals are wide."
        out.append(phrase(text, calibration.rocks))
    return out


def calibration_report(
    calibration: SiteCalibration,
    folder: Path,
    *,
    configurations: Sequence[str],
    warnings: Sequence[str],
) -> page.ReportContext:
    """Draw the figures into ``folder`` and put the report together."""
    sites = joined(", ", (phrase("{} ({} rocks)", s.name, s.rocks) for s in calibration.sites))
    labels = [f.parameter.label for f in calibration.fitted]
    common = page.table_of(
        "Common parameters and those that fit each site best",
        (*page.heads("site; score, common; score, separate"), *((label, "") for label in labels)),
        (
            (s.name, s.score, s.own_score, *(float(f"{s.own[k]:.3g}") for k in labels))
            for s in calibration.sites
        ),
        "Score: energy score, mean over the rocks; lower is better.",
    )
    return page.ReportContext(
        title=translated("Calibrated ground classes"),
        subtitle=sites,
        verdict=verdict(calibration),
        answer=(_MEANING,),
        warnings=tuple(warnings),
        what_was_run=(
            ("Sites", sites),
            ("Configurations", ", ".join(configurations)),
            *(
                (
                    phrase("Observations of {}", s.name),
                    joined(", ", (phrase("{} {}", n, phrase(t)) for t, n in s.tables.items())),
                )
                for s in calibration.sites
            ),
            ("Parameter sets tried", calibration.draws),
        ),
        key_results=_parameter_table(calibration.fitted),
        figures=tuple(_figures(calibration, folder)),
        tables=(
            _score_table(calibration),
            *(_error_table(site) for site in calibration.sites),
            page.table_of(
                "Parameters that compensate each other",
                "one; other; correlation",
                ((t.one, t.other, f"{t.correlation:+.2f}") for t in calibration.trade_offs),
                "Above 0: raising both fits as well; below 0: raising one and lowering the other.",
            ),
            page.table_of(
                "Other combinations that fit as well",
                ((label, "") for label in labels),
                ((float(f"{one[k]:.3g}") for k in labels) for one in calibration.as_good),
                "Combinations as different as possible whose scores differ from the best only by "
                "chance.",
            ),
            *([common] if len(calibration.sites) > 1 else []),
        ),
        provenance=(("Program", f"sassgis {sassgis.__version__}"), ("Seed", calibration.seed)),
    )


def _figures(calibration: SiteCalibration, folder: Path) -> list[page.ReportFigure]:
    caption = (
        "Line: range of the search. Bar: 95 % interval; dot: calibrated; upright stroke: "
        "configured. Grey: not identified."
    )
    figure = partial(parameters_figure, calibration.fitted)
    found = [picture(folder, "parameters", "Parameters", caption, figure)]
    caption = (
        "Share of the rocks below a value. Before: configured parameters. Held out: each rock "
        "predicted with parameters chosen without it."
    )
    for k, site in enumerate(calibration.sites, start=1):
        panels = []
        for name, e in list(zip(site.observed, site.errors, strict=True))[::-1][:_PANELS]:
            natural = np.exp if name.endswith(":speed") else np.asarray
            made = {m: natural(v[name]) for m, v in site.replicas.items()}
            label = with_unit_in_brackets(e.name, e.unit)
            panels.append((label, natural(site.observed[name]), made))
        title = phrase("Observed and simulated rocks: {}", site.name)
        figure = partial(quantity_curves_figure, panels)
        found.append(picture(folder, f"rocks_{k}", title, caption, figure))
    return found


def _parameter_table(fitted: Sequence[Fitted]) -> page.ReportTable:
    return page.table_of(
        "Calibrated parameters",
        "class; parameter; configured; spread between sites; calibrated; 95 % interval; "
        "limits of the search; identified; at a limit",
        (
            (
                ground_name(f.parameter.class_name), f.parameter.name, f.parameter.configured,
                float(f"{f.parameter.spread:.2g}"), f.value,
                interval_text((f.low, f.high), 2),
                interval_text((f.parameter.limits.low, f.parameter.limits.high), 2),
                "yes" if f.identified else "no", _LIMITS[f.limit],
            )
            for f in fitted
        ),
        "Identified: the interval is clearly narrower than without observations. Spread between "
        "sites: standard deviation of the prior about the configured value.",
    )  # fmt: skip


def _score_table(calibration: SiteCalibration) -> page.ReportTable:
    rows: list[tuple[page.Cell, ...]] = []
    for s in calibration.sites:
        for t in s.scores:
            means = (page.sensible(t.score[m], 2) for m in ("before", "after", "left out"))
            rows.append((s.name, t.table, t.rocks, *means, _percent(t.gain)))
        rows.append((s.name, "all", s.rocks, None, None, None, _percent(s.gain)))
    return page.table_of(
        "What each table of observations contributes",
        "site; table; rocks; before; after; left out; gain on held-out rocks | 95 %",
        rows,
        "Energy score, mean over the rocks; lower is better. Gain: relative to the score before, "
        "paired by rock. All tables have the same weight, however many stations or impacts a "
        "rock has.",
    )


def _error_table(site: SiteResult) -> page.ReportTable:
    rows: list[tuple[page.Cell, ...]] = []
    for e in site.errors:
        rows.append((e.name, e.unit, "observed", *e.observed, None, "–"))
        for model in ("before", "after", "left out"):
            error = e.median_error[model]
            rows.append(
                (e.name, e.unit, model, *e.quantiles[model], e.crps[model], _percent(error))
            )
    return page.table_of(
        phrase("Errors at {}", site.name),
        "quantity; unit; rocks; 10 %; 50 %; 90 %; CRPS; error of the median | 95 % interval",
        rows,
        "Error of the median: simulated / observed − 1; for the lateral offset, of the distance "
        "between the 10 % and the 90 % quantile. Intervals: observed rocks resampled.",
    )


def _percent(error: Interval) -> str:
    value, low, high = (100.0 * v for v in (error.value, error.low, error.high))
    return phrase("{} ({} to {})", f"{value:+.0f} %", f"{low:+.0f}", f"{high:+.0f}")
