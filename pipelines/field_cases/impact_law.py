"""Single impacts predicted from the observed state before them, with and without soft ground."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from field_cases.contacts import REACH_M, read_contacts
from field_cases.figures import contacts_figure
from field_cases.sites import AXES
from sassgis.engine.effects import hooks
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.ellipse import inertia
from sassgis.engine.simulate import physics_of
from sassgis.gap.fit.distances import energy_scores
from sassgis.gap.residuals.impact_residuals import impact_draws
from sassgis.grid import FloatArray
from sassgis.inputs.ground_map import built_in_table
from sassgis.report.figures import save
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.settings import EngineSettings

DRAWS = 400
#: Relative error of a velocity: the effect of another radius of the plane through the ground.
SPEED_ERROR = 0.1
#: Ground by expert judgement.
GROUND = "soft_meadow"
#: Parameters calibrated on the other contacts, over grids as wide as the effect allows.
ETA_MAX = (0.2, 0.35, 0.5, 0.7, 0.95)
FORMS: Mapping[str, Mapping[str, Sequence[float]]] = {
    "base": {},
    "velocity_scaled": {"reference_speed_mps": (1.0, 3.0, 9.144, 30.0)},
    "scar": {"drag_coefficient": (0.3, 1.0, 3.0, 10.0)},
    "slip": {"friction": (0.05, 0.2, 0.5, 1.0)},
}
QUANTITIES = ("vt_out_mps", "vn_out_mps", "omega_out_radps", "energy_kept", "energy_trans_kept")


@dataclass(frozen=True)
class State:
    """A rock before an impact.

    Attributes
    ----------
    dip : float
        Of the ground along the travel (rad).
    vt, vn, omega : float
        (m/s, rad/s)
    axes : tuple of float
        Semi-axes, longest first (m).
    """

    dip: float
    vt: float
    vn: float
    omega: float
    axes: tuple[float, float, float]
    mass_kg: float


@dataclass(frozen=True)
class Law:
    """The law of impacts: a ground class, and a form of soft ground or none."""

    ground: GroundClass
    soft: SoftGround | None = None


def ground_class(name: str = GROUND) -> GroundClass:
    """A built-in class."""
    table = built_in_table(EngineSettings().readings)
    return table.classes[table.index(name)]


def laws(form: str, ground: GroundClass) -> list[Law]:
    """All laws of a form over the grids."""
    names = list(FORMS[form])
    made = []
    for eta, *values in itertools.product(ETA_MAX, *FORMS[form].values()):
        soft = None
        if form != "base":
            given: dict[str, Any] = dict(zip(names, values, strict=True))
            soft = SoftGround(form=form, classes=(ground.name,), **given)  # type: ignore[arg-type]
        made.append(Law(replace(ground, eta_max=eta), soft))
    return made


def defaults(ground: GroundClass) -> dict[str, Law]:
    """Each form with its defaults."""
    return {
        form: Law(ground, None if form == "base" else SoftGround(form=form))  # type: ignore[arg-type]
        for form in FORMS
    }


def predict(
    state: State,
    law: Law,
    rng: np.random.Generator,
    draws: int = DRAWS,
    error: float = SPEED_ERROR,
) -> FloatArray:
    """v_t, v_n, ω after the impact, kept share of the total and of the translational energy.

    Shape (draws, 5), in the order of QUANTITIES. Orientation and slope variation are drawn as the
    engine draws them, the errors of measurement on top. All rebound, as was observed.
    """
    settings = EngineSettings().resolved()
    table = GroundTable((law.ground,)).with_rolling_threshold(0.0)
    effects = EffectSettings()
    if law.soft is not None:
        effects = effects.having(replace(law.soft, classes=(law.ground.name,)))
    radius = float(np.cbrt(np.prod(state.axes)))
    density = state.mass_kg / (4.0 / 3.0 * math.pi * radius**3)
    factor = np.maximum(1.0 + error * rng.standard_normal((draws, 3)), 0.1)
    before = np.array([state.vt, state.vn, state.omega]) / factor[:, [0, 0, 1]]
    drawn = np.empty((draws, 1, 3))
    drawn[:, 0, 0] = rng.uniform(0.0, math.pi, draws)
    drawn[:, 0, 1] = rng.uniform(law.ground.dp_min, law.ground.dp_max, draws)
    after = np.empty((draws, 1, 3))
    impact_draws(
        np.column_stack([np.full(draws, state.dip), before]), np.zeros(draws, np.int64),
        np.tile(state.axes, (draws, 1, 1)), drawn,
        rng.integers(2**64, size=(draws, 1), dtype=np.uint64), np.full(draws, density),
        hooks.ground_of(effects, table), np.zeros(1, hooks.BLOCK_DTYPE), physics_of(settings),
        hooks.prepare(effects, has_stems=False), after,
    )  # fmt: skip
    made = after[:, 0]
    made[:, :2] *= factor[:, 2:]
    return _with_energies(made, state)


def _with_energies(after: FloatArray, state: State) -> FloatArray:
    """Quantities from v_t, v_n and ω after an impact, shape (n, 3); in the order of QUANTITIES."""
    inert = inertia(*state.axes[:2])
    moving = after[:, 0] ** 2 + after[:, 1] ** 2
    speed2 = state.vt**2 + state.vn**2
    kept = (moving + inert * after[:, 2] ** 2) / (speed2 + inert * state.omega**2)
    return np.column_stack([after, kept, moving / speed2])


def _state(row: Mapping[str, Any]) -> State:
    a, b, c = (row[axis] for axis in AXES)
    return State(
        math.radians(row["slope_deg"]), row["vt_in_mps"], row["vn_in_mps"], row["omega_in_radps"],
        (a, b, c), row["mass_kg"],
    )  # fmt: skip


def observed_scale(observed: FloatArray) -> FloatArray:
    """Standard deviation of each quantity among the observed rows, shape (p,); 1 without any."""
    spread = np.nanstd(observed, axis=0, ddof=1) if len(observed) > 1 else np.zeros(1)
    return np.where(spread > 1e-12, spread, 1.0)


def left_out_scores(
    states: Sequence[State],
    seen: FloatArray,
    runs: Sequence[str],
    scored: Sequence[int],
    seed: int,
    draws: int = DRAWS,
) -> dict[str, dict[str, Any]]:
    """Calibrate each form on the contacts of the other runs, and predict those of each run.

    Parameters
    ----------
    seen : float64, shape (n, 5)
        What was observed, in the order of QUANTITIES.
    runs : sequence of str
        Run of each contact; its contacts are held out together.
    scored : sequence of int
        Columns that are scored; distances are in units of the observed spread.
    draws : int
        Orientations and slopes drawn for each contact.

    Returns
    -------
    dict
        Of each form: mean energy score of held-out contacts, mean prediction of each contact with
        5 and 95 %, and what was chosen.
    """
    ground = ground_class()
    columns = list(scored)
    own = np.array(runs)
    report: dict[str, dict[str, Any]] = {}
    for form in FORMS:
        tried = laws(form, ground)
        made = [
            [predict(s, law, np.random.default_rng([seed, i]), draws) for i, s in enumerate(states)]
            for law in tried
        ]

        def score(law: int, i: int, unit: FloatArray, made: Any = made) -> float:
            replicas = made[law][i][:, None, columns] / unit
            return float(energy_scores(seen[i : i + 1, columns] / unit, replicas)[0])

        best = np.empty(len(states), int)
        for run in set(runs):
            # The unit must not depend on the held-out contacts either.
            others = np.flatnonzero(own != run)
            unit = observed_scale(seen[np.ix_(others, columns)])
            means = [np.mean([score(j, i, unit) for i in others]) for j in range(len(tried))]
            best[own == run] = int(np.argmin(means))
        scale = observed_scale(seen[:, columns])
        scores = np.array([score(j, i, scale) for i, j in enumerate(best.tolist())])
        chosen = [made[best[i]][i] for i in range(len(states))]
        report[form] = {
            "energy_score": float(scores.mean()),
            "scores": scores,
            "eta_max": sorted({tried[j].ground.eta_max for j in best}),
            **{
                name: sorted({float(getattr(tried[j].soft, name)) for j in best})
                for name in FORMS[form]
            },
            "mean": [m.mean(axis=0) for m in chosen],
            "q05": [np.quantile(m, 0.05, axis=0) for m in chosen],
            "q95": [np.quantile(m, 0.95, axis=0) for m in chosen],
        }
    return report


def summary(found: Mapping[str, Any]) -> dict[str, Any]:
    """Mean of the predictions of a form over the contacts, and the chosen parameters."""
    kept = {k: v for k, v in found.items() if k not in ("mean", "q05", "q95", "scores")}
    return {**kept, "mean": np.mean(found["mean"], axis=0)}


def _means(states: Sequence[State], law: Law, seed: int) -> FloatArray:
    """Mean prediction over all contacts."""
    made = [predict(s, law, np.random.default_rng([seed, i])) for i, s in enumerate(states)]
    means: FloatArray = np.mean([m.mean(axis=0) for m in made], axis=0)
    return means


def contact_study(folder: Path, out: Path, seed: int) -> dict[str, Any]:
    """Contacts of the flights, predicted with each form; writes ``contacts.png``."""
    contacts, rocks = read_contacts(folder)
    contacts = contacts.merge(rocks[["rock_id", *AXES]], "left", on="rock_id", validate="m:1")
    spun = contacts["omega_in_radps"].notna() & contacts["omega_out_radps"].notna()
    ahead = contacts["vn_in_mps"] < 0.0
    near, _ = read_contacts(folder, 0.6 * REACH_M)
    columns = ["vt_in_mps", "vn_in_mps", "vt_out_mps", "vn_out_mps"]
    used = (contacts["left_out"] == "").to_numpy()
    report: dict[str, Any] = {
        "speeds_by_reach_of_the_ground": {
            f"{reach:g} m": dict(zip(columns, frame.loc[used, columns].mean(), strict=True))
            for reach, frame in ((REACH_M, contacts), (0.6 * REACH_M, near))
        }
    }
    for name, rows in (
        ("used", contacts[used]),
        ("all with a spin", contacts[spun & ahead]),
    ):
        records = rows.to_dict("records")
        states = [_state(row) for row in records]
        after = rows[list(QUANTITIES[:3])].to_numpy(float)[:, None]
        seen = np.concatenate([_with_energies(a, s) for a, s in zip(after, states, strict=True)])
        runs = rows["rock_id"].tolist()
        scored = left_out_scores(states, seen, runs, (0, 1, 2), seed)
        untuned = {
            form: _means(states, law, seed) for form, law in defaults(ground_class()).items()
        }
        # The block of the model rotates about its shortest axis; these plates may tumble.
        tumbling = [replace(s, axes=(s.axes[0], s.axes[2], s.axes[1])) for s in states]
        untuned["base, shortest axis in the plane"] = _means(tumbling, Law(ground_class()), seed)
        for other in ("debris", "rock"):
            untuned[f"base on {other}"] = _means(states, Law(ground_class(other)), seed)
        report[name] = {
            "contacts": len(rows),
            "quantities": QUANTITIES,
            "before_mean": np.mean([[s.vt, s.vn, s.omega] for s in states], axis=0),
            "observed_mean": seen.mean(axis=0),
            "untuned_mean": untuned,
            "left_out": {form: summary(found) for form, found in scored.items()},
        }
        if name == "used":
            names = [f"{r} {i}" for r, i in zip(runs, rows["impact"], strict=True)]
            save(contacts_figure(seen, scored, names), out / "contacts.png")
    return report
