"""Make the zip of the QGIS plugin: equal files give equal bytes.

    python qgis_plugin/make_zip.py OUT.zip [--wheel sassgis-0.1.0-py3-none-any.whl]

With ``--wheel`` the plugin brings the program along and needs the network for its libraries only.
"""

from __future__ import annotations

import argparse
import zipfile
from pathlib import Path

PLUGIN = Path(__file__).resolve().parent / "sassgis_plugin"
LICENSE = PLUGIN.parents[1] / "LICENSE"
_SUFFIXES = (".py", ".txt", ".png", ".svg")
#: The first moment that a zip can state; equal bytes whenever it is made.
_MOMENT = (1980, 1, 1, 0, 0, 0)


def make_zip(target: Path, wheel: Path | None = None) -> None:
    """Write the zip that QGIS installs.

    Parameters
    ----------
    target : Path
    wheel : Path, optional
        The program, to lie in the plugin.
    """
    files = [file for file in PLUGIN.iterdir() if file.suffix in _SUFFIXES]
    files += [LICENSE, *([wheel] if wheel else [])]
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files, key=lambda file: file.name):
            entry = zipfile.ZipInfo(f"{PLUGIN.name}/{file.name}", _MOMENT)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, file.read_bytes())


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", type=Path)
    parser.add_argument("--wheel", type=Path)
    given = parser.parse_args()
    make_zip(given.target, given.wheel)
    print(f"wrote {given.target}")


if __name__ == "__main__":
    main()
