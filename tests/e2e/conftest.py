"""The README's commands, and the package as a user installs it, from a wheel."""

from __future__ import annotations

import re
import site
import sys
import sysconfig
from pathlib import Path

import pytest
from helpers.installed import Installed, command_of, done_in


@pytest.fixture(scope="session")
def readme(repository: Path) -> str:
    return (repository / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    done_in(
        repository, sys.executable, "-m", "pip", "wheel", ".", "--quiet", "--no-deps",
        "--no-build-isolation", "--wheel-dir", folder,
    )  # fmt: skip
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """A fresh environment with the wheel; the packages it needs are those of the tests."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    done_in(folder.parent, sys.executable, "-m", "venv", "--without-pip", folder)
    made = Installed(folder)
    done_in(
        folder, sys.executable, "-m", "pip", "--quiet", "--python", made.python, "install",
        "--no-deps", "--no-index", wheel,
    )  # fmt: skip
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (packages / "needed.pth").write_text("\n".join([*site.getsitepackages(), ""]))
    return made


@pytest.fixture(scope="session")
def demo(installed: Installed, readme: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the README's `sassgis demo` writes, run from the wheel outside the checkout."""
    outside = tmp_path_factory.mktemp("outside")
    call = re.search(r"\bsassgis (demo (?:-o|--output) (\S+))", command_of(readme, "main"))
    assert call is not None
    done_in(outside, installed.sassgis, *call[1].split())
    return outside / call[2]
