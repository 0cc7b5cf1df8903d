"""Saved arrays: whole, or taken for none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sassgis.io.saved_arrays import FINGERPRINT, read_saved, write_saved

ARRAYS = {FINGERPRINT: "own", "sums": np.arange(12.0).reshape(3, 4), "names": np.array(["a", "bc"])}


@pytest.mark.parametrize("compressed", [False, True])
def test_what_is_written_is_read(tmp_path: Path, compressed: bool) -> None:
    file = tmp_path / "state.npz"
    write_saved(file, ARRAYS, compressed=compressed)
    found = read_saved(file, "own")
    assert found is not None and found.keys() == ARRAYS.keys()
    assert np.array_equal(found["sums"], ARRAYS["sums"]) and found["names"].tolist() == ["a", "bc"]
    assert [f.name for f in tmp_path.iterdir()] == ["state.npz"]
    assert read_saved(file, "another") is None
    assert read_saved(tmp_path / "nothing.npz") is None


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "state.npz", sums=np.array([{"a": 1}], dtype=object))
    assert read_saved(tmp_path / "state.npz") is None


@given(place=st.floats(0.0, 1.0), bit=st.integers(0, 7), cut=st.booleans())
def test_damage_is_noticed(
    tmp_path_factory: pytest.TempPathFactory, place: float, bit: int, cut: bool
) -> None:
    file = tmp_path_factory.mktemp("damaged") / "state.npz"
    write_saved(file, ARRAYS)
    content = bytearray(file.read_bytes())
    k = min(int(place * len(content)), len(content) - 1)
    content[k] ^= 1 << bit
    file.write_bytes(content[:k] if cut else content)
    found = read_saved(file, "own")
    if found is not None:
        # Some bits of the archive's own tables mean nothing.
        assert found.keys() == ARRAYS.keys()
        assert all(np.array_equal(found[name], value) for name, value in ARRAYS.items())
