"""The README's commands are there once and call what exists."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest
from helpers.installed import command_of

from sassgis.cli.entry import cli

pytestmark = pytest.mark.e2e


@pytest.mark.parametrize("name", ["main", "test"])
def test_a_command_installs_what_it_needs(name: str, readme: str, repository: Path) -> None:
    command = command_of(readme, name)
    assert command.startswith("python3 -m venv .venv && . .venv/bin/activate && pip install ")
    extras = tomllib.loads((repository / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    wanted = re.search(r'pip install "\.\[(\w+)\]"', command)
    assert wanted is not None and wanted[1] in extras


def test_the_test_command_runs_every_test_but_the_batteries(readme: str, repository: Path) -> None:
    assert command_of(readme, "test").endswith("&& python -m pytest -n 2")
    settings = tomllib.loads((repository / "pyproject.toml").read_text())["tool"]["pytest"]
    assert settings["ini_options"]["testpaths"] == ["tests"]
    assert "-m 'not battery'" in settings["ini_options"]["addopts"]


def called(page: str) -> list[list[str]]:
    """The arguments of every call of the program in the shell blocks of a page."""
    found = []
    for block in re.findall(r"^```sh\n(.*?)^```$", page, re.M | re.S):
        for line in block.splitlines():
            for part in re.split(r"&&|;", line):
                words = shlex.split(part, comments=True)
                if words[:1] == ["sassgis"]:
                    found.append(words[1:])
    return found


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs"])
def test_every_call_of_the_program_has_a_command_and_its_options(
    page: str, repository: Path
) -> None:
    path = repository / page
    files = sorted(path.rglob("*.md")) if path.is_dir() else [path]
    calls = [(f.name, c) for f in files for c in called(f.read_text(encoding="utf-8"))]
    assert page != "README.md" or len(calls) >= 5
    for file, words in calls:
        group: click.Group = cli
        rest = list(words)
        context = click.Context(cli)
        while True:
            command = group.get_command(context, rest[0])
            assert command is not None, f"{file}: sassgis {shlex.join(words)}"
            rest = rest[1:]
            if not isinstance(command, click.Group):
                break
            group = command
        try:
            command.make_context(command.name, rest)
        except click.UsageError as error:
            pytest.fail(f"{file}: sassgis {shlex.join(words)}: {error.format_message()}")
