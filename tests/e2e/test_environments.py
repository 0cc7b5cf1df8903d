"""Environments beside pip's name the same packages in the same ranges."""

from __future__ import annotations

import tomllib
from pathlib import Path

import sassgis

#: Names that conda-forge has for the same package.
CONDA = {"matplotlib": "matplotlib-base"}
#: Packages that conda-forge has not: pip brings them with the project.
PIP_ALONE = {"xstatic-leaflet"}


def parts(requirement: str) -> tuple[str, str]:
    """Name and range of a requirement."""
    cut = next((i for i, c in enumerate(requirement) if c in "<>=!~;["), len(requirement))
    return requirement[:cut].strip(), requirement[cut:].strip()


def test_the_conda_environment_has_what_pip_installs(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["cluster"]]
    needed = [own for own in needed if parts(own)[0] not in PIP_ALONE]
    lines = (repository / "environment.yml").read_text().splitlines()
    # Options of pip are not allowed there.
    assert [line for line in lines if line.startswith("      - ")] == ["      - ."]
    listed = [line.strip().removeprefix("- ") for line in lines if line.startswith("  - ")]
    packages = dict(parts(line) for line in listed)
    assert packages["python"] == project["requires-python"]
    for requirement in needed:
        name, limits = parts(requirement)
        assert packages[CONDA.get(name, name)] == limits, name
    assert set(packages) == {
        "python", "pip", "pip:", "conda-forge", "nodefaults",
        *(CONDA.get(n, n) for n, _ in map(parts, needed)),
    }  # fmt: skip


def test_the_conda_recipe_has_what_pip_installs(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    recipe = (repository / "conda" / "recipe.yaml").read_text()
    run = recipe.split("  run:\n")[1].split("\n\n")[0]
    packages = dict(parts(line.strip().removeprefix("- ")) for line in run.splitlines())
    assert packages.pop("python") == project["requires-python"]
    needed = {CONDA.get(n, n): limits for n, limits in map(parts, project["dependencies"])}
    assert packages == needed
    (command,) = project["scripts"].items()
    assert " = ".join(command) in recipe


def test_all_files_state_one_version(repository: Path) -> None:
    read = {name: (repository / name).read_text() for name in ("CITATION.cff", "CHANGELOG.md")}
    assert f"\nversion: {sassgis.__version__}\n" in read["CITATION.cff"]
    assert f"\n## [{sassgis.__version__}] - " in read["CHANGELOG.md"]
    recipe = (repository / "conda" / "recipe.yaml").read_text()
    assert f'version: "{sassgis.__version__}"' in recipe


def test_the_image_installs_the_package(repository: Path) -> None:
    text = (repository / "Dockerfile").read_text()
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    extras = text.split('".[')[1].split("]")[0].split(",")
    assert set(extras) <= set(project["optional-dependencies"])
    assert text.rstrip().endswith('CMD ["--help"]') and 'ENTRYPOINT ["sassgis"]' in text
    # What the build needs is not left out of its context.
    ignored = (repository / ".dockerignore").read_text().split()
    assert not {"sassgis", "sample_dem", "pyproject.toml", "README.md"} & set(ignored)
