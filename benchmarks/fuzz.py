"""Damaged input files: every one is read or refused in one line.

    python benchmarks/fuzz.py [--inputs 20000] [--only dem,config] [--jobs 2] [--json FILE]

Real files of the samples are damaged at random (bits, bytes, pieces, lines, cells of tables and of
databases, numbers and names that are legal text but no legal value) and given to the reader of
their kind. A reader may return, or raise one of the program's own errors in a single line. Anything
else counts as a failure: another exception, a process that ends, more than TOO_LONG_S for one file.
What is read must not hold numbers that the reader promises not to return.
"""

from __future__ import annotations

import argparse
import json
import logging
import re
import shutil
import sqlite3
import sys
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import rasterio
from rasterio.enums import Resampling
from watched import Case, watched

from sassgis.errors import SassgisError
from sassgis.files.saved_arrays import write_saved
from sassgis.gap.fit.linear_fit import Trial
from sassgis.inputs.config import load_config, resolved
from sassgis.inputs.csv_table import read_profile
from sassgis.inputs.dem import read_dem
from sassgis.inputs.frequencies import read_frequencies
from sassgis.inputs.ground_map import PARAMETERS, built_in_table, read_ground_table
from sassgis.inputs.objects import read_objects, read_vulnerability
from sassgis.inputs.observation_files import read_observations
from sassgis.inputs.tiles import read_terrain
from sassgis.inputs.vectors import read_release
from sassgis.outputs.gap_files import classes_csv
from sassgis.runs.draw_store import DrawStore
from sassgis.settings.exposure import ObjectSettings
from sassgis.settings.settings import ReleaseSettings

SAMPLE = Path(__file__).resolve().parents[1] / "sample_dem"
SEED = 7
TOO_LONG_S = 30.0
#: A draw that a calibration has kept.
SHARES, SCORES = [0.1, 0.2, 0.3], [1.0]
NUMBERS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e308", b"-1e308", b"1e-320", b"99999999999999999999",
    b"", b"1,5", b"0x10", b"1e", b"--1", b"1_000", b"\xd9\xa3", b"true",
)  # fmt: skip
WORDS = (
    b"=1+1", b"../../x", b"/etc/passwd", b"'; DROP TABLE x; --", b"%s%n", b"{0}", b"\xe2\x80\xae",
    b"\x00", b"<script>", b'"', b"\\", b"a" * 5000, b"CON", b"\xff\xfe", b"None",
)  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Damage


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """The content with one damage, or with up to four."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 4]))):
        content = DAMAGES[int(rng.integers(len(DAMAGES)))](content, rng)
    return content


def _place(content: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(content))) if content else 0


def _bits(content: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(content)
    for _ in range(int(rng.integers(1, 9))):
        if out:
            out[_place(content, rng)] ^= 1 << int(rng.integers(8))
    return bytes(out)


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: _place(content, rng)]


def _without(content: bytes, rng: np.random.Generator) -> bytes:
    i = _place(content, rng)
    return content[:i] + content[i + int(rng.integers(1, 64)) :]


def _twice(content: bytes, rng: np.random.Generator) -> bytes:
    i = _place(content, rng)
    return content[:i] + content[i : i + int(rng.integers(1, 256))] + content[i:]


def _noise(content: bytes, rng: np.random.Generator) -> bytes:
    i = _place(content, rng)
    return content[:i] + rng.bytes(int(rng.integers(1, 32))) + content[i:]


def _token(
    pattern: bytes, values: tuple[bytes, ...], content: bytes, rng: np.random.Generator
) -> bytes:
    found = list(re.finditer(pattern, content[:200_000]))
    if not found:
        return content
    one = found[int(rng.integers(len(found)))]
    return content[: one.start()] + values[int(rng.integers(len(values)))] + content[one.end() :]


def _lines(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    i, j = (int(rng.integers(len(lines))) for _ in range(2))
    kind = int(rng.integers(3))
    if kind == 0:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 1:
        lines.insert(i, lines[j])
    else:
        del lines[i]
    return b"\n".join(lines)


DAMAGES: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _bits, _cut, _without, _twice, _noise, _lines,
    partial(_token, rb"-?\d+\.?\d*(?:e-?\d+)?", NUMBERS),
    partial(_token, rb"-?\d+\.?\d*(?:e-?\d+)?", NUMBERS),
    partial(_token, rb"[A-Za-z_]{3,}", WORDS),
)  # fmt: skip


def damage_file(file: Path, rng: np.random.Generator) -> None:
    """Damage a file where it lies; half of the databases cell by cell."""
    if file.suffix == ".gpkg" and rng.random() < 0.5:
        _damage_cell(file, rng)
        return
    file.write_bytes(damaged(file.read_bytes(), rng))


def _damage_cell(file: Path, rng: np.random.Generator) -> None:
    """One cell of one table of a database becomes another value."""
    values = [*NUMBERS, *WORDS]
    with suppress(sqlite3.Error):
        database = sqlite3.connect(file)
        with database:
            names = "SELECT name FROM sqlite_master WHERE type = 'table'"
            tables = [row[0] for row in database.execute(names)]
            table = tables[int(rng.integers(len(tables)))]
            columns = [row[1] for row in database.execute(f'PRAGMA table_info("{table}")')]
            column = columns[int(rng.integers(len(columns)))]
            value: Any = values[int(rng.integers(len(values)))]
            if rng.random() < 0.7:
                value = value.decode("utf-8", "replace")
            database.execute(
                f'UPDATE "{table}" SET "{column}" = ? WHERE rowid = '
                f'(SELECT rowid FROM "{table}" ORDER BY random() LIMIT 1)',
                (value,),
            )
        database.close()


# ---------------------------------------------------------------------------------------------
# Readers


def _site(folder: Path) -> None:
    """The sample valley with coarse terrain, observed rocks and small tables of each kind."""
    shutil.copytree(SAMPLE / "valley", folder)
    shutil.copytree(SAMPLE / "observed", folder / "observed")
    with rasterio.open(folder / "dem.tif") as source:
        shape = source.height // 8, source.width // 8
        heights = source.read(1, out_shape=shape, resampling=Resampling.average)
        scale = rasterio.Affine.scale(source.width / shape[1], source.height / shape[0])
        profile = {
            "driver": "GTiff", "dtype": "float32", "count": 1, "height": shape[0],
            "width": shape[1], "crs": source.crs, "transform": source.transform * scale,
            "nodata": source.nodata,
        }  # fmt: skip
    (folder / "tiles").mkdir()
    for name in ("small.tif", "tiles/a.tif"):
        with rasterio.open(folder / name, "w", **profile) as out:
            out.write(heights.astype("float32"), 1)
    cell, corner = profile["transform"].a, profile["transform"]
    head = (
        f"ncols {shape[1]}\nnrows {shape[0]}\nxllcorner {corner.c}\n"
        f"yllcorner {corner.f + shape[0] * corner.e}\ncellsize {cell}\nNODATA_value -9999\n"
    )
    rows = "\n".join(" ".join(f"{v:.2f}" for v in row) for row in heights)
    (folder / "small.asc").write_text(head + rows + "\n", encoding="utf-8")
    profile_rows = "\n".join(f"{5 * i},{500 - 3 * i},debris" for i in range(20))
    (folder / "profile.csv").write_text(f"s_m,z_m,ground\n{profile_rows}\n", encoding="utf-8")
    (folder / "frequencies.csv").write_text(
        "area,scenario,frequency,unit\nNord,frequent,0.2,per_year\nMitte,rare,0.01,per_year_ha\n",
        encoding="utf-8",
    )
    for name in ("release", "road"):
        gpd.read_file(folder / f"{name}.gpkg").to_file(folder / f"{name}.geojson", driver="GeoJSON")
    table = built_in_table()
    (folder / "classes.csv").write_text(classes_csv(table, table, lambda _c: ""), encoding="utf-8")


def _dem(file: str, folder: Path, _kept: Any) -> None:
    grid = read_dem(folder / file, "local" if file.endswith("asc") else None)
    known = grid.values[np.isfinite(grid.values)]
    assert not np.isinf(grid.values).any() and grid.cell_size > 0.0
    assert known.size == 0 or (known.min() > -500.0 and known.max() < 9000.0), "heights off Earth"


def _config(folder: Path, _kept: Any) -> None:
    json.dumps(resolved(load_config(folder / "config.toml")), default=str)


def _ground_table(folder: Path, _kept: Any) -> None:
    for own in read_ground_table(folder / "classes.csv").classes:
        assert all(np.isfinite(getattr(own, name)) for name in PARAMETERS)


def _profile(folder: Path, _kept: Any) -> None:
    made = read_profile(folder / "profile.csv", built_in_table(), "debris")
    assert np.isfinite(made.s).all() and np.isfinite(made.z).all() and (np.diff(made.s) > 0).all()


def _release(file: str, folder: Path, kept: Any) -> None:
    settings = ReleaseSettings(
        file=folder / file, name_field="name", scenario_field="scenario", spacing_m=3.0
    )
    read_release(settings, kept, ("frequent", "rare"))


def _road(file: str, folder: Path, kept: Any) -> None:
    read_objects(ObjectSettings("road", "line", folder / file, value_per_m=1.0), kept)


def _state(folder: Path, _kept: Any) -> None:
    store = DrawStore(folder / "draws.npz", "x", lambda _text: None)
    trial = Trial(0, np.array(SHARES), 1)
    made = store.seen([trial], run=lambda due: [(np.zeros(1), 0.0) for _ in due], step=lambda: None)
    assert made[0][1] in (0.0, *SCORES), "other scores than were saved"


#: Reader of each kind, whether it reads over the terrain model, and the files that are damaged.
TARGETS: Mapping[str, tuple[Callable[[Path, Any], Any], bool, tuple[str, ...]]] = {
    "config": (_config, False, ("config.toml",)),
    "dem": (partial(_dem, "small.tif"), False, ("small.tif",)),
    "dem_ascii": (partial(_dem, "small.asc"), False, ("small.asc",)),
    "tiles": (lambda folder, _: read_terrain(folder / "tiles"), False, ("tiles/a.tif",)),
    "ground_table": (_ground_table, False, ("classes.csv",)),
    "profile": (_profile, False, ("profile.csv",)),
    "frequencies": (
        lambda folder, _: read_frequencies(
            folder / "frequencies.csv", ["Nord", "Mitte"], ["frequent", "rare"]
        ),
        False,
        ("frequencies.csv",),
    ),
    "vulnerability": (
        lambda folder, _: read_vulnerability(folder / "vulnerability.csv", ["low", "mean", "high"]),
        False,
        ("vulnerability.csv",),
    ),
    "release": (partial(_release, "release.gpkg"), True, ("release.gpkg",)),
    "release_geojson": (partial(_release, "release.geojson"), True, ("release.geojson",)),
    "objects": (partial(_road, "road.gpkg"), True, ("road.gpkg",)),
    "objects_geojson": (partial(_road, "road.geojson"), True, ("road.geojson",)),
    "observations": (
        lambda folder, kept: read_observations(folder / "observed", kept),
        True,
        tuple(
            f"observed/{n}.csv" for n in ("rocks", "passages", "deposits", "stations", "metadata")
        ),
    ),
    "saved_state": (_state, False, ("draws.npz",)),
}


# ---------------------------------------------------------------------------------------------
# Battery


def reading(target: str, site: str) -> Case:
    """In a process of its own: what damages and reads the file of a number."""
    logging.disable(logging.CRITICAL)
    reader, over_terrain, names = TARGETS[target]
    folder = Path(site)
    kept = read_dem(folder / "dem.tif") if over_terrain else None
    own = Path(tempfile.mkdtemp(prefix=f"{target}-", dir=folder.parent)) / "site"
    shutil.copytree(folder, own)

    reader(own, kept)  # what is not damaged can be read

    def case(number: int) -> dict[str, int]:
        rng = np.random.default_rng([SEED, sorted(TARGETS).index(target), number])
        file = own / names[int(rng.integers(len(names)))]
        damage_file(file, rng)
        try:
            reader(own, kept)
        except SassgisError as error:
            assert not {"\n", "\r"} & set(str(error)), "more than one line"
            return {"refused": 1}
        finally:
            shutil.copyfile(folder / file.relative_to(own), file)
        return {"read": 1}

    return case


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=20_000, help="of all kinds together")
    parser.add_argument("--only", default="", help="kinds, with commas between them")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    chosen = [n for n in TARGETS if not options.only or n in options.only.split(",")]
    each = -(-options.inputs // len(chosen))
    failures: list[dict[str, Any]] = []
    table = {}
    with tempfile.TemporaryDirectory(prefix="sassgis-fuzz-") as made:
        site = Path(made) / "site"
        _site(site)
        arrays = {"trials": [0], "parameters": [SHARES], "numbers": [[0.0]], "scores": SCORES}
        write_saved(site / "draws.npz", arrays, "x")
        with ThreadPoolExecutor(options.jobs) as pool:
            done = pool.map(
                lambda name: (name, *watched(reading, (name, str(site)), range(each), TOO_LONG_S)),
                chosen,
            )
            for name, counts, failed in done:
                table[name] = dict(counts)
                failures += [{"target": name, **one} for one in failed]
                print(name, dict(counts), flush=True)
                if options.json:
                    rows = {"each": each, "verdicts": table, "failures": failures}
                    options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    for one in failures[:20]:
        print(one["target"], one["number"], one["said"], sep="\n")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
