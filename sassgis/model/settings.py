"""Readings of the paper where it is silent: each is a setting with a name and a default."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from sassgis.model.errors import ConfigError

EtaMaxRule = Literal["scale", "coulomb"]
SlopeVariation = Literal["per_impact", "off"]
Rolling = Literal["round", "ellipse"]


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Settings of the engine; docs/model.md says what each one means for the results.

    Attributes
    ----------
    gravity_mps2 : float
        Acceleration of gravity.
    eta_max_rule : {"scale", "coulomb"}
        How an impact that would keep more energy than η_max is brought down to it. "scale" scales
        spin and velocity together (direction and no-slip kept). "coulomb" first lets the contact
        slip where friction μ_f cannot hold it, then scales what is left.
    slope_variation : {"per_impact", "off"}
        Whether each impact on descending ground meets it at tan β' = tan β (1 − u).
    rolling_threshold : float
        A rock lands softly and rolls when v_n²/(2 g cos β) is below this share of its radius.
    rolling : {"round", "ellipse"}
        "round": dv/dt = g (sin β − μ_r cos β), the paper's words; the rock leaves the ground at
        convex vertices only. "ellipse": also the turning ellipse counts, whose centre rises and
        falls, and it leaves the ground where the normal force on it ends (N <= 0).
    end_sliding : bool
        Whether a rock too slow to turn over its longer axis ends by sliding.
    contact_tolerance_m : float
        Gap below which ground and rock touch.
    max_events : int
        Contacts after which a rock is given up and reported.
    """

    gravity_mps2: float = 9.81
    eta_max_rule: EtaMaxRule = "scale"
    slope_variation: SlopeVariation = "per_impact"
    rolling_threshold: float = 0.1
    rolling: Rolling = "round"
    end_sliding: bool = True
    contact_tolerance_m: float = 1e-6
    max_events: int = 20_000

    def __post_init__(self) -> None:
        choices = {
            "eta_max_rule": get_args(EtaMaxRule),
            "slope_variation": get_args(SlopeVariation),
            "rolling": get_args(Rolling),
        }
        for field, allowed in choices.items():
            if getattr(self, field) not in allowed:
                raise ConfigError(
                    "unknown choice",
                    field=f"engine.{field}",
                    found=repr(getattr(self, field)),
                    expected="one of " + ", ".join(allowed),
                )
        limits = {
            "gravity_mps2": (0.1, 30.0),
            "rolling_threshold": (0.0, 10.0),
            "contact_tolerance_m": (1e-12, 1e-2),
            "max_events": (100, 10_000_000),
        }
        for field, (low, high) in limits.items():
            if not low <= getattr(self, field) <= high:
                raise ConfigError(
                    "value out of range",
                    field=f"engine.{field}",
                    found=getattr(self, field),
                    expected=f"{low:g} to {high:g}",
                )
