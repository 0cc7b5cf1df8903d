"""Observations through the command line."""

from __future__ import annotations

from pathlib import Path


def test_what_a_filled_template_identifies_is_printed(tmp_path: Path, printed) -> None:
    folder = tmp_path / "observed"
    printed("gap", "template", folder)
    deposits = folder / "deposits.csv"
    columns = deposits.read_text().splitlines()[0].split(",")
    rows = [
        ",".join(
            {"rock_id": f"R{i}", "x": str(10 + i), "y": "5", "z": "1"}.get(c, "") for c in columns
        )
        for i in range(3)
    ]
    deposits.write_text("\n".join([",".join(columns), *rows]) + "\n")
    out = printed("gap", "validate", folder)
    assert "not identifiable" in out and "deposits" in out


def test_an_empty_template_is_one_clear_line(tmp_path: Path, printed, refusal) -> None:
    folder = tmp_path / "observed"
    printed("gap", "template", folder)
    assert "holds no observed rock" in refusal("gap", "validate", folder)
