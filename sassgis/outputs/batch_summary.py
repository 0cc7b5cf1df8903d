"""The table of the areas of a batch, ``summary.csv``."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from sassgis.files.atomic_output import staged_file
from sassgis.outputs.frames import without_formulas

#: So many times as long as the table took to write the next one waits.
_SHARE = 50.0
_NOT_RUN, _SKIPPED = "not run", "skipped: "


class BatchSummary:
    """The table of all areas (name and file by folder), written anew whenever one is done."""

    def __init__(
        self, path: Path, areas: Mapping[str, tuple[str, str]], levels: Sequence[str]
    ) -> None:
        self._path = path
        self._levels = list(levels)
        self._next = 0.0
        # Times of areas that an earlier call has run.
        try:
            frame = pd.read_csv(path, dtype={"folder": str}).dropna(subset=["folder", "seconds"])
            self._before = dict(zip(frame["folder"], frame["seconds"].astype(float), strict=True))
        except (OSError, ValueError, KeyError):
            self._before = {}
        self._rows: dict[str, dict[str, object]] = {
            folder: {"area": name, "file": file, "status": _NOT_RUN}
            for folder, (name, file) in areas.items()
        }

    def done(
        self,
        folder: str,
        facts: Mapping[str, object],
        zones_m2: Mapping[str, float],
        seconds: float | None,
    ) -> None:
        """Note an area that was run, or was there already (``seconds`` None); zones by code."""
        self._rows[folder] |= {
            "status": "done",
            "folder": folder,
            **facts,
            **{f"{code}_m2": zones_m2.get(code) for code in self._levels},
            "seconds": self._before.get(folder) if seconds is None else round(seconds, 1),
        }

    def skipped(self, folder: str, reason: str) -> None:
        """Note an area that could not be run."""
        self._rows[folder]["status"] = _SKIPPED + reason

    def reasons(self) -> dict[str, str]:
        """Return the reasons why areas were skipped, by their name."""
        return {
            str(row["area"]): str(row["status"]).removeprefix(_SKIPPED)
            for row in self._rows.values()
            if str(row["status"]).startswith(_SKIPPED)
        }

    def frame(self) -> pd.DataFrame:
        """Return the table."""
        columns = ["area", "file", "folder", "status", "points", "rocks", "furthest_m"]
        columns += [*(f"{code}_m2" for code in self._levels), "seconds"]
        frame = pd.DataFrame(list(self._rows.values()), columns=columns)
        return frame.astype({"points": "Int64", "rocks": "Int64"})

    def write_now_and_then(self) -> None:
        """Write the table, unless that took most of the time of a batch of many small areas."""
        if time.monotonic() > self._next:
            began = time.monotonic()
            self.write()
            self._next = time.monotonic() + _SHARE * (time.monotonic() - began)

    def write(self) -> None:
        """Write the table; whole or not at all."""
        with staged_file(self._path, overwrite=True) as fresh:
            without_formulas(self.frame()).to_csv(fresh, index=False)
