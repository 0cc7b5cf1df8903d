"""Hypotheses: the base model calibrated anew, and with each cause added.

A hypothesis is a set of ranges from which its parameters are drawn. Every draw has its own
calibration of the ground, of the scatter of rolling friction, and of the sideways tilt and the
drift of followed paths, so that an effect has to explain what calibration cannot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sassgis.gap.calibration.parameters import classes_met, fitted_names
from sassgis.gap.causes.all_causes import CAUSES, FAMILIES
from sassgis.gap.causes.parameter_draws import ParameterDraws, rounded
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, MeasurementError, moving_effects
from sassgis.model.declared import highest
from sassgis.model.ground import GroundTable
from sassgis.model.settings import EngineSettings

#: Half widths of the ranges in which the ground is calibrated: as far as the published values of
#: one kind of ground lie apart.
GROUND_WIDTHS: Mapping[str, float] = {
    "eta_max": 0.09,
    "mu_f": 0.10,
    "mu_0": 0.08,
    "restitution": 0.15,
}
_BOUNDS = {
    "eta_max": (0.05, 0.95),
    "mu_f": (0.05, 2.0),
    "mu_0": (0.02, 2.0),
    "restitution": (0.0, 0.95),
}
#: Factors on the configured sideways tilt and drift of followed paths between which they are free:
#: wider, and the base follows what deflects blocks.
_SIDEWAYS = (1.0 / 3.0, 3.0)
#: Rotations at stations over those of a block that turns in the plane of its path, and their
#: scatter: others turn about an axis that moves, and roll on corners. Of spins at contacts, which
#: are those about the axis across the path, factor and scatter are learned from the contacts.
_SPIN, _SPIN_NOISE = (0.65, 1.0 / 0.65), (0.02, 0.8)
NONE = "none"


@dataclass(frozen=True, slots=True)
class Draw:
    """One set of parameters of a hypothesis.

    Attributes
    ----------
    effect : str
        "none", a family, or two joined by "+".
    form : str
        Functional form.
    parameters : mapping
        Calibrated parameters by name, as they are reported.
    parameter_draws : mapping
        To make the same draw again, or one near it.
    """

    effect: str
    form: str
    model: HypothesisModel
    parameters: Mapping[str, float]
    parameter_draws: Mapping[str, float] = field(default_factory=dict)


def draw(case: Case, families: tuple[str, ...], parameter_draws: ParameterDraws) -> Draw:
    """The base model, its ground calibrated anew, with effects.

    Parameters
    ----------
    families : tuple of str
        None, one or more; "contact_law" is one of them here.
    """
    table, parameters = _calibrated(case, parameter_draws)
    engine = _engine_keys(case, parameter_draws)
    spins = {}
    if case.learned is not None:
        spins = {"spin_scale": case.learned.spin_scale, "spin_noise": case.learned.spin_noise}
    turning = {}
    if np.isfinite(case.observations.passages.rotation_hz).any():
        turning["rotation_factor"] = parameter_draws.log("rotation_factor", *_SPIN)
        turning["rotation_noise"] = parameter_draws.log("rotation_noise", *_SPIN_NOISE)
    made = Draw(
        NONE,
        "calibrated ground",
        HypothesisModel(
            table,
            moving_effects(case),
            measurement=MeasurementError(
                rotation_scale=turning.get("rotation_factor", 1.0),
                rotation_noise=turning.get("rotation_noise", 0.0),
                **spins,
            ),
            **engine,  # type: ignore[arg-type]
        ),
        parameters | engine | turning,
    )
    for family in sorted(families):
        part = CAUSES[family].draw(case, parameter_draws)
        first = made.effect == NONE
        made = replace(
            made,
            effect=family if first else f"{made.effect}+{family}",
            form=part.form if first else f"{made.form} + {part.form}",
            model=part.change(made.model),
            parameters={**made.parameters, **part.parameters},
        )
    # A law of the contact shifts what was calibrated.
    ground = {c.name: c for c in made.model.table.classes}
    values = {
        label: getattr(ground[name], key)
        for label in parameters
        for name, _, key in (label.rpartition("."),)
    }
    return replace(
        made, parameters={**made.parameters, **values}, parameter_draws=dict(parameter_draws.used)
    )


def _engine_keys(case: Case, parameter_draws: ParameterDraws) -> dict[str, float]:
    """Keys of ``[engine]`` that are free, by what is configured, no higher than they may be."""
    drawn = {}
    if case.terrain is not None:
        for key in ("side_tilt_deg", "drift_deg"):
            middle = max(float(getattr(case.engine, key)), 1.0)
            drawn[key] = parameter_draws.log(key, *(factor * middle for factor in _SIDEWAYS))
    if rolling := case.engine.resolved().rolling_friction_sd:
        key = "rolling_friction_sd"
        drawn[key] = parameter_draws.uniform(key, 0.0, 2.0 * rolling)
    return {key: min(value, highest(EngineSettings, key)) for key, value in drawn.items()}


def _calibrated(
    case: Case, parameter_draws: ParameterDraws
) -> tuple[GroundTable, dict[str, float]]:
    """Ground classes with shifted parameters; classes that no rock meets stay."""
    met = case.met or classes_met(case)
    names = [name for name in fitted_names(None, [case.engine]) if name in GROUND_WIDTHS]
    classes, parameters = [], {}
    for ground in case.table.classes:
        if ground.name not in met:
            classes.append(ground)
            continue
        values = {}
        for name in names:
            width = GROUND_WIDTHS[name] * case.ground_range
            low, high = _BOUNDS[name]
            value = float(getattr(ground, name)) + parameter_draws.uniform(
                f"{ground.name}.{name}", -width, width
            )
            values[name] = rounded(min(max(value, low), high))
        classes.append(replace(ground, **values))  # type: ignore[arg-type]
        parameters.update({f"{ground.name}.{name}": v for name, v in values.items()})
    return GroundTable(tuple(classes)), parameters


def families_to_try(case: Case) -> tuple[str, ...]:
    """Families that are not switched on in the configuration already."""
    on = set(case.effects.names)
    return tuple(name for name in FAMILIES if name not in on)
