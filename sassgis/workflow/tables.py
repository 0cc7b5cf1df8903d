"""Tables of single rocks and passages, written part by part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from sassgis.core.errors import OutputError
from sassgis.core.results import Outcome, StopReason
from sassgis.io.staging import writing
from sassgis.workflow.checkpoint import read_rows
from sassgis.workflow.map_run import MapRun, Plan, Rows


def require_parquet() -> None:
    """Raise OutputError if Parquet tables are asked for and cannot be written."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise OutputError(
            "Parquet tables need the package pyarrow: pip install 'sassgis[parquet]', "
            'or set the table to "csv"'
        ) from None


def rock_frame(rows: Rows, run: MapRun, planned: Plan) -> pd.DataFrame:
    """A row per rock, units in the names."""
    point = rows.rocks["line"] // run.spread.lines_per_point
    frame = pd.DataFrame({name: rows.rocks[name] for name in rows.rocks.dtype.names or ()})
    names = np.array(planned.points.area_names)
    frame.insert(0, "area", names[planned.points.area[point]] if len(names) else [])
    frame.insert(1, "scenario", np.array([b.name for b in run.blocks])[rows.rock_scenario])
    frame["reason"] = [StopReason(int(r)).name.lower() for r in frame["reason"]]
    frame["x_m"] = rows.x
    frame["y_m"] = rows.y
    return frame


def passage_frame(rows: Rows, run: MapRun) -> pd.DataFrame:
    """A row per rock and station or barrier, units in the names."""
    frame = pd.DataFrame({name: rows.passages[name] for name in rows.passages.dtype.names or ()})
    names = np.array([g.name for g, _ in run.gates], dtype=object)
    frame["gate"] = names[rows.passages["gate"]] if names.size else []
    frame["outcome"] = [Outcome(int(o)).name.lower() for o in frame["outcome"]]
    frame.insert(1, "scenario", np.array([b.name for b in run.blocks])[rows.passage_scenario])
    return frame


def write_table(path: Path, frames: Iterable[pd.DataFrame]) -> Path:
    """Write frames one under the other, as CSV or Parquet by the suffix of the path.

    Raises
    ------
    OutputError
        If the disk is full, or pyarrow is missing for Parquet.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".csv":
            with path.open("w", encoding="utf-8", newline="") as stream:
                for i, frame in enumerate(frames):
                    frame.to_csv(stream, index=False, header=i == 0, lineterminator="\n")
            return path
        require_parquet()
        import pyarrow as pa
        import pyarrow.parquet as pq

        writer = None
        try:
            for frame in frames:
                table = pa.Table.from_pandas(frame, preserve_index=False)
                if writer is None:
                    writer = pq.ParquetWriter(path, table.schema)
                writer.write_table(table)
        finally:
            if writer is not None:
                writer.close()
    return path


def rows_of(parts: Iterable[Path]) -> Iterator[Rows]:
    """Rows of the saved parts, one part in memory at a time."""
    for part in parts:
        yield read_rows(part)
