"""What a hypothesis sets: ground, effects, deviation from the fall line, errors."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.gap.observations.case import Case
from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundTable
from sassgis.model.settings import EngineSettings


@dataclass(frozen=True, slots=True)
class LateralWalk:
    """How rocks leave the plane of their fall line, as lateral offsets (m).

    The lateral offset of a rock from its line is a random walk whose heading is drawn anew with the
    standard deviation ``angle_deg`` every ``hop_m`` metres, or a deviation of its own, uniform
    within ``width_percent`` of the chainage to both sides together. This is
    ``[effects.lateral_deflection]`` without the terrain beside the line.
    """

    angle_deg: float = 0.0
    hop_m: float = 10.0
    width_percent: float = 0.0

    @classmethod
    def of(cls, effect: LateralDeflection | None) -> LateralWalk:
        """The walk of an effect; none without one."""
        if effect is None:
            return cls()
        if effect.form == "constant":
            return cls(width_percent=effect.width_percent)
        return cls(effect.angle_deg, effect.hop_m)

    @property
    def effect(self) -> LateralDeflection | None:
        """The effect whose walk this is; None where nothing walks."""
        if self.width_percent > 0.0:
            return LateralDeflection("constant", width_percent=self.width_percent)
        if self.angle_deg > 0.0:
            return LateralDeflection("kicks", self.angle_deg, self.hop_m)
        return None


@dataclass(frozen=True, slots=True)
class ReleaseError:
    """Errors of the stated release.

    Attributes
    ----------
    ahead_m : float
        Rocks start up to this much further down the line, uniformly (m).
    faster_mps : float
        Added to the initial speed, uniform from 0 (m/s).
    shift_m, scatter_m : float
        Lateral offset of the start: the same for all, and standard deviation (m).
    """

    ahead_m: float = 0.0
    faster_mps: float = 0.0
    shift_m: float = 0.0
    scatter_m: float = 0.0


@dataclass(frozen=True, slots=True)
class MeasurementError:
    """Errors of measurement beyond those that are stated.

    Attributes
    ----------
    scale : float
        Lengths, and so speeds and heights, as measured over true.
    clock_sd : float
        Standard deviation of the logarithm of each rock's time base.
    rotation_scale : float
        Rotations as measured over true.
    noise_rel : float
        Added relative error of speeds and rotations.
    stretch : float
        Distances from the first station as measured over true.
    position_m : float
        Added standard error of positions (m).
    """

    scale: float = 1.0
    clock_sd: float = 0.0
    rotation_scale: float = 1.0
    noise_rel: float = 0.0
    stretch: float = 1.0
    position_m: float = 0.0


@dataclass(frozen=True, slots=True)
class ForestStand:
    """A forest between two chainages of all lines.

    Attributes
    ----------
    s0, s1 : float
        (m)
    stems_per_ha, dbh_cm : float
    """

    s0: float
    s1: float
    stems_per_ha: float
    dbh_cm: float


@dataclass(frozen=True, slots=True)
class HypothesisModel:
    """All that a hypothesis sets.

    Attributes
    ----------
    table : GroundTable
    effects : EffectSettings
        Those along the line; ``lateral_deflection`` is in ``lateral_walk``.
    stand : ForestStand or None
    lateral_walk : LateralWalk
    release : ReleaseError
    measurement : MeasurementError
    turn_noise_deg : float
        Standard error of the change of azimuth at impacts.
    side_tilt_deg, drift_deg : float or None
        Of followed paths, in place of the configured ones.
    """

    table: GroundTable
    effects: EffectSettings
    stand: ForestStand | None = None
    lateral_walk: LateralWalk = LateralWalk()
    release: ReleaseError = ReleaseError()
    measurement: MeasurementError = MeasurementError()
    turn_noise_deg: float = 2.0
    side_tilt_deg: float | None = None
    drift_deg: float | None = None

    @property
    def engine_keys(self) -> dict[str, float]:
        """Keys of ``[engine]`` that differ from the configuration."""
        own = {"side_tilt_deg": self.side_tilt_deg, "drift_deg": self.drift_deg}
        return {key: value for key, value in own.items() if value is not None}

    def engine_of(self, configured: EngineSettings) -> EngineSettings:
        """Settings of the engine that move its blocks."""
        return replace(configured, **self.engine_keys)  # type: ignore[arg-type]

    def sections(self, configured: EffectSettings) -> dict[str, dict[str, Any]]:
        """``[effects.*]`` sections of a configuration that has only some of these effects.

        Every effect of the model that is not configured as it is here, the way beside the line
        included: family to key to value. Errors of release and measurement are no part of the
        motion.
        """
        aside = self.lateral_walk.effect
        had = configured.get(LateralDeflection)
        own = [effect for effect in self.effects if configured.get(type(effect)) != effect]
        if aside is not None and self.lateral_walk != LateralWalk.of(had):
            own.append(aside)
        return {effect.name: _set_keys(effect) for effect in own}


def configured_model(case: Case, table: GroundTable | None = None) -> HypothesisModel:
    """The model of a case as it is configured, or with another table of ground classes."""
    return HypothesisModel(
        case.table if table is None else table,
        case.effects.without(LateralDeflection),
        lateral_walk=LateralWalk.of(case.effects.get(LateralDeflection)),
    )


def _set_keys(effect: Any) -> dict[str, Any]:
    """Form and whatever is not as by default."""
    return {
        f.name: getattr(effect, f.name)
        for f in fields(effect)
        if f.name == "form" or getattr(effect, f.name) != f.default
    }
