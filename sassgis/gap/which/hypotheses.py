"""Hypotheses: the base model calibrated anew, and with each family of effects added.

A hypothesis is a set of ranges from which its parameters are drawn. Every draw has its own
calibration of the ground, so that an effect has to explain what calibration cannot, and has some
lateral scatter where nature would make some with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtri

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.registry import EFFECTS, Range
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.gap.calibration.parameters import classes_met, fitted_names
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import (
    ForestStand,
    HypothesisModel,
    LateralWalk,
    MeasurementError,
    ReleaseError,
)
from sassgis.gap.which.families import FAMILIES, calibration_of
from sassgis.model.effects import EffectSection
from sassgis.model.ground import GroundTable


def rounded(value: float) -> float:
    """As many digits as a configuration states: the model that is written is the one scored."""
    return float(f"{value:.6g}")


class ParameterDraws:
    """Where the parameters of a draw come from: a number in [0, 1) under each name.

    Parameters
    ----------
    rng : numpy.random.Generator
        For names that are not set.
    values : mapping, optional
        Values of an earlier draw: the same names then give the same parameters.
    """

    def __init__(self, rng: np.random.Generator, values: Mapping[str, float] | None = None) -> None:
        self._rng = rng
        self._given = dict(values or {})
        self.used: dict[str, float] = {}

    def share(self, name: str) -> float:
        """A number from 0 to 1."""
        if name not in self.used:
            known = self._given.get(name)
            self.used[name] = float(self._rng.random()) if known is None else known
        return self.used[name]

    def uniform(self, name: str, low: float, high: float) -> float:
        """A number between limits."""
        return rounded(low + (high - low) * self.share(name))

    def log(self, name: str, low: float, high: float) -> float:
        """A number between limits, evenly on a logarithmic scale."""
        return rounded(math.exp(math.log(low) + math.log(high / low) * self.share(name)))

    def normal(self, name: str, sd: float) -> float:
        """A number from a normal distribution about zero."""
        return rounded(sd * float(ndtri(min(max(self.share(name), 1e-6), 1.0 - 1e-6))))

    def within(self, name: str, limits: Range) -> float:
        """A number from a range of the registry."""
        draw = self.log if limits.scale == "log" else self.uniform
        return draw(name, limits.low, limits.high)

    def one_of(self, name: str, choices: Sequence[str], shares: Sequence[float]) -> str:
        """One of some words."""
        edges = np.cumsum(shares) / sum(shares)
        return choices[min(int(np.searchsorted(edges, self.share(name), "right")), len(edges) - 1)]


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
#: Bounds of the contact law: those that any ground has shown (``calibration.parameters.RANGES``).
_LAW_BOUNDS = {"eta_max": (0.1, 1.0), "mu_f": (0.1, 1.5), "restitution": (0.0, 0.9)}
#: Ground on which no block lies loose and nothing yields.
_HARD = ("rock", "asphalt")
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
    model : HypothesisModel
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


@dataclass(frozen=True, slots=True)
class _Part:
    """What one family sets of a model."""

    form: str
    change: Callable[[HypothesisModel], HypothesisModel]
    parameters: Mapping[str, float]


def draw(case: Case, families: tuple[str, ...], parameter_draws: ParameterDraws) -> Draw:
    """The base model, its ground calibrated anew, with effects.

    Parameters
    ----------
    case : Case
    families : tuple of str
        None, one or more; "contact_law" is one of them here.
    parameter_draws : ParameterDraws

    Returns
    -------
    Draw
    """
    table, parameters = _calibrated(case, parameter_draws)
    configured = case.effects.get(LateralDeflection)
    made = Draw(
        NONE,
        "calibrated ground",
        HypothesisModel(
            table,
            case.effects.without(LateralDeflection),
            lateral_walk=LateralWalk.of(configured)
            if configured is not None or case.terrain is not None
            else _little_walk(parameter_draws),
            turn_noise_deg=parameter_draws.log("turn_noise", 0.7, 5.0),
        ),
        parameters,
    )
    for family in sorted(families):
        part = (_FAMILIES.get(family) or _from_row(family))(case, parameter_draws)
        first = made.effect == NONE
        model = _wider_walk(made.model.lateral_walk, part.change(made.model))
        if case.terrain is not None and family != LateralDeflection.name:
            # Followed paths turn by themselves.
            model = replace(model, lateral_walk=made.model.lateral_walk)
        made = replace(
            made,
            effect=family if first else f"{made.effect}+{family}",
            form=part.form if first else f"{made.form} + {part.form}",
            model=model,
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
        made,
        parameters={**made.parameters, **values},
        parameter_draws=dict(parameter_draws.used),
    )


def _wider_walk(before: LateralWalk, model: HypothesisModel) -> HypothesisModel:
    """Of two effects that scatter rocks laterally, keep the wider scatter."""
    if before.angle_deg > model.lateral_walk.angle_deg and model.lateral_walk.width_percent == 0.0:
        return replace(model, lateral_walk=before)
    return model


def _calibrated(
    case: Case, parameter_draws: ParameterDraws
) -> tuple[GroundTable, dict[str, float]]:
    """Ground classes with shifted parameters; classes that no rock meets stay."""
    met = classes_met(case)
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


def at_physical_limit(case: Case, ground: str, name: str, end: str) -> bool:
    """Whether the end of a range of calibration is that of all grounds, not that of this one."""
    value = float(getattr(case.table.classes[case.table.index(ground)], name))
    width = GROUND_WIDTHS[name] * case.ground_range
    low, high = _BOUNDS[name]
    return value - width <= low if end == "low" else value + width >= high


def _little_walk(parameter_draws: ParameterDraws) -> LateralWalk:
    """Fall lines of a survey are not exact: a heading that is a degree or so off."""
    if parameter_draws.share("little_aside") < 0.5:
        return LateralWalk()
    return LateralWalk(angle_deg=parameter_draws.log("little_aside_deg", 0.05, 1.0))


def _walk_too(parameter_draws: ParameterDraws, most_deg: float) -> LateralWalk:
    """Lateral scatter that an effect makes besides what it is named for.

    It goes with the strength of the effect: an effect that does nothing along the line scatters
    no lateral offset either, and is no other name for lateral deflection.
    """
    if parameter_draws.share("aside_too") < 0.3:
        return _little_walk(parameter_draws)
    return LateralWalk(rounded(parameter_draws.uniform("aside_too_deg", 0.1, 1.0) * most_deg))


def _length(case: Case) -> float:
    """How far rocks come: the furthest that was observed, or the shortest line (m)."""
    ends = case.profiles.s[case.profiles.offset[1:] - 1]
    seen = [
        float(np.nanmax(put.s))
        for name, put in case.projected.items()
        if name in ("deposits", "passages") and np.isfinite(put.s).any()
    ]
    return max(min(max(seen, default=float(ends.min())), float(ends.max())), 5.0)


def _soft_classes(case: Case, parameter_draws: ParameterDraws) -> tuple[str, ...]:
    present = [case.table.classes[k].name for k in np.unique(case.profiles.ground).tolist()]
    yielding = [name for name in present if name not in _HARD] or present
    softest = sorted(yielding, key=lambda name: case.table.classes[case.table.index(name)].eta_max)
    return tuple(softest[: 1 + int(parameter_draws.share("soft_classes") * len(softest))])


def _loose_classes(case: Case, parameter_draws: ParameterDraws) -> tuple[str, ...]:
    present = [case.table.classes[k].name for k in np.unique(case.profiles.ground).tolist()]
    loose = [name for name in present if name not in _HARD] or present
    if len(loose) > 1 and parameter_draws.share("loose_classes") < 0.6:
        # Meadows are commonly free of stones.
        loose.sort(key=lambda name: case.table.classes[case.table.index(name)].eta_max)
        loose = loose[1:]
    return tuple(loose)


def _with_effect(model: HypothesisModel, effect: EffectSection) -> HypothesisModel:
    return replace(model, effects=model.effects.having(effect))


def _fitted(
    family: str, parameter_draws: ParameterDraws, form_draw: str, draws: Mapping[str, str]
) -> tuple[str, dict[str, float]]:
    """Form and parameters of an effect from the ranges of its row.

    ``draws`` names the draw of each parameter.
    """
    fit = calibration_of(family)
    form = ""
    if fit.forms:
        form = parameter_draws.one_of(form_draw, tuple(fit.forms), tuple(fit.forms.values()))
    return form, {
        key: parameter_draws.within(draws[key], fit.ranges[key]) for key in fit.drawn(form)
    }


def _from_row(family: str) -> Callable[[Case, ParameterDraws], _Part]:
    """An effect that needs nothing but the ranges of its row."""

    def part(case: Case, parameter_draws: ParameterDraws) -> _Part:
        draws = {key: f"{family}.{key}" for key in calibration_of(family).ranges}
        form, values = _fitted(family, parameter_draws, f"{family}.form", draws)
        section: dict[str, object] = {**({"form": form} if form else {}), **values}
        effect = EFFECTS[family].settings(**section)
        return _Part(form or family, lambda m: _with_effect(m, effect), values)

    return part


def _lateral_deflection(case: Case, parameter_draws: ParameterDraws) -> _Part:
    fit = calibration_of("lateral_deflection")
    if parameter_draws.share("lateral.form") < fit.forms["kicks"]:
        angle = parameter_draws.within("lateral.angle", fit.ranges["angle_deg"])
        hop = parameter_draws.within("lateral.hop", fit.ranges["hop_m"])
        walk, uneven_deg = LateralWalk(angle_deg=angle, hop_m=hop), angle
        form, values = "kicks", {"angle_deg": angle, "hop_m": hop}
    else:
        width = parameter_draws.within("lateral.width", fit.ranges["width_percent"])
        walk = LateralWalk(width_percent=width)
        uneven_deg = parameter_draws.log("lateral.kicks", 0.3, 6.0)
        form, values = "constant", {"width_percent": width}
    # Ground that deflects rocks laterally is not even along their path either.
    lean = math.tan(
        math.radians(min(uneven_deg, 25.0) * parameter_draws.uniform("lateral.lean", 0, 0.6))
    )
    bumps = Roughness(obstacle_m=rounded(min(float(np.median(case.radius_m)) * lean, 1.0)))

    def change(model: HypothesisModel) -> HypothesisModel:
        changed = replace(model, lateral_walk=walk)
        if model.effects.get(Roughness) is None and parameter_draws.share("lateral.uneven") < 0.6:
            changed = _with_effect(changed, bumps)
        return changed

    return _Part(form, change, values)


def _fragmentation(case: Case, parameter_draws: ParameterDraws) -> _Part:
    fit = calibration_of("fragmentation")
    threshold = parameter_draws.share("break.form") < fit.forms["threshold"]
    values: dict[str, float] = {
        "energy_jkg": parameter_draws.within("break.energy", fit.ranges["energy_jkg"]),
        "loss": parameter_draws.within("break.loss", fit.ranges["loss"]),
    }
    if threshold:
        values["pieces"] = int(parameter_draws.within("break.pieces", fit.ranges["pieces"]))
    else:
        for key, name in (
            ("shape", "break.shape"),
            ("survival_rate", "break.survival"),
            ("fractal_dimension", "break.dimension"),
        ):
            values[key] = parameter_draws.within(name, fit.ranges[key])
    form = "threshold" if threshold else "fractal"
    # Smaller pieces are not looked for in the field, and there would be very many of them.
    smallest = rounded(0.03 * 4.0 / 3.0 * math.pi * float(np.median(case.radius_m)) ** 3)
    section = {"form": form, "smallest_m3": smallest, **values}
    effect = Fragmentation(**section)  # type: ignore[arg-type]
    # The more blocks break, the more of what is seen are pieces that flew apart.
    walk = _walk_too(parameter_draws, min(150.0 / values["energy_jkg"], 8.0))
    return _Part(form, lambda m: replace(_with_effect(m, effect), lateral_walk=walk), values)


def _soft_ground(case: Case, parameter_draws: ParameterDraws) -> _Part:
    names = {
        "reference_speed_mps": "soft.reference",
        "depth_scale": "soft.depth",
        "drag_coefficient": "soft.drag",
        "friction": "soft.friction",
    }
    form, values = _fitted("soft_ground", parameter_draws, "soft.form", names)
    section = {"form": form, "classes": _soft_classes(case, parameter_draws), **values}
    effect = SoftGround(**section)  # type: ignore[arg-type]
    return _Part(form, lambda m: _with_effect(m, effect), values)


def _entrainment(case: Case, parameter_draws: ParameterDraws) -> _Part:
    names = {
        "number": "set_off.number",
        "size_ratio": "set_off.size",
        "share": "set_off.share",
        "energy_kj": "set_off.energy",
    }
    form, values = _fitted("entrainment", parameter_draws, "set_off.form", names)
    section: dict[str, object] = {
        "form": form,
        "classes": _loose_classes(case, parameter_draws),
        **values,
    }
    effect = Entrainment(**section)  # type: ignore[arg-type]
    walk = _little_walk(parameter_draws)
    return _Part(form, lambda m: replace(_with_effect(m, effect), lateral_walk=walk), values)


def _trees(case: Case, parameter_draws: ParameterDraws) -> _Part:
    fit = calibration_of("trees")
    length = _length(case)
    low = parameter_draws.uniform("stand.from", 0.0, 0.75 * length)
    stand = ForestStand(
        low,
        rounded(low + parameter_draws.uniform("stand.length", 0.15, 1.0) * length),
        parameter_draws.within("stand.stems", fit.ranges["stems_per_ha"]),
        parameter_draws.within("stand.dbh", fit.ranges["dbh_cm"]),
    )
    form = parameter_draws.one_of("stand.form", tuple(fit.forms), tuple(fit.forms.values()))
    values = {"stand_from_m": stand.s0, "stand_to_m": stand.s1}
    section: dict[str, object] = {"form": form}
    if form == "viscous":
        masses = case.mass_kg[np.isfinite(case.mass_kg)]
        middle = float(np.median(masses)) if masses.size else 1000.0
        section["drag_kgps"] = values["drag_kgps"] = rounded(
            middle * parameter_draws.within("stand.drag", fit.ranges["drag_kgps"])
        )
    else:
        section["efficiency"] = values["efficiency"] = parameter_draws.within(
            "stand.efficiency", fit.ranges["efficiency"]
        )
        values |= {"stems_per_ha": stand.stems_per_ha, "dbh_cm": stand.dbh_cm}
    effect = Trees(**section)  # type: ignore[arg-type]
    # Stems that are hit off their middle deflect rocks laterally.
    hits = stand.stems_per_ha * values.get("efficiency", 0.3) / 300.0
    walk = _walk_too(parameter_draws, min(5.0 * math.sqrt(hits), 12.0))
    return _Part(
        form,
        lambda m: replace(_with_effect(m, effect), stand=stand, lateral_walk=walk),
        values,
    )


def _air_drag(case: Case, parameter_draws: ParameterDraws) -> _Part:
    form, values = _fitted(
        "air_drag", parameter_draws, "air.form", {"drag_coefficient": "air.coefficient"}
    )
    values["air_density_kgm3"] = AirDrag().air_density_kgm3
    section: dict[str, object] = {"form": form, **values}
    effect = AirDrag(**section)  # type: ignore[arg-type]
    return _Part(form, lambda m: _with_effect(m, effect), values)


def _roughness(case: Case, parameter_draws: ParameterDraws) -> _Part:
    names = {"obstacle_m": "rough.obstacle", "wavelength_m": "rough.wavelength"}
    form, values = _fitted("roughness", parameter_draws, "rough.form", names)
    section: dict[str, object] = {"form": form, **values}
    if parameter_draws.share("rough.classes") < 0.6:
        section["classes"] = _loose_classes(case, parameter_draws)
    effect = Roughness(**section)  # type: ignore[arg-type]
    # Bumps lean across the path as well, if less often than against it.
    tilt = math.degrees(math.atan(values["obstacle_m"] / float(np.median(case.radius_m))))
    walk = _walk_too(parameter_draws, 0.6 * tilt)
    return _Part(form, lambda m: replace(_with_effect(m, effect), lateral_walk=walk), values)


def _rock_shape(case: Case, parameter_draws: ParameterDraws) -> _Part:
    form, values = _fitted(
        "rock_shape", parameter_draws, "shape.form", {"strength": "shape.strength"}
    )
    section: dict[str, object] = {"form": form, **values}
    effect = RockShape(**section)  # type: ignore[arg-type]
    walk = _walk_too(parameter_draws, min(10.0 * values.get("strength", 0.5), 12.0))
    return _Part(form, lambda m: replace(_with_effect(m, effect), lateral_walk=walk), values)


def _release_error(case: Case, parameter_draws: ParameterDraws) -> _Part:
    wrong = [
        parameter_draws.share(f"release.{what}") < 0.7 for what in ("ahead", "faster", "aside")
    ]
    if not any(wrong):
        wrong[int(parameter_draws.share("release.one") * 3)] = True
    release = ReleaseError(
        ahead_m=parameter_draws.log("release.ahead_m", 0.5, 12.0) if wrong[0] else 0.0,
        faster_mps=parameter_draws.log("release.faster_mps", 0.5, 12.0) if wrong[1] else 0.0,
        shift_m=parameter_draws.normal("release.shift_m", 4.0) if wrong[2] else 0.0,
        scatter_m=parameter_draws.log("release.scatter_m", 0.3, 12.0) if wrong[2] else 0.0,
    )
    values = {
        name: getattr(release, name) for name in ("ahead_m", "faster_mps", "shift_m", "scatter_m")
    }
    return _Part("offset and speed", lambda m: replace(m, release=release), values)


def _measurement_error(case: Case, parameter_draws: ParameterDraws) -> _Part:
    kinds = [
        parameter_draws.share(f"seen.{what}") < 0.6 for what in ("scale", "clock", "turns", "place")
    ]
    if not any(kinds):
        kinds[int(parameter_draws.share("seen.one") * 4)] = True
    scale = math.exp(parameter_draws.uniform("seen.log_scale", -0.35, 0.35)) if kinds[0] else 1.0
    measurement = MeasurementError(
        scale=scale,
        clock_sd=parameter_draws.log("seen.clock_sd", 0.02, 0.35) if kinds[1] else 0.0,
        rotation_scale=math.exp(parameter_draws.uniform("seen.log_turns", -0.3, 0.3))
        if kinds[2]
        else 1.0,
        noise_rel=parameter_draws.log("seen.noise", 0.05, 0.4) if kinds[2] else 0.0,
        stretch=1.0 + (scale - 1.0) * parameter_draws.share("seen.stretch"),
        position_m=parameter_draws.log("seen.position_m", 0.5, 8.0) if kinds[3] else 0.0,
    )
    names = ("scale", "clock_sd", "rotation_scale", "noise_rel", "stretch", "position_m")
    values = {name: float(getattr(measurement, name)) for name in names}
    return _Part("scale, time base, noise", lambda m: replace(m, measurement=measurement), values)


def _contact_law(case: Case, parameter_draws: ParameterDraws) -> _Part:
    """Freedom of the contact beyond calibration: one shift for all classes, in wide ranges.

    Classes keep the differences between them. The restitution counts only where the engine reads
    it; from the highest speeds on it hardly falls with the normal speed.
    """
    shifts = {
        "eta_max": parameter_draws.uniform("law.eta_max", -0.5, 0.5),
        "mu_f": parameter_draws.uniform("law.mu_f", -0.5, 0.7),
    }
    speed = math.nan
    if case.engine.resolved().eta_max_rule == "restitution":
        shifts["restitution"] = parameter_draws.uniform("law.restitution", -0.5, 0.9)
        speed = parameter_draws.log("law.restitution_speed", 2.0, 200.0)
    used = set(np.unique(case.profiles.ground).tolist())

    def change(model: HypothesisModel) -> HypothesisModel:
        classes = []
        for k, ground in enumerate(model.table.classes):
            values = {
                name: rounded(min(max(float(getattr(ground, name)) + shift, low), high))
                for name, shift in shifts.items()
                for low, high in (_LAW_BOUNDS[name],)
            }
            if math.isfinite(speed):
                values["restitution_speed_mps"] = speed
            classes.append(replace(ground, **values) if k in used else ground)  # type: ignore[arg-type]
        return replace(model, table=GroundTable(tuple(classes)))

    values = {f"shift_of_{name}": shift for name, shift in shifts.items()}
    if math.isfinite(speed):
        values["restitution_speed_mps"] = speed
    return _Part("shifted contact", change, values)


#: Families that set more of a model than the ranges of their row say.
_FAMILIES: Mapping[str, Callable[[Case, ParameterDraws], _Part]] = {
    "lateral_deflection": _lateral_deflection,
    "fragmentation": _fragmentation,
    "soft_ground": _soft_ground,
    "entrainment": _entrainment,
    "trees": _trees,
    "air_drag": _air_drag,
    "roughness": _roughness,
    "rock_shape": _rock_shape,
    "release_error": _release_error,
    "measurement_error": _measurement_error,
    "contact_law": _contact_law,
}


def families_to_try(case: Case) -> tuple[str, ...]:
    """Families that are not switched on in the configuration already."""
    on = set(case.effects.names)
    return tuple(name for name in FAMILIES if name not in on)
