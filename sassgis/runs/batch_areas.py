"""The release areas that a batch is to run, by name."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from sassgis.io.read.config import load_config
from sassgis.io.read.vectors import release_features
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.labels import file_stems
from sassgis.model.run_config import Config
from sassgis.model.settings import ReleaseSettings

#: Vector files of a folder by their suffix; those that the configuration names do not count.
VECTOR_SUFFIXES = (".gpkg", ".shp", ".geojson", ".json", ".fgb", ".kml")


@dataclass(frozen=True, slots=True)
class Candidate:
    """A release area that a batch is to run.

    Attributes
    ----------
    name : str
    stem : str
        Name of its folder.
    release : ReleaseSettings
        Section ``[release]`` with the file and fields of this area.
    number : int
        Place in the layer, counted from 1.
    problem : str
        Why it cannot be run; empty if nothing is known against it.
    """

    name: str
    stem: str
    release: ReleaseSettings
    number: int
    problem: str = ""


def batch_config(
    releases: Path, config: str | Path | None, dem: str | Path | None, seed: int | None
) -> Config:
    """The configuration, with the release areas in it."""
    overrides: dict[str, object] = {} if seed is None else {"run.seed": seed}
    if dem is not None:
        overrides["terrain.dem"] = str(Path(dem).expanduser().resolve())
    if releases.suffix.lower() == ".toml":
        if config is not None:
            raise ConfigError(
                "two configurations", file=releases, found=str(config), expected="one of them"
            )
        return load_config(releases, overrides)
    if not releases.exists():
        raise InputError(
            "file not found",
            file=releases,
            expected="a vector file of release areas, a folder of them, or a configuration",
        )
    overrides["release.file"] = str(releases.expanduser().resolve())
    return load_config(_beside(releases) if config is None else config, overrides)


def _beside(releases: Path) -> Path:
    """The only configuration in the folder of the release areas."""
    folder = releases if releases.is_dir() else releases.parent
    found = sorted(folder.glob("*.toml"))
    if len(found) != 1:
        raise ConfigError(
            "no configuration is given",
            file=folder,
            found=", ".join(f.name for f in found) or "no TOML file",
            expected="--config FILE, or one TOML file there",
        )
    return found[0]


def find_areas(config: Config) -> list[Candidate]:
    """All release areas that the configuration names, by name; shapes are not looked at.

    ``release.file`` may be a folder: then an area is named by its ``name_field`` or, in files
    without it, by the file.

    Raises
    ------
    InputError
        If a single file cannot be used, or a folder holds no vector file.
    """
    path = config.release_path
    named: list[tuple[str, ReleaseSettings, int, str]] = []
    for file in _release_files(config) if path.is_dir() else [path]:
        release = replace(config.release, file=file)
        try:
            named += _named(release, by_file=path.is_dir())
        except InputError as error:
            if not path.is_dir():
                raise
            named.append((file.stem, release, 0, str(error)))
    counts = Counter(name for name, _, _, _ in named)
    named.sort(key=lambda n: (n[0], str(n[1].file), n[2]))
    stems = file_stems([name for name, _, _, _ in named])
    return [
        Candidate(
            name,
            stem,
            release,
            number,
            problem or (f"{release.file}: name is used {counts[name]} times ({name!r}; expected "
                        "names that differ)" if counts[name] > 1 else ""),
        )
        for (name, release, number, problem), stem in zip(named, stems, strict=True)
    ]  # fmt: skip


def _release_files(config: Config) -> list[Path]:
    """Vector files of the folder of release areas that serve no other purpose."""
    folder = config.release_path
    others = {
        Path(f).resolve()
        for f in (
            config.ground.file,
            config.trees.file if config.trees is not None else None,
            *(item.file for item in (*config.stations, *config.barriers)),
            *(item.file for item in config.objects),
        )
        if f is not None
    }
    files = sorted(
        f
        for f in folder.iterdir()
        if f.suffix.lower() in VECTOR_SUFFIXES and f.resolve() not in others
    )
    if not files:
        raise InputError(
            "holds no file of release areas",
            file=folder,
            field="release.file",
            expected="vector files (" + ", ".join(VECTOR_SUFFIXES) + ")",
        )
    return files


def _named(release: ReleaseSettings, by_file: bool) -> list[tuple[str, ReleaseSettings, int, str]]:
    """Name, settings, number and problem of each area of a file."""
    assert release.file is not None
    stem = release.file.stem if by_file else "area"
    try:
        features = release_features(release)
    except InputError as error:
        if not by_file or error.field != "release.name_field":
            raise
        release = replace(release, name_field=None)
        features = release_features(release)
    out = []
    for feature in features:
        problem = ""
        if release.name_field is None:
            single = by_file and len(features) == 1
            name = stem if single else f"{stem} {feature.number}"
        else:
            name = feature.text(release.name_field) or ""
            if not name:
                name = f"{stem}, feature {feature.number}"
                problem = f"{release.file}: {release.name_field}: feature has no name"
        out.append((name, release, feature.number, problem))
    return out
