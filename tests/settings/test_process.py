"""How much memory a process may still take."""

from __future__ import annotations

from pathlib import Path

import pytest

from sassgis.errors import InputError
from sassgis.settings import process
from sassgis.settings.process import memory_bytes, require_memory

#: 8 GB available, of which the process has 100 MB already (kB).
MACHINE = {
    "proc/meminfo": "MemTotal: 16000000 kB\nMemFree: 9 kB\nMemAvailable: 8000000 kB\n",
    "proc/self/status": "Name: sassgis\nVmPeak: 900000 kB\nVmRSS: 100000 kB\n",
}
V2 = {
    "proc/self/cgroup": "0::/slurm/job\n",
    "sys/fs/cgroup/slurm/job/memory.max": "max\n",
    "sys/fs/cgroup/slurm/job/memory.current": "1000000\n",
    "sys/fs/cgroup/slurm/memory.max": "2000000000\n",
    "sys/fs/cgroup/slurm/memory.current": "600000000\n",
    "sys/fs/cgroup/slurm/memory.stat": "anon 1\ninactive_file 100000000\n",
}
V1 = {
    "proc/self/cgroup": "5:devices:/\n4:memory:/docker/a\n0::/\n",
    "sys/fs/cgroup/memory/docker/a/memory.limit_in_bytes": "3000000000\n",
    "sys/fs/cgroup/memory/docker/a/memory.usage_in_bytes": "1000000000\n",
    "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712\n",
    "sys/fs/cgroup/memory/memory.usage_in_bytes": "1000000000\n",
}


@pytest.mark.parametrize(
    ("files", "free"),
    [
        (MACHINE, 8_000_000 * 1024 + 100_000 * 1024),
        (MACHINE | V2, 1_500_000_000 + 100_000 * 1024),
        (MACHINE | V1, 2_000_000_000 + 100_000 * 1024),
    ],
)
def test_the_tightest_limit_counts(tmp_path: Path, files: dict[str, str], free: int) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert memory_bytes(tmp_path) == free


def test_the_line_names_what_most_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "memory_bytes", lambda: 5_000_000_000)
    need = {"terrain.dem": 100, "release.spacing_m": 2_000_000_000}
    require_memory(need)
    with pytest.raises(InputError) as refused:
        require_memory(need | {"release.rocks_per_point": 4_000_000_000}, Path("a.toml"))
    assert str(refused.value) == (
        "a.toml: release.rocks_per_point, release.spacing_m: needs more memory than there is "
        "(found about 6 GB; expected at most 5 GB, which are free here)"
    )
    with pytest.raises(InputError, match="2 GB; expected at most 1 GB, which --memory"):
        require_memory(need, most=1_000_000_000)
    with pytest.raises(InputError, match="5 GB, which are free here"):
        require_memory(need | {"terrain.dem": 5_000_000_000}, most=6_000_000_000)
    monkeypatch.setattr(process, "memory_bytes", lambda: None)
    with pytest.raises(InputError, match="--memory allows"):
        require_memory(need, most=1_000_000_000)
    require_memory({"terrain.dem": 10**30})
