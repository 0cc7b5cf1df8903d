"""--overwrite deletes what sassgis wrote, as it wrote it, and no file of the user's."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from helpers.listed_results import list_files

from sassgis.errors import OutputError
from sassgis.files.atomic_output import (
    MARKER_NAME,
    WRITTEN_NAME,
    check_output,
    staged_file,
    staged_output,
)

LINES = {"maps/energy.tif": "map", "tables/zones.csv": "a,b\n", "project.qgz": "project"}


def make(target: Path, overwrite: bool = False, text: str = "") -> None:
    """A result of a few files."""
    with staged_output(target, overwrite) as work:
        for name, own in LINES.items():
            (work / name).parent.mkdir(exist_ok=True)
            (work / name).write_text(own + text)
        list_files(work)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A result, in a folder with nothing else."""
    make(tmp_path / "out")
    return tmp_path / "out"


def everything(folder: Path) -> dict[str, str | bytes]:
    """All that lies in a folder: links by where they point to, files by their content."""
    found: dict[str, str | bytes] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = os.readlink(path) if path.is_symlink() else b""
        if path.is_file():
            found[name] = path.read_bytes()
    return found


def refused(root: Path, target: Path, words: str) -> str:
    """Replacing the target is refused before anything is computed, and all stays as it was."""
    before = everything(root)
    with pytest.raises(OutputError, match=words) as caught, staged_output(target, True):
        raise AssertionError("computed in vain")
    assert everything(root) == before
    with pytest.raises(OutputError) as early:
        check_output(target, True)
    assert str(early.value) == str(caught.value) and "\n" not in str(early.value)
    return str(early.value)


YEARS = hashlib.sha256(b"years").hexdigest()
STRANGE = {
    "that is not there": None,
    "of an extension": '{"manifest_version": 3, "files": ["thesis.txt"]}',
    "that lists digests": json.dumps(
        {"files": [{"path": "thesis.txt", "size": 5, "sha256": YEARS}]}
    ),
    "of a version without a list": '{"format": 0, "sassgis": "0.0.1", "inputs": []}',
    "of another type": "[1, 2]",
    "nested too deeply": "[" * 100_000,
}


@pytest.mark.parametrize("kind", STRANGE)
def test_a_folder_with_any_manifest_is_no_result(tmp_path: Path, kind: str) -> None:
    own, link = tmp_path / "thesis", tmp_path / "link"
    own.mkdir()
    if STRANGE[kind] is not None:
        (own / "manifest.json").write_text(STRANGE[kind])
    (own / "thesis.txt").write_text("years")
    link.symlink_to(own)
    for target in (own, link):
        line = refused(tmp_path, target, "not a result of sassgis that lists its files")
        assert str(target) in line and "by hand" in line


@pytest.mark.parametrize("name", ["next.toml", "terrain/dem.tif", "maps/mine.tif", "a.tif.aux.xml"])
def test_a_result_in_which_the_user_keeps_a_file(tmp_path: Path, out: Path, name: str) -> None:
    (out / name).parent.mkdir(exist_ok=True)
    (out / name).write_text("mine")
    link = tmp_path / "link"
    link.symlink_to(out)
    for target in (out, link):
        line = refused(tmp_path, target, "move it away")
        assert f"{target / name}: is not a file that manifest.json lists" in line
    (out / name).rename(tmp_path / "away")
    make(link, overwrite=True, text="new")
    assert (out / "maps" / "energy.tif").read_text() == "mapnew" and link.is_symlink()


def longer(file: Path) -> None:
    file.write_text(file.read_text() + "and mine")


def as_long(file: Path) -> None:
    """As the user's own program may write it: no other size, no other time, the same inode."""
    state = file.stat()
    file.write_bytes(bytes(reversed(file.read_bytes())))
    os.utime(file, ns=(state.st_atime_ns, state.st_mtime_ns))


@pytest.mark.parametrize("name", ["project.qgz", "tables/zones.csv"])
@pytest.mark.parametrize("change", [longer, as_long])
def test_a_file_that_has_changed(out, name, change):
    check_output(out, True)
    change(out / name)
    assert f"{out / name}: " in refused(out.parent, out, "has changed since sassgis wrote it")


def test_a_manifest_that_has_changed(out: Path) -> None:
    file = out / "manifest.json"
    content = json.loads(file.read_text())
    file.write_text(json.dumps(content))  # Another form of the same.
    check_output(out, True)
    content["notes"] = "what I found out about this run"
    file.write_text(json.dumps(content, indent=2))
    refused(out.parent, out, r"manifest\.json: has changed")


@pytest.mark.parametrize(
    ("name", "points_to"), [("more", "."), ("maps", "."), ("maps/energy.tif", "energy.tif")]
)
def test_links_in_a_result(tmp_path: Path, out: Path, name: str, points_to: str) -> None:
    """A link is not followed: what it points to is neither judged nor deleted."""
    outside = tmp_path / "outside"
    outside.mkdir()
    # The same content as that of the file which the result has, or had.
    (outside / "energy.tif").write_text(LINES["maps/energy.tif"])
    if (out / name).exists():
        (out / name).rename(tmp_path / "moved away")
    (out / name).symlink_to(outside / points_to)
    refused(tmp_path, out, f"{name}: is not a file that")
    (out / name).unlink()
    make(out, overwrite=True)
    assert everything(outside) == {"energy.tif": b"map"}


def test_a_result_that_was_only_looked_at_is_replaced(tmp_path: Path, out: Path) -> None:
    for name in ("maps/energy.tif.aux.xml", ".DS_Store", "maps/Thumbs.db"):
        (out / name).write_text("x")
    (out / "tables" / "zones.csv").unlink()
    make(out, overwrite=True, text="new")
    assert set(everything(tmp_path)) == {
        "out", "out/maps", "out/tables", "out/manifest.json", *(f"out/{n}" for n in LINES)
    }  # fmt: skip


def test_another_result_within_one(out: Path) -> None:
    """Only where a command puts one: any other was put there by the user."""
    make(out / "map")
    refused(out.parent, out, r"out/map/manifest\.json: is not a file that")
    with staged_output(out, True, ("map",)) as work:
        list_files(work)
    assert set(everything(out)) == {"manifest.json"}


def test_a_file_that_comes_at_the_last_moment(tmp_path, out, monkeypatch):
    """After the older result was looked through, while it is moved aside: it is put back."""
    before = everything(out)
    rename = os.rename

    def late(source: Path, destination: Path) -> None:
        rename(source, destination)
        if ".replaced" in Path(destination).name:
            (Path(destination) / "maps" / "energy.tif").write_text("MAP")

    monkeypatch.setattr("sassgis.files.atomic_output.os.rename", late)
    with pytest.raises(OutputError, match=r"out/maps/energy\.tif: has changed"):
        make(out, overwrite=True)
    assert everything(out) == before | {"maps/energy.tif": b"MAP"}
    assert {p.name for p in tmp_path.iterdir()} == {"out", "out.partial"}


def test_a_file_that_comes_while_the_older_result_is_deleted(tmp_path, out, monkeypatch):
    rename = os.rename

    def later(source: Path, destination: Path) -> None:
        rename(source, destination)
        if Path(source).name == "out.partial":
            (aside,) = tmp_path.glob("out.replaced*")
            (aside / "maps" / "mine.tif").write_text("mine")

    monkeypatch.setattr("sassgis.files.atomic_output.os.rename", later)
    make(out, overwrite=True, text="new")
    assert (out / "project.qgz").read_text() == "projectnew"
    (aside,) = tmp_path.glob("out.replaced*")
    assert everything(aside) == {"maps": b"", "maps/mine.tif": b"mine"}


@pytest.mark.parametrize("link", ["out.partial", "out.partial/.sassgis-partial"])
def test_links_in_the_place_of_the_working_folder(tmp_path: Path, link: str) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / MARKER_NAME).write_text("mine.txt\n")
    (own / "mine.txt").write_text("mine")
    (tmp_path / link).parent.mkdir(exist_ok=True)
    (tmp_path / link).symlink_to(own if link == "out.partial" else own / MARKER_NAME)
    refused(tmp_path, tmp_path / "out", r"out\.partial: exists already")


def write(file: Path, text: str, overwrite: bool = False) -> None:
    with staged_file(file, overwrite) as work:
        work.write_text(text)


def test_a_single_file_is_replaced_as_long_as_it_is_as_written(tmp_path: Path) -> None:
    file = tmp_path / "zones.xtf"
    write(file, "one")
    with pytest.raises(OutputError, match="exists already"):
        write(file, "two")
    for text in ("two", "three", "three"):
        write(file, text, overwrite=True)
    assert file.read_text() == "three"
    assert {p.name for p in tmp_path.iterdir()} == {"zones.xtf", WRITTEN_NAME}
    (tmp_path / "link").symlink_to(file)
    write(tmp_path / "link", "four", overwrite=True)
    assert (tmp_path / "link").is_symlink() and file.read_text() == "four"
    (tmp_path / "link").unlink()
    # Under another name it is a copy that somebody keeps.
    file.rename(tmp_path / "kept.xtf")
    with pytest.raises(OutputError, match=r"kept\.xtf: .*is not deleted even with --overwrite"):
        write(tmp_path / "kept.xtf", "five", overwrite=True)
    write(file, "five")
    for change in (longer, as_long):
        change(file)
        before = everything(tmp_path)
        with pytest.raises(OutputError, match=r"zones\.xtf: has changed since sassgis wrote it"):
            write(file, "six", overwrite=True)
        assert everything(tmp_path) == before


def test_a_geopackage_that_is_open_in_another_program(tmp_path: Path, out: Path) -> None:
    """To move away what SQLite keeps beside it would damage it."""
    for target, folder in ((out / "result.gpkg", out), (tmp_path / "cliffs.gpkg", tmp_path)):
        if folder is out:
            sqlite3.connect(target).execute("create table t (a)").connection.close()
            list_files(out)
        else:
            with staged_file(target) as work:
                sqlite3.connect(work).execute("create table t (a)").connection.close()
        with closing(sqlite3.connect(target)) as program:
            program.execute("pragma journal_mode = wal")
            program.execute("insert into t values (1)")
            program.commit()
            words = r"\.gpkg: is open in another program, such as QGIS .*: close it there"
            if folder is out:
                assert "move it away" not in refused(tmp_path, out, words)
            else:
                with pytest.raises(OutputError, match=words):
                    write(target, "new", overwrite=True)
            assert program.execute("select a from t").fetchall() == [(1,)]


@pytest.mark.parametrize("listed", [None, "{", '{"a.txt": 1}', '{"a.txt": ["x"]}'])
def test_a_single_file_of_the_user(tmp_path: Path, listed: str | None) -> None:
    (tmp_path / "a.txt").write_text("mine")
    if listed is not None:
        (tmp_path / WRITTEN_NAME).write_text(listed)
    before = everything(tmp_path)
    with pytest.raises(OutputError, match=r"a\.txt: .*is not of sassgis"):
        write(tmp_path / "a.txt", "new", overwrite=True)
    assert everything(tmp_path) == before


def test_a_single_file_that_changes_while_it_is_made_anew(tmp_path: Path) -> None:
    write(tmp_path / "a.txt", "one")
    with (
        pytest.raises(OutputError, match="has changed"),
        staged_file(tmp_path / "a.txt", overwrite=True) as work,
    ):
        work.write_text("two")
        (tmp_path / "a.txt").write_text("mine")
    assert (tmp_path / "a.txt").read_text() == "mine"


def test_a_command_that_is_killed_before_it_replaces_a_file(tmp_path, monkeypatch):
    file, replace = tmp_path / "a.txt", os.replace
    write(file, "one")

    def killed(source: Path, target: Path) -> None:
        if Path(target) == file:
            raise SystemExit
        replace(source, target)

    with monkeypatch.context() as stopped, pytest.raises(SystemExit):
        stopped.setattr("sassgis.files.atomic_output.os.replace", killed)
        write(file, "two", overwrite=True)
    assert file.read_text() == "one"
    write(file, "four", overwrite=True)
    assert file.read_text() == "four"
