"""Fit what fingerprints and gains count, and judge each generator by numbers that never saw it.

    python docs/studies/gap_weights.py rows -o ROWS   # a minute a site on one core; --jobs
    python docs/studies/gap_weights.py level -o ROWS  # some 3 s a campaign
    python docs/studies/gap_weights.py fit            # seconds
    python docs/studies/gap_weights.py page

``rows`` makes synthetic sites, calibrates the base model with a free contact on what was observed
in each, and writes what speaks for each cause, one row per site, as
``docs/studies/gap_weights/rows.csv``. Their seeds are no battery's. ``level`` puts campaigns of the
configured model in the place of what was observed at the sites without an effect, and writes
how often the check of the base calls that same model inadequate
(``docs/studies/gap_weights/level.csv``). ``fit`` fits the numbers to all
rows (``sassgis/data/gap_thresholds.json``) and writes ``docs/studies/gap_weights/results.json``:
scores of answers on the sites of each generator by numbers fitted to the others. ``page`` writes
these into ``docs/studies/gap_weights.md``, and the figures in all into ``docs/gap.md``.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import multiprocessing
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.optimize import minimize
from scipy.special import logsumexp

sys.path.append(str(Path(__file__).resolve().parents[2] / "pipelines"))

from gap_check.answers import Answer, Truth, is_right
from gap_check.check import make_case
from gap_check.scores import CheckScores, score, scores_as_json
from gap_check.worlds import FAMILIES, WorldSpec, battery, world_seeds
from study_tables import between_marks, table

from sassgis.errors import InputError
from sassgis.gap.causes.all_causes import CAUSES, STATISTICS
from sassgis.gap.constants import FIT_DRAWS, SHOWING_GAIN
from sassgis.gap.diagnosis import CauseGain, Fingerprint
from sassgis.gap.fit.hypothesis_fit import CONTACT_LAW, NONE, UNKNOWN, HypothesisFits
from sassgis.gap.fit.linear_fit import summary_of
from sassgis.gap.fit.site_data import site_data_of
from sassgis.gap.forward.campaign_case import with_campaign
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.residuals.residual_table import residuals_of
from sassgis.gap.residuals.rock_residuals import holm_adjusted
from sassgis.gap.verdict.evidence import Evidence, evidence_of_site, located
from sassgis.gap.verdict.verdict import (
    FEATURES,
    CauseWeights,
    Thresholds,
    confidence_of,
    confusion_set,
    decide,
    evidence_of,
    large_gaps,
    seen_of,
)
from sassgis.grid import FloatArray
from sassgis.inputs.observation_values import THRESHOLDS, read_thresholds, thresholds_of
from sassgis.runs.calibrate import prepared_case
from sassgis.simulation.workers import one_algebra_thread, task_map

STUDY = Path(__file__).with_suffix("")
ROWS, RESULTS, PAGE = STUDY / "rows.csv", STUDY / "results.json", STUDY.with_suffix(".md")
LEVEL = STUDY / "level.csv"
GAP_PAGE = STUDY.parents[1] / "gap.md"
#: Campaigns of the configured model at each site without an effect.
CAMPAIGNS = 2
#: Batteries of sites by seed, and how many of each: these are no check any more.
BATTERIES = {20261125: 42, 951: 78, 20261126: 36, 20261127: 36, 20261128: 30, 20261129: 120}
#: Sites with more rocks take longest, and are left out.
MOST_ROCKS = 100
#: What the numbers are before any site (those of 182 sites of three former generators, rounded),
#: and how strongly a ridge holds them there.
START = CauseWeights(np.array([5.0, 1.0, 1.5, 1.5]), 2.5, -1.3, 1.2, math.inf)
RIDGE = 1.0
#: Fitted besides the weights.
NUMBERS = ("offset", "other", "unsound")
#: Thresholds for naming that are tried. Lower ones name more wrong causes, and no more right ones.
NAMED = (0.7, 0.75, 0.8)
#: Most false alarms among sites without an effect, wrong names among those with one; share of the
#: sites whose confusion set need not hold the truth.
FALSE_ALARMS, WRONG_NAMED, OUTSIDE = 0.05, 0.08, 0.1
FIXED = (
    "site", "law", "slope", "effects", "strengths", "disturbance", "rocks", "kind", "adequate",
    "excess", "against",
)  # fmt: skip
#: Columns of each cause that was tried: what it closes, standard errors, power.
GAINS = ("share", "sureness", "power")

#: Laws of the motion at the sites of the rows, in the order of the tables.
LAWS = ("own", "elastic", "plastic")

Row = dict[str, str]


# ---------------------------------------------------------------------------------------------
# Rows


def sites() -> dict[str, tuple[int, WorldSpec]]:
    """Seeds and specifications of all sites, by name."""
    return {
        f"{seed}-{k:03d}": own
        for seed, n in BATTERIES.items()
        for k, own in enumerate(zip(world_seeds(seed, n), battery(seed, n), strict=True), 1)
        if own[1].n_rocks <= MOST_ROCKS
    }


def evidence_at(site: Path) -> Evidence:
    """Evidence at a site, in this process."""
    with one_algebra_thread():
        case = prepared_case(site / "config.toml", site / "observations", 1, 1.0)
        summary = summary_of(site_data_of(case, 1))
        with task_map(summary, 1) as run:
            return evidence_of_site(HypothesisFits(summary, run, FIT_DRAWS)).evidence


def row_of(site: str, folder: Path) -> dict[str, Any]:
    """Evidence at one site; the site itself is made only where it is not there yet."""
    seed, spec = sites()[site]
    label, own = folder / f"{site}.json", folder / site
    if not label.exists():
        made = make_case(spec, seed, site, own)
        label.write_text(json.dumps(made["label"]), encoding="utf-8")
    effects = json.loads(label.read_text(encoding="utf-8"))["effects"]
    found = evidence_at(own)
    z = {f.statistic: round(f.z, 2) for f in found.prints if f.observable}
    gains = {
        f"{name} {what}": round(float(getattr(gain, what)), 3)
        for name, gain in found.gains.items()
        for what in GAINS
    }
    against = sorted({f"{f.test}: {f.quantity}" for f in large_gaps(found.findings)})
    fixed = (
        site, spec.law, spec.slope, "+".join(e["name"] for e in effects),
        "+".join(e["strength"] for e in effects), spec.disturbance, spec.n_rocks, spec.kind,
        int(found.sound),
        round(max((g.excess for g in found.gains.values()), default=1.0), 2), "; ".join(against),
    )  # fmt: skip
    return dict(zip(FIXED, fixed, strict=True)) | z | gains


def make_row(site: str, folder: Path) -> None:
    """Write the row of a site, and nothing where nothing was observed."""
    try:
        row = row_of(site, folder / "cases")
    except InputError as error:
        row = {}
        print(site, error, flush=True)
    (folder / "rows" / f"{site}.json").write_text(json.dumps(row), encoding="utf-8")


def make_rows(folder: Path, jobs: int) -> None:
    """The table; sites and rows that are there already are not made again."""
    cases, done = folder / "cases", folder / "rows"
    for one in (cases, done):
        one.mkdir(parents=True, exist_ok=True)
    left = [site for site in sites() if not (done / f"{site}.json").exists()]
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(make_row, left, [folder] * len(left)))
    rows = [json.loads((done / f"{site}.json").read_text(encoding="utf-8")) for site in sites()]
    names = [*FIXED, *STATISTICS, *(f"{name} {what}" for name in FAMILIES for what in GAINS)]
    with ROWS.open("w", encoding="utf-8", newline="") as stream:
        table = csv.DictWriter(stream, names, lineterminator="\n", restval="")
        table.writeheader()
        table.writerows(filter(None, rows))


def read_rows(file: Path = ROWS) -> list[Row]:
    """A committed table."""
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def evidence(row: Row) -> tuple[list[Fingerprint], dict[str, CauseGain]]:
    """Fingerprints and gains of a row."""
    z = {name: float(row[name]) for name in STATISTICS if row.get(name)}
    p = holm_adjusted(stats.norm.sf(list(z.values()))) if z else np.empty(0)
    prints = [
        Fingerprint(STATISTICS[name], name, math.nan, value, float(own), True, 0)
        for (name, value), own in zip(z.items(), p, strict=True)
    ]
    gains = {
        name: CauseGain(
            name, *(float(row[f"{name} {what}"]) for what in GAINS), float(row["excess"])
        )
        for name in FAMILIES
        if row.get(f"{name} share")
    }
    return prints, gains


def known_of(row: Row) -> tuple[str, ...]:
    """The effects at a site that have a name."""
    return tuple(name for name in row["effects"].split("+") if name in FAMILIES)


def truth_of(row: Row) -> Truth:
    """The truth of a row."""
    effects = tuple(filter(None, row["effects"].split("+")))
    return Truth(
        case=row["site"],
        verdict=NONE if not effects else "+".join(known_of(row)) or UNKNOWN,
        effects=effects,
        strengths=tuple(filter(None, row["strengths"].split("+"))),
        slope=row["slope"], rocks=int(row["rocks"]), kind=row["kind"],
        law=row["law"], disturbance=row["disturbance"],
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Level of the check of the base


def make_level(folder: Path) -> None:
    """How often the check calls the configured model inadequate where that model made the rocks.

    And the factor on the spins that was learned from the recorded contacts, and their scatter.
    """
    rows = []
    for site, (seed, spec) in sites().items():
        own = folder / "cases" / site
        if spec.effects or not own.exists():
            continue
        case = prepared_case(own / "config.toml", own / "observations", 1, 1.0)
        model = configured_model(case)
        made = campaigns(case, rock_lines_of(case), model, count=CAMPAIGNS, seed=seed)
        large, sound = [], []
        for one in made:
            seen = with_campaign(case, one)
            findings, is_sound, _ = located(seen, residuals_of(seen, model, seed=1), 1)
            sound.append(is_sound)
            large.append([] if is_sound else large_gaps(findings))
        against = Counter(f"{f.test}: {f.quantity}" for found in large for f in found)
        learned = case.learned
        spins = ("", "") if learned is None else (learned.spin_scale, learned.spin_noise)
        rows.append((site, spec.law, spec.kind, len(sound), len(sound) - sum(sound),
                     "; ".join(sorted(against)), *spins))  # fmt: skip
        print(*rows[-1], flush=True)
    with LEVEL.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("site", "law", "kind", "campaigns", "inadequate", "against", "spins",
                        "scatter"))  # fmt: skip
        table.writerows(rows)


# ---------------------------------------------------------------------------------------------
# Fit


def fitted(rows: Sequence[Row]) -> CauseWeights:
    """Numbers by penalised maximum likelihood; a ridge pulls to the start.

    At sites with two effects either counts.
    """
    evident, truths = [], []
    for row in rows:
        features = np.array([evidence_of(name, *evidence(row)) for name in FAMILIES])
        evident.append((features, bool(int(row["adequate"]))))
        known = [2 + FAMILIES.index(name) for name in known_of(row)]
        truths.append(known or [1 if row["effects"] else 0])
    n = len(FEATURES)
    start = np.array([*START.weights, *(getattr(START, name) for name in NUMBERS)])

    def loss(x: FloatArray) -> float:
        found = 0.5 * RIDGE * float(((x - start) ** 2).sum())
        weights = CauseWeights(x[:n], *x[n:].tolist(), math.inf)
        for own, truth in zip(evident, truths, strict=True):
            logits = np.append(0.0, weights.logits(*own))
            found += float(logsumexp(logits) - logsumexp(logits[truth]))
        return found

    bounds = [(0.0, None)] * (n + 1) + [(None, None), (0.0, None)]
    x = minimize(loss, start, method="L-BFGS-B", bounds=bounds).x
    # One site of a hundred, as a normal deviate of the logarithm.
    excess = np.log([float(row["excess"]) for row in rows])
    farthest = float(np.exp(excess.mean() + 2.33 * excess.std()))
    return CauseWeights(x[:n], *x[n:].tolist(), farthest)


def without_law(rows: Sequence[Row]) -> list[CauseWeights]:
    """For each row, numbers fitted to the rows of the other generators."""
    by_law = {
        law: fitted([row for row in rows if row["law"] != law]) for law in {r["law"] for r in rows}
    }
    return [by_law[row["law"]] for row in rows]


def shares_at(row: Row, weights: CauseWeights) -> dict[str, float]:
    """Probabilities at a site."""
    return weights.shares(*evidence(row), FAMILIES, bool(int(row["adequate"])))


def answer_of(row: Row, weights: CauseWeights, thresholds: Thresholds) -> Answer:
    """What would be answered, were nothing known of the distance on rocks left out."""
    prints, gains = evidence(row)
    shares, is_adequate = shares_at(row, weights), bool(int(row["adequate"]))
    effect, group, _ = decide(prints, gains, shares, is_adequate, None, thresholds, False)
    seen = seen_of(prints, gains, FAMILIES)
    return Answer(
        case=row["site"],
        effect=effect,
        confidence=confidence_of(effect, prints, shares, thresholds),
        confusion_set=confusion_set(effect, thresholds.possible, shares),
        group=group,
        large_findings=not is_adequate,
        cannot_exclude=tuple(name for name in FAMILIES if name not in seen),
    )


def possible_from(row: Row, weights: CauseWeights) -> float:
    """Least probability of a set that just holds the truth, of two causes one."""
    shares = shares_at(row, weights)
    return max(shares[name] for name in known_of(row) or [UNKNOWN if row["effects"] else NONE])


def least_possible(scores: Sequence[float]) -> float:
    """Probability from which nine sets of ten hold the truth: split conformal prediction.

    V. Vovk, A. Gammerman and G. Shafer (2005, Algorithmic learning in a random world, section
    4.2): of n sites and one more, in any order, this one has a score below the k-th least of the
    others with a chance of at most k / (n + 1). Between two of them, on a logarithmic scale, where
    one in ten is no whole number of these sites.
    """
    known = np.sort([one for one in scores if math.isfinite(one)])
    k = OUTSIDE * (known.size + 1)
    if k < 1.0:
        return 0.0
    at = np.arange(1, known.size + 1)
    return float(np.exp(np.interp(k, at, np.log(np.maximum(known, 1e-6)))))


def chosen(rows: Sequence[Row], weights: Sequence[CauseWeights]) -> Thresholds:
    """The lowest threshold with few wrong names at the sites of each generator; sets that hold the
    truth nine times of ten.

    One limit for all sites and causes makes the smallest sets that do (M. Sadinle, J. Lei and L.
    Wasserman, 2019, Least ambiguous set-valued classifiers with bounded error levels, J. Am. Stat.
    Assoc. 114, 223-234).
    """
    scores = [possible_from(row, own) for row, own in zip(rows, weights, strict=True)]
    possible = round(least_possible(scores), 4)
    found = replace(thresholds_of(read_thresholds()), possible=possible, right={})
    for named in NAMED:
        found = replace(found, named=named)
        of_laws = scores_with(rows, weights, found).by_law.values()
        if all(
            own.measures["false_alarm"].hits <= FALSE_ALARMS * own.measures["false_alarm"].trials
            and own.measures["wrong_named"].hits <= WRONG_NAMED * own.measures["wrong_named"].trials
            for own in of_laws
        ):
            break
    return found


def answers_with(
    rows: Sequence[Row], weights: Sequence[CauseWeights], thresholds: Thresholds
) -> list[Answer]:
    """Answers to all rows."""
    return [answer_of(row, own, thresholds) for row, own in zip(rows, weights, strict=True)]


def scores_with(
    rows: Sequence[Row], weights: Sequence[CauseWeights], thresholds: Thresholds
) -> CheckScores:
    """Scores of all rows."""
    return score([truth_of(row) for row in rows], answers_with(rows, weights, thresholds))


def right_of(
    rows: Sequence[Row], weights: Sequence[CauseWeights], thresholds: Thresholds
) -> dict[str, float]:
    """Share of the sites at which an answer that names no family was right (Laplace's rule)."""
    found = {}
    answers = answers_with(rows, weights, thresholds)
    for name in (NONE, CONTACT_LAW):
        right = [
            is_right(truth_of(row), answer)
            for row, answer in zip(rows, answers, strict=True)
            if answer.effect == name
        ]
        found[name] = round((sum(right) + 1) / (len(right) + 2), 2)
    return found


def fit() -> None:
    """Numbers from all rows; scores by numbers that never saw the generator."""
    rows = read_rows()
    left_out = without_law(rows)
    thresholds = chosen(rows, left_out)
    thresholds = replace(thresholds, right=right_of(rows, left_out, thresholds))
    weights = fitted(rows)
    results = {
        "sites": len(rows),
        "named": thresholds.named,
        "possible": thresholds.possible,
        **scores_as_json(scores_with(rows, left_out, thresholds)),
        "answers": {a.case: a.effect for a in answers_with(rows, left_out, thresholds)},
    }
    RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    content = read_thresholds() | {
        "battery_seeds": sorted({*read_thresholds()["battery_seeds"], *BATTERIES}),
        "named": thresholds.named,
        "possible": thresholds.possible,
        "right": thresholds.right,
        "weights": {
            **{n: round(float(v), 2) for n, v in zip(FEATURES, weights.weights, strict=True)},
            **{n: round(getattr(weights, n), 2) for n in NUMBERS},
            "farthest": round(weights.farthest, 1),
        },
    }
    THRESHOLDS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


# ---------------------------------------------------------------------------------------------
# Page


def headline() -> str:
    """The figures that hold for generators that the weights never saw, in some sentences."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    of = {k: f"{own['hits']} of {own['trials']}" for k, own in found["measures"].items()}
    size = {k: f"{v:.1f}" for k, v in found["numbers"].items() if v is not None}
    return (
        f"**It names a wrong effect at {of['wrong_named']} sites with an effect, and at "
        f"{of['false_alarm']} without.** A single effect is named at {of['family_single']} sites; "
        f"with 100 rocks and everything observed, at {of['family_full_all']} if it is medium or "
        "strong. The confusion set contains the truth at "
        f"{of['covered_everything']} sites where everything was observed (on average "
        f"{size['set_size_everything']} entries), and at {of['covered_otherwise']} others "
        f"({size['set_size_otherwise']})."
    )


def by_generator() -> str:
    """Figures in all and by generator."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    names = {
        "false_alarm": "no effect, yet one is named",
        "null_right": "no effect, and none is answered",
        "unknown_named": "no known effect, yet one is named",
        "wrong_named": "an effect, yet another one is named",
        "family_full": "right, could be seen: 100 rocks, everything",
        "family_modest": "right, could be seen: 40 rocks, stations and stops",
        "family_full_all": "right, seen or not: 100 rocks, everything",
        "family_modest_all": "right, seen or not: 40 rocks, stations and stops",
        "pair_one_none_wrong": "two effects: one right and none wrong",
        "confident_right": "right where the confidence is 0.6 or more",
        "covered_everything": "truth in the confusion set, everything",
        "covered_otherwise": "truth in the confusion set, otherwise",
    }

    def cell(figures: dict[str, Any], key: str) -> str:
        one = figures["measures"].get(key)
        return "–" if not one or not one["trials"] else f"{one['hits']}/{one['trials']}"

    all_of = [found, *found["by_law"].values()]
    rows = [
        " | ".join([words, *(cell(own, key) for own in all_of)])
        for key, words in names.items()
        if key in found["measures"]
    ]
    errors = (own["numbers"].get("calibration_error") for own in all_of)
    shown = ("–" if v is None else f"{v:.2f}" for v in errors)
    rows.append(" | ".join(["calibration error of the confidence", *shown]))
    return table(" | ".join(["", "all", *found["by_law"]]), rows)


def confusion() -> str:
    """Answers to medium and strong single effects, by design and true cause."""
    answers = json.loads(RESULTS.read_text(encoding="utf-8"))["answers"]
    sites = [r for r in read_rows() if r["strengths"] in ("medium", "strong")]
    rows = []
    for cause in sorted(FAMILIES):
        cells = []
        for kind in ("everything", "both"):
            own = [r for r in sites if r["kind"] == kind and r["effects"] == cause]
            counts = Counter(answers[r["site"]] for r in own)
            right = counts.pop(cause, 0)
            others = [f"{name} {n}" for name, n in sorted(counts.items())]
            cells.append("; ".join([f"{right}/{len(own)}", ", ".join(others)]).rstrip("; "))
        rows.append(" | ".join([cause, *cells]).replace("_", " "))
    return table("true cause | 100 rocks, everything | 40 rocks, stations and stops", rows)


def adequacy() -> str:
    """Sites without an effect at which the base is adequate, by what else is there."""
    sites = [r for r in read_rows() if not r["effects"]]
    rows = []
    for kind, words in (
        ("", "nothing"),
        ("patch", "a patch of unmapped ground"),
        ("speed_loss", "a loss at contacts that grows with the speed"),
    ):
        own = [r for r in sites if r["disturbance"] == kind]
        parts = [own, *([r for r in own if r["law"] == law] for law in LAWS)]
        shown = [f"{sum(int(r['adequate']) for r in part)}/{len(part)}" for part in parts]
        rows.append(" | ".join([words, *shown]))
    return table(" | ".join(["", "all", *LAWS]), rows)


def level() -> str:
    """Campaigns of a model that the check calls inadequate for that model, as a sentence."""
    sites = read_rows(LEVEL)
    shown = [
        f"{sum(int(r['inadequate']) for r in own)} of {sum(int(r['campaigns']) for r in own)}"
        for own in (sites, *([r for r in sites if r["law"] == law] for law in LAWS))
    ]
    laws = ", ".join(f"{law} {one}" for law, one in zip(LAWS, shown[1:], strict=True))
    return f"{shown[0]} ({laws})."


def reached() -> str:
    """How many gains reach the sureness of a named cause: those that act and those that do not."""
    acts, absent, most = [], [], []
    for row in read_rows():
        gains = {n: g.sureness for n, g in evidence(row)[1].items() if CAUSES[n].closes}
        acts += [sure for name, sure in gains.items() if name in known_of(row)]
        own = [sure for name, sure in gains.items() if name not in known_of(row)]
        absent += own
        most.append(max(own, default=-math.inf))
    acting, others, sites = (
        f"{sum(z >= SHOWING_GAIN for z in sure)} of {len(sure)}" for sure in (acts, absent, most)
    )
    return f"{acting} causes that act reach it, {others} that do not, at {sites} sites."


def with_headline(text: str) -> str:
    """A page with the figures that hold for generators that the weights never saw."""
    return between_marks(text, "headline", headline())


def filled(text: str) -> str:
    """The page with its tables."""
    tables = {
        "laws": by_generator, "confusion": confusion, "level": level,
        "reached": reached, "adequacy": adequacy,
    }  # fmt: skip
    for name, made in tables.items():
        text = between_marks(text, name, made())
    return text


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    command = parser.add_subparsers(dest="command", required=True)
    rows = command.add_parser("rows")
    rows.add_argument("-o", "--out", type=Path, required=True)
    rows.add_argument("--jobs", type=int, default=1)
    level = command.add_parser("level")
    level.add_argument("-o", "--out", type=Path, required=True)
    command.add_parser("fit")
    command.add_parser("page")
    given = parser.parse_args()
    if given.command == "rows":
        make_rows(given.out, given.jobs)
    elif given.command == "level":
        make_level(given.out)
    elif given.command == "fit":
        fit()
    else:
        PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
        GAP_PAGE.write_text(with_headline(GAP_PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
