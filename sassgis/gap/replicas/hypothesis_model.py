"""What a hypothesis sets: ground, effects, deviation from the fall line, errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundTable


@dataclass(frozen=True, slots=True)
class LateralWalk:
    """How rocks leave the plane of their fall line, as lateral offsets (m).

    The lateral offset of a rock from its line is a random walk whose heading is drawn anew with the
    standard deviation ``angle_deg`` every ``hop_m`` metres between two chainages, plus a deviation
    of its own, uniform within ``width_percent`` of the chainage to both sides together, plus a
    ``drift`` that all rocks share. This is ``[effects.lateral_deflection]`` without the terrain
    beside the line.

    Attributes
    ----------
    angle_deg, hop_m, width_percent : float
    drift : float
        Metres to the side per metre along.
    s0, s1 : float
        Chainages between which they walk (m).
    """

    angle_deg: float = 0.0
    hop_m: float = 10.0
    width_percent: float = 0.0
    drift: float = 0.0
    s0: float = -np.inf
    s1: float = np.inf


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
    """

    table: GroundTable
    effects: EffectSettings
    stand: ForestStand | None = None
    lateral_walk: LateralWalk = LateralWalk()
    release: ReleaseError = ReleaseError()
    measurement: MeasurementError = MeasurementError()
    turn_noise_deg: float = 2.0
