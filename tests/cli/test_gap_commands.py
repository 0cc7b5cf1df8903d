"""Observations through the command line."""

from __future__ import annotations

from pathlib import Path


def test_what_a_filled_template_identifies_is_printed(tmp_path: Path, call) -> None:
    folder = tmp_path / "observed"
    assert call("gap", "template", folder)[0] == 0
    deposits = folder / "deposits.csv"
    columns = deposits.read_text().splitlines()[0].split(",")
    rows = [
        ",".join(
            {"rock_id": f"R{i}", "x": str(10 + i), "y": "5", "z": "1"}.get(c, "") for c in columns
        )
        for i in range(3)
    ]
    deposits.write_text("\n".join([",".join(columns), *rows]) + "\n")
    code, out, _ = call("gap", "validate", folder)
    assert code == 0 and "not identifiable" in out and "deposits" in out


def test_an_empty_template_is_one_clear_line(tmp_path: Path, call) -> None:
    folder = tmp_path / "observed"
    call("gap", "template", folder)
    code, _, err = call("gap", "validate", folder)
    assert code == 2 and err.count("\n") == 1 and "holds no observed rock" in err
