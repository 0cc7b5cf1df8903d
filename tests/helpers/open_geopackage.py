"""A GeoPackage that a GIS has open: an edit is saved, but lies in the -wal file beside it."""

from __future__ import annotations

import sqlite3
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import shapely


@contextmanager
def moved_in_gis(file: Path, shape: shapely.Geometry, srs: int = 2056) -> Iterator[None]:
    """Another shape in place of the first feature of the only layer, within the block in -wal.

    In a process of its own, as locks are.
    """
    blob = b"GP\0\1" + struct.pack("<i", srs) + shapely.to_wkb(shape)
    gis = subprocess.Popen(
        [sys.executable, __file__, str(file), blob.hex()],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    with gis:
        assert gis.stdout is not None
        assert gis.stdout.readline() == b"open\n"
        yield
        gis.communicate()


def _edit(file: str, blob: bytes) -> None:
    with closing(sqlite3.connect(file, isolation_level=None)) as gis:
        gis.execute("pragma journal_mode = wal")
        gis.execute("pragma wal_autocheckpoint = 0")
        # They call functions that plain SQLite does not have.
        triggers = gis.execute("select name from sqlite_master where type = 'trigger'").fetchall()
        for (name,) in triggers:
            gis.execute(f'drop trigger "{name}"')
        table, column = gis.execute(
            "select table_name, column_name from gpkg_geometry_columns"
        ).fetchone()
        # What stands in the file itself is the same before and after the edit.
        gis.execute("pragma wal_checkpoint(truncate)")
        gis.execute(f'update "{table}" set "{column}" = ? where fid = 1', (blob,))
        print("open", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    _edit(sys.argv[1], bytes.fromhex(sys.argv[2]))
