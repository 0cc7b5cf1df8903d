"""Fit the weights of the fingerprints, and judge each law of motion by weights that never saw it.

    python docs/studies/gap_weights.py rows -o ROWS --jobs 2   # an hour on two cores
    python docs/studies/gap_weights.py fit                     # seconds
    python docs/studies/gap_weights.py page

``rows`` makes synthetic sites of the three laws of motion, calibrates the base model on what was
observed in each, and writes the z of all fingerprints, one row per site, as
``docs/studies/gap_weights/rows.csv``. Their seeds are no battery's. ``fit`` fits the weights to all
rows (``sassgis/data/gap_thresholds.json``) and writes ``docs/studies/gap_weights/results.json``:
scores of answers on the sites of each law by weights fitted to the others. ``page`` writes these
into ``docs/studies/gap_weights.md``.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.optimize import minimize
from scipy.special import log_softmax

from sassgis.gap.causes.all_causes import CAUSES as ROWS_OF_CAUSES
from sassgis.gap.causes.all_causes import GROUPS
from sassgis.gap.check.answers import Answer, Truth, is_covered, is_right
from sassgis.gap.check.check_scores import (
    score,
    scores_as_json,
)
from sassgis.gap.check.worlds import EffectSpec, WorldSpec
from sassgis.gap.check.worlds.observe import KINDS
from sassgis.gap.check.worlds.slopes import SLOPE_TYPES
from sassgis.gap.check.worlds.world import DISTURBANCES, FAMILIES, LAWS, MOST_STATIONS, UNKNOWNS
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.inference.rock_tests import holm_adjusted
from sassgis.gap.which.cause_weights import CauseWeights, counts_of, distance
from sassgis.gap.which.verdict import (
    CONTACT_LAW,
    NONE,
    Thresholds,
    adequate,
    confidence_of,
    confusion_set,
    decide,
    group_of,
    seen_of,
    significant,
)
from sassgis.io.read.gap_thresholds import THRESHOLDS, read_thresholds, thresholds_of
from sassgis.model.grid import FloatArray
from sassgis.runs.blinded_cases import make_case
from sassgis.runs.diagnose import fingerprints_of

STUDY = Path(__file__).with_suffix("")
#: Of each table: seed of the designs, first seed of the worlds, sites. Weights are fitted to
#: "rows"; "fresh" was made when these, the fingerprints and all thresholds stood.
TABLES = {"rows": (4712, 910_000, 240), "fresh": (4713, 920_000, 60)}
RESULTS, PAGE = STUDY / "results.json", STUDY.with_suffix(".md")
CAUSES = (*FAMILIES, NONE)
#: What is at ten sites of a generator, again and again.
TRUTHS = (NONE, "effect", "effect", NONE, "effect", "effect", NONE, "effect", "effect", "unknown")
#: Fingerprints of what synthetic sites can have: cause, and weight for it before any site.
_ALL: Mapping[str, tuple[str, float]] = {
    own.name: (name, own.weight)
    for name, row in ROWS_OF_CAUSES.items()
    for own in row.statistics
    if name in (*FAMILIES, CONTACT_LAW)
}


def read_rows(name: str = "rows") -> list[dict[str, str]]:
    """A committed table."""
    with (STUDY / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


#: Those that the committed rows have: one that is newer has its weight from before any site.
STATISTICS = {name: own for name, own in _ALL.items() if name in read_rows()[0]}
#: Before any site a fingerprint speaks for its own cause with the weight of its row, and no cause
#: is more likely than "none" by this; the ridge holds the weights there.
NONE_OFFSET, OFFSET_RIDGE = 3.0, 0.1
RIDGES = (1.0, 3.0, 10.0, 30.0)
SHARPNESS = (0.6, 0.8, 1.0, 1.3, 1.7)
NAMED = (0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8)
#: Most false alarms among sites without an effect, wrong names among those with one, known names
#: among those with an unknown one; share of the sites whose confusion set need not hold the truth.
FALSE_ALARMS, WRONG_NAMED, UNKNOWN_NAMED, OUTSIDE = 0.05, 0.08, 0.2, 0.1
FIXED = (
    "site", "law", "slope", "effects", "strengths", "rocks", "kind", "stations", "named",
    "error_factor", "disturbance", "adequate",
)  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Rows


def sites(seed: int, first: int, n: int) -> list[tuple[int, WorldSpec]]:
    """Seeds and specifications, generators in turn: of ten sites three have no effect, one an
    unknown one.
    """
    rng = np.random.default_rng(seed)

    def one_of(values: Sequence[Any]) -> Any:
        return values[int(rng.integers(len(values)))]

    families: dict[str, list[str]] = {law: [] for law in LAWS}
    found: list[tuple[int, WorldSpec]] = []
    for k in range(n):
        law, number = LAWS[k % len(LAWS)], k // len(LAWS)
        truth = TRUTHS[number % len(TRUTHS)]
        effects: tuple[EffectSpec, ...] = ()
        disturbance = one_of(DISTURBANCES) if truth == NONE else ""
        strength = one_of(("weak", "medium", "strong", "medium", "strong"))
        if truth == "unknown":
            effects = (EffectSpec(one_of(UNKNOWNS), one_of(("medium", "strong"))),)
        elif truth == "effect":
            families[law] = families[law] or rng.permutation(FAMILIES).tolist()
            effects = (EffectSpec(families[law].pop(), strength),)  # type: ignore[arg-type]
        share = rng.random()
        rocks, kind = (100, "everything") if share < 0.5 else (40, "both")
        if share > 0.9:
            rocks, kind = one_of((20, 40, 100)), one_of(KINDS)
        stations = 4 if rng.random() < 0.5 else int(rng.integers(2, MOST_STATIONS + 1))
        spec = WorldSpec(
            one_of(SLOPE_TYPES), effects, n_rocks=rocks, kind=kind, law=law, n_stations=stations,
            named=bool(rng.random() < 0.7), error_factor=one_of((0.5, 1.0, 1.0, 1.5)),
            disturbance=disturbance, faults=True,
        )  # fmt: skip
        found.append((first + k, spec))
    return found


def row_of(task: tuple[int, WorldSpec, Path]) -> dict[str, Any]:
    """Fingerprints of one site; the site itself is made only where it is not there yet."""
    seed, spec, folder = task
    label = folder / f"{seed}.json"
    if not label.exists():
        made = make_case(spec, seed, str(seed), str(folder / str(seed)))
        label.write_text(json.dumps(made["label"]), encoding="utf-8")
    effects = json.loads(label.read_text(encoding="utf-8"))["effects"]
    prints, findings = fingerprints_of(
        folder / str(seed) / "config.toml", folder / str(seed) / "observations"
    )
    return as_row(seed, spec, [str(e["strength"]) for e in effects], prints, adequate(findings))


def as_row(
    seed: int,
    spec: WorldSpec,
    strengths: Sequence[str],
    prints: Sequence[Fingerprint],
    is_adequate: bool,
) -> dict[str, Any]:
    """One row of the table."""
    z = {f.statistic: round(f.z, 2) for f in prints if f.observable}
    return {
        "site": seed,
        "law": spec.law,
        "slope": spec.slope,
        "effects": "+".join(e.name for e in spec.effects),
        "strengths": "+".join(strengths),
        "rocks": spec.n_rocks,
        "kind": spec.kind,
        "stations": spec.n_stations,
        "named": int(spec.named),
        "error_factor": spec.error_factor,
        "disturbance": spec.disturbance,
        "adequate": int(is_adequate),
        **{name: z.get(name, "") for name in _ALL},
    }


def write_rows(rows: Sequence[dict[str, Any]], file: Path) -> None:
    """Rows as CSV, by site."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        table = csv.DictWriter(stream, [*FIXED, *_ALL], lineterminator="\n")
        table.writeheader()
        table.writerows(sorted(rows, key=lambda r: int(r["site"])))


def make_rows(name: str, folder: Path, jobs: int) -> None:
    """A table; sites and rows that are there already are not made again."""
    cases, done = folder / "cases", folder / "rows"
    for one in (cases, done):
        one.mkdir(parents=True, exist_ok=True)
    due = [(k, s, cases) for k, s in sites(*TABLES[name]) if not (done / f"{k}.json").exists()]
    with ProcessPoolExecutor(jobs) as pool:
        for (seed, *_), row in zip(due, pool.map(row_of, due), strict=True):
            (done / f"{seed}.json").write_text(json.dumps(row), encoding="utf-8")
            print(seed, flush=True)
    made = [json.loads(f.read_text(encoding="utf-8")) for f in done.glob("*.json")]
    write_rows(made, STUDY / f"{name}.csv")


# ---------------------------------------------------------------------------------------------
# Fit


def fitted(counts: FloatArray, cause: np.ndarray, ridge: float) -> tuple[FloatArray, FloatArray]:
    """Weights and offsets by penalised maximum likelihood; the ridge pulls towards the start."""
    c, k = len(CAUSES), counts.shape[1]
    start = np.array(
        [[weight * (e == name) for e, weight in STATISTICS.values()] for name in CAUSES]
    )
    first = np.array([NONE_OFFSET * (name == NONE) for name in CAUSES])
    truth = np.eye(c)[cause]

    def loss(x: FloatArray) -> tuple[float, FloatArray]:
        weights, offset = x[: c * k].reshape(c, k), x[c * k :]
        log_p = log_softmax(counts @ weights.T + offset, axis=1)
        off, up = weights - start, offset - first
        value = -(truth * log_p).sum() + 0.5 * (
            ridge * (off**2).sum() + OFFSET_RIDGE * (up**2).sum()
        )
        slope = np.exp(log_p) - truth
        gradient = slope.T @ counts + ridge * off
        return float(value), np.concatenate(
            [gradient.ravel(), slope.sum(axis=0) + OFFSET_RIDGE * up]
        )

    x = minimize(
        loss, np.concatenate([start.ravel(), first]), jac=True, method="L-BFGS-B",
        options={"maxiter": 2000},
    ).x  # fmt: skip
    return x[: c * k].reshape(c, k), x[c * k :]


def prints_of(z: FloatArray) -> list[Fingerprint]:
    """Fingerprints of a row."""
    seen = np.flatnonzero(np.isfinite(z))
    p = holm_adjusted(stats.norm.sf(z[seen]))
    names = list(STATISTICS)
    return [
        Fingerprint(STATISTICS[names[i]][0], names[i], math.nan, float(z[i]), float(own), True, 0)
        for i, own in zip(seen.tolist(), p, strict=True)
    ]


def shares_of(prints: Sequence[Fingerprint], weights: CauseWeights) -> dict[str, float]:
    """Probabilities of what could be seen."""
    return weights.shares(prints, seen_of(prints, FAMILIES))


def answer_of(
    row: dict[str, str], z: FloatArray, weights: CauseWeights, thresholds: Thresholds
) -> Answer:
    """What would be answered, were nothing known of how far the gap shrinks."""
    prints = prints_of(z)
    shares = shares_of(prints, weights)
    law = CONTACT_LAW in significant(prints, thresholds.level)
    is_adequate = bool(int(row["adequate"]))
    effect, group, _ = decide(prints, shares, is_adequate, None, thresholds, law)
    return Answer(
        case=row["site"],
        effect=effect,
        confidence=confidence_of(effect, shares, thresholds.right),
        confusion_set=confusion_set(effect, thresholds.possible[design(row)], shares),
        group=group,
        large_findings=not is_adequate,
        cannot_exclude=tuple(name for name in FAMILIES if name not in shares),
    )


def design(row: dict[str, str]) -> str:
    """Whether impacts were recorded at a site: there sets are smaller."""
    return "impacts" if row["kind"] == "everything" else "otherwise"


def possible_from(prints: Sequence[Fingerprint], weights: CauseWeights, cause: str) -> float:
    """Least probability of a set that just holds a cause or its group; NaN if it is unseen.

    A group is in the set once two of its causes are.
    """
    shares = shares_of(prints, weights)
    if cause not in shares:
        return math.nan
    mates = [shares[name] for name in GROUPS.get(group_of(cause), ()) if name in shares]
    return max(shares[cause], *sorted(mates)[-2:-1], 0.0)


def least_possible(scores: Sequence[float]) -> float:
    """Probability from which nine sets of ten hold the truth: split conformal prediction.

    V. Vovk, A. Gammerman and G. Shafer (2005, Algorithmic learning in a random world, section
    4.2): of n sites and one more, in any order, this one has a score below the k-th least of the
    others with a chance of at most k / (n + 1).
    """
    known = np.sort([one for one in scores if math.isfinite(one)])
    k = math.floor(OUTSIDE * (known.size + 1))
    return float(known[k - 1]) if k else 0.0


def possible_scores(rows: Sequence[dict[str, str]], weights: Sequence[CauseWeights]) -> FloatArray:
    """``possible_from`` of the truth of each row; NaN of unknown causes and pairs."""
    found = np.full(len(rows), math.nan)
    for i, (z, own, cause) in enumerate(zip(z_of(rows), weights, causes_of(rows), strict=True)):
        if cause >= 0:
            found[i] = possible_from(prints_of(z), own, CAUSES[cause])
    return found


def with_sets(
    thresholds: Thresholds, rows: Sequence[dict[str, str]], scores: FloatArray
) -> Thresholds:
    """Thresholds with those of the confusion sets by the scores of some sites.

    Sites with and without an effect apart: nine sets of ten hold the truth of both.
    """
    of = np.array([design(row) for row in rows])
    effect = causes_of(rows) != CAUSES.index(NONE)
    return replace(
        thresholds,
        possible={
            name: [
                round(least_possible(scores[(of == name) & kind].tolist()), 4)
                for kind in (effect, ~effect)
            ]
            for name in ("impacts", "otherwise")
        },
    )


def sets_left_out(
    rows: Sequence[dict[str, str]], weights: Sequence[CauseWeights], thresholds: Thresholds
) -> dict[str, Any]:
    """Coverage and mean size of confusion sets whose limits never saw the law of the site."""
    law = np.array([row["law"] for row in rows])
    scores = possible_scores(rows, weights)
    found: dict[str, list[tuple[bool, int]]] = {}
    for name in np.unique(law).tolist():
        others = np.flatnonzero(law != name)
        own = with_sets(thresholds, [rows[i] for i in others], scores[others])
        some = np.flatnonzero((law == name) & np.isfinite(scores))
        chosen, by = [rows[i] for i in some], [weights[i] for i in some]
        for row, made in zip(chosen, answers_with(chosen, by, own), strict=True):
            kind = "with an effect" if row["effects"] else "without"
            held = is_covered(truth_of(row), made), len(made.confusion_set)
            for key in ("all", kind, f"{design(row)}, {kind}"):
                found.setdefault(key, []).append(held)
    return {
        key: {
            "sites": len(held),
            "covered": round(float(np.mean([one for one, _ in held])), 3),
            "size": round(float(np.mean([size for _, size in held])), 2),
        }
        for key, held in sorted(found.items())
    }


def truth_of(row: dict[str, str]) -> Truth:
    """The truth of a row."""
    effects = tuple(filter(None, row["effects"].split("+")))
    unknown = any(name in UNKNOWNS for name in effects)
    return Truth(
        case=row["site"],
        verdict="unknown" if unknown else "+".join(sorted(effects)) or NONE,
        effects=effects,
        strengths=tuple(filter(None, row["strengths"].split("+"))),
        phase="",
        segments=(),
        reaches=(),
        slope=row["slope"],
        rocks=int(row["rocks"]),
        kind=row["kind"],
        law=row["law"],
        disturbance=row["disturbance"],
    )


def z_of(rows: Sequence[dict[str, str]]) -> FloatArray:
    """All z of the fingerprints, shape (n_rows, n_statistics); NaN where one was not seen."""
    return np.array([[float(row[name] or "nan") for name in STATISTICS] for row in rows])


def without_law(rows: Sequence[dict[str, str]], ridge: float) -> list[CauseWeights]:
    """For each row, weights fitted to the rows of the other laws."""
    law = np.array([row["law"] for row in rows])
    counts, cause = counts_of(z_of(rows)), causes_of(rows)
    by_law = {}
    for name in np.unique(law).tolist():
        own = (law != name) & (cause >= 0)
        parts = fitted(counts[own], cause[own], ridge)
        by_law[name] = CauseWeights(CAUSES, tuple(STATISTICS), *parts, 1.0, *usual_of(rows))
    return [by_law[name] for name in law.tolist()]


def usual_of(rows: Sequence[dict[str, str]]) -> tuple[FloatArray, FloatArray, float]:
    """Mean and spread of what fingerprints count, and the distance that 1 % of the rows exceed."""
    z = z_of(rows)
    seen, counts = np.isfinite(z), counts_of(z)
    usual = np.array([counts[seen[:, k], k].mean() for k in range(counts.shape[1])])
    spread = np.array([max(counts[seen[:, k], k].std(), 0.05) for k in range(counts.shape[1])])
    far = [distance(row, usual, spread) for row in z]
    return usual, spread, float(np.quantile(far, 0.99))


def causes_of(rows: Sequence[dict[str, str]]) -> np.ndarray:
    """Number of the cause of each row; -1 for pairs and unknown effects."""
    names = [truth_of(row).verdict for row in rows]
    return np.array([CAUSES.index(n) if n in CAUSES else -1 for n in names])


def cross_entropy(
    rows: Sequence[dict[str, str]], weights: Sequence[CauseWeights], sharpness: float
) -> float:
    """Mean of −log p of the true cause."""
    z, cause = counts_of(z_of(rows)), causes_of(rows)
    found = [
        -log_softmax(sharpness * (w.offset + w.weights @ z[i]))[cause[i]]
        for i, w in enumerate(weights)
        if cause[i] >= 0
    ]
    return float(np.mean(found))


def fit() -> None:
    """Weights from all rows; scores by weights that never saw the law."""
    rows = read_rows()
    options = [
        (cross_entropy(rows, found, sharpness), ridge, sharpness)
        for ridge in RIDGES
        for found in [without_law(rows, ridge)]
        for sharpness in SHARPNESS
    ]
    entropy, ridge, sharpness = min(options)
    left_out = [replace(w, sharpness=sharpness) for w in without_law(rows, ridge)]
    thresholds = chosen(rows, left_out)
    right = right_without_law(rows, left_out, thresholds)
    scored = scores_as_json(scores_with(rows, left_out, thresholds, right))
    law = sorted({row["law"] for row in rows})
    RESULTS.write_text(
        json.dumps(
            {
                "sites": len(rows), "laws": law, "ridge": ridge, "sharpness": sharpness,
                "cross_entropy": round(entropy, 3), "named": thresholds.named,
                "possible": thresholds.possible, "sets": sets_left_out(rows, left_out, thresholds),
                **scored,
                "answers": {a.case: a.effect for a in answers_with(rows, left_out, thresholds)},
                "fresh": fresh_scores(left_out, rows, thresholds, right), "right": right,
            },
            indent=1,
        )
        + "\n",
        encoding="utf-8",
    )  # fmt: skip
    cause = causes_of(rows)
    usual, spread, farthest = usual_of(rows)
    weights, offset = fitted(counts_of(z_of(rows))[cause >= 0], cause[cause >= 0], ridge)
    content = read_thresholds()
    content |= {"named": thresholds.named, "possible": thresholds.possible}
    content |= {"right": right_of(rows, left_out, thresholds)}
    content["weights"] = {
        "statistics": list(STATISTICS),
        "sharpness": sharpness,
        "farthest": round(farthest, 2),
        "usual": {n: round(float(v), 2) for n, v in zip(STATISTICS, usual, strict=True)},
        "spread": {n: round(float(v), 2) for n, v in zip(STATISTICS, spread, strict=True)},
        "offset": {n: round(float(v), 2) for n, v in zip(CAUSES, offset, strict=True)},
        "weights": {
            name: {
                s: round(float(v), 2)
                for s, v in zip(STATISTICS, own, strict=True)
                if abs(v) > 0.005
            }
            for name, own in zip(CAUSES, weights, strict=True)
        },
    }
    THRESHOLDS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def fresh_scores(
    left_out: Sequence[CauseWeights],
    rows: Sequence[dict[str, str]],
    thresholds: Thresholds,
    right: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """Scores of sites that nothing was chosen on, by weights that never saw their law either."""
    by_law = {row["law"]: own for row, own in zip(rows, left_out, strict=True)}
    fresh = read_rows("fresh")
    own = [by_law[row["law"]] for row in fresh]
    found = scores_as_json(scores_with(fresh, own, thresholds, right))
    kept = "measures", "numbers"
    of_law = {law: {k: own[k] for k in kept} for law, own in found["by_law"].items()}
    return {k: found[k] for k in kept} | {"by_law": of_law}


def answers_with(
    rows: Sequence[dict[str, str]],
    weights: Sequence[CauseWeights],
    thresholds: Thresholds,
    right: Mapping[str, Mapping[str, float]] | None = None,
) -> list[Answer]:
    """Answers to all rows; ``right``, by the law of a site, in place of that of the thresholds."""
    return [
        answer_of(row, z, w, replace(thresholds, right=right[row["law"]]) if right else thresholds)
        for row, z, w in zip(rows, z_of(rows), weights, strict=True)
    ]


def scores_with(
    rows: Sequence[dict[str, str]],
    weights: Sequence[CauseWeights],
    thresholds: Thresholds,
    right: Mapping[str, Mapping[str, float]] | None = None,
) -> Any:
    """Scores of all rows."""
    answers = answers_with(rows, weights, thresholds, right)
    return score([truth_of(row) for row in rows], answers)


def right_of(
    rows: Sequence[dict[str, str]], weights: Sequence[CauseWeights], thresholds: Thresholds
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


def right_without_law(
    rows: Sequence[dict[str, str]], weights: Sequence[CauseWeights], thresholds: Thresholds
) -> dict[str, dict[str, float]]:
    """``right_of`` for each law, from the sites of the others."""
    pairs = list(zip(rows, weights, strict=True))
    found: dict[str, dict[str, float]] = {}
    for law in sorted({row["law"] for row in rows}):
        others = [pair for pair in pairs if pair[0]["law"] != law]
        found[law] = right_of([r for r, _ in others], [w for _, w in others], thresholds)
    return found


def chosen(rows: Sequence[dict[str, str]], weights: Sequence[CauseWeights]) -> Thresholds:
    """The lowest threshold with few wrong names; sets that hold the truth nine times of ten."""
    found = with_sets(thresholds_of(read_thresholds()), rows, possible_scores(rows, weights))
    for named in NAMED:
        found = replace(found, named=named)
        made = scores_with(rows, weights, found).measures
        if (
            made["false_alarm"].value <= FALSE_ALARMS
            and made["wrong_named"].value <= WRONG_NAMED
            and made["unknown_named"].value <= UNKNOWN_NAMED
        ):
            break
    return found


# ---------------------------------------------------------------------------------------------
# Page


def table(name: str = "") -> str:
    """Figures in all and by law; of another table if it is named."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    found = found[name] if name else found
    names = {
        "false_alarm": "no effect, yet one is named",
        "wrong_named": "an effect, yet another one is named",
        "family_full": "family right: 100 rocks, everything",
        "group_full": "group right: 100 rocks, everything",
        "family_modest": "family right: 40 rocks, stations and stops",
        "group_modest": "group right: 40 rocks, stations and stops",
        "unknown_named": "unknown effect, a family is named",
        "confident_right": "right where the confidence is 0.6 or more",
        "none_while_large": "large gaps, answer none",
        "covered_everything": "truth in the confusion set, everything",
        "covered_otherwise": "truth in the confusion set, otherwise",
    }
    laws = list(found["by_law"])

    def cell(figures: dict[str, Any], key: str) -> str:
        one = figures["measures"].get(key)
        return "–" if not one or not one["trials"] else f"{one['hits']}/{one['trials']}"

    lines = [["", "all", *laws], ["---"] * (2 + len(laws))]
    for key, words in names.items():
        if key in found["measures"]:
            lines.append(
                [words, cell(found, key), *(cell(found["by_law"][law], key) for law in laws)]
            )
    for key, words in (
        ("set_size_everything", "size of the confusion set, everything"),
        ("set_size_otherwise", "size of the confusion set, otherwise"),
        ("calibration_error", "calibration error of the confidence"),
    ):
        values = [found, *(found["by_law"][law] for law in laws)]
        shown = [v["numbers"].get(key) for v in values]
        lines.append([words, *("–" if v is None else f"{v:.2f}" for v in shown)])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def sets() -> str:
    """Coverage and size of the confusion sets."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))["sets"]
    head = [
        "sites whose cause could be seen",
        "sites",
        "truth or its group in the set",
        "mean size",
    ]
    lines = [head, ["---"] * len(head)]
    lines += [
        [key, str(one["sites"]), f"{100 * one['covered']:.0f} %", f"{one['size']:.2f}"]
        for key, one in found.items()
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def confusion() -> str:
    """Answers to medium and strong single effects, by design and true cause."""
    answers = json.loads(RESULTS.read_text(encoding="utf-8"))["answers"]
    rows = [r for r in read_rows() if r["strengths"] in ("medium", "strong")]
    designs = (("100", "everything"), ("40", "both"))
    head = ["true cause", "100 rocks, everything", "40 rocks, stations and stops"]
    lines = [head, ["---"] * len(head)]
    for cause in sorted(FAMILIES):
        cells = []
        for design in designs:
            own = [r for r in rows if (r["rocks"], r["kind"]) == design and r["effects"] == cause]
            counts = Counter(answers[r["site"]] for r in own)
            right = counts.pop(cause, 0)
            others = [f"{name} {n}" for name, n in sorted(counts.items())]
            cells.append("; ".join([f"{right}/{len(own)}", ", ".join(others)]).rstrip("; "))
        lines.append([cause, *cells])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines).replace("_", " ")


def filled(text: str) -> str:
    """The page with its tables."""
    for name, made in (
        ("laws", table), ("fresh", lambda: table("fresh")), ("sets", sets), ("confusion", confusion)
    ):  # fmt: skip
        text = re.sub(
            rf"(<!-- {name} -->\n).*?(\n<!-- end {name} -->)",
            lambda m, made=made: m[1] + made() + m[2],  # type: ignore[misc]
            text,
            flags=re.DOTALL,
        )
    return text


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    command = parser.add_subparsers(dest="command", required=True)
    rows = command.add_parser("rows")
    rows.add_argument("-o", "--out", type=Path, required=True)
    rows.add_argument("--jobs", type=int, default=1)
    rows.add_argument("--table", choices=TABLES, default="rows")
    command.add_parser("fit")
    command.add_parser("page")
    given = parser.parse_args()
    if given.command == "rows":
        make_rows(given.table, given.out, given.jobs)
    elif given.command == "fit":
        fit()
    else:
        PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
