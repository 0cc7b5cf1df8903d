"""What several test folders share."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import pytest
from helpers.command_line import exit_code
from helpers.samples import copy_sample

if TYPE_CHECKING:
    from helpers.small_slope import Slope

ROOT = Path(__file__).resolve().parents[1]
SYSTEM_PYTHON = Path("/usr/bin/python3")

# What a test writes need not outlive a power cut; waiting for the disk is half of some tests' time.
os.environ.setdefault("OGR_SQLITE_SYNCHRONOUS", "OFF")
os.fsync = lambda _descriptor: None

# How long a case takes says how busy the machine is, and nothing of the case.
hypothesis.settings.register_profile("unhurried", deadline=None)
hypothesis.settings.load_profile("unhurried")

#: A file runs on one worker, so that its fixtures are made once. The long ones come first: no
#: worker is left alone with one of them at the end.
LONG_FILES = (
    "test_diagnose.py", "test_worlds.py", "test_blind_check.py", "test_outputs.py",
    "test_where.py", "test_project.py", "test_products.py", "test_batch.py",
    "test_federal_export.py", "test_any_world.py", "test_convergence.py", "test_pipelines.py",
    "test_command_line.py", "test_atomic_output.py", "test_docs.py", "test_layout.py",
    "test_paths.py", "test_zones.py", "test_contact.py", "test_plugin.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    place = {name: i for i, name in enumerate(LONG_FILES)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))
    for item in items:
        if item.get_closest_marker("battery"):
            item.add_marker(pytest.mark.timeout(0))


@pytest.fixture(scope="session")
def repository() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the field data folder ../shared/data is not beside the repository")
    return folder


@pytest.fixture(scope="session")
def official_models(shared_data: Path) -> Path:
    """Folder with the text of the federal model 166.1 V1.3, for the validator."""
    folder = shared_data / "interlis_166_1"
    if not folder.is_dir():
        pytest.skip("the official text of model 166.1 is not in ../shared/data/interlis_166_1")
    pytest.importorskip("ilivalidator", reason="there is no ilivalidator for this machine")
    return folder


def with_settings(config: Path, **values: object) -> Path:
    """Set keys that a configuration has already, each of which it has once."""
    text = config.read_text()
    for key, value in values.items():
        text, found = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        assert found == 1, key
    config.write_text(text)
    return config


@pytest.fixture(scope="session")
def make_valley(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Copy the sample valley, with few release points and rocks; returns the configuration."""

    def make(**values: object) -> Path:
        config = copy_sample("valley", tmp_path_factory.mktemp("valley"))
        return with_settings(config, **{"spacing_m": 12.0, "rocks_per_point": 6, **values})

    return make


@pytest.fixture
def slope(tmp_path: Path) -> Slope:
    """A small configuration with everything that a run needs."""
    from helpers.small_slope import Slope

    return Slope.made(tmp_path)


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Call the command line; gives exit code, stdout and stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = exit_code(*arguments)
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def printed(call: Callable[..., tuple[int, str, str]]) -> Callable[..., str]:
    """Call the command line, which succeeds; gives stdout."""

    def run(*arguments: object) -> str:
        code, out, err = call(*arguments)
        assert code == 0, err
        return out

    return run


@pytest.fixture
def refusal(call: Callable[..., tuple[int, str, str]]) -> Callable[..., str]:
    """Call the command line, which refuses; gives the one line that says why."""

    def run(*arguments: object, code: int = 2) -> str:
        found, out, err = call(*arguments)
        lines = [line for line in err.splitlines() if not line.endswith("...")]
        assert (found, len(lines)) == (code, 1) and lines[0].startswith("Error: "), err
        # Fetching and checking a DEM say what they have done so far.
        assert not out or arguments[0] == "dem", out
        return lines[0]

    return run


@pytest.fixture(scope="session")
def qgis() -> None:
    if SYSTEM_PYTHON.is_file():
        done = subprocess.run(
            [SYSTEM_PYTHON, "-c", "import qgis.core"], capture_output=True, check=False
        )
        if done.returncode == 0:
            return
    pytest.skip("QGIS for the system's Python is not installed (Debian: python3-qgis)")
