"""Compiling leaves the host process as it was."""

from __future__ import annotations

import os
import subprocess
import sys


def in_a_process(code: str, **environment: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    ).stdout


def test_importing_changes_no_environment_variable():
    code = (
        "import os; before = dict(os.environ); import sassgis, sassgis.engine.simulate; "
        "print(before == dict(os.environ))"
    )
    assert in_a_process(code).strip() == "True"


def test_machine_code_is_kept_in_the_folder_asked_for_and_only_ours(tmp_path):
    code = (
        "import numba; from sassgis.model import rng; rng.uniform(rng.mix(1), 0, 0); "
        "print(numba.config.CACHE_DIR == '')"
    )
    environment = {"SASSGIS_CACHE_DIR": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    assert in_a_process(code, **environment).strip() == "True"
    assert list(tmp_path.rglob("*.nbi"))
