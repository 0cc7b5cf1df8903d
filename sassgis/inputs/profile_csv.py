"""A profile from a table of chainages and heights, for runs without a map."""

from __future__ import annotations

from functools import partial

import numpy as np

from sassgis.errors import ConfigError, InputError, notice
from sassgis.inputs.config import profile_control_lines
from sassgis.inputs.csv_table import CsvColumn, read_table
from sassgis.settings.ground import GroundTable
from sassgis.settings.profiles import ProfileSet
from sassgis.settings.run_config import Config
from sassgis.settings.schema import Input


def read_profile(path: Input, table: GroundTable, default: str) -> ProfileSet:
    """Read one profile, in one stretch that lies in no cell of a map.

    The CSV has the columns s_m (chainage, rising) and z_m (height) and, if wanted, ground: the
    class of the segment that starts at the row. Rows without a class take the default.
    """
    columns = {
        "s_m": CsvColumn(float),
        "z_m": CsvColumn(float),
        "ground": CsvColumn(known=table.names, default=default, what="ground class"),
    }
    wrong = partial(InputError, file=path)
    rows: list[tuple[float, float, int]] = []
    what = "a CSV file with columns s_m, z_m and, if wanted, ground"
    for where, row in read_table(path, "profile.file", what, columns):
        if rows and row["s_m"] <= rows[-1][0]:
            raise wrong(
                f"{where}: chainage does not rise", field="s_m",
                found=f"{row['s_m']:g} after {rows[-1][0]:g}",
                expected="a larger one than in the row before",
            )  # fmt: skip
        rows.append((row["s_m"], row["z_m"], table.index(row["ground"])))
    if len(rows) < 2:
        found = f"{len(rows)} row(s)"
        raise wrong("is too short for a profile", found=found, expected="two rows or more")
    s, z, ground = zip(*rows, strict=True)
    return ProfileSet(
        offset=np.array([0, len(s)], np.int64), s=np.array(s), z=np.array(z),
        ground=np.array(ground, np.int32), cell_offset=np.array([0, 1], np.int64),
        cell_s=np.array([s[0], s[-1]]), cell=np.array([-1], np.int64),
    )  # fmt: skip


def check_on_profile(config: Config, profile: ProfileSet) -> None:
    """Check that starts, stations and barriers of a configuration lie on its profile."""
    first, last = float(profile.s[0]), float(profile.s[-1])
    expected = f"within the profile, {first:g} to {last:g} m"
    wrong = partial(ConfigError, file=config.file, expected=expected)
    if config.profile is not None:
        low, high = config.profile.start_m
        if low < first or high > last:
            found = f"[{low:g}, {high:g}]"
            raise wrong("blocks would start off the profile", field="profile.start_m", found=found)
        steepest = np.degrees(np.arctan((-np.diff(profile.z) / np.diff(profile.s)).max()))
        if steepest <= 0.0:
            notice(f"{config.profile.file}: the profile descends nowhere")
    for control_line, chainage in profile_control_lines(config):
        if not first <= chainage <= last:
            section = "stations" if control_line.kind == "station" else "barriers"
            field = f"{section}[{control_line.name}].chainage_m"
            raise wrong("lies off the profile", field=field, found=f"{chainage:g}")
