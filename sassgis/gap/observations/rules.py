"""What the checks of observations say: one rule for each kind of fault."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.observations.observation_finding import LeftOut, Level, ObservationFinding
from sassgis.gap.observations.observed import Observations
from sassgis.model.grid import IntArray
from sassgis.model.labels import some_of


@dataclass(frozen=True, slots=True)
class Rule:
    """A kind of fault."""

    level: Level  # "error": wrong, and to be mended; "warning": usable, but deserves a look
    problem: str  # it and ``expected`` may hold {words} that the check fills in
    column: str = ""  # where the fault is seen, if the check does not say
    expected: str = ""
    left_out: LeftOut = ""  # what is not used because of it: "", "value" or "row"

    def at(
        self,
        observations: Observations,
        table: str,
        which: NDArray[np.bool_] | IntArray,
        found: str = "",
        column: str = "",
        **words: object,
    ) -> Iterator[ObservationFinding]:
        """The finding of this rule for some rows of a table; none for none of them."""
        rows = observations.tables[table].row[which]
        if rows.size:
            yield ObservationFinding(
                self.level,
                self.problem.format(**words),
                str(observations.files.get(table, "")),
                table,
                column or self.column,
                tuple(rows.tolist()),
                found,
                self.expected.format(**words),
                self.left_out,
            )


_AXES = "semi_axis_a_m, semi_axis_b_m, semi_axis_c_m"
_IMPACT_SPEEDS = "vt_in_mps, vn_in_mps, vt_out_mps, vn_out_mps"
_DENSITY = "900 to 5000 kg/m³"

#: By name; the checks say which rows break them.
RULES: Mapping[str, Rule] = {
    # Names
    "twice": Rule("error", "is there twice; the first one is taken", "rock_id",
                  "one row for each", "row"),
    "same stop": Rule("error", "the same stop is there twice", "rock_id",
                      "one row for each block", "row"),
    "several stops": Rule("warning", "several stops of one rock are taken to be its pieces",
                          "rock_id", "names with a suffix, such as {name}.1 and {name}.2"),
    "unattributed": Rule("warning", "not in the table of rocks: {taken}", "rock_id", "{nearest}"),
    "piece of none": Rule("warning", "named as a piece of a rock that is not there: taken as a "
                          "rock of its own", "rock_id",
                          "a row for {parent}, or names without a point"),
    "placed elsewhere": Rule("warning", "no such station: the passages are used by their x and y "
                             "alone", "station", "{nearest}"),
    "no station": Rule("error", "no such station", "station", "{nearest}", "row"),
    # Sizes
    "full axes": Rule("error", "look like full axes, not semi-axes", _AXES,
                      "half of length, width and height", "value"),
    "large axes": Rule("warning", "semi-axes do not go with the volume or the mass", _AXES,
                       "half of length, width and height", "value"),
    "small axes": Rule("warning", "semi-axes are too small for the volume or the mass", _AXES,
                       "half of length, width and height in m"),
    "unit of mass": Rule("error", "look like {unit}: mass and volume do not go together",
                         "mass_kg", _DENSITY, "value"),
    "tonnes": Rule("error", "look like tonnes: mass and semi-axes do not go together", "mass_kg",
                   "kg", "value"),
    "unit of axes": Rule("error", "look like {unit}", _AXES, "half of length, width and height in "
                         "m", "value"),
    "mass and volume": Rule("warning", "mass and volume do not go together", "mass_kg", _DENSITY),
    "density": Rule("error", "{problem}", "density_kgm3", _DENSITY, "value"),
    "heavy pieces": Rule("warning", "blocks of {name} are more than the rock itself", "",
                         "{most} at most"),
    # Motion
    "inward": Rule("error", "the rock leaves the ground before it hits it{hint}",
                   "vn_in_mps, vn_out_mps", "below zero: the normal points out of the ground",
                   "value"),
    "grazing": Rule("warning", "within its error the rock does not come down on the ground",
                    "vn_in_mps, vn_out_mps", "below zero", "value"),
    "radians": Rule("error", "look like radians or tangents", "slope_deg", "degrees", "value"),
    "swapped": Rule("error", "before and after look swapped: more energy after the impact than "
                    "before", "vt_out_mps", "at most 1, {room:.2f} with errors of measurement"),
    "energy gain": Rule("warning", "more energy after the impact than before", "vt_out_mps",
                        "at most 1, {room:.2f} with errors of measurement"),
    "spin": Rule("error", "look like {guess}", "", "{unit}", "value"),
    "odd spin": Rule("error", "too fast for the sizes and speeds of the rocks: another unit, or "
                     "full axes?", "", "{unit}", "value"),
    "unit of speed": Rule("error", "look like {unit}", "speed_mps", "m/s, and times in s", "value"),
    "speed and time": Rule("error", "speeds do not go with positions and times", "speed_mps",
                           "m/s, and times in s", "value"),
    "milliseconds": Rule("error", "look like milliseconds", "t_s", "s", "value"),
    "unit of impacts": Rule("error", "look like km/h, or another unit", _IMPACT_SPEEDS, "m/s",
                            "value"),
    "scale": Rule("warning", "speeds are too high for all, by one scale; they are kept",
                  _IMPACT_SPEEDS, "the scale of the film and its frame rate as they were"),
    "km/h": Rule("error", "look like km/h", "", "{fastest:.1f} m/s at most", "value"),
    "mostly too fast": Rule("error", "faster than the drop allows", "",
                            "{fastest:.1f} m/s at most", "value"),
    "start too low": Rule("warning", "faster than the drop from the stated start allows, at "
                          "{rocks} of {all} rocks; they are kept", "",
                          "a start that is at least {more:.1f} m higher, or a right scale"),
    "too fast": Rule("warning", "faster than the drop allows", "",
                     "{fastest:.1f} m/s at most", "value"),
    # Contacts
    "ends early": Rule("error", "ends before it starts", "t_end_s", "t_start_s or later", "value"),
    "overlap": Rule("error", "ends after the next contact of the rock has begun", "t_end_s",
                    "times that rise from contact to contact", "value"),
    "no place": Rule("warning", "has no place: its time and spin alone are used", "x, y",
                     "centre of the rock at the contact"),
    "too far": Rule("warning", "farther from the contact before than any fall takes the rock in "
                    "that time", "x, y, z", "{fastest:.1f} m/s at most", "value"),
    # Places
    "far from station": Rule("warning", "passages lie away from the station that they name",
                             "x, y", "{room:g} m at most"),
    "above release": Rule("warning", "passages lie above the release of the rock", "station",
                          "stations below the release"),
    "impacts above release": Rule("warning", "impacts lie above the stated release of the rock",
                                  "x, y", "the right place of the release"),
    "climbs": Rule("error", "the rock climbs from one station to the next lower one", "z",
                   "the right station in each row, and z of the rock there", "value"),
    "unordered": Rule("warning", "passages are not listed down the slope: taken in the order of "
                      "the stations' heights", "station"),
    "outside": Rule("warning", "lies outside the DEM", "x, y", "{extent}", "value"),
    "all outside": Rule("error", "no row lies on the DEM{why}", "x, y", "{extent}", "value"),
    "station outside": Rule("error", "station {name} lies outside the DEM{why}", "", "{extent}",
                            "row"),
    "height system": Rule("warning", "heights are offset from the DEM: another height system?",
                          "z", "within {limit:g} m of the ground"),
    "stray height": Rule("warning", "height is far from the DEM", "z",
                         "a height near the ground", "value"),
    "under ground": Rule("warning", "paths run under the ground: another height system?", "z",
                         "at or above the DEM"),
}  # fmt: skip


def nearest_of(name: str, known: Sequence[str]) -> str:
    """What was expected: known names, and the one most like the one found."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f"one of {some_of(known)}" + (f"; nearest: {close[0]}" if close else "")
