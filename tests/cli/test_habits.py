"""What users expect of a command line: examples, exit codes, JSON, completion, a schema."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from helpers.small_slope import Slope

from sassgis import errors
from sassgis.cli.entry import cli
from sassgis.inputs.config import config_schema, declared_sections
from sassgis.outputs.config_template import config_template


def commands(
    group: click.Group = cli, before: str = "sassgis"
) -> Iterator[tuple[str, click.Command]]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, f"{before} {name}")
        else:
            yield f"{before} {name}", command


@pytest.fixture(scope="module")
def page(repository: Path) -> str:
    return (repository / "docs" / "command_line.md").read_text(encoding="utf-8")


# --- help ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "command"), list(commands()))
def test_every_command_has_an_example_that_can_be_read(name: str, command: click.Command) -> None:
    assert command.epilog is not None and command.epilog.startswith(f"Example: {name}")
    words = shlex.split(command.epilog.removeprefix("Example: ").removeprefix(name))
    command.make_context(name, words)


def test_commands_are_listed_in_the_order_of_work_with_whole_sentences(printed) -> None:
    for group in ((), ("dem",), ("gap",)):
        listed = re.search(r"Commands:\n((?:  .*\n)+)", printed(*group, "-h"))[1].splitlines()
        assert all(line.endswith(".") and not line.endswith("...") for line in listed), listed
    out = printed("-h")
    places = [
        out.index(f"\n  {name} ") for name in ("dem", "new", "init", "validate", "run", "zone")
    ]
    assert places == sorted(places)


def test_every_command_is_on_the_page(page: str) -> None:
    cells = re.findall(r"^\| (`.*?) \|", page.split("\n## ")[0], re.M)
    named = {name for cell in cells for name in re.findall(r"`([a-z ]+)`", cell)}
    assert named == {name.removeprefix("sassgis ") for name, _ in commands()}


def test_exit_codes_are_those_of_the_errors(page: str, printed) -> None:
    kinds = [e for e in vars(errors).values() if isinstance(e, type) and hasattr(e, "exit_code")]
    codes = {0, 70} | {kind.exit_code for kind in kinds}
    out = printed("-h")
    for text in (page, out):
        assert {int(c) for c in re.findall(r"^(?:\| |    )(\d+) ", text, re.M)} == codes


def test_completion_of_commands_and_options() -> None:
    def completed(words: str) -> set[str]:
        place = str(len(words.split()) - 1)
        asked = {"_SASSGIS_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": place}
        command = [sys.executable, "-c", "from sassgis.cli import main; main()"]
        done = subprocess.run(command, env=os.environ | asked, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return set(done.stdout.split())

    assert completed("sassgis va") == {"plain,validate"}
    assert "plain,--overwrite" in completed("sassgis run --o")


# --- JSON ----------------------------------------------------------------------------------------


def test_results_as_one_json_object(slope: Slope, printed) -> None:
    text = slope.config.read_text()
    text = re.sub(r"(\[\[blocks\]\]\n)", r"\1onset_frequency = 0.5\n", text)
    slope.config.write_text(text + "\n[hazard]\nref_width_m = 10.0\n")
    found = json.loads(printed("validate", slope.config, "--json"))
    assert found["dem"]["cell_size"] > 0.0 and found["missing"]["zone"] == []
    assert found["missing"]["risk"] == ["risk.vulnerability", "[[objects]]"]
    found = json.loads(printed("zone", slope.config, "-o", slope.folder / "zones", "--json"))
    manifest = json.loads((slope.folder / "zones" / "manifest.json").read_text())
    assert found["blocks"] == manifest["counts"]["rocks"] == sum(found["stopping_reasons"].values())
    assert found["zones"] > 0 and found["output"] == str(slope.folder / "zones")


# --- schema --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def checks():
    jsonschema = pytest.importorskip("jsonschema", reason="the check needs the library jsonschema")
    return jsonschema.Draft202012Validator(json.loads(json.dumps(config_schema())))


def test_samples_and_template_fit_the_schema(checks, repository: Path) -> None:
    files = [
        f for f in repository.glob("sample_dem/*/*.toml") if "[[blocks]]" in f.read_text("utf-8")
    ]
    assert len(files) >= 4
    for text in (*(f.read_text("utf-8") for f in files), config_template()):
        assert not list(checks.iter_errors(tomllib.loads(text)))


@pytest.mark.parametrize(
    "wrong",
    [
        "[release]\nspacin_m = 3",
        "[release]\nrocks_per_point = 0",
        "[release]\nrocks_per_point = 2.5",
        '[terrain]\npath = "straight"',
        '[[blocks]]\nname = "a"\nvolume_m3 = [1.0, 2000.0]',
        '[[blocks]]\nname = "a"\nvolume_m3 = 0',
        '[blocks]\nname = "a"',
        "[effects.none]",
    ],
)
def test_what_the_configuration_refuses_the_schema_refuses(checks, wrong: str) -> None:
    assert list(checks.iter_errors(tomllib.loads(wrong)))


def test_every_key_has_its_meaning_in_the_schema() -> None:
    kinds = config_schema()["$defs"]
    for section, keys in declared_sections().items():
        (own,) = [k for k in kinds.values() if list(k["properties"]) == list(keys)][:1]
        for key, setting in keys.items():
            assert own["properties"][key]["description"] == setting.description, (section, key)
            assert (key in own.get("required", ())) == setting.is_required


def test_the_schema_is_written_once(tmp_path: Path, printed, refusal) -> None:
    file = tmp_path / "own.schema.json"
    printed("schema", file)
    assert json.loads(file.read_text("utf-8")) == json.loads(json.dumps(config_schema()))
    assert "--overwrite" in refusal("schema", file, code=3)


@pytest.mark.skipif(sys.platform == "win32", reason="the shell of POSIX closes the streams")
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
@pytest.mark.parametrize(("arguments", "code"), [("--version", 0), ("run no_such.toml -o out", 2)])
def test_exit_codes_stay_where_a_stream_is_closed(
    arguments: str, code: int, closed: str, tmp_path: Path
) -> None:
    command = f"{shlex.quote(sys.executable)} -m sassgis {arguments} {closed}"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == code
    assert b"Traceback" not in done.stderr
