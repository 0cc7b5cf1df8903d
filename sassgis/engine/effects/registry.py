"""The effects beyond the model of 1986: one row for each.

The configuration with its checks, the template, the documentation, the report and the diagnosis
follow from the row; the motion follows from the hooks (``hooks.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import Wind
from sassgis.model.declared import Declared, Section, declared
from sassgis.model.effects import EffectSection
from sassgis.model.settings import ForestPlace

Phase = Literal["release", "flight", "impact", "ground", "path"]
Hook = Literal[
    "on_block",
    "on_start",
    "on_path",
    "before_turn",
    "before_flight",
    "after_flight",
    "before_stretch",
    "after_stretch",
    "on_contact",
    "after_impact",
    "on_loss",
]


@dataclass(frozen=True, slots=True)
class Range:
    """Where a parameter is drawn from: between two limits, evenly or on a logarithmic scale."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"


@dataclass(frozen=True, slots=True)
class Calibration:
    """How the diagnosis fits an effect to observations.

    Attributes
    ----------
    order : int
        Place among the families of the diagnosis, which fixes its random draws: a new effect takes
        the next free number (``sassgis.gap.which.families`` has those that are no effects).
    phase : {"flight", "impact"}
        Of the observed motion in which the effect shows.
    ranges : mapping of str to Range
        By parameter, those of all forms; what is not named keeps its default.
    forms : mapping of str to float
        How often each form is tried, relative to the others; empty if the effect has one law.
    parameters : mapping of str to tuple of str
        Parameters that a form draws, where it does not draw all of ``ranges``.
    """

    order: int
    phase: Literal["flight", "impact"]
    ranges: Mapping[str, Range]
    forms: Mapping[str, float]
    parameters: Mapping[str, tuple[str, ...]]

    def drawn(self, form: str) -> tuple[str, ...]:
        """Parameters that a form draws, in the order of their draws."""
        return self.parameters.get(form, tuple(self.ranges))


@dataclass(frozen=True, slots=True)
class Effect:
    """One effect.

    Attributes
    ----------
    settings : type
        Declared settings (``sassgis.model.declared``), with the name of the effect.
    phase : {"release", "flight", "impact", "ground", "path"}
        Of the motion in which it acts; "path": on the heading, where paths are followed.
    label : str
        Its name in a sentence.
    summary : str
        What it does, to follow "the gap is best explained by".
    hooks : tuple of str
        Hooks of the motion on which it acts.
    place : type or None
        More declared settings of its section, which say where it acts and are read into a map.
    calibration : Calibration or None
        None if the diagnosis does not try it: no fingerprint speaks for it.
    """

    settings: type[EffectSection]
    phase: Phase
    label: str
    summary: str
    hooks: tuple[Hook, ...]
    place: type[Section] | None = None
    calibration: Calibration | None = None

    @property
    def name(self) -> str:
        """The name, as in ``[effects.<name>]``."""
        return self.settings.name

    @property
    def keys(self) -> Mapping[str, Declared]:
        """All declared settings of the section ``[effects.<name>]``."""
        place = {} if self.place is None else declared(self.place)
        return {**place, **declared(self.settings)}


_ROWS = (
    Effect(
        AirDrag,
        phase="flight",
        label="air drag",
        summary="the drag of the air",
        hooks=("on_start", "before_flight", "after_flight"),
        calibration=Calibration(
            order=5,
            phase="flight",
            ranges={"drag_coefficient": Range(0.3, 2.0, "log")},
            forms={"constant": 1.0, "sphericity": 1.0},
            parameters={},
        ),
    ),
    Effect(
        Wind,
        phase="flight",
        label="wind",
        summary="a steady wind on blocks in flight",
        hooks=("on_start", "before_flight", "after_flight"),
    ),
    Effect(
        Trees,
        phase="flight",
        label="trees",
        summary="trees that take energy from passing rocks",
        hooks=("on_start", "before_flight", "after_flight", "before_stretch", "after_stretch"),
        place=ForestPlace,
        calibration=Calibration(
            order=4,
            phase="flight",
            # drag_kgps per kilogram of a middling block (1/s).
            ranges={
                "efficiency": Range(0.05, 3.0, "log"),
                "drag_kgps": Range(0.03, 0.8, "log"),
                "stems_per_ha": Range(60.0, 2500.0, "log"),
                "dbh_cm": Range(10.0, 55.0),
            },
            forms={"stems": 0.45, "full_stems": 0.4, "viscous": 0.15},
            parameters={},
        ),
    ),
    Effect(
        SoftGround,
        phase="impact",
        label="soft ground",
        summary="soft ground that yields at impacts and takes energy",
        hooks=("on_contact", "after_impact"),
        calibration=Calibration(
            order=2,
            phase="impact",
            ranges={
                "reference_speed_mps": Range(0.4, 12.0, "log"),
                "depth_scale": Range(1.0, 80.0, "log"),
                "drag_coefficient": Range(0.5, 6.0, "log"),
                "friction": Range(0.05, 0.6),
            },
            forms={"velocity_scaled": 1.0, "scar": 1.0, "slip": 1.0},
            parameters={
                "velocity_scaled": ("reference_speed_mps",),
                "scar": ("depth_scale", "drag_coefficient"),
                "slip": ("friction",),
            },
        ),
    ),
    Effect(
        Roughness,
        phase="impact",
        label="roughness of the ground",
        summary="ground that is rougher than the terrain model shows",
        hooks=("on_contact",),
        calibration=Calibration(
            order=6,
            phase="impact",
            ranges={
                "obstacle_m": Range(0.05, 1.5, "log"),
                "wavelength_m": Range(0.8, 6.0, "log"),
            },
            forms={"uniform": 1.0, "wave": 1.0},
            parameters={"uniform": ("obstacle_m",)},
        ),
    ),
    Effect(
        RockShape,
        phase="impact",
        label="shape of the rocks",
        summary="the shape of the rocks, which the plane ellipse does not know",
        hooks=("on_block", "after_impact"),
        calibration=Calibration(
            order=7,
            phase="impact",
            ranges={"strength": Range(0.08, 3.0, "log")},
            forms={"flat_landing": 0.85, "mean_inertia": 0.15},
            parameters={"mean_inertia": ()},
        ),
    ),
    Effect(
        Fragmentation,
        phase="impact",
        label="fragmentation",
        summary="blocks that break at impacts",
        hooks=("on_loss",),
        calibration=Calibration(
            order=1,
            phase="impact",
            ranges={
                "energy_jkg": Range(12.0, 800.0, "log"),
                "loss": Range(0.0, 0.5),
                "pieces": Range(2, 9),
                "shape": Range(0.0, 3.0),
                "survival_rate": Range(0.0, 0.8),
                "fractal_dimension": Range(1.8, 2.8),
            },
            forms={"threshold": 0.35, "fractal": 0.65},
            parameters={
                "threshold": ("energy_jkg", "loss", "pieces"),
                "fractal": ("energy_jkg", "loss", "shape", "survival_rate", "fractal_dimension"),
            },
        ),
    ),
    Effect(
        Entrainment,
        phase="impact",
        label="entrainment",
        summary="blocks of the slope that passing rocks set in motion",
        hooks=("on_loss",),
        calibration=Calibration(
            order=3,
            phase="impact",
            ranges={
                "number": Range(0.003, 0.8, "log"),
                "size_ratio": Range(0.2, 0.9),
                "share": Range(0.03, 0.6, "log"),
                "energy_kj": Range(2.0, 60.0, "log"),
            },
            forms={"poisson": 1.0, "energy": 1.0},
            parameters={"poisson": ("number", "size_ratio", "share")},
        ),
    ),
    Effect(
        LateralDeflection,
        phase="path",
        label="lateral deflection",
        summary="rocks that leave the fall line sideways",
        hooks=("on_path", "before_turn"),
        calibration=Calibration(
            order=0,
            phase="impact",
            ranges={
                "angle_deg": Range(1.0, 35.0, "log"),
                "hop_m": Range(4.0, 15.0, "log"),
                "width_percent": Range(3.0, 60.0, "log"),
            },
            forms={"kicks": 0.65, "constant": 0.35},
            parameters={"kicks": ("angle_deg", "hop_m"), "constant": ("width_percent",)},
        ),
    ),
)

#: The effects by name, in the order in which they are listed everywhere.
EFFECTS: Mapping[str, Effect] = {row.name: row for row in _ROWS}
