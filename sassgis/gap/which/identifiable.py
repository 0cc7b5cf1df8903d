"""What observations support: the quantities that are identifiable, and those that are not."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.observations.observed import Observations, rock_masses_kg
from sassgis.model.languages import all_of, joined, phrase

#: A gap of this many standard errors is found four times in five at the level of 5 %.
_DETECTABLE = 1.96 + 0.84


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that the observations hold."""

    name: str
    table: str
    rocks: int  # on how many of them; unattributed blocks are not counted
    values: int


@dataclass(frozen=True, slots=True)
class Identifiable:
    """What observations support, and what not."""

    rocks: int
    unattributed: int  # blocks and passages that belong to none of the rocks
    quantities: tuple[Quantity, ...]
    #: Sentences: what is missing, and what is therefore not identifiable.
    not_identifiable: tuple[str, ...]

    def has(self, name: str, table: str | None = None) -> bool:
        """Whether a quantity is there, in one table or in any."""
        return any(q.name == name and table in (None, q.table) for q in self.quantities)


def what_is_identifiable(observations: Observations) -> Identifiable:
    """Which quantities the data support, and what they do not identify."""
    quantities = []
    unattributed = 0
    for table, data in observations.tables.items():
        for name, columns in data.quantities.items():
            known = np.all([np.isfinite(data.numbers[c]) for c in columns], axis=0)
            if known.any():
                owner = observations.rock_of(table)[known]
                rocks = int(np.unique(owner[owner >= 0]).size)
                quantities.append(Quantity(name, table, rocks, int(known.sum())))
        if data.may_be_loose:
            unattributed += int((observations.rock_of(table) < 0).sum())
    found = Identifiable(len(observations.rock_names), unattributed, tuple(quantities), ())
    lacks = (
        *_missing_of_releases(observations, found),
        *_missing_at_stations(observations, found),
        *_missing_on_the_path(found),
        *_missing_of_rocks(observations),
        *_causes_without_fingerprint(observations),
    )
    return replace(found, not_identifiable=lacks)


def _missing_of_releases(observations: Observations, found: Identifiable) -> Iterable[str]:
    rocks = observations.rocks
    yield _sample_size(found.rocks)
    if not len(rocks):
        yield (
            "No table of rocks: which block is a piece and which belongs to no release is not "
            "known, so entrainment cannot be distinguished from fragmentation."
        )
    if not {"x", "y"} <= rocks.present:
        yield (
            "No release points: rocks have no fall line of their own, and an error of the release "
            "cannot be distinguished from one of the motion."
        )
    if not found.has("release_speed_mps"):
        yield "No release speeds: a wrong initial speed can only be inferred from further down."


def _missing_at_stations(observations: Observations, found: Identifiable) -> Iterable[str]:
    if not len(observations.stations) or not found.has("speed_mps", "passages"):
        yield (
            "No speeds at stations: the slope cannot be cut into reaches, and where between the "
            "release and the stop a gap begins is not known."
        )
    elif len(observations.stations) == 1:
        yield "One station: a gap lies above or below it, no closer than that."
    if found.has("speed_mps", "passages") and not found.has("rotation_hz", "passages"):
        yield "No rotation at stations: spin and the energy in it are not compared."
    if found.has("speed_mps", "passages") and not found.has("height_m"):
        yield "No heights at stations: flying and rolling passages are not kept apart."


def _missing_on_the_path(found: Identifiable) -> Iterable[str]:
    if not found.has("energy_kept"):
        yield (
            "No velocities before and after impacts: whether energy is lost in impacts, in flight "
            "or in rolling is not seen directly, and soft ground, roughness and trees are kept "
            "apart by their trends down the slope alone."
        )
    elif not found.has("spin_out_radps"):
        yield "No spin before and after impacts: slip at the contact is not seen."
    if not found.has("runout_m"):
        yield "No deposits: run-out, its spread and stopping are not compared."
    elif not (found.has("block_mass_kg") or found.has("block_volume_m3")):
        yield "No sizes of deposited blocks: whether pieces sum up to their rock is not known."
    if not (found.has("lateral_m") or found.has("turn_deg") or found.has("path_m")):
        yield "No positions beside the fall line: lateral deflection is not seen."
    if not found.has("flight_fit"):
        yield (
            "No trajectories in time: air drag and a wrong time base or scale of the measurement "
            "are not seen in flight."
        )


#: Keys of ``metadata`` that state an error of measurement, by what was measured.
_ERRORS = {
    "positions": "position_error_m",
    "speeds": "speed_error_rel",
    "rotations": "rotation_error_rel",
    "heights": "height_error_m",
}


def _missing_of_rocks(observations: Observations) -> Iterable[str]:
    rocks = observations.rocks
    masses = rock_masses_kg(observations)
    known = masses[np.isfinite(masses)]
    if known.size < 3:
        yield "Fewer than three rocks with a mass: effects that go with mass are not identifiable."
    elif float(np.std(np.log(known))) < 0.1:
        yield phrase(
            "All rocks have about the same mass ({} kg): effects that go with mass are not "
            "identifiable.",
            f"{np.median(known):.3g}",
        )
    if not {"semi_axis_a_m", "semi_axis_b_m", "semi_axis_c_m"} <= rocks.present:
        yield "No semi-axes of the rocks: an effect of rock shape is not identifiable."
    missing = [
        what for what, key in _ERRORS.items() if math.isnan(getattr(observations.metadata, key))
    ]
    if missing:
        whose = phrase("")
        if len(missing) < len(_ERRORS):
            whose = phrase(" of {}", all_of(missing))
        yield phrase(
            "Errors of measurement{} are not stated: noise of the measurement and scatter of the "
            "rocks are kept apart by assumption only.",
            whose,
        )


def _causes_without_fingerprint(observations: Observations) -> Iterable[str]:
    """Causes that leave nothing in the tables that are there, and what each would take."""
    unseen: dict[tuple[str, ...], list[str]] = {}
    for cause in CAUSES.values():
        lacks = [
            [name for name in own.tables if not len(observations.tables[name])]
            for own in cause.statistics
        ]
        # The law of the contact is that of the base: it has none.
        if lacks and all(lacks):
            fewest = lacks[int(np.argmin([len(own) for own in lacks]))]
            unseen.setdefault(tuple(fewest), []).append(cause.words[0])
    for tables, names in unseen.items():
        causes = joined(", ", map(phrase, names))
        yield phrase("No {}: no fingerprint is seen of {}.", all_of(tables), causes)


def _sample_size(rocks: int) -> str:
    if rocks == 0:
        return "No rocks: nothing can be compared rock by rock."
    if rocks == 1:
        return "One rock: its scatter is unknown, and no gap can be distinguished from chance."
    return phrase(
        "{} rocks: a gap of the mean below {} standard deviations, or of a share of half of the "
        "rocks below {} percentage points, is likely to go unseen (power 80 %, level 5 %, one "
        "comparison).",
        rocks,
        f"{_DETECTABLE / math.sqrt(rocks):.2f}",
        f"{100.0 * min(1.0, _DETECTABLE * 0.5 / math.sqrt(rocks)):.0f}",
    )
