"""Hypotheses: the base model calibrated anew, and with each cause added.

A hypothesis is a set of ranges from which its parameters are drawn. Every draw has its own
calibration of the ground, of the scatter of rolling friction, and of the sideways tilt and the
drift of followed paths, so that an effect has to explain what calibration cannot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.parameters import classes_met, fitted_names
from sassgis.gap.causes.all_causes import CAUSES, FAMILIES
from sassgis.gap.causes.parameter_draws import ParameterDraws, rounded
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, MeasurementError, moving_effects
from sassgis.model.declared import highest
from sassgis.model.ground import GroundTable
from sassgis.model.ground_ranges import with_values
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
    """One set of parameters of a hypothesis."""

    form: str  # functional form
    model: HypothesisModel
    parameters: Mapping[str, float]  # calibrated ones by name, as they are reported
    parameter_draws: Mapping[str, float]  # to make the same draw again, or one near it


def draw(case: Case, families: tuple[str, ...], parameter_draws: ParameterDraws) -> Draw:
    """The base model, its ground calibrated anew, with effects.

    ``families``: none, one or more; "contact_law" is one of them here.
    """
    table, ground = _calibrated(case, parameter_draws)
    engine = _engine_keys(case, parameter_draws)
    error: dict[str, float] = {}
    turning = {}
    if case.learned is not None:
        error |= {"spin_scale": case.learned.spin_scale, "spin_noise": case.learned.spin_noise}
    if np.isfinite(case.observations.passages.rotation_hz).any():
        scale = parameter_draws.log("rotation_factor", *_SPIN)
        noise = parameter_draws.log("rotation_noise", *_SPIN_NOISE)
        turning = {"rotation_factor": scale, "rotation_noise": noise}
        error |= {"rotation_scale": scale, "rotation_noise": noise}
    model = HypothesisModel(
        table,
        moving_effects(case),
        measurement=MeasurementError(**error),
        **engine,  # type: ignore[arg-type]
    )
    parameters = {**ground, **engine, **turning}
    forms = []
    for family in sorted(families):
        part = CAUSES[family].draw(case, parameter_draws)
        forms.append(part.form)
        model = part.change(model)
        parameters.update(part.parameters)
    # A law of the contact shifts what was calibrated.
    for label in ground:
        name, _, key = label.rpartition(".")
        parameters[label] = getattr(model.table.classes[table.index(name)], key)
    form = " + ".join(forms) or "calibrated ground"
    return Draw(form, model, parameters, dict(parameter_draws.used))


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
    values = {}
    for ground in case.table.classes:
        for name in names if ground.name in met else ():
            width = GROUND_WIDTHS[name] * case.ground_range
            low, high = _BOUNDS[name]
            shift = parameter_draws.uniform(f"{ground.name}.{name}", -width, width)
            shifted = float(getattr(ground, name)) + shift
            values[ground.name, name] = rounded(min(max(shifted, low), high))
    return with_values(case.table, values), {".".join(key): v for key, v in values.items()}


def families_to_try(case: Case) -> tuple[str, ...]:
    """Families that are not switched on in the configuration already."""
    on = set(case.effects.names)
    return tuple(name for name in FAMILIES if name not in on)
