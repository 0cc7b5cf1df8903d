"""Settings of a hypothesis: ground, effects, deviation from the fall line, errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.gap.observations.case import Case
from sassgis.settings.effects import EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.settings import EngineSettings

#: Keys of ``[engine]`` that a hypothesis may set.
ENGINE_KEYS = ("side_tilt_deg", "drift_deg", "rolling_friction_sd")


@dataclass(frozen=True, slots=True)
class ReleaseError:
    """Errors of the stated release."""

    #: Rocks start this much further down the line (m), or up the slope where it is below zero, each
    #: half as much to one and a half times as much, uniformly.
    ahead_m: float = 0.0
    faster_mps: float = 0.0  # added to the initial speed, uniform from 0
    shift_m: float = 0.0  # lateral offset of the start: the same for all
    scatter_m: float = 0.0  # and standard deviation


@dataclass(frozen=True, slots=True)
class MeasurementError:
    """Errors of measurement beyond those that are stated."""

    scale: float = 1.0  # lengths, and so speeds and heights, as measured over true
    clock_sd: float = 0.0  # standard deviation of the logarithm of each rock's time base
    rotation_scale: float = 1.0  # rotations at stations and on paths as measured over true
    rotation_noise: float = 0.0  # added relative error: blocks do not turn in one plane
    spin_scale: float = 1.0  # the same of spins at contacts, about the axis across the path
    spin_noise: float = 0.0  # added relative error
    noise_rel: float = 0.0  # added relative error of speeds and rotations
    stretch: float = 1.0  # distances from the first station as measured over true
    position_m: float = 0.0  # added standard error of positions


@dataclass(frozen=True, slots=True)
class ForestStand:
    """A forest between two chainages of all lines (m)."""

    s0: float
    s1: float
    stems_per_ha: float
    dbh_cm: float


@dataclass(frozen=True, slots=True)
class HypothesisModel:
    """All that a hypothesis sets."""

    table: GroundTable
    effects: EffectSettings  # on fall lines without ``lateral_deflection``: blocks keep to them
    stand: ForestStand | None = None
    release: ReleaseError = ReleaseError()
    measurement: MeasurementError = MeasurementError()
    # Of followed paths, and of all; None: as configured.
    side_tilt_deg: float | None = None
    drift_deg: float | None = None
    rolling_friction_sd: float | None = None

    @property
    def engine_keys(self) -> dict[str, float]:
        """Keys of ``[engine]`` that differ from the configuration."""
        own = {key: getattr(self, key) for key in ENGINE_KEYS}
        return {key: value for key, value in own.items() if value is not None}

    def engine_of(self, configured: EngineSettings) -> EngineSettings:
        """Return settings of the engine that move its blocks."""
        return replace(configured, **self.engine_keys)  # type: ignore[arg-type]

    def sections(self, configured: EffectSettings) -> dict[str, dict[str, Any]]:
        """Return ``[effects.*]`` sections for a configuration that has only some of these effects.

        Every effect of the model that is not configured as it is here: the form, and whatever is
        not as by default.
        """
        return {
            effect.name: {
                f.name: getattr(effect, f.name)
                for f in fields(effect)
                if f.name == "form" or getattr(effect, f.name) != f.default
            }
            for effect in self.effects
            if configured.get(type(effect)) != effect
        }


def configured_model(case: Case, table: GroundTable | None = None) -> HypothesisModel:
    """Return the model of a case as it is configured, or with another table of ground classes."""
    return HypothesisModel(case.table if table is None else table, moving_effects(case))


def moving_effects(case: Case) -> EffectSettings:
    """Return configured effects that move the rocks: on fall lines none deflects them."""
    return case.effects if case.terrain is not None else case.effects.without(LateralDeflection)


def model_as_json(model: HypothesisModel) -> dict[str, Any]:
    """Return a model as JSON takes it, to keep a calibrated one in a file and use it again."""
    return {**asdict(model), "effects": {own.name: asdict(own) for own in model.effects}}
