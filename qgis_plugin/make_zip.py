"""Make the zip of the QGIS plugin: equal files give equal bytes.

    python qgis_plugin/make_zip.py [OUT.zip] [--repository https://... --email NAME@...]

Without OUT.zip it is dist/sassgis_plugin-VERSION.zip, beside the wheel of the program. The address
of the repository and of whoever answers are part of a publication and stand in no file here;
without them the zip can be installed from the disk, and is not one for plugins.qgis.org.
"""

from __future__ import annotations

import argparse
import configparser
import re
import zipfile
from pathlib import Path

PLUGIN = Path(__file__).resolve().parent / "sassgis_plugin"
LICENSE = PLUGIN.parents[1] / "LICENSE"
_SUFFIXES = (".py", ".txt", ".png", ".svg")
#: The first moment that a zip can state; equal bytes whenever it is made.
_MOMENT = (1980, 1, 1, 0, 0, 0)
#: What plugins.qgis.org asks for.
REQUIRED = (
    "name", "qgisMinimumVersion", "description", "about", "version", "author", "email",
    "repository", "tracker",
)  # fmt: skip
_LARGEST = 25_000_000


def make_zip(target: Path, repository: str = "", email: str = "") -> None:
    """Write the zip that QGIS installs; a publication has addresses in its metadata."""
    target.parent.mkdir(parents=True, exist_ok=True)
    files = [file for file in PLUGIN.iterdir() if file.suffix in _SUFFIXES]
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted([*files, LICENSE], key=lambda file: file.name):
            content = file.read_bytes()
            if file.name == "metadata.txt" and repository:
                content += _addresses(repository, email).encode()
            entry = zipfile.ZipInfo(f"{PLUGIN.name}/{file.name}", _MOMENT)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)


def _addresses(repository: str, email: str) -> str:
    root = repository.rstrip("/")
    return f"email={email}\nrepository={root}\ntracker={root}/issues\nhomepage={root}\n"


def _usual() -> Path:
    metadata = (PLUGIN / "metadata.txt").read_text(encoding="utf-8")
    version = re.search(r"^version=(\S+)", metadata, re.M)
    assert version
    return Path("dist", f"{PLUGIN.name}-{version[1]}.zip")


def problems_of(file: Path) -> list[str]:
    """What plugins.qgis.org would refuse about a zip."""
    found = []
    with zipfile.ZipFile(file) as archive:
        names = archive.namelist()
        folders = {name.split("/")[0] for name in names}
        if len(folders) != 1 or not re.fullmatch(r"[A-Za-z][\w-]*", next(iter(folders), "")):
            found.append(f"folders: {', '.join(sorted(folders))}; expected one, of letters")
        plain = (*_SUFFIXES, "/LICENSE")
        binaries = [name for name in names if not name.endswith(plain)]
        if binaries:
            found.append(f"holds {', '.join(binaries)}; expected no binaries")
        for name in ("__init__.py", "metadata.txt", "LICENSE"):
            if f"{PLUGIN.name}/{name}" not in names:
                found.append(f"no {name}")
        text = archive.read(f"{PLUGIN.name}/metadata.txt").decode()
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read_string(text)
    general = metadata["general"]
    found += [f"metadata: no {key}" for key in REQUIRED if not general.get(key, "").strip()]
    for key in ("repository", "tracker", "homepage"):
        address = general.get(key, "")
        if address and not re.fullmatch(r"https://(?!([\w.]+\.)?example\.)[\w.-]+/\S+", address):
            found.append(f"metadata: {key} {address}: expected the address of a page")
    if not re.fullmatch(r"[^@\s]+@(?!example\.)[\w.-]+\.\w+", general.get("email", "a@b.c")):
        found.append(f"metadata: email {general['email']}: expected an address")
    if file.stat().st_size > _LARGEST:
        found.append(f"{file.stat().st_size / 1e6:.0f} MB; expected at most {_LARGEST / 1e6:.0f}")
    return found


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", type=Path, nargs="?", default=_usual())
    parser.add_argument("--repository", default="", help="address of the source code")
    parser.add_argument("--email", default="", help="of whoever answers")
    given = parser.parse_args()
    make_zip(given.target, given.repository, given.email)
    problems = problems_of(given.target)
    if given.repository and problems:
        raise SystemExit("; ".join(problems))
    print(f"wrote {given.target}")
    if problems:
        print(f"to be installed from the disk; plugins.qgis.org asks for more: {problems[0]}, ...")


if __name__ == "__main__":
    main()
