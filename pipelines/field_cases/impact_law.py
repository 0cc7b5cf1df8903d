"""Single impacts predicted from the observed state before them, with and without soft ground."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from field_cases.contacts import REACH_M, read_contacts
from field_cases.distances import energy_scores, observed_scale
from field_cases.figures import contacts_figure
from sassgis.engine.effects import soft_ground
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.ellipse import frame_of, inertia
from sassgis.engine.impact import COULOMB, SCALE, impact
from sassgis.gap.residuals.impact_step import orientation_at_contact
from sassgis.io.read.ground_map import built_in_table
from sassgis.model.ground import GroundClass
from sassgis.report.figures import save

FloatArray = NDArray[np.float64]

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
    mass_kg : float
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

    @property
    def name(self) -> str:
        """Form of soft ground, or "base"."""
        return "base" if self.soft is None else self.soft.form


def ground_class(name: str = GROUND) -> GroundClass:
    """A class as the readings of 1986 have it, with which the campaign is diagnosed."""
    table = built_in_table("1986")
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


def predict(state: State, law: Law, rng: np.random.Generator, draws: int = DRAWS) -> FloatArray:
    """v_t, v_n, ω after the impact, kept share of the total and of the translational energy.

    Shape (draws, 5), in the order of QUANTITIES.

    Orientation and slope variation are drawn as the engine draws them, the errors of measurement on
    top. The order of things is that of the engine: the law of impacts, then the soft ground.
    """
    a, b, c = state.axes
    inert, radius = inertia(a, b), (a * b * c) ** (1.0 / 3.0)
    ground, soft = law.ground, law.soft
    numbers = None if soft is None else soft_ground.prepare(soft)
    phase = rng.uniform(0.0, math.pi, draws)
    u = rng.uniform(ground.dp_min, ground.dp_max, draws)
    error = np.maximum(1.0 + SPEED_ERROR * rng.standard_normal((draws, 3)), 0.1)
    made = np.empty((draws, 5))
    before = state.vt**2 + state.vn**2 + inert * state.omega**2
    for k in range(draws):
        vt, vn, omega = state.vt / error[k, 0], state.vn / error[k, 0], state.omega / error[k, 1]
        theta = orientation_at_contact(a, b, phase[k], vn, omega)
        turn = 0.0
        if state.dip > 0.0:
            turn = state.dip - math.atan(math.tan(state.dip) * (1.0 - u[k]))
        cosine, sine = math.cos(turn), math.sin(turn)
        mt, mn = vt * cosine + vn * sine, vn * cosine - vt * sine
        x, y, _ = frame_of(a, b, math.sin(theta - turn), math.cos(theta - turn))
        slips = soft is not None and soft.form == "slip"
        wt, wn, spin = impact(
            x, y, inert, mt, mn, omega, ground.eta_max,
            COULOMB if slips else SCALE, soft.friction if soft is not None else ground.mu_f,
        )  # fmt: skip
        if soft is not None and numbers is not None:
            if soft.form == "velocity_scaled" and wn > 0.0:
                wn *= soft_ground.rebound_left(numbers, -mn)
            elif soft.form == "scar":
                kept = soft_ground.scar_energy_left(numbers, state.mass_kg, radius, -mn)
                wt, wn, spin = (v * math.sqrt(kept) for v in (wt, wn, spin))
        made[k, 0] = (wt * cosine - wn * sine) * error[k, 2]
        made[k, 1] = (wn * cosine + wt * sine) * error[k, 2]
        made[k, 2] = spin
        energy = made[k, 0] ** 2 + made[k, 1] ** 2
        made[k, 3] = (energy + inert * spin**2) / before
        made[k, 4] = energy / (state.vt**2 + state.vn**2)
    return made


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
    states : sequence of State
    seen : float64, shape (n, 5)
        What was observed, in the order of QUANTITIES.
    runs : sequence of str
        Run of each contact; its contacts are held out together.
    scored : sequence of int
        Columns that are scored; distances are in units of the observed spread.
    seed : int
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
            own_made = made[law][i][None][:, :, columns]
            return float(energy_scores(own_made, seen[i : i + 1, columns], unit)[0])

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
    axes: dict[str, tuple[float, float, float]] = {
        r["rock_id"]: (r["semi_axis_a_m"], r["semi_axis_b_m"], r["semi_axis_c_m"])
        for r in rocks.to_dict("records")
    }
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
        states = [
            State(math.radians(r["slope_deg"]), r["vt_in_mps"], r["vn_in_mps"], r["omega_in_radps"],
                  axes[r["rock_id"]], r["mass_kg"])
            for r in rows.to_dict("records")
        ]  # fmt: skip
        seen = np.empty((len(rows), 5))
        seen[:, :3] = rows[list(QUANTITIES[:3])].to_numpy()
        for i, (s, v) in enumerate(zip(states, seen, strict=True)):
            inert = inertia(*s.axes[:2])
            before = s.vt**2 + s.vn**2 + inert * s.omega**2
            seen[i, 3] = (v[0] ** 2 + v[1] ** 2 + inert * v[2] ** 2) / before
            seen[i, 4] = (v[0] ** 2 + v[1] ** 2) / (s.vt**2 + s.vn**2)
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
