"""Compiling leaves the host process as it was, and runs no code that others have put there."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


def in_a_process(code: str, **environment: str) -> str:
    """Runs from the root folder: nothing but the installed package is imported."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True, text=True, check=True, cwd="/", env={**os.environ, **environment},
    ).stdout  # fmt: skip


def test_machine_code_is_kept_in_the_folder_asked_for_and_only_ours(tmp_path):
    code = (
        "import numba; from sassgis.compiled import rng; rng.uniform(rng.mix(1), 0, 0); "
        "print(numba.config.CACHE_DIR == '')"
    )
    environment = {"SASSGIS_CACHE_DIR": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    assert in_a_process(code, **environment).strip() == "True"
    assert list(tmp_path.rglob("*.nbi"))


def test_machine_code_is_made_only_of_what_python_calls(tmp_path):
    code = "import numpy as np; from sassgis.compiled import rng; rng.normal(np.uint64(1), 0, 0)"
    in_a_process(code, SASSGIS_CACHE_DIR=str(tmp_path))
    # It calls two others, which are part of it.
    assert [index.name.split("-")[0] for index in tmp_path.rglob("*.nbi")] == ["rng.normal"]


#: Compiles one short function, or runs what is kept of it.
CALL = "from sassgis.compiled import rng; rng.uniform(rng.mix(1), 0, 0)"


class Payload:
    """What a stranger would have run: it leaves a file."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self):
        return Path.touch, (self.file,)


@pytest.fixture(scope="module")
def indexed(tmp_path_factory) -> Path:
    """A cache as the program makes it; its one folder is named after the sources."""
    made = tmp_path_factory.mktemp("cache")
    in_a_process(CALL, SASSGIS_CACHE_DIR=str(made))
    (folder,) = made.iterdir()
    return folder


@pytest.fixture
def plant(indexed, tmp_path):
    """Put a cache whose index files are payloads somewhere; says whether one was run."""
    proof = tmp_path / "was run"

    def plant_at(place: Path) -> None:
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(indexed, place)
        for index in place.rglob("*.nbi"):
            index.write_bytes(pickle.dumps(Payload(proof)))

    plant_at.was_run = proof.exists
    return plant_at


def call(folder: Path, **environment: str) -> str:
    """What the call says on stderr, from a folder."""
    done = subprocess.run(
        [sys.executable, "-c", CALL],
        capture_output=True, text=True, check=True, cwd=folder, env={**os.environ, **environment},
    )  # fmt: skip
    return done.stderr


def test_the_payload_is_one(plant, tmp_path, indexed):
    plant(tmp_path / "own" / indexed.name)
    call(tmp_path, SASSGIS_CACHE_DIR=str(tmp_path / "own"))
    assert plant.was_run()


@pytest.mark.parametrize(
    "settings", ["cache_dir: {}", "cache_dir: {}\ncache_locator_classes: InTreeCacheLocator", "]["]
)
def test_settings_of_numba_in_the_current_folder_are_not_read(plant, tmp_path, settings):
    plant(tmp_path / "planted")
    (tmp_path / ".numba_config.yaml").write_text(settings.format(tmp_path / "planted"))
    assert call(tmp_path, SASSGIS_CACHE_DIR=str(tmp_path / "cache")) == ""
    assert not plant.was_run()
    assert list((tmp_path / "cache").rglob("*.nbi"))


def test_a_full_disk_of_the_cache_ends_no_call(tmp_path):
    """One line, and nothing that speaks of the result."""
    code = (
        "import errno; from numba.core.caching import IndexDataCacheFile as F\n"
        "def full(*_): raise OSError(errno.ENOSPC, 'No space left on device')\n"
        "F.save = full\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", f"{code}{CALL}\n{CALL}"], capture_output=True, text=True,
        check=True, cwd=tmp_path, env={**os.environ, "SASSGIS_CACHE_DIR": str(tmp_path / "cache")},
    )  # fmt: skip
    assert done.stderr.count("\n") == 1 and "is not kept" in done.stderr, done.stderr
    assert "No space left on device" in done.stderr


def test_a_folder_that_all_share_is_no_way_out(plant, tmp_path, indexed):
    shared = tmp_path / "tmp"
    plant(shared / "sassgis" / indexed.name)
    (tmp_path / "file").touch()
    folder = str(tmp_path / "file" / "cache")
    said = call(tmp_path, SASSGIS_CACHE_DIR=folder, TMPDIR=str(shared))
    assert said.count("\n") == 1 and "is not kept" in said
    assert not plant.was_run()


@pytest.mark.parametrize("which", ["folder", "above"])
@pytest.mark.parametrize("how", ["others", "owner"])
@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
def test_a_folder_that_others_can_change_is_not_used(plant, tmp_path, indexed, which, how):
    base = tmp_path / "cache"
    plant(base / indexed.name)
    place = base / indexed.name if which == "folder" else base
    if how == "others":
        place.chmod(0o777)
    elif os.geteuid() != 0:
        pytest.skip("only root can give a folder to another user")
    else:
        os.chown(place, 65534, 65534)
    said = call(tmp_path, SASSGIS_CACHE_DIR=str(base))
    assert said.count("\n") == 1 and str(place) in said
    assert not plant.was_run()


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
def test_in_a_folder_such_as_tmp_an_own_folder_is_used(tmp_path):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o1777)
    cache = tmp_path / "shared" / "mine"
    assert call(tmp_path, SASSGIS_CACHE_DIR=str(cache)) == ""
    assert list(cache.rglob("*.nbi"))
    assert {p.stat().st_mode & 0o777 for p in (cache, *cache.iterdir())} == {0o700}


@pytest.mark.parametrize("name", ["SASSGIS_CACHE_DIR", "XDG_CACHE_HOME"])
def test_a_relative_folder_would_lie_in_the_project(plant, tmp_path, indexed, name):
    plant(tmp_path / "near" / indexed.name)
    plant(tmp_path / "near" / "sassgis" / indexed.name)
    home = tmp_path / "home"
    home.mkdir()
    call(tmp_path, **{"SASSGIS_CACHE_DIR": "", "HOME": str(home), name: "near"})
    assert not plant.was_run()


def test_modules_in_the_current_folder_are_not_imported(tmp_path):
    for name in ("click", "numpy", "logging"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('run')")
    done = subprocess.run(
        [sys.executable, "-m", "sassgis", "--version"],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


def test_with_another_numba_functions_are_compiled_and_kept_as_it_does_by_itself(tmp_path):
    code = (
        "import sys, numba; numba.__version__ = sys.argv[1]; from sassgis.compiled import rng\n"
        "own = 'sassgis.compiled.machine_code' in sys.modules\n"
        "print(float(rng.normal(rng.mix(1), 0, 0)), own)"
    )
    said = {}
    for version in ("0.68.9", "0.69.0rc1", "1.0.0"):
        done = subprocess.run(
            [sys.executable, "-c", code, version], capture_output=True, text=True, check=True,
            cwd="/", env={**os.environ, "SASSGIS_CACHE_DIR": str(tmp_path / version)},
        )  # fmt: skip
        said[version] = done.stdout.split()
        assert list((tmp_path / version).rglob("*.nbi")) and done.stderr == ""
    assert [own for _, own in said.values()] == ["True", "False", "False"]
    assert len({number for number, _ in said.values()}) == 1
