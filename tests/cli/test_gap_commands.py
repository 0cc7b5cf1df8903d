"""Observations through the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from sassgis.cli import main


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    return int(stopped.value.code or 0)


def test_a_filled_template_is_read_and_told_of(tmp_path: Path, capsys) -> None:
    folder = tmp_path / "observed"
    assert run("gap", "template", folder) == 0
    deposits = folder / "deposits.csv"
    columns = deposits.read_text().splitlines()[0].split(",")
    rows = [
        ",".join(
            {"rock_id": f"R{i}", "x": str(10 + i), "y": "5", "z": "1"}.get(c, "") for c in columns
        )
        for i in range(3)
    ]
    deposits.write_text("\n".join([",".join(columns), *rows]) + "\n")
    capsys.readouterr()
    assert run("gap", "validate", folder) == 0
    said = capsys.readouterr().out
    assert "cannot tell" in said and "deposits" in said


def test_an_empty_template_is_one_clear_line(tmp_path: Path, capsys) -> None:
    folder = tmp_path / "observed"
    run("gap", "template", folder)
    capsys.readouterr()
    assert run("gap", "validate", folder) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "holds no observed rock" in said
