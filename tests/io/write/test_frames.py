"""Tables: what a spreadsheet would compute is text."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from sassgis.io.write.frames import without_formulas, write_table


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
    write_table(tmp_path / "table.csv", [frame])
    cells = pd.read_csv(tmp_path / "table.csv")["name"].dropna()
    assert not cells.str.startswith(("=", "+", "-", "@", "\t", "\r")).any()


def test_tables_without_texts_and_categories_stay() -> None:
    numbers = pd.DataFrame({"a": [1, 2], "b": [-1.0, 2.0]})
    assert without_formulas(numbers).equals(numbers)
    kinds = pd.DataFrame({"kind": pd.Categorical(["=x", "rock", "=x"])})
    assert without_formulas(kinds)["kind"].tolist() == ["'=x", "rock", "'=x"]
