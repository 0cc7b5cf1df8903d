"""Tables: what a spreadsheet would compute is text."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from sassgis.outputs.frames import passage_frame, rock_frame, without_formulas, write_table
from sassgis.settings.map_run import BlockRows
from sassgis.settings.results import PASSAGE_DTYPE, ROCK_DTYPE
from sassgis.simulation.accumulators import joined_rows

RUN = SimpleNamespace(
    blocks=[SimpleNamespace(name="small")], followed=True,
    control_lines=[(SimpleNamespace(name="road", kind="station"), None)],
)  # fmt: skip
PLANNED = SimpleNamespace(points=SimpleNamespace(area_names=["north"], area=np.zeros(1, int)))


@pytest.mark.parametrize("text", ["=1+1", "+SUM(A1)", "-2", "@cmd", "\t=1", "\r=1"])
def test_no_text_is_a_formula(text: str, tmp_path: Path) -> None:
    frame = pd.DataFrame({"name": ["Nord", text, None], "value": [-1.5, 2.0, 3.0]})
    safe = without_formulas(frame)
    assert (
        safe["name"].tolist()[:2] == ["Nord", "'" + text.replace("\r", " ")]
        and safe["name"].isna()[2]
    )
    named = without_formulas(frame.rename(columns={"value": text}))
    assert named.columns.tolist() == ["name", "'" + text.replace("\r", " ")]
    assert safe["value"].tolist() == [-1.5, 2.0, 3.0]
    kinds = without_formulas(pd.DataFrame({"kind": pd.Categorical([text, "rock"])}))
    assert kinds["kind"].tolist() == ["'" + text.replace("\r", " "), "rock"]
    write_table(tmp_path / "table.csv", [frame])
    cells = pd.read_csv(tmp_path / "table.csv")["name"].dropna()
    assert not cells.str.startswith(("=", "+", "-", "@", "\t", "\r")).any()


def test_rows_say_for_how_many_blocks_they_count() -> None:
    rocks, passages, place = np.zeros(2, ROCK_DTYPE), np.zeros(3, PASSAGE_DTYPE), np.zeros(2)
    parts = [BlockRows.of_chunk(rocks, place, place, passages, 0, weight) for weight in (1, 8)]
    rows = joined_rows(parts)
    assert rock_frame(rows, RUN, PLANNED)["weight"].tolist() == [1, 1, 8, 8]
    assert passage_frame(rows, RUN, PLANNED)["weight"].tolist() == [1, 1, 1, 8, 8, 8]


def test_parts_without_passages_stand_beside_others_in_parquet(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    passages, none = np.zeros(2, PASSAGE_DTYPE), np.zeros(0)
    some, empty = (
        passage_frame(BlockRows.of_chunk(none, none, none, rows, 0, 1), RUN, PLANNED)
        for rows in (passages, passages[:0])
    )
    for name, frames, expected in (
        ("first", [empty, some], [some]),
        ("between", [some, empty, some], [some, some]),
        ("all", [empty, empty], [empty]),
    ):
        write_table(tmp_path / f"{name}.parquet", frames)
        found = pd.read_parquet(tmp_path / f"{name}.parquet")
        assert found.columns.tolist() == some.columns.tolist(), name
        assert found.values.tolist() == pd.concat(expected).values.tolist(), name
