"""Results appear whole or not at all."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from helpers.listed_results import list_files

from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import MARKER_NAME, partial_folder, staged_output, writing


def make_result(target: Path, text: str, overwrite: bool = False) -> None:
    with staged_output(target, overwrite) as work:
        (work / "maps").mkdir()
        (work / "maps" / "a.txt").write_text(text)
        list_files(work)


def names(folder: Path) -> set[str]:
    return {str(entry.relative_to(folder)) for entry in folder.rglob("*")}


@pytest.mark.parametrize("empty", [False, True])
def test_the_target_appears_only_at_the_end(tmp_path: Path, empty: bool) -> None:
    target = tmp_path / "deep" / "out"
    if empty:
        target.mkdir(parents=True)
    with staged_output(target, overwrite=False) as work:
        (work / "manifest.json").write_text("{}")
        assert target.exists() == empty and names(target) == set()
        assert work == tmp_path / "deep" / "out.partial"
    assert names(tmp_path) == {"deep", "deep/out", "deep/out/manifest.json"}


def test_a_file_in_the_place_of_the_target(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    with pytest.raises(OutputError, match="is a file"):
        make_result(tmp_path / "out", "new", overwrite=True)
    with pytest.raises(OutputError, match="a file, not a folder"):
        make_result(tmp_path / "out" / "deeper", "new")


def test_a_working_folder_not_made_by_sassgis_is_left_alone(tmp_path: Path) -> None:
    foreign = tmp_path / "out.partial"
    foreign.mkdir()
    (foreign / "mine.txt").write_text("x")
    with pytest.raises(OutputError, match="exists already"):
        make_result(tmp_path / "out", "new")
    assert (foreign / "mine.txt").read_text() == "x"


@pytest.mark.parametrize("stop", [RuntimeError, KeyboardInterrupt, InputError])
def test_a_failure_leaves_the_old_result_and_the_checkpoint(tmp_path, stop):
    target = tmp_path / "out"
    make_result(target, "old")
    with pytest.raises(stop), staged_output(target, overwrite=True) as work:
        (work / "half.tif").write_bytes(b"x")
        (work / "checkpoint").mkdir()
        (work / "checkpoint" / "rocks.npy").write_bytes(b"computed")
        raise stop("no")
    assert (target / "maps" / "a.txt").read_text() == "old"
    assert names(partial_folder(target)) == {MARKER_NAME, "checkpoint", "checkpoint/rocks.npy"}

    with staged_output(target, overwrite=True) as work:
        assert (work / "checkpoint" / "rocks.npy").read_bytes() == b"computed"
        list_files(work)
    # Once the result is there the checkpoint has done its service.
    assert names(tmp_path) == {"out", "out/manifest.json"}


def test_a_failure_without_checkpoint_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), staged_output(tmp_path / "out", False) as work:
        (work / "half.tif").write_bytes(b"x")
        1 / 0  # noqa: B018
    assert list(tmp_path.iterdir()) == []


def test_half_written_files_of_a_killed_run_are_cleared(tmp_path: Path) -> None:
    work = tmp_path / "out.partial"
    (work / "maps").mkdir(parents=True)
    (work / MARKER_NAME).touch()
    for name in ("maps/half.tif", "zones.gpkg"):
        (work / name).write_bytes(b"x")
    for beside in ("maps/half.tif.ovr.tmp", "zones.gpkg-journal"):
        (work / beside).write_bytes(b"x")
    (work / "checkpoint.npz").write_bytes(b"computed")
    with staged_output(tmp_path / "out", False) as folder:
        assert names(folder) == {MARKER_NAME, "checkpoint.npz"}


def test_two_runs_into_one_target(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    with staged_output(tmp_path / "out", False) as work:
        (work / "manifest.json").write_text("first")
        with (
            pytest.raises(OutputError, match="another run"),
            staged_output(tmp_path / "out", False),
        ):
            raise AssertionError("two runs share a working folder")
        assert (work / "manifest.json").read_text() == "first"
    assert (tmp_path / "out" / "manifest.json").read_text() == "first"


def test_a_target_that_appears_during_the_run_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "out"
    kept = r"not empty; the finished result is in .*out\.partial"
    with pytest.raises(OutputError, match=kept), staged_output(target, False) as work:
        (work / "manifest.json").write_text("new")
        target.mkdir()
        (target / "other.txt").write_text("x")
    assert (target / "other.txt").read_text() == "x"
    assert (partial_folder(target) / "manifest.json").read_text() == "new"


def test_the_old_result_comes_back_if_the_swap_fails(tmp_path, monkeypatch):
    target = tmp_path / "out"
    make_result(target, "old")
    rename = os.rename

    def failing(source: Path, destination: Path) -> None:
        if Path(source).name == "out.partial":
            raise OSError(errno.EBUSY, "busy")
        rename(source, destination)

    monkeypatch.setattr("sassgis.files.atomic_output.os.rename", failing)
    with pytest.raises(OutputError, match=r"out: .*busy; the finished result is in"):
        make_result(target, "new", overwrite=True)
    assert {entry.name for entry in tmp_path.iterdir()} == {"out", "out.partial"}
    assert (target / "maps" / "a.txt").read_text() == "old"
    assert (tmp_path / "out.partial" / "maps" / "a.txt").read_text() == "new"


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "disk is full"), (errno.EROFS, "read-only"), (errno.EDQUOT, "quota")],
)
def test_an_error_of_the_disk_is_one_line(tmp_path: Path, number: int, words: str) -> None:
    target = tmp_path / "out"
    with pytest.raises(OutputError, match=words) as caught, staged_output(target, False):
        raise OSError(number, os.strerror(number))
    assert str(tmp_path / "out") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bugs_and_errors_of_inputs_are_not_put_down_to_the_output(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), staged_output(tmp_path / "out", False):
        (tmp_path / "no such input").read_bytes()
    with pytest.raises(KeyError), writing(tmp_path / "a"):
        raise KeyError("a bug")


def test_no_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    before = os.geteuid()
    if before == 0:  # Root may write everywhere; take off the hat for a moment.
        os.seteuid(65534)
    try:
        with pytest.raises(OutputError, match=r"out.*: permission denied") as caught:
            make_result(tmp_path / "out", "new")
    finally:
        if before == 0:
            os.seteuid(0)
        tmp_path.chmod(0o700)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


WRITE = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    import geopandas as gpd, numpy as np, shapely
    from sassgis.errors import OutputError
    from sassgis.files.atomic_output import staged_output
    from sassgis.files.vector_layer import VectorLayer
    from sassgis.grid import Grid
    from sassgis.outputs.geopackage import write_geopackage
    from sassgis.outputs.raster import write_raster
    from sassgis.settings.results import Band, RasterLayer
    from sassgis.settings.styles import RELEASE_POINT_STYLE

    values = np.random.default_rng(1).random((400, 400))
    band = Band("a", "a", "kJ", values.astype(np.float32))
    points = shapely.points(values[:100].reshape(-1, 2))
    frame = gpd.GeoDataFrame({"n": np.arange(20000)}, geometry=points)
    try:
        with staged_output(Path(sys.argv[1]), False) as work:
            (work / "checkpoint").write_text("computed")
            if sys.argv[2] == "raster":
                layer = RasterLayer("noise", "Noise", "", (band,), (), "viridis")
                write_raster(layer, Grid(values, 0.0, 800.0, 2.0), work / "maps")
            else:
                layer = VectorLayer("p", "P", "", frame, style=RELEASE_POINT_STYLE)
                write_geopackage(work / "result.gpkg", [layer])
    except OutputError as error:
        print(error)
        sys.exit(3)
    """
)


@pytest.mark.parametrize("what", ["raster", "geopackage"])
def test_a_file_that_may_not_grow(tmp_path: Path, what: str) -> None:
    target = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-B", "-c", WRITE, str(target), what], capture_output=True, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000)),
        timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 3, done.stdout + done.stderr
    (line,) = done.stdout.strip().splitlines()
    assert str(target) in line and "cannot be written: " in line
    assert "Traceback" not in done.stderr and "Warning" not in done.stderr
    assert not target.exists()
    assert names(partial_folder(target)) == {MARKER_NAME, "checkpoint"}
    assert (partial_folder(target) / "checkpoint").read_text() == "computed"


def test_a_folder_that_cannot_be_made_is_named_as_given(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    target = tmp_path / "file" / "out"
    with pytest.raises(OutputError) as refused, staged_output(target, overwrite=False):
        pass
    assert str(refused.value).startswith(f"{target}: cannot be written: ")
