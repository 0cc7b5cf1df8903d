"""Tables of single blocks and passages, written part by part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sassgis.errors import OutputError
from sassgis.files.atomic_output import writing
from sassgis.grid import IntArray
from sassgis.settings.map_run import BlockRows, MapRun
from sassgis.settings.results import ContactKind, ControlLine, Outcome, StopReason, rounded
from sassgis.simulation.path_sample import BlockPath, ProfileResult
from sassgis.terrain.prepare import Plan

#: Where a block passes a station on a followed path; on a fall line there is one place for all.
_PLACE = ("x_m", "y_m")


def require_parquet() -> None:
    """Raise OutputError if Parquet tables are asked for and cannot be written."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise OutputError(
            "Parquet tables need the package pyarrow: pip install 'sassgis[parquet]', "
            'or set the table to "csv"'
        ) from None


def rock_frame(rows: BlockRows, run: MapRun, planned: Plan) -> pd.DataFrame:
    """Return a row per block, units in the names."""
    frame = _columns(rows.rocks, np.array([b.name for b in run.blocks])[rows.rock_scenario])
    frame.insert(0, "area", _areas(rows.rocks["line"], planned))
    return frame.assign(x_m=rows.x, y_m=rows.y, weight=rows.rock_weight)


def passage_frame(rows: BlockRows, run: MapRun, planned: Plan) -> pd.DataFrame:
    """Return a row per block and station or barrier, units in the names."""
    frame = _columns(rows.passages, np.array([b.name for b in run.blocks])[rows.passage_scenario])
    frame = _at_lines(frame, [line for line, _ in run.control_lines])
    frame.insert(0, "area", _areas(rows.passages["line"], planned))
    frame = frame.assign(weight=rows.passage_weight)
    return frame if run.followed else frame.drop(columns=list(_PLACE))


def same(*names: str) -> dict[str, str]:
    """Return columns that are called as the attributes that they hold."""
    return dict(zip(names, names, strict=True))


def table_of(
    rows: Sequence[object], columns: Mapping[str, str], digits: Mapping[str, int]
) -> pd.DataFrame:
    """Return a row for each thing, columns by attribute; those in ``digits`` rounded."""
    values = {name: [attrgetter(own)(row) for row in rows] for name, own in columns.items()}
    values |= {name: [rounded(v, n) for v in values[name]] for name, n in digits.items()}
    return pd.DataFrame(values)


class ProfileTables(NamedTuple):
    """Tables of the blocks along one profile.

    Attributes
    ----------
    blocks : DataFrame
        A row for each block and fragment: size, run-out, why it stopped, largest values.
    passages : DataFrame
        A row for each block at each station or barrier: speed, energy, height, outcome.
    along : DataFrame
        By stretch of the profile (``from_m``, ``to_m``): quantiles of energy, speed and height.
    paths : DataFrame
        Centres of some blocks: ``path``, ``s_m``, ``z_m``.
    contacts : DataFrame
        A row for each contact of these blocks: place, time, velocities, rotation and energy before
        and after, and the share of the energy that an impact takes.
    """

    blocks: pd.DataFrame
    passages: pd.DataFrame
    along: pd.DataFrame
    paths: pd.DataFrame
    contacts: pd.DataFrame


def profile_tables(result: ProfileResult, scenarios: Sequence[str]) -> ProfileTables:
    """Return blocks, passages, quantiles by stretch, and paths of a profile."""
    units = {"energy": "kj", "speed": "mps", "height": "m"}
    along = {"from_m": result.stretches[:-1], "to_m": result.stretches[1:]}
    for quantity, quantiles in result.along.items():
        for p, values in quantiles.items():
            along[f"{quantity}_q{100 * p:.0f}_{units[quantity]}"] = values
    paths = [
        pd.DataFrame({"path": k, "s_m": s, "z_m": z}) for k, (s, z) in enumerate(result.paths, 1)
    ]
    none = pd.DataFrame({"path": [], "s_m": [], "z_m": []})
    ended = np.concatenate([result.rocks, result.pieces])
    names, own = np.array(scenarios), np.concatenate([result.scenario, result.piece_scenario])
    passages = _columns(result.passages, names[result.passage_scenario])
    passages = _at_lines(passages, [line for line, _ in result.profile.control_lines])
    return ProfileTables(
        _columns(ended, names[own]).drop(columns="line"),
        passages.drop(columns=["line", *_PLACE]),
        pd.DataFrame(along),
        pd.concat(paths, ignore_index=True) if paths else none,
        contact_frame(result.contacts, names[result.contact_scenario]),
    )


def contact_frame(rows: NDArray[np.void], scenario: NDArray[np.str_]) -> pd.DataFrame:
    """Return a row per contact (CONTACT_DTYPE), rounded for reading."""
    frame = _columns(rows, scenario)
    before, after = rows["energy_in_kj"], rows["energy_out_kj"]
    lost = np.full(rows.size, np.nan)
    hit = (rows["kind"] == ContactKind.IMPACT) & (before > 0.0)
    np.divide(before - after, before, out=lost, where=hit)
    return frame.assign(energy_lost_share=lost).round(4)


def path_contacts(paths: Sequence[BlockPath]) -> pd.DataFrame:
    """Return a row per contact of the blocks of a path sample, ``path`` as in their layer."""
    sizes = [path.contacts.size for path in paths]
    scenario, area = (
        np.repeat(np.array([getattr(path, name) for path in paths]), sizes)
        for name in ("scenario", "area")
    )
    frame = contact_frame(np.concatenate([path.contacts for path in paths]), scenario)
    frame.insert(0, "path", np.repeat(np.arange(1, len(paths) + 1), sizes))
    frame.insert(1, "area", area)
    x, y = np.concatenate([path.contact_xy for path in paths]).T.round(2)
    return frame.drop(columns="rock").assign(x_m=x, y_m=y)


def _columns(rows: NDArray[np.void], scenario: NDArray[np.str_]) -> pd.DataFrame:
    frame = pd.DataFrame({name: rows[name] for name in rows.dtype.names or ()})
    for column, kind in (("reason", StopReason), ("outcome", Outcome), ("kind", ContactKind)):
        if column in frame:
            frame[column] = [kind(int(own)).name.lower() for own in frame[column]]
    frame.insert(0, "scenario", scenario)
    return frame


def _areas(line: IntArray, planned: Plan) -> NDArray[np.object_]:
    """Return the name of the release area of each line."""
    return np.array(planned.points.area_names, dtype=object)[planned.points.area[line]]


def _at_lines(frame: pd.DataFrame, lines: Sequence[ControlLine]) -> pd.DataFrame:
    """Return passages with the names of the lines; energies into roofs only if there are any."""
    names = np.array([line.name for line in lines], dtype=object)
    frame["control_line"] = names[frame["control_line"]]
    roofs = any(line.kind == "gallery" for line in lines)
    return frame if roofs else frame.drop(columns=["roof_energy_kj", "roof_left_kj"])


#: What a spreadsheet takes for the beginning of a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def without_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with an apostrophe before texts that a spreadsheet would compute."""

    def text(value: object) -> object:
        if not isinstance(value, str):
            return value
        # A carriage return by itself would begin a new row, and is not quoted.
        return ("'" if value.startswith(_FORMULA) else "") + value.replace("\r", " ")

    texts = frame.select_dtypes(include=["object", "string", "category"]).columns
    safe = frame.copy(deep=False)
    for name in texts:
        safe[name] = frame[name].astype(object).map(text)
    return safe.rename(columns=text)


def _not_empty(frames: Iterable[pd.DataFrame]) -> Iterator[pd.DataFrame]:
    """Yield frames with rows, or an empty one: Arrow knows no type of texts without any."""
    empty, some = None, False
    for frame in frames:
        if len(frame):
            some = True
            yield frame
        elif empty is None:
            empty = frame
    if empty is not None and not some:
        yield empty


def write_table(path: Path, frames: Iterable[pd.DataFrame]) -> None:
    """Write frames one under the other, as CSV or Parquet by the suffix of the path."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".csv":
            with path.open("w", encoding="utf-8", newline="") as stream:
                for i, frame in enumerate(frames):
                    safe = without_formulas(frame)
                    safe.to_csv(stream, index=False, header=i == 0, lineterminator="\n")
            return
        require_parquet()
        import pyarrow as pa
        import pyarrow.parquet as pq

        writer = None
        try:
            for frame in _not_empty(frames):
                table = pa.Table.from_pandas(frame, preserve_index=False)
                if writer is None:
                    writer = pq.ParquetWriter(path, table.schema)
                writer.write_table(table)
        finally:
            if writer is not None:
                writer.close()
