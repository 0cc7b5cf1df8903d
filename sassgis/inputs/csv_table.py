"""Small tables that people write, with row numbers for messages; profiles from them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from sassgis.errors import ConfigError, InputError, notice
from sassgis.files.plain_file import check_text, number, read_text
from sassgis.inputs.config import profile_control_lines
from sassgis.inputs.vector_features import nearest
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Config
from sassgis.settings.results import ProfileSet
from sassgis.settings.schema import Input, composed

#: Far more than any table has; each takes long to be compared with those that are known.
_MOST_COLUMNS = 1000


_TRUTH = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


@dataclass(frozen=True, slots=True)
class CsvColumn:
    """What may stand in a column; numbers with decimal commas where ``;`` separates."""

    kind: type = str  # or float, int, bool
    known: Sequence[str] = ()  # the texts that may stand in it; empty for any
    low: float = -math.inf  # smallest number
    default: object = None  # of a row or a table without it; None: it must be there
    what: str = ""  # what a name in it is of, for messages; default: that of the column

    def value(self, cell: object, where: str, name: str, file: Input) -> Any:
        """Return the value of a cell; InputError with the row and the column if that cannot be."""
        wrong = partial(InputError, file=file, field=name, found=repr(cell))
        if self.default is not None and (cell is None or cell == ""):
            return self.default
        if self.kind in (float, int):
            found = number(cell, where, name, file)
            if found < self.low:
                raise wrong(f"{where}: is out of range", expected=f"{self.low:g} or more")
            if self.kind is int and not found.is_integer():
                raise wrong(f"{where}: is not a whole number", expected="a whole number")
            return self.kind(found)
        if self.kind is bool:
            truth = str(cell).strip().lower()
            if truth not in _TRUTH:
                raise wrong(f"{where}: cannot be used", expected="true or false")
            return _TRUTH[truth]
        if not isinstance(cell, str) or (self.default is None and not cell.strip()):
            raise wrong(f"{where}: is empty", expected="text")
        if self.known and cell not in self.known:
            what = self.what or name
            raise wrong(f"{where}: unknown {what}", expected=nearest(cell, self.known))
        return composed(cell.strip())


Columns = Mapping[str, CsvColumn]


def read_table(
    file: Input, field: str | None, what: str, columns: Columns
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield rows of a CSV file with the columns that are declared and no others.

    Each comes with its place, as "row 3", counted with the header. For messages, ``field`` is the
    key of the configuration that names the file, and ``what`` says what the file should be.
    """
    for where, row in csv_rows(read_text(file, field, what), file, columns):
        yield where, row_of(row, columns, where, file)


def row_of(
    cells: Mapping[str, object], columns: Columns, where: str, file: Input
) -> dict[str, Any]:
    """Return values of a row as its columns declare them."""
    return {
        name: column.value(cells.get(name), where, name, file) for name, column in columns.items()
    }


def csv_rows(text: str, file: Input, columns: Columns) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield rows of read_table, whose cells are still text; ``file`` is where the text is from."""
    header, delimiter, lines = csv_cells(text, file)
    check_columns(header, columns, file, "row 1")
    for line, cells in lines:
        where = f"row {line}"
        if len(cells) != len(header):
            problem, found = f"{where} does not fit the header", f"{len(cells)} values"
            expected = f"{len(header)} (texts with a {delimiter} in quotes)"
            raise InputError(problem, file=file, found=found, expected=expected)
        row = {c: v.strip() for c, v in zip(header, cells, strict=True)}
        for column, cell in row.items():
            check_text(cell, file, column, where)
            if delimiter == ";" and columns[column].kind in (float, int):
                row[column] = cell.replace(",", ".")
        yield where, row


def csv_cells(text: str, file: Input) -> tuple[list[str], str, Iterator[tuple[int, list[str]]]]:
    """Return cells of a CSV text as they stand: columns, delimiter, rows.

    The delimiter is "," or ";": what the first line has more of. A row is the number of its line,
    and its cells; empty lines are left out. InputError, also while the rows are taken, if it is no
    such text, or has too many columns.
    """
    lines = composed(text).splitlines()
    header = lines[0] if lines else ""
    delimiter = ";" if header.count(";") > header.count(",") else ","
    if (n := header.count(delimiter) + 1) > _MOST_COLUMNS:
        raise InputError(
            "row 1: has too many columns", file=file, found=n, expected=f"at most {_MOST_COLUMNS}"
        )
    # Strict, as a quote without its counterpart would take in all rows below without a word.
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True, strict=True)

    def rows() -> Iterator[tuple[int, list[str]]]:
        begun = 1
        try:
            for cells in reader:
                yield reader.line_num, cells
                begun = reader.line_num + 1
        except csv.Error as error:
            raise InputError(
                f"row {begun}: cannot be read", file=file, found=str(error),
                expected="values separated by commas; quotes in pairs",
            ) from None  # fmt: skip

    found = rows()
    columns = [c.strip() for c in next(found, (0, []))[1]]
    return columns, delimiter, ((n, cells) for n, cells in found if any(c.strip() for c in cells))


def check_columns(header: Sequence[str], columns: Columns, file: Input, where: str) -> None:
    """Raise InputError where a column is missing, unknown or repeated."""
    wrong = partial(InputError, file=file)
    required = [name for name, column in columns.items() if column.default is None]
    known = (*required, *(name for name in columns if name not in required))
    for column in header:
        if column not in known or header.count(column) > 1:
            problem, meant = f"{where}: unknown or repeated column", nearest(column, known)
            raise wrong(problem, field=column or "(empty)", found=repr(column), expected=meant)
    for column in required:
        if column not in header:
            found, expected = ", ".join(header) or "nothing", ", ".join(known)
            raise wrong(f"{where}: missing column", field=column, found=found, expected=expected)


@contextmanager
def errors_of_row(where: str, file: Input) -> Iterator[None]:
    """Name row and file in the InputError of a class that checks its values."""
    try:
        yield
    except InputError as error:
        raise InputError(**error.parts(problem=f"{where}: {error.problem}", file=file)) from None


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
