"""Names of effects, quantities and places, for readers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce

from sassgis.gap.causes.all_causes import CAUSES, GROUPS
from sassgis.gap.constants import LEVEL
from sassgis.gap.diagnosis import GapFinding, Rung
from sassgis.settings.languages import Phrase, all_of, in_english, joined, named, phrase
from sassgis.settings.results import ground_name, short
from sassgis.settings.styles import with_unit

EFFECT_NAMES: Mapping[str, str] = {
    **{name: cause.words[0] for name, cause in CAUSES.items()},
    "none": "no missing effect",
    "unknown": "unknown or not testable with these data",
}

QUANTITY_NAMES: Mapping[str, str] = {
    "release_speed_mps": "speed at the release",
    "speed_mps": "speed",
    "rotation_hz": "rotation",
    "height_m": "passing height",
    "lateral_m": "lateral offset",
    "energy_kept": "share of energy kept",
    "spin_out_radps": "spin after the impact",
    "turn_deg": "turn in plan",
    "runout_m": "run-out",
    "block_mass_kg": "mass of stopped blocks",
    "block_volume_m3": "volume of stopped blocks",
    "path_m": "length of path",
    "flight_fit": "gravity from flights",
    # Quantities of the calibration, without units.
    "runout": "run-out",
    "aside": "lateral offset",
    "blocks": "number of stopped blocks",
    "height": "passing height",
    "contacts": "number of contacts",
    "fastest_second": "greatest speed over a second",
    "between_contacts": "time between contacts",
    "hop_length_90": "length of hops, 90 %",
    "hop_height_90": "height of hops, 90 %",
    "rim_ratio": "ratio of surface speed to speed",
    "hop_time_s": "time of hops",
    "stops_per_rock": "stopped blocks per rock",
    "largest_share": "share of the largest fragment",
    "arrived": "share of rocks that arrive",
    "tangential_speed_mps": "tangential speed after the impact",
    "normal_speed_mps": "normal speed after the impact",
    "spin_ratio": "ratio of surface speed to speed after the impact",
    "rebound_angle_deg": "angle of the rebound",
    "vertical_acceleration_mps2": "vertical acceleration in flight",
    "horizontal_acceleration_mps2": "horizontal acceleration in flight",
    "speed_change_mps": "speed change in flight without gravity",
    "acceleration_mps2": "acceleration on the ground",
}
_UNIT_ENDS = (
    "_mps2", "_mps", "_radps", "_hz", "_kgm3", "_kg", "_m3", "_m", "_deg", "_rel", "_kj", "_s",
)  # fmt: skip

_TESTS: Mapping[str, str] = {
    "free run": "from the release",
    "reach": "from where the stretch begins",
    "one step": "from one state to the next",
}

#: No cause is stated to be more probable; one that is less probable is not listed.
MOST_SURE, LISTED = 0.99, 0.005

#: Rungs of the ladder that are no effect.
RUNG_NAMES: Mapping[str, str] = {
    "configured": "the configured ground",
    "ground": "calibrated ground",
    "contact_law": EFFECT_NAMES["contact_law"],
    "floor": "chance",
}


def effect_name(effect: str) -> Phrase:
    """Return the name of a cause, of two joined by "+", or of a group."""
    if effect in GROUPS:
        return phrase("the group “{}”", phrase(effect))
    return all_of(EFFECT_NAMES.get(e, e.replace("_", " ")) for e in effect.split("+"))


def effect_key(effect: str) -> Phrase:
    """Return a cause as the configuration calls it; in other languages than English by its name."""
    return in_english(effect.replace("_", " "), effect_name(effect))


def rung_name(rung: str) -> Phrase:
    """Return the name of a model of the ladder."""
    return phrase(RUNG_NAMES.get(rung) or effect_name(rung))


def file_has(rung: str) -> Phrase:
    """Describe the configuration of a model of the ladder, without errors of the data."""
    moving = [own for own in rung.split("+") if own not in CAUSES or not CAUSES[own].of_data]
    if moving:
        return rung_name("+".join(moving))
    return phrase("the calibrated base model (with {} in the data)", rung_name(rung))


def effect_phrase(effect: str) -> Phrase:
    """Return what a cause, or two joined by "+", does, to follow "The gap is best explained by"."""
    return reduce(
        lambda one, other: phrase("{}, together with {}", one, other),
        (phrase(CAUSES[e].words[1]) if e in CAUSES else effect_name(e) for e in effect.split("+")),
    )


def closed_percent(share: float) -> float:
    """Return the closed share of a gap in per cent, at most 100 (the distance of chance)."""
    return 100.0 * min(share, 1.0)


def is_chance(rung: Rung, ladder: Sequence[Rung]) -> bool:
    """Return whether the distance of a model of the ladder is not distinguishable from chance."""
    first, floor = ladder[0], ladder[-1]
    if rung.ci95 is not None and rung.ci95[1] >= 1.0:
        return True
    # Where the first one may be chance, no model has a share.
    withheld = all(own.share is None for own in ladder)
    return rung.distance <= max(floor.distance, first.distance if withheld else 0.0)


def number_text(value: float) -> str:
    """Return two digits for large numbers, as many decimals as a setting needs for small ones."""
    text = short(value)
    return text.replace("-", "\u2212")


def range_text(low: float, high: float) -> Phrase:
    """Return an interval, low to high."""
    return phrase("{} to {}", number_text(low), number_text(high))


def quantity_name(quantity: str) -> Phrase:
    """Return the name of a quantity, without its unit: "passing height" for ``height_m``."""
    if quantity.startswith("stop "):
        name = quantity_name(quantity.removeprefix("stop "))
        return phrase("{} of stops", name) if name.startswith("lateral") else name
    if quantity.endswith("_spread"):
        return phrase(
            "scatter of {} about the prediction", quantity_name(quantity.removesuffix("_spread"))
        )
    if quantity in QUANTITY_NAMES:
        return phrase(QUANTITY_NAMES[quantity])
    end = next((e for e in _UNIT_ENDS if quantity.endswith(e)), "")
    return phrase(quantity.removesuffix(end).replace("_", " ") or quantity)


def tested_by(test: str) -> Phrase:
    """Describe how a gap was tested."""
    return phrase(_TESTS.get(test, test))


def place_words(place: str) -> Phrase:
    """Name a place: "at S3", "between S2 and S3", "below S4", "on talus", "on the whole slope"."""
    if place == "all":
        return phrase("on the whole slope")
    if place == "stop":
        return phrase("at stop")
    if place == "contacts":
        return phrase("along the path")
    if place.startswith("ground:"):
        ground = ground_name(place.removeprefix("ground:"))
        return phrase("on {}", in_english(ground.replace("_", " "), ground))
    upper, dash, lower = place.partition("-")
    if not dash:
        return phrase("at {}", place)
    # A name with a dash in it cannot be taken apart.
    if place.count("-") > 1:
        return phrase("on the stretch {}", place)
    if upper == "release":
        whole = lower == "end"
        return phrase("from the release to the stop") if whole else phrase("above {}", lower)
    if lower == "end":
        return phrase("below {}", upper)
    return phrase("between {} and {}", upper, lower)


def place_name(place: str) -> Phrase:
    """Return a place as a row of a table: names of stations and of ground stay."""
    if place == "stop":
        return phrase("stop")
    if place == "all":
        return in_english("all", phrase("whole slope"))
    upper, dash, lower = place.removeprefix("ground:").partition("-")
    begins = phrase("release") if dash and upper == "release" else named(upper)
    ends = phrase("end") if dash and lower == "end" else named(lower)
    return joined("", (begins, dash, ends))


def with_unit_in_brackets(text: str, unit: str) -> str:
    """Return the name of a quantity with its unit, if it has one: "speed (m/s)"."""
    return phrase("{} ({})", phrase(text), unit) if unit and unit != "1" else text


def significance(finding: GapFinding) -> str:
    """Rate a gap: "sure" (headline), "likely" (among those on the map) or "open"."""
    if finding.p_adjusted <= LEVEL:
        return "sure"
    return "likely" if finding.q_value <= LEVEL else "open"


def finding_label(finding: GapFinding) -> str:
    """Return a finding as a label on the map: "speed −2.1 m/s"."""
    sign = "+" if finding.gap > 0.0 else "\u2212"
    number = with_unit(f"{sign}{abs(finding.gap):.2g}", finding.unit)
    return f"{quantity_name(finding.quantity)} {number}"
