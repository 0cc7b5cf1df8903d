"""What the owner of observations should know about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning"]
LeftOut = Literal["", "value", "row", "table"]


@dataclass(frozen=True, slots=True)
class ObservationFinding:
    """Something about the observations that their owner should know."""

    level: Level  # "error": wrong, and to be mended; "warning": usable, but deserves a look
    problem: str
    # Where; empty where it does not apply.
    file: str = ""
    table: str = ""
    column: str = ""
    #: Rows of the table: lines of a CSV counted with the header, or feature ids.
    rows: tuple[int, ...] = ()
    found: str = ""
    expected: str = ""
    left_out: LeftOut = ""  # what is not used because of it

    def __str__(self) -> str:
        """One line that names file, table, column and row."""
        place = ".".join(filter(None, (self.table, self.column)))
        parts = (self.level, self.file, place, _rows(self.rows), self.problem)
        line = ": ".join(filter(None, parts))
        detail = (("found", self.found), ("expected", self.expected))
        if any(text for _, text in detail):
            line += f" ({'; '.join(f'{word} {text}' for word, text in detail if text)})"
        if self.left_out:
            what = self.left_out + ("s" if len(self.rows) > 1 and self.left_out != "table" else "")
            line += f"; {what} left out"
        return " ".join(line.split())


def _rows(rows: Sequence[int]) -> str:
    if not rows:
        return ""
    shown = ", ".join(str(r) for r in rows[:5])
    more = f" and {len(rows) - 5} more" if len(rows) > 5 else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"
