"""The program as a process of its own: quick to answer, and a good guest."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.e2e

PROGRAM = [sys.executable, "-m", "sassgis"]


def cpu_s(command: list[str]) -> float:
    """Processor time of a command, which does not grow on a busy machine as clock time does."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_help_takes_less_than_a_second() -> None:
    assert min(cpu_s([*PROGRAM, "--help"]) for _ in range(3)) < 1.0


def test_the_environment_of_the_host_process_is_left_alone(tmp_path: Path) -> None:
    """Also where kernels are compiled, and whether or not the user names a cache folder."""
    code = (
        # Its libraries name the certificates that they bring.
        "import os, pyogrio, rasterio\n"
        "before = dict(os.environ)\n"
        "import sassgis\n"
        "for name in sassgis.__all__:\n    getattr(sassgis, name)\n"
        "import sassgis.engine.simulate, sassgis.terrain, sassgis.hazard\n"
        "from sassgis.compiled.jit import kernel\n"
        "@kernel\n"
        "def double(x):\n    return 2 * x\n"
        "assert double(2) == 4\n"
        "changed = {k for k in {*before, *os.environ} if before.get(k) != os.environ.get(k)}\n"
        "print(sorted(changed))\n"
    )
    script = tmp_path / "host.py"
    script.write_text(code)
    plain = {
        k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "SASSGIS_", "KMP_"))
    }
    plain["XDG_CACHE_HOME"] = str(tmp_path)
    for own in ({}, {"SASSGIS_CACHE_DIR": str(tmp_path / "cache")}):
        done = subprocess.run(
            [sys.executable, script], env=plain | own, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr
