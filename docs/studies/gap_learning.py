"""Train the classifier of the diagnosis on signatures of known cause, and freeze it.

    python docs/studies/gap_learning.py rows -o ROWS --jobs 2       # an hour on two cores
    python docs/studies/gap_learning.py learn ROWS                  # a few minutes
    python docs/studies/gap_learning.py page                        # the page from the numbers

``rows`` generates the training sites. Their seeds are reserved: no battery with reported scores may
use any of them. Each site gives

- the signature of its observed campaign, once as observed and once with 40 rocks and without
  impacts, and both also with tables left out;
- signatures of campaigns of the engine's own effects in the same case, so that each cause is
  represented in the forms of two programs;
- of unknown effects, wind, snow, lying blocks and wetting. Ice, terraces and lift are reserved for
  the check: it needs unknown effects outside the training set.

``learn`` trains an ensemble of randomised trees for each design, calibrates its probabilities on
held-out sites, by cross-validation over sites, and writes
``sassgis/data/gap_classifiers.npz``, ``sassgis/data/gap_thresholds.json`` and
``docs/studies/gap_learning.json``, with the accuracy on held-out sites; ``page``
writes it into ``docs/studies/gap_learning.md``.
"""

from __future__ import annotations

import argparse
import json
import pickle
import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from sklearn.ensemble import ExtraTreesClassifier

from sassgis.gap.check.worlds import EffectSpec, WorldSpec, make_world
from sassgis.gap.check.worlds.battery import DESIGNS as ALL_DESIGNS
from sassgis.gap.check.worlds.battery import FULL, MODEST, world_seeds
from sassgis.gap.check.worlds.slopes import SLOPE_TYPES
from sassgis.gap.check.worlds.strength import inhomogeneity
from sassgis.gap.check.worlds.world import FAMILIES, UNKNOWNS
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.which.classifier import (
    DESIGNS,
    PAIR,
    SURE,
    UNKNOWN,
    Classifier,
    TreeEnsemble,
    calibrated,
    cautious,
    standardised,
)
from sassgis.gap.which.ensemble import problem_of
from sassgis.gap.which.families import FAMILIES as TRIED
from sassgis.gap.which.features import summary
from sassgis.gap.which.hypotheses import NONE, ParameterDraws, draw
from sassgis.gap.which.signature import Base, base_of, features_of, reference_in, signature_of
from sassgis.gap.which.verdict import Thresholds, decide
from sassgis.io.read.gap_thresholds import CLASSIFIERS, THRESHOLDS, write_classifiers
from sassgis.io.write.gap_case_files import CONFIG_NAME, OBSERVATIONS_NAME
from sassgis.model.grid import FloatArray, IntArray
from sassgis.runs.blinded_cases import write_world
from sassgis.runs.gap_case import read_case

SEED = 20261121
ROUNDS = 23
SEEN_UNKNOWNS = ("wind", "snow", "collisions", "wetting")
#: Draws of the base model, engine campaigns sought and kept for each family, and the least size of
#: what their effect changes (energy distance over its bound).
DRAWS, SOUGHT, KEPT, LEAST_SIZE = 60, 4, 2, 0.15
#: Of the training: weight of an engine's campaign, trees, and folds of the cross-validation.
ENGINE_WEIGHT, TREES, FOLDS = 0.1, 160, 8
#: Least number of rows in a leaf, and share of the numbers that each node tries.
LEAF, ASKED = 3, 0.1
#: A battery's shares of causes, for which probabilities are calibrated.
PRIOR = {NONE: 1 / 3, PAIR: 2 / 15, UNKNOWN: 2 / 15}
SINGLES = 2 / 5
#: From this probability on none is named; less probable causes are not named. Chosen on
#: held-out sites, with unknown effects of a kind outside the training set as well.
NONE_SHARE, LEAST_CONFIDENCE = 0.4, 0.45
#: Required share of correct answers where a confidence is SURE or more; required share of single
#: effects with the truth in the confusion set.
RIGHT, COVERED = 0.93, 0.97
#: Designs, with a number of rocks, whose accuracy is reported.
ASKED_OF = (("everything", 100), ("both", 40), ("stations", 40), ("stops", 40))
#: Seeds of batteries that were scored before.
EARLIER = (7, 1986)
BOTH = "synthetic sites and the engine"
STUDY = Path(__file__).with_suffix(".json")


def development_worlds() -> list[tuple[WorldSpec, int]]:
    """Specifications and seeds, in an order of which any beginning is a fair mix."""
    rng = np.random.default_rng([SEED, 1])
    others = [d for d in ALL_DESIGNS if d not in (FULL, MODEST)]
    rng.shuffle(others)
    strengths = ("medium", "strong", "medium", "strong", "weak")
    cells: list[tuple[tuple[EffectSpec, ...], tuple[int, str]]] = []
    turn = 0

    def other() -> tuple[int, str]:
        nonlocal turn
        turn += 1
        return others[turn % len(others)]

    unknown = 0
    for k in range(ROUNDS):
        design = FULL if k % 8 == 7 else (FULL, MODEST, FULL, None)[k % 4]
        for i, family in enumerate(FAMILIES):
            spec = EffectSpec(family, strengths[(k + i) % 5])  # type: ignore[arg-type]
            cells.append(((spec,), design or other()))
        cells += [((), (FULL, MODEST, other(), FULL)[j]) for j in range(4)]
        for _ in range(2):
            spec = EffectSpec(
                SEEN_UNKNOWNS[unknown % 4],  # type: ignore[arg-type]
                ("medium", "strong")[unknown // 4 % 2],  # type: ignore[arg-type]
            )
            cells.append(((spec,), FULL if unknown % 4 else other()))
            unknown += 1
        for j in range(2):
            names = rng.choice(len(FAMILIES), 2, replace=False)
            pair = tuple(
                EffectSpec(FAMILIES[n], ("medium", "strong")[rng.integers(2)])  # type: ignore[arg-type]
                for n in names
            )
            cells.append((pair, FULL if j else other()))
    seeds = world_seeds(SEED, len(cells))
    return [
        (WorldSpec(SLOPE_TYPES[(k + k // 5) % len(SLOPE_TYPES)], effects, *design), seed)
        for k, ((effects, design), seed) in enumerate(zip(cells, seeds, strict=True))
    ]


# ---------------------------------------------------------------------------------------------
# Rows


@dataclass(frozen=True)
class Rows:
    """Signatures of one case in one design.

    Attributes
    ----------
    world, rocks : int
    design : str
    names : tuple of str
    values : float32, shape (n, p)
        The first of the site itself, the others of the engine's campaigns.
    causes : tuple of str, length n
    truth : tuple of str
        Effects of the site.
    strength : str
        Of a single effect.
    """

    world: int
    rocks: int
    design: str
    names: tuple[str, ...]
    values: np.ndarray
    causes: tuple[str, ...]
    truth: tuple[str, ...]
    strength: str


def cause_of(truth: Sequence[str]) -> str:
    """Cause of a site in the training set."""
    if not truth:
        return NONE
    if len(truth) > 1:
        return PAIR
    return UNKNOWN if truth[0] in UNKNOWNS else truth[0]


#: Designs that an observed one holds.
HELD = {
    "everything": ("everything", "both"),
    "both": ("both", "stations", "stops"),
    "stations": ("stations",),
    "stops": ("stops",),
}


def engine_campaigns(case: Case, base: Base) -> list[tuple[str, dict[str, float]]]:
    """Features of campaigns of the engine's effects, strong enough to be detected."""
    problem, made = base.problem, []
    for k, family in enumerate(TRIED):
        kept = 0
        for j in range(SOUGHT):
            rng = np.random.default_rng([problem.seed, 97, k, j])
            with_effect = draw(case, (family,), ParameterDraws(rng))
            without = draw(case, (), ParameterDraws(rng, with_effect.parameter_draws))
            one, other = (
                campaigns(
                    case,
                    problem.rock_lines,
                    d.model,
                    count=1,
                    seed=problem.seed + 5,
                    number=first + 10 * k + j,
                )[0]
                for d, first in ((with_effect, 9000), (without, 9500))
            )
            rows = [problem.scale.rows(summary(case, s, problem.given)[1]) for s in (one, other)]
            if rows[0].shape[1] and inhomogeneity(*rows) > LEAST_SIZE:
                kept += 1
                made.append((family, features_of(base, one)))
            if kept == KEPT:
                break
    return made


def rows_of_case(case: Case, designs: Iterable[str]) -> dict[str, tuple[tuple[str, ...], Any]]:
    """Signatures of the observed and of engine campaigns, by design."""
    base, _ = base_of(problem_of(case, 1), DRAWS)
    seen = [
        ("", features_of(base, base.problem.observed)),
        *engine_campaigns(case, base),
    ]
    # The base model itself is one of the engine's campaigns, too.
    seen += [(NONE, dict(zip(base.names, base.x[i].tolist(), strict=True))) for i in (3, 4)]
    out = {}
    for design in designs:
        reference = reference_in(base, design)
        signatures = [signature_of(reference, numbers) for _, numbers in seen]
        columns = tuple(sorted(set().union(*signatures)))
        values = np.array([[s.get(c, np.nan) for c in columns] for s in signatures], np.float32)
        out[design] = ((*(cause for cause, _ in seen),), (columns, values))
    return out


def make_rows(task: tuple[int, WorldSpec, int, str]) -> int:
    """Write all rows of one site to a file."""
    number, spec, seed, folder = task
    file = Path(folder) / f"{number:03d}.pkl"
    if file.exists():
        return number
    world = make_world(spec, seed)
    truth = tuple(e.name for e in spec.effects)
    strength = spec.effects[0].strength if len(truth) == 1 else ""
    found = []
    wanted = {(spec.n_rocks, spec.kind)}
    if spec.kind in ("both", "everything") and spec.n_rocks >= MODEST[0]:
        wanted.add(MODEST)
    with tempfile.TemporaryDirectory() as place:
        for rocks, kind in sorted(wanted):
            case_folder = Path(place) / f"{rocks}{kind}"
            write_world(world, case_folder, str(number), kind, rocks)
            case = read_case(case_folder / CONFIG_NAME, case_folder / OBSERVATIONS_NAME)
            for design, (causes, (names, values)) in rows_of_case(case, HELD[kind]).items():
                causes = (cause_of(truth), *causes[1:])
                found.append(Rows(number, rocks, design, names, values, causes, truth, strength))
    part = file.with_suffix(".part")
    part.write_bytes(pickle.dumps(found))
    part.replace(file)
    return number


# ---------------------------------------------------------------------------------------------
# Learning


@dataclass(frozen=True)
class Table:
    """Rows of one design over all worlds: ``x`` float32 (n, p), NaN where a number is not had."""

    names: tuple[str, ...]
    x: np.ndarray
    cause: np.ndarray
    world: IntArray
    rocks: IntArray
    made: np.ndarray
    strength: np.ndarray
    truth: list[tuple[str, ...]]


def table_of(rows: Sequence[Rows], design: str) -> Table:
    """Put rows of a design together; numbers that few have are left out."""
    own = [r for r in rows if r.design == design]
    counts = Counter(name for r in own for name in r.names)
    names = tuple(sorted(n for n, c in counts.items() if c > 0.3 * len(own)))
    place = {name: i for i, name in enumerate(names)}
    blocks, causes = [], []
    for r in own:
        # The site, and every second campaign of the engine: more of them mainly add nodes.
        rows = [0, *range(1, len(r.values), 2)]
        block = np.full((len(rows), len(names)), np.nan, np.float32)
        kept = [k for k, name in enumerate(r.names) if name in place]
        block[:, [place[r.names[k]] for k in kept]] = r.values[np.ix_(rows, kept)]
        blocks.append(block)
        causes.append([r.causes[k] for k in rows])
    sizes = [len(block) for block in blocks]
    return Table(
        names,
        np.concatenate(blocks),
        np.concatenate(causes),
        np.repeat([r.world for r in own], sizes),
        np.repeat([r.rocks for r in own], sizes),
        np.concatenate([np.arange(n) == 0 for n in sizes]),
        np.repeat([r.strength for r in own], sizes),
        [r.truth for r, n in zip(own, sizes, strict=True) for _ in range(n)],
    )


def weights_of(table: Table, used: np.ndarray) -> FloatArray:
    """Causes count alike, the base, unknown effects and pairs more: they are more various."""
    weight = np.where(table.made[used], 1.0, ENGINE_WEIGHT)
    cause = table.cause[used]
    for name in np.unique(cause):
        mine = cause == name
        weight[mine] *= {NONE: 3.0, UNKNOWN: 2.0, PAIR: 1.3}.get(str(name), 1.0)
        weight[mine] /= weight[mine].sum()
    out: FloatArray = weight / weight.mean()
    return out


def grown(table: Table, used: np.ndarray, seed: int) -> tuple[Any, np.ndarray, np.ndarray]:
    """Trees on some rows; with the centre and scale of the numbers."""
    centre = np.nanmean(table.x[used], axis=0)
    scale = np.nanstd(table.x[used], axis=0) + np.float32(0.3)
    model = ExtraTreesClassifier(
        TREES, min_samples_leaf=LEAF, max_features=ASKED, random_state=seed
    )
    x = standardised(table.x[used], centre, scale)
    model.fit(x, table.cause[used], sample_weight=weights_of(table, used))
    return model, centre, scale


def shares_of(
    model: Any, table: Table, used: np.ndarray, centre: np.ndarray, scale: np.ndarray
) -> FloatArray:
    """Shares of the causes in the trees, in the order of ``model.classes_``."""
    out: FloatArray = model.predict_proba(standardised(table.x[used], centre, scale))
    return out


def left_out_shares(
    table: Table, causes: Sequence[str], *, worlds: bool = True
) -> tuple[IntArray, FloatArray]:
    """Shares of the rows of the synthetic sites, by trees trained without the site.

    Without ``worlds`` the trees grow on the engine's campaigns alone.
    """
    part = (np.random.default_rng([SEED, 2]).permutation(1000) % FOLDS)[table.world]
    found = np.zeros((len(table.x), len(causes)))
    for p in range(FOLDS):
        seen = (part != p) & (worlds | ~table.made)
        model, centre, scale = grown(table, seen, p)
        asked = (part == p) & table.made
        at = np.searchsorted(causes, model.classes_)
        if asked.any():
            found[np.ix_(asked, at)] = shares_of(model, table, asked, centre, scale)
    own = np.flatnonzero(table.made)
    return own, found[own]


def kinds_left_out(table: Table, causes: Sequence[str], shares: FloatArray) -> FloatArray:
    """The same shares, but those of unknown effects by trees trained without their kind."""
    own = np.flatnonzero(table.made)
    kind = np.array([t[0] if len(t) == 1 else "" for t in table.truth])
    found = shares.copy()
    for name in SEEN_UNKNOWNS:
        asked = table.made & (kind == name)
        if not asked.any():
            continue
        model, centre, scale = grown(table, kind != name, 7)
        rows = np.searchsorted(own, np.flatnonzero(asked))
        found[np.ix_(rows, np.searchsorted(causes, model.classes_))] = shares_of(
            model, table, asked, centre, scale
        )
    return found


def prior_weights(cause: np.ndarray) -> FloatArray:
    """Weights that give causes the shares that they have in a battery."""
    singles = ~np.isin(cause, list(PRIOR))
    weight = np.zeros(cause.size)
    for name, share in PRIOR.items():
        mine = cause == name
        weight[mine] = share / max(mine.sum(), 1)
    weight[singles] = SINGLES / max(singles.sum(), 1)
    return weight


def calibration(
    shares: FloatArray, cause: np.ndarray, causes: Sequence[str]
) -> tuple[float, FloatArray]:
    """Power and weights by maximum likelihood (the families have one weight)."""
    truth = np.searchsorted(causes, cause)
    weight = prior_weights(cause)
    special = [list(causes).index(name) for name in PRIOR]

    def of(parameter_draws: FloatArray) -> tuple[float, FloatArray]:
        factors = np.ones(len(causes))
        factors[special] = np.exp(parameter_draws[1:])
        return float(np.exp(parameter_draws[0])), factors

    def loss(parameter_draws: FloatArray) -> float:
        p = calibrated(shares, *of(parameter_draws))
        return float(
            -(weight * np.log(p[np.arange(truth.size), truth])).sum()
            + 0.01 * parameter_draws @ parameter_draws
        )

    return of(minimize(loss, np.zeros(1 + len(PRIOR)), method="Nelder-Mead").x)


def as_trees(model: Any, causes: Sequence[str]) -> TreeEnsemble:
    """Trees of scikit-learn in one table."""
    at = np.searchsorted(causes, model.classes_)
    root, parts, offset = [], [], 0
    for one in model.estimators_:
        tree = one.tree_
        own = np.arange(tree.node_count)
        leaf = tree.children_left < 0
        share = np.zeros((tree.node_count, len(causes)))
        value = tree.value[:, 0, :]
        share[:, at] = np.where(leaf[:, None], value / value.sum(axis=1, keepdims=True), 0.0)
        parts.append(
            (
                np.where(leaf, 0, tree.feature),
                np.where(leaf, 0.0, tree.threshold),
                np.where(leaf, own, tree.children_left) + offset,
                np.where(leaf, own, tree.children_right) + offset,
                share,
            )
        )
        root.append(offset)
        offset += tree.node_count
    number, limit, left, right, shares = (np.concatenate(c) for c in zip(*parts, strict=True))
    return TreeEnsemble(
        np.array(root), number, limit.astype(np.float32), left, right, shares.astype(np.float32)
    )


@dataclass(frozen=True)
class Answers:
    """Probabilities of the causes of held-out sites, and the truth."""

    causes: tuple[str, ...]
    probability: FloatArray
    cause: np.ndarray
    rocks: IntArray
    strength: np.ndarray
    truth: list[str]

    def decided(self, thresholds: Thresholds) -> tuple[np.ndarray, FloatArray]:
        """Answer on each site, and its probability."""
        answers = []
        for p in self.probability:
            order = np.argsort(-p, kind="stable")
            shares = {self.causes[k]: float(p[k]) for k in order}
            answers.append(decide(shares, None, thresholds)[:2])
        return np.array([a for a, _ in answers]), np.array([p for _, p in answers])


def learn_design(rows: Sequence[Rows], design: str) -> tuple[Classifier, dict[str, Answers]]:
    """Classifier of a design, and the answers on held-out sites, by training set."""
    table = table_of(rows, design)
    causes = tuple(sorted(set(table.cause.tolist())))
    own, shares = left_out_shares(table, causes)
    power, weight = calibration(shares, table.cause[own], causes)
    _, engine_only = left_out_shares(table, causes, worlds=False)
    model, centre, scale = grown(table, np.ones(len(table.x), bool), 99)
    truth = ["+".join(sorted(table.truth[k])) for k in own.tolist()]
    truth = [UNKNOWN if t in UNKNOWNS else t or NONE for t in truth]

    def answers(p: FloatArray) -> Answers:
        return Answers(causes, p, table.cause[own], table.rocks[own], table.strength[own], truth)

    left_out = answers(calibrated(shares, power, weight))
    confidence_calibration = confidence_calibration_of(left_out)
    classifier = Classifier(
        table.names,
        causes,
        centre,
        scale,
        as_trees(model, causes),
        power,
        weight,
        confidence_calibration,
    )
    strange = calibrated(kinds_left_out(table, causes, shares), power, weight)
    return classifier, {
        BOTH: left_out,
        "the same, no unknown effect of the kind": answers(strange),
        "the engine only": answers(engine_only),
    }


def confidence_calibration_of(left_out: Answers) -> float:
    """Confidence calibration: where confidences are SURE or more, enough answers are correct."""
    answer, p = left_out.decided(Thresholds(NONE_SHARE, LEAST_CONFIDENCE))
    right = answer == np.array(left_out.truth)
    weight = prior_weights(left_out.cause)
    for confidence_calibration in np.arange(0.0, 4.0, 0.1):
        sure = cautious(p, confidence_calibration) >= SURE
        if not sure.any() or (weight * right * sure).sum() >= RIGHT * (weight * sure).sum():
            return float(round(confidence_calibration, 1))
    raise ValueError("no caution is enough")


def covering_mass(all_left_out: Sequence[Answers]) -> float:
    """Probability that confusion sets must hold, to hold the truth of enough single effects."""
    above = []
    for one in all_left_out:
        causes = np.array(one.causes)
        for p, cause in zip(one.probability, one.cause, strict=True):
            if cause not in (NONE, PAIR, UNKNOWN):
                single = np.where(causes == PAIR, 0.0, p)
                single /= single.sum()
                above.append(float(single[single > single[causes == cause]].sum()))
    return round(min(max(float(np.quantile(above, COVERED)), 0.9), 0.995), 3)


def accuracy(
    design: str,
    rocks: int,
    learned_on: str,
    one: Answers,
    thresholds: Thresholds,
    confidence_calibration: float,
) -> dict[str, Any]:
    """Accuracy on held-out sites."""
    answer, p = one.decided(thresholds)
    mine = one.rocks == rocks
    answer, p, truth = answer[mine], p[mine], np.array(one.truth)[mine]
    cause, strength = one.cause[mine], one.strength[mine]
    single = ~np.isin(cause, (NONE, PAIR, UNKNOWN))
    right, named = answer == truth, ~np.isin(answer, (NONE, UNKNOWN))
    weight = prior_weights(cause) * (cautious(p, confidence_calibration) >= SURE)
    families = np.isin(one.causes, FAMILIES)
    first = np.array(one.causes)[np.where(families, one.probability[mine], -1.0).argmax(axis=1)]

    def share(of: np.ndarray, counted: np.ndarray) -> dict[str, int]:
        return {"counted": int((counted & of).sum()), "worlds": int(of.sum())}

    return {
        "design": design,
        "rocks": rocks,
        "learned_on": learned_on,
        "first_family_right": share(single & (strength != "weak"), first == truth),
        "single_right": share(single & (strength != "weak"), right),
        "weak_right": share(single & (strength == "weak"), right),
        "false_alarms": share(cause == NONE, named),
        "unknown_named": share(cause == UNKNOWN, named),
        "pair_right": share(cause == PAIR, right),
        # Weighted to the shares of causes in a battery.
        "right_where_sure": round(float((weight * right).sum() / max(weight.sum(), 1e-9)), 3),
    }


def learn(folder: Path) -> None:
    """Write classifiers, thresholds and their accuracy."""
    rows = [r for file in sorted(folder.glob("*.pkl")) for r in pickle.loads(file.read_bytes())]
    with ProcessPoolExecutor(len(DESIGNS)) as pool:
        learned = dict(
            zip(DESIGNS, pool.map(learn_design, [rows] * len(DESIGNS), DESIGNS), strict=True)
        )
    mass = covering_mass([answers[BOTH] for _, answers in learned.values()])
    thresholds = Thresholds(NONE_SHARE, LEAST_CONFIDENCE, 0.0, mass)
    write_classifiers(
        CLASSIFIERS, {design: classifier for design, (classifier, _) in learned.items()}
    )
    content = {"battery_seeds": [*EARLIER, SEED], **asdict(thresholds)}
    THRESHOLDS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    told = {
        "worlds": len({r.world for r in rows}),
        "signatures": {d: len(table_of(rows, d).x) for d in DESIGNS},
        "thresholds": asdict(thresholds),
        "caution": {
            design: classifier.confidence_calibration for design, (classifier, _) in learned.items()
        },
        "left_out": [
            accuracy(
                design, rocks, on, answers, thresholds, learned[design][0].confidence_calibration
            )
            for design, rocks in ASKED_OF
            for on, answers in learned[design][1].items()
        ],
    }
    STUDY.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    write_page()


def page_part(told: dict[str, Any]) -> str:
    """The table of the page."""
    columns = {
        "first_family_right": "most probable effect is the true one",
        "single_right": "single effect answered",
        "weak_right": "weak one answered",
        "pair_right": "pair answered, both",
        "false_alarms": "effect named where there is none",
        "unknown_named": "known effect named where it is unknown",
    }
    lines = ["| observed | learned on | " + " | ".join(columns.values()) + " |"]
    lines.append("|" + "---|" * (2 + len(columns)))
    for row in told["left_out"]:
        cells = [f"{row['rocks']} rocks, {row['design']}", row["learned_on"]]
        for key in columns:
            share = row[key]
            cells.append(
                f"{100.0 * share['counted'] / max(share['worlds'], 1):.0f} % "
                f"({share['counted']} of {share['worlds']})"
            )
        lines.append("| " + " | ".join(cells) + " |")
    thresholds = told["thresholds"]
    lines += [
        "",
        f"{told['worlds']} sites; signatures: "
        + ", ".join(f"{n} of {design}" for design, n in told["signatures"].items())
        + f". `none` is answered from a probability of {thresholds['none_share']:g} on; causes "
        f"below {thresholds['least_confidence']:g} are not named; confusion sets hold "
        f"{thresholds['confusion_mass']:g} of the probability.",
    ]
    return "\n".join(lines)


def write_page() -> None:
    """Rewrite what stands between ``<!-- learned -->`` and ``<!-- end learned -->``."""
    page = STUDY.with_suffix(".md")
    told = json.loads(STUDY.read_text(encoding="utf-8"))
    part = f"<!-- learned -->\n{page_part(told)}\n<!-- end learned -->"
    text = page.read_text(encoding="utf-8")
    pattern = r"<!-- learned -->.*<!-- end learned -->"
    page.write_text(re.sub(pattern, lambda _: part, text, flags=re.DOTALL), encoding="utf-8")


def main() -> None:
    """Make rows, or learn from them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    steps = parser.add_subparsers(dest="step", required=True)
    make = steps.add_parser("rows")
    make.add_argument("-o", "--out", type=Path, required=True)
    make.add_argument("--jobs", type=int, default=1)
    make.add_argument("--worlds", type=int, help="number of sites; default: all")
    steps.add_parser("learn").add_argument("rows", type=Path)
    steps.add_parser("page")
    arguments = parser.parse_args()
    if arguments.step != "rows":
        learn(arguments.rows) if arguments.step == "learn" else write_page()
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    worlds = development_worlds()[: arguments.worlds]
    tasks = [(k, spec, seed, str(arguments.out)) for k, (spec, seed) in enumerate(worlds)]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for number in pool.map(make_rows, tasks):
            print(f"{number + 1} of {len(tasks)} sites", flush=True)


if __name__ == "__main__":
    main()
