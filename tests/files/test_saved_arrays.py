"""Saved arrays: as they were saved, or not used."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers.changed_arrays import Change, change_arrays
from hypothesis import given
from hypothesis import strategies as st

from sassgis.errors import InputError
from sassgis.files import digests, saved_arrays
from sassgis.files.saved_arrays import read_saved, saved_digest, saved_or_refused, write_saved

ROWS = np.array([(1, 0.5), (2, 1.5)], dtype=[("block", "i4"), ("energy_kj", "f8")])
ARRAYS = {
    "sums": np.arange(12.0).reshape(3, 4), "names": np.array(["a", "bc"]), "rows": ROWS,
    "count": np.array(3), "none": np.empty((0, 2)), "blocks": np.arange(300).reshape(3, 100),
    "below": np.array([-1, 2**40]), "large": np.array([0, 2**63], np.uint64),
}  # fmt: skip


def never(text: str) -> None:
    raise AssertionError(text)


@pytest.mark.parametrize("compressed", [False, True])
def test_what_is_written_is_read_and_no_clock_is_in_it(tmp_path, compressed, monkeypatch):
    """Not even one before the first year that ZIP knows, as of a computer without a battery."""
    file, written = tmp_path / "state.npz", []
    for seconds in (0.0, 1.7e9):
        monkeypatch.setattr(zipfile.time, "time", lambda now=seconds: now)
        digest = write_saved(file, ARRAYS, "own", compressed=compressed)
        written.append(file.read_bytes())
    assert written[0] == written[1]
    found = read_saved(file, "own", never)
    assert saved_digest(file) == digest
    assert found is not None and found.keys() == ARRAYS.keys()
    for name, own in ARRAYS.items():
        assert np.array_equal(found[name], own) and found[name].dtype == own.dtype
    assert [f.name for f in tmp_path.iterdir()] == ["state.npz"]
    assert read_saved(tmp_path / "nothing.npz", "own", never) is None


CHANGES: dict[str, Change] = {
    "one bit": lambda a: a["rows"]["block"].__setitem__(0, 0),
    "shape": lambda a: a.update(sums=a["sums"].reshape(4, 3)),
    "type": lambda a: a.update(sums=a["sums"].view("<i8")),
    "missing": lambda a: a.pop("names"),
    "more": lambda a: a.update(other=np.zeros(2)),
    "names changed round": lambda a: a.update(sums=a["blocks"], blocks=a["sums"]),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_was_changed_is_taken_for_none_and_said(tmp_path: Path, change: str) -> None:
    file = tmp_path / "state.npz"
    write_saved(file, ARRAYS, "own")
    assert read_saved(file, "own", never) is not None
    change_arrays(file, CHANGES[change])
    said: list[str] = []
    assert read_saved(file, "own", said.append) is None
    assert said == [f"Saved state {file} is not used: damaged, or changed since it was saved"]
    with pytest.raises(InputError, match=r"state.npz: .*expected what was there"):
        saved_or_refused(file, "what was there")


def test_of_a_file_with_this_content_some_arrays_are_read(tmp_path: Path) -> None:
    file, said = tmp_path / "state.npz", "what was there"
    content = write_saved(file, ARRAYS, "own", compressed=True)
    whole = saved_or_refused(file, said, content)
    assert whole.keys() == ARRAYS.keys()
    some = saved_or_refused(file, said, content, lambda name: name == "blocks")
    assert some.keys() == {"blocks"} and np.array_equal(some["blocks"], ARRAYS["blocks"])
    write_saved(file, ARRAYS | {"count": np.array(4)}, "own", compressed=True)
    with pytest.raises(InputError, match=r"state.npz: cannot be read, or was changed"):
        saved_or_refused(file, said, content, lambda name: name == "blocks")


def test_another_file_is_not_taken_for_this_one(tmp_path: Path) -> None:
    """Neither one of another name, nor an older one of the same name."""
    file = tmp_path / "rows_1.npz"
    digest = write_saved(file, ARRAYS, "own")
    shutil.copy(file, tmp_path / "rows_2.npz")
    said: list[str] = []
    assert read_saved(tmp_path / "rows_2.npz", "own", said.append) is None
    write_saved(file, {"sums": np.zeros(2)}, "own")
    assert read_saved(file, "own", said.append) is not None
    assert saved_digest(file) not in ("", digest)
    file.unlink()
    assert saved_digest(file) == ""
    assert [line.split()[2] for line in said] == [str(tmp_path / "rows_2.npz")]


def test_other_settings_and_versions_are_said(tmp_path, monkeypatch):
    file = tmp_path / "state.npz"
    write_saved(file, ARRAYS, "own")
    said: list[str] = []
    assert read_saved(file, "another", said.append) is None
    monkeypatch.setattr(saved_arrays, "program_digest", lambda: "of other code")
    assert read_saved(file, "own", said.append) is None
    assert said == [f"Saved state {file} is not used: of other settings, inputs or versions"] * 2


def test_a_library_that_computes_is_part_of_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    before, version = digests.program_digest.__wrapped__(), digests.version
    assert digests.program_digest.__wrapped__() == before
    for library in ("numpy", "numba"):
        monkeypatch.setattr(
            digests, "version", lambda n, own=library: version(n) + "x" * (n == own)
        )
        assert digests.program_digest.__wrapped__() != before


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="allow_pickle"):
        write_saved(tmp_path / "state.npz", {"sums": np.array([{}], dtype=object)}, "own")
    assert list(tmp_path.iterdir()) == []
    np.savez(tmp_path / "state.npz", sums=np.array([{"a": 1}], dtype=object))
    assert read_saved(tmp_path / "state.npz", "own", lambda _text: None) is None


@given(place=st.floats(0.0, 1.0), bit=st.integers(0, 7), cut=st.booleans())
def test_damage_is_noticed(tmp_path_factory, place, bit, cut):
    file = tmp_path_factory.mktemp("damaged") / "state.npz"
    write_saved(file, ARRAYS, "own")
    content = bytearray(file.read_bytes())
    k = min(int(place * len(content)), len(content) - 1)
    content[k] ^= 1 << bit
    file.write_bytes(content[:k] if cut else content)
    assert read_saved(file, "own", lambda _text: None) is None
