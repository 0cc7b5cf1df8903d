"""Settings of the effects that the model of 1986 leaves out. None is on unless it is asked for."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_type_hints

from sassgis.model.errors import ConfigError


def _check(settings: Any, limits: dict[str, tuple[float, float]]) -> None:
    """Raise ConfigError unless the form is known and every number lies between its limits."""
    forms = get_args(get_type_hints(type(settings))["form"])
    if settings.form not in forms:
        raise ConfigError(
            "unknown form",
            field="form",
            found=repr(settings.form),
            expected="one of " + ", ".join(forms),
        )
    for name, (low, high) in limits.items():
        value = getattr(settings, name)
        if not (math.isfinite(value) and low <= value <= high):
            raise ConfigError(
                "is out of range",
                field=name,
                found=f"{value:g}",
                expected=f"a number from {low:g} to {high:g}",
            )


@dataclass(frozen=True, slots=True)
class AirDrag:
    """Drag of the air in flight: ½ ρ C_d A v² against the motion.

    Attributes
    ----------
    form : {"constant", "sphericity"}
        "constant": C_d is ``drag_coefficient``. "sphericity": C_d follows from how far the rock is
        from a sphere, 0.43 · 10^(1.8148 (−log ψ)^0.5743) (Ganser 1993, Powder Technology 77, for
        fast flow; from memory), times ``drag_coefficient`` over 0.43.
    drag_coefficient : float
        0.4 to 0.5 for a sphere, about 1 for a tumbling block. What is far above 2 is no property of
        air: such a value can come out of a fit to what else brakes rocks in flight.
    air_density_kgm3 : float
        1.2 at 300 m, 1.0 at 2,000 m above the sea.
    """

    form: Literal["constant", "sphericity"] = "constant"
    drag_coefficient: float = 0.43
    air_density_kgm3: float = 1.1

    def __post_init__(self) -> None:
        _check(self, {"drag_coefficient": (0.0, 300.0), "air_density_kgm3": (0.0, 2.0)})


@dataclass(frozen=True, slots=True)
class Trees:
    """Loss of energy on the stems of a forest.

    Attributes
    ----------
    form : {"stems", "full_stems", "viscous"}
        "stems": the block meets stems at random along its way; each takes at most
        38.7 DBH^2.31 J (DBH in cm), the less the farther from its middle it is hit (Dorren and
        Berger 2006, Tree Physiology 26: 63-71). "full_stems": each takes ``efficiency`` of that
        wherever it is hit. "viscous": a force −k v while the block is below the crowns, as in
        RAMMS::ROCKFALL; ``drag_kgps`` is k.
    efficiency : float
        Share of the energy of a stem that counts, for both forms with stems.
    drag_kgps : float
        k of "viscous" (kg/s).
    height_m : float
        Stems take energy up to this height above the ground (m).
    """

    form: Literal["stems", "full_stems", "viscous"] = "stems"
    efficiency: float = 1.0
    drag_kgps: float = 300.0
    height_m: float = 15.0

    def __post_init__(self) -> None:
        _check(
            self,
            {"efficiency": (0.0, 10.0), "drag_kgps": (0.0, 1e5), "height_m": (0.0, 100.0)},
        )

    @property
    def takes_anything(self) -> bool:
        """Whether a stand with these settings takes any energy."""
        strength = self.drag_kgps if self.form == "viscous" else self.efficiency
        return strength > 0.0 and self.height_m > 0.0


@dataclass(frozen=True, slots=True)
class SoftGround:
    """Impacts on ground that yields.

    Attributes
    ----------
    form : {"velocity_scaled", "scar", "slip"}
        "velocity_scaled": the normal rebound is multiplied with 1 / (1 + (v_n / v_ref)²)
        (Pfeiffer and Bowen 1989, with v_ref = 9.144 m/s). "scar": a scar of depth
        d = depth_factor · m^¼ M_E^−0.4 v_n^0.8 (after Lu et al. 2019, Landslides 16) and a drag
        ½ C ρ A v² along it, A the section of the block below the surface; "slip": the contact
        slips with the friction ``friction`` where the impulse would need more.
    classes : tuple of str
        Ground classes that are soft.
    reference_speed_mps : float
        v_ref of "velocity_scaled".
    modulus_mpa : float
        M_E of "scar" (MPa).
    depth_factor : float
        Of "scar": depth in m for m in kg, M_E in MPa and v_n in m/s.
    drag_coefficient : float
        C of "scar".
    soil_density_kgm3 : float
        ρ of "scar".
    friction : float
        Of "slip".
    """

    form: Literal["velocity_scaled", "scar", "slip"] = "velocity_scaled"
    classes: tuple[str, ...] = ("soft_meadow", "forest_soil")
    reference_speed_mps: float = 9.144
    modulus_mpa: float = 10.0
    depth_factor: float = 0.02
    drag_coefficient: float = 1.0
    soil_density_kgm3: float = 1800.0
    friction: float = 0.5

    def __post_init__(self) -> None:
        _check(
            self,
            {
                "reference_speed_mps": (0.1, 1e6),
                "modulus_mpa": (0.1, 1e4),
                "depth_factor": (0.0, 1.0),
                "drag_coefficient": (0.0, 100.0),
                "soil_density_kgm3": (100.0, 4000.0),
                "friction": (0.0, 100.0),
            },
        )


@dataclass(frozen=True, slots=True)
class Roughness:
    """Ground rougher than its segments: each impact meets a surface that is tilted at random.

    Attributes
    ----------
    form : {"uniform", "wave"}
        "uniform": the tilt is uniform within atan(obstacle height / radius of the block) to both
        sides (Pfeiffer and Bowen 1989). "wave": the surface is a wave of amplitude half the
        obstacle height and length ``wavelength_m`` that is met at a random phase; a block bridges
        waves shorter than its diameter (after the amplitude and frequency of Spang's ROCKFALL).
    obstacle_m : float
        Height of obstacles (m).
    wavelength_m : float
        Of "wave" (m).
    classes : tuple of str
        Ground classes that are rough; empty: all.
    """

    form: Literal["uniform", "wave"] = "uniform"
    obstacle_m: float = 0.1
    wavelength_m: float = 2.0
    classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check(self, {"obstacle_m": (0.0, 10.0), "wavelength_m": (0.01, 100.0)})


@dataclass(frozen=True, slots=True)
class RockShape:
    """What the plane ellipse does not know of the third axis.

    Attributes
    ----------
    form : {"flat_landing", "mean_inertia"}
        "flat_landing": at each impact a block may fall on its flat side, the more likely the
        flatter it is (probability ``strength`` · (1 − c/b)); the contact then stops its spin. This
        is how platy blocks leave the wheel-like motion (Caviezel et al. 2021, Nature Communications
        12). "mean_inertia": the block tumbles about all axes: its moment of inertia is the mean of
        the three (as for spheres of equal inertia in lumped models; Jaboyedoff et al. 2005).
    strength : float
        Of "flat_landing".
    """

    form: Literal["flat_landing", "mean_inertia"] = "flat_landing"
    strength: float = 1.0

    def __post_init__(self) -> None:
        _check(self, {"strength": (0.0, 10.0)})


@dataclass(frozen=True, slots=True)
class Fragmentation:
    """Breaking of blocks at impacts.

    Attributes
    ----------
    form : {"fractal", "threshold"}
        "fractal": a block breaks with the probability 1 − exp(−(e/e_ref)^shape), e the energy
        lost in the impact per unit mass; the largest piece keeps ``survival`` of the volume, the
        next that share of the rest, and so on (fractal fragmentation after Perfect 1997 and Ruiz-
        Carulla et al. 2017). "threshold": it breaks if e is above e_ref, into ``pieces`` equal
        parts (as in many lumped models; Matas et al. 2017 have a threshold as well).
    energy_jkg : float
        e_ref (J/kg).
    shape : float
        Exponent of "fractal" (Weibull).
    survival : float
        Of "fractal": share of the volume that the largest piece keeps.
    pieces : int
        Most pieces of one break.
    loss : float
        Share of the energy left after the impact that breaking takes.
    cone_deg : float
        Pieces leave within this angle of the way of the whole (degrees), in the vertical plane.
    smallest_m3 : float
        No smaller piece is made: fewer pieces, or the block stays whole (m³).
    """

    form: Literal["fractal", "threshold"] = "fractal"
    energy_jkg: float = 300.0
    shape: float = 2.0
    survival: float = 0.5
    pieces: int = 5
    loss: float = 0.1
    cone_deg: float = 20.0
    smallest_m3: float = 0.02

    def __post_init__(self) -> None:
        _check(
            self,
            {
                "energy_jkg": (0.0, 1e6),
                "shape": (0.1, 20.0),
                "survival": (0.01, 0.999),
                "pieces": (2, 20),
                "loss": (0.0, 0.99),
                "cone_deg": (0.0, 89.0),
                "smallest_m3": (0.0, 10.0),
            },
        )


@dataclass(frozen=True, slots=True)
class Entrainment:
    """Blocks of the ground that an impact sets in motion; these set off no others.

    Attributes
    ----------
    form : {"poisson", "energy"}
        "poisson": each impact sets in motion a Poisson number of blocks with the mean ``number``.
        "energy": the mean is ``number`` times the energy lost over ``energy_kj``.
    number : float
        Blocks per impact.
    energy_kj : float
        Of "energy" (kJ).
    size_ratio : float
        Axes of a block set in motion over those of the block that hit.
    share : float
        Of the energy that the impact took: what each of them gets, all together at most 1.
    classes : tuple of str
        Ground classes with loose blocks.
    """

    form: Literal["poisson", "energy"] = "poisson"
    number: float = 0.05
    energy_kj: float = 10.0
    size_ratio: float = 0.4
    share: float = 0.1
    classes: tuple[str, ...] = ("debris", "talus")

    def __post_init__(self) -> None:
        _check(
            self,
            {
                "number": (0.0, 10.0),
                "energy_kj": (1e-3, 1e6),
                "size_ratio": (0.01, 1.0),
                "share": (0.0, 1.0),
            },
        )


@dataclass(frozen=True, slots=True)
class LateralDeflection:
    """Ways in plan that leave the fall line, on the terrain.

    Each rock has a way of its own, traced before it is followed: sideways it is a random walk, not
    the outcome of its impacts.

    Attributes
    ----------
    form : {"kicks", "constant"}
        "kicks": over each hop the way heads at an angle to the steepest descent that is drawn anew,
        normal with the standard deviation ``angle_deg``; tests report 5 to 20 degrees per impact.
        "constant": each way keeps one deviation, uniform within ``width_percent`` of the length,
        both sides together; 10 to 20 per cent are reported (Azzoni et al. 1995, Crosta and Agliardi
        2004).
    angle_deg : float
    hop_m : float
        Mean length of the hops in plan, exponential (m).
    width_percent : float
    """

    form: Literal["kicks", "constant"] = "kicks"
    angle_deg: float = 10.0
    hop_m: float = 10.0
    width_percent: float = 15.0

    def __post_init__(self) -> None:
        _check(
            self,
            {
                "angle_deg": (0.0, 60.0),
                "hop_m": (0.5, 1000.0),
                "width_percent": (0.0, 100.0),
            },
        )


@dataclass(frozen=True, slots=True)
class EffectSettings:
    """The effects of a run; None is off."""

    air_drag: AirDrag | None = None
    trees: Trees | None = None
    soft_ground: SoftGround | None = None
    roughness: Roughness | None = None
    rock_shape: RockShape | None = None
    fragmentation: Fragmentation | None = None
    entrainment: Entrainment | None = None
    lateral_deflection: LateralDeflection | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are on."""
        fields = dataclasses.fields(self)
        return tuple(f.name for f in fields if getattr(self, f.name) is not None)

    @property
    def on_the_way(self) -> bool:
        """Whether one is on that changes the course of a rock along its line."""
        return any(name != "lateral_deflection" for name in self.names)
