"""The command as a user runs it: files in, files out, going on, bad input."""

from __future__ import annotations

import html
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from gap_check.make import make_world
from gap_check.observers import CONFIG_NAME, OBSERVATIONS_NAME, write_case
from gap_check.worlds import WorldSpec
from helpers.changed_arrays import change_arrays

from sassgis.cli.entry import cli
from sassgis.errors import InputError, Interrupted
from sassgis.files.atomic_output import check_output, partial_folder
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import read_ground_table
from sassgis.runs import calibrate as calibrate_module
from sassgis.runs.calibrate import calibrate

DRAWS = 16
CLASSES, NAMES = ("talus",), ("eta_max", "mu_0")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibrate") / "case"
    world = make_world(WorldSpec("cliff_talus_meadow", (), 24, "everything"), 31)
    config = write_case(world, folder, "synthetic")
    config.write_text(config.read_text().replace("[project]", '[project]\nlanguage = "de"', 1))
    return folder


def run(case: Path, out: Path, **options: object) -> object:
    return calibrate(
        [(case / CONFIG_NAME, case / OBSERVATIONS_NAME)],
        out,
        classes=CLASSES,
        parameters=NAMES,
        draws=DRAWS,
        **options,  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def done(case: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("calibrated") / "out"
    arguments = [case / CONFIG_NAME, "--observations", case / OBSERVATIONS_NAME, "-o", out]
    options = [f"--{k}={v}" for k, own in (("class", CLASSES), ("parameter", NAMES)) for v in own]
    options.append(f"--draws={DRAWS}")
    said = CliRunner().invoke(cli, ["calibrate", *map(str, arguments), *options])
    assert said.exit_code == 0, said.output
    # The last line says which ground to run.
    found = json.loads((out / "calibration.json").read_text())
    assert said.stdout.splitlines()[-1] == found["recommendation"]
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.*"))}


def test_what_is_written_can_be_run_and_says_where_it_comes_from(case: Path, done: Path) -> None:
    for name in ("report.html", "figures/parameters.png", "figures/rocks_1.png", "manifest.json"):
        assert (done / name).is_file(), name
    check_output(done, overwrite=True)
    table = read_ground_table(done / "fitted_classes.csv")
    own = table.classes[table.index("talus")]
    found = json.loads((done / "calibration.json").read_text())
    # What is to be run is what was recommended.
    run_with = load_config(done / "config.toml").ground.classes
    stays = load_config(case / CONFIG_NAME).ground.classes
    assert run_with == (
        done / "fitted_classes.csv" if found["recommended"] == "calibrated" else stays
    )
    assert found["recommendation"] in (done / "config.toml").read_text()
    for f in found["parameters"]:
        assert getattr(own, f["parameter"]) == pytest.approx(f["value"], rel=1e-4)
    assert "Calibrated by sassgis" in own.source and "24 rocks" in own.source
    assert own.trust == "fitted"
    before = read_ground_table(load_config(case / CONFIG_NAME).ground.classes)
    assert table.classes[table.index("rock")] == before.classes[before.index("rock")]
    errors = found["sites"][0]["errors"]
    assert {"run-out", "lateral offset"} <= {e["quantity"] for e in errors}
    assert set(errors[0]["crps"]) == {"before", "after", "left out"}


def test_the_report_is_in_the_language_of_the_project(done: Path) -> None:
    page = (done / "report.html").read_text().partition("<body>")[2]
    shown = html.unescape(re.sub("<[^>]*>", " ", page))
    assert "Kalibrierte Bodenklassen" in shown and "an Validierungsblöcken" in shown
    assert not re.findall(r"\b(?:[Tt]he|of|to|and|rocks|before|after|is|by)\b", shown)


@pytest.mark.battery
@pytest.mark.parametrize("changed", [False, True], ids=["as it was", "scores changed"])
def test_an_interruption_changes_nothing(
    case: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: bool
) -> None:
    def stop(made: int, total: int, rocks: int) -> None:
        if made >= 20:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        run(case, tmp_path / "out", on_progress=stop)
    assert not (tmp_path / "out").exists()
    kept = partial_folder(tmp_path / "out") / "checkpoint.draws.npz"
    if changed:
        change_arrays(kept, lambda arrays: arrays["scores"].__imul__(0.5))
    made: list[int] = []
    said: list[str] = []
    whole = calibrate_module.run_trial
    monkeypatch.setattr(
        calibrate_module, "run_trial", lambda task, one: made.append(one.number) or whole(task, one)
    )
    run(case, tmp_path / "out", say=said.append)
    # What was made before is not made again, unless somebody has changed it. Draws of the first
    # round have the numbers 2 to 17.
    assert all((k in made) == changed for k in range(2, DRAWS + 2)) and max(made) > DRAWS + 2
    assert sum(str(kept) in text for text in said) == changed
    monkeypatch.undo()
    assert contents(tmp_path / "out") == contents(done)


@pytest.mark.battery
def test_processes_change_nothing(case: Path, done: Path, tmp_path: Path) -> None:
    run(case, tmp_path / "two", jobs=2)
    assert contents(tmp_path / "two") == contents(done)


def test_nothing_to_calibrate_on(case: Path, tmp_path: Path) -> None:
    bare = shutil.copytree(case, tmp_path / "bare")
    for name in ("deposits", "passages", "impacts"):
        (bare / OBSERVATIONS_NAME / f"{name}.csv").unlink()
    with pytest.raises(InputError, match="nothing to compare simulations with"):
        run(bare, tmp_path / "out")


def test_unknown_class_and_parameter(case: Path, tmp_path: Path) -> None:
    sites = [(case / CONFIG_NAME, case / OBSERVATIONS_NAME)]
    with pytest.raises(InputError, match=r"not a known ground class.*'mud'"):
        calibrate(sites, tmp_path / "out", classes=["mud"])
    with pytest.raises(InputError, match=r"met by none of the rocks.*'asphalt'"):
        calibrate(sites, tmp_path / "out", classes=["asphalt"])
    with pytest.raises(InputError, match=r"can be calibrated.*'dp_min'"):
        calibrate(sites, tmp_path / "out", parameters=["dp_min"])


def test_a_class_that_differs_between_the_sites(case: Path, tmp_path: Path) -> None:
    other = shutil.copytree(case, tmp_path / "other")
    table = (Path(calibrate_module.__file__).parents[1] / "data" / "ground_classes.csv").read_text()
    (other / "own.csv").write_text(table.replace("talus,0.9", "talus,0.4"))
    config = other / CONFIG_NAME
    config.write_text(config.read_text().replace("[ground]", '[ground]\nclasses = "own.csv"'))
    with pytest.raises(InputError, match="'talus' differs between the sites"):
        calibrate(
            [(c / CONFIG_NAME, c / OBSERVATIONS_NAME) for c in (case, other)], tmp_path / "out"
        )


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[tuple[Path, Path]]]]:
    seen: list[list[tuple[Path, Path]]] = []

    def take(sites: list[tuple[Path, Path]], *_: object, **__: object) -> None:
        seen.append(sites)
        raise InputError("enough")

    monkeypatch.setattr(calibrate_module, "calibrate", take)
    return seen  # type: ignore[return-value]


def test_the_command_takes_pairs(asked: list[list[tuple[Path, Path]]]) -> None:
    arguments = ["calibrate", "a.toml", "--observations", "a", "b.toml", "b", "-o", "out"]
    CliRunner().invoke(cli, arguments)
    assert asked == [[(Path("a.toml"), Path("a")), (Path("b.toml"), Path("b"))]]
    failed = CliRunner().invoke(cli, [*arguments[:5], "-o", "out"])
    assert failed.exit_code == 2 and "b.toml" in failed.output
