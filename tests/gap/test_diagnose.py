"""The diagnosis as a user runs it: from files to answers, and what it does with poor input."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from gap_check.make import base_world, place_effect, with_effect
from gap_check.observers import CONFIG_NAME, OBSERVATIONS_NAME, write_case
from gap_check.worlds import EffectSpec, WorldSpec
from helpers.changed_arrays import change_arrays
from helpers.model_files import model_from_json

from sassgis.errors import InputError, Interrupted
from sassgis.files.atomic_output import check_output
from sassgis.files.saved_arrays import unfit
from sassgis.gap.fit import hypothesis_fit
from sassgis.gap.fit.distances import RockDistances
from sassgis.gap.fit.linear_fit import Seen, Trial
from sassgis.gap.fit.site_data import SiteData, model_rows, site_data_of
from sassgis.gap.forward.released_rocks import (
    HypothesisModel,
    MeasurementError,
    configured_model,
)
from sassgis.gap.verdict import evidence, model_comparison
from sassgis.inputs.config import load_config
from sassgis.inputs.observation_values import read_thresholds, thresholds_of
from sassgis.runs import diagnose as gap_diagnose
from sassgis.runs.calibrate import read_case
from sassgis.runs.diagnose import ENSEMBLE, diagnose
from sassgis.runs.draw_store import DrawStore

#: Models in the file of the ensemble.
MODELS = ("base", "effect", "configured")


@pytest.fixture(scope="module", autouse=True)
def few_draws() -> Iterator[None]:
    """Few draws, campaigns, calibrations and rounds: numbers are rough, all else is whole."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_comparison, "CAUSE_DRAWS", 4)
        patch.setattr(model_comparison, "BASE_CAMPAIGNS", 5)
        patch.setattr(hypothesis_fit, "FIT_ROUNDS", 1)
        patch.setattr(evidence, "PLAUSIBLE_FITS", 2)
        yield


def make_case(folder: Path, kind: str, n_rocks: int, effect: str = "") -> Path:
    """A quarry; an effect acts near its strongest, which is not brought to a size."""
    world = base_world(WorldSpec("quarry", n_rocks=n_rocks, kind=kind), 32)
    if effect:
        placed = place_effect(world, EffectSpec(effect, "strong"), 33)
        world = with_effect(world, replace(placed, share=0.8))
    write_case(world, folder, "test")
    return folder


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_case(tmp_path_factory.mktemp("gap") / "case", "everything", 24, "fragmentation")


@pytest.fixture(scope="module")
def answered(everything: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("answer") / "out"
    run(everything, out)
    return out


def run(case: Path, out: Path, **options: object) -> gap_diagnose.Diagnosis:
    return diagnose(
        case / CONFIG_NAME,
        case / OBSERVATIONS_NAME,
        out,
        draws=8,
        **options,  # type: ignore[arg-type]
    )


def test_all_that_is_promised_is_there(answered: Path) -> None:
    for name in ("report.html", "gap.gpkg", "diagnosis.json", "model/config.toml"):
        assert (answered / name).is_file(), name
    check_output(answered, overwrite=True)
    found = json.loads((answered / "diagnosis.json").read_text())
    verdict, shares = found["verdict"], found["verdict"]["probabilities"]
    assert verdict["effect"] == found["shrinkage"]["effect"] == "fragmentation"
    assert "fragmentation" in verdict["confusion_set"]
    assert (verdict["phase"], verdict["group"]) == ("impact", "extra blocks")
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)
    which = {c["effect"]: c["probability"] for c in found["which"]}
    assert {"none", "contact_law", "fragmentation"} <= which.keys()
    del which["contact_law"]
    assert all(p == shares[effect.split("+")[0]] for effect, p in which.items())
    own = next(f for f in found["fingerprints"] if f["effect"] == "fragmentation")
    assert own["observable"] and own["p_adjusted"] <= 0.01
    assert found["where"] and found["data"]["rocks"] == 24


def test_the_calibrated_configuration_can_be_run(answered: Path) -> None:
    """It has what is recommended: the last rung whose gain over the simpler ones clears zero."""
    settings = load_config(answered / "model" / "config.toml")
    found = json.loads((answered / "diagnosis.json").read_text())
    clears = {r["rung"] for r in found["ladder"] if r["gain"] and r["gain_ci95"][0] > 0.0}
    recommended, why = found["advice"]["recommended"], found["advice"]["why"]
    assert recommended == "configured" or recommended in clears
    # Scatter to the side is no part of the motion on fall lines.
    assert settings.effects.names == (("fragmentation",) if recommended == "fragmentation" else ())
    kept = "Keep the configured ground." in found["first_sentence"]
    assert kept == (recommended == "configured")
    assert bool(why) == (recommended != "fragmentation") and why[1:] in found["first_sentence"]


def test_the_model_that_is_handed_over_is_the_one_scored(everything: Path, answered: Path) -> None:
    """Read back, it lets the rocks go as it did when it was scored, and leaves that distance."""
    kept = json.loads((answered / ENSEMBLE).read_text())

    def problem_of(config: Path) -> SiteData:
        return site_data_of(read_case(config, everything / OBSERVATIONS_NAME), kept["seed"])

    def distance(problem: SiteData, model: HypothesisModel, name: str) -> float:
        rows = model_rows(problem, model, kept[name]["number"], kept["count"])
        return RockDistances.of(problem.rows, rows).value()

    problem = problem_of(everything / CONFIG_NAME)
    assert kept["scale"]["names"] == list(problem.scale.names)
    assert kept["scale"]["scale"] == problem.scale.scale.tolist()
    models = {name: model_from_json(kept[name]["model"]) for name in MODELS}
    for name, model in models.items():
        assert distance(problem, model, name) == pytest.approx(kept[name]["distance"], rel=1e-5)
    # So does the configuration beside it, which has no factor and scatter of the rotations.
    problem, turning = problem_of(answered / "model" / "config.toml"), models["effect"].measurement
    own = MeasurementError(
        rotation_scale=turning.rotation_scale, rotation_noise=turning.rotation_noise
    )
    model = replace(configured_model(problem.case), measurement=own)
    assert distance(problem, model, "effect") == pytest.approx(kept["effect"]["distance"], rel=1e-5)


def test_the_ladder_and_the_first_sentence_are_there(answered: Path) -> None:
    found = json.loads((answered / "diagnosis.json").read_text())
    rungs = [r["rung"] for r in found["ladder"]]
    effect = found["verdict"]["effect"]
    assert rungs == ["configured", "ground", "contact_law", effect, "floor"]
    assert re.match(r"(At|Between|Before|In the run-out|As configured)", found["first_sentence"])
    assert "blocks that break at impacts" in found["first_sentence"].partition(". ")[0]
    assert found["first_sentence"] in unescape((answered / "report.html").read_text())
    assert {c["quantity"] for c in found["advice"]["consequences"]} == {
        "runout_m (median)", "runout_m (90 %)", "runout_m (width)", "energy_kj (median)",
        "energy_kj (90 %)", "arrived (mean)",
    }  # fmt: skip
    settings = found["advice"]["settings"]
    assert all(s["ci95"][0] <= s["value"] <= s["ci95"][1] for s in settings)


@pytest.mark.battery
def test_processes_change_nothing_and_an_interruption_leaves_nothing(
    everything: Path, answered: Path, tmp_path: Path
) -> None:
    def stop(done: int, total: int, rocks: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        run(everything, tmp_path / "out", report=False, on_progress=stop)
    assert not (tmp_path / "out").exists()
    run(everything, tmp_path / "two", report=False, jobs=2)
    expected = json.loads((answered / "diagnosis.json").read_text())
    assert json.loads((tmp_path / "two" / "diagnosis.json").read_text()) == expected


def test_draws_that_were_changed_are_made_again(tmp_path: Path) -> None:
    made: list[int] = []
    said: list[str] = []
    # Steps that are looked at have one number and differ in their parameters.
    trials = [Trial(min(k, 1), np.array([0.1 * k, 0.5]), 2) for k in range(3)]

    def scores(name: str) -> list[float]:
        made.clear()
        store = DrawStore(tmp_path / name, "own", said.append)

        def run(due: list[Trial]) -> list[Seen]:
            made.extend(round(10.0 * one.at[0]) for one in due)
            return [Seen(one.at + one.number, one.at.sum()) for one in due]

        seen = store.seen(trials, run=run, step=lambda: None)
        assert all(
            np.array_equal(n, t.at + t.number) for t, (n, _) in zip(trials, seen, strict=True)
        )
        return [score for _, score in seen]

    first = scores("one.npz")
    assert made == [0, 1, 2] and scores("one.npz") == first and not made and not said
    change_arrays(tmp_path / "one.npz", lambda arrays: arrays["scores"].__imul__(0.5))
    assert scores("one.npz") == first and made == [0, 1, 2]
    shutil.copy(tmp_path / "one.npz", tmp_path / "two.npz")
    assert scores("two.npz") == first and len(made) == 3
    assert said == [unfit(tmp_path / "one.npz"), unfit(tmp_path / "two.npz")]


@pytest.mark.battery
def test_little_is_enough_for_an_answer_and_what_is_not_read_is_warned_of(tmp_path: Path) -> None:
    """15 rocks at stations; a column that is not known, and a key of a former version."""
    case = make_case(tmp_path / "case", "stations", 15)
    rewrite(case, "passages", lambda rows: [row | {"speed_kmh": "1"} for row in rows])
    with (case / CONFIG_NAME).open("a", encoding="utf-8") as file:
        file.write('\n[hazard]\nblocks = "auto"\nuncertain_share_max = 0.3\n')
    found = run(case, tmp_path / "out")
    assert found.verdict.effect in ("none", "unknown", "contact_law")
    assert any("15 rocks" in line for line in found.not_identifiable)
    assert any("passages.speed_kmh: column is not known" in line for line in found.warnings)
    assert "hazard.uncertain_share_max" in found.warnings[0]
    assert "changed_share_max" in found.warnings[0]
    manifest, told = (
        json.loads((tmp_path / "out" / name).read_text())
        for name in ("manifest.json", "diagnosis.json")
    )
    assert manifest["warnings"][0] == found.warnings[0]
    assert told["data"]["warnings"] == list(found.warnings)
    assert "changed_share_max" in (tmp_path / "out/report.html").read_text()


@pytest.mark.battery
def test_stops_alone_are_enough_for_an_answer(tmp_path: Path) -> None:
    found = run(make_case(tmp_path / "case", "stops", 15), tmp_path / "out")
    assert found.verdict.effect in ("none", "unknown")
    seen = {f.effect for f in found.fingerprints if f.observable}
    assert seen.isdisjoint({"rock_shape", "roughness", "trees", "air_drag"})
    assert any("15 rocks" in line for line in found.not_identifiable)


Rows = list[dict[str, str]]


def rewrite(case: Path, table: str, change: Callable[[Rows], Rows]) -> None:
    """Change the rows of a table of a case."""
    file = case / OBSERVATIONS_NAME / f"{table}.csv"
    with file.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    with file.open("w", encoding="utf-8", newline="") as stream:
        changed = change(rows)
        writer = csv.DictWriter(stream, list((changed or rows)[0]))
        writer.writeheader()
        writer.writerows(changed)


@pytest.mark.battery
def test_rocks_in_two_groups_are_answered_with_a_warning(everything: Path, tmp_path: Path) -> None:
    def grouped(rows: Rows) -> Rows:
        days = ("tuesday", "monday", "monday")
        return [row | {"group": days[k % 3]} for k, row in enumerate(rows)]

    case = Path(shutil.copytree(everything, tmp_path / "case"))
    rewrite(case, "rocks", grouped)
    read = read_case(case / CONFIG_NAME, case / OBSERVATIONS_NAME)
    assert sorted(np.bincount(read.group).tolist()) == [8, 16]
    assert np.bincount(site_data_of(read, 1).part).tolist() in ([8, 16], [16, 8])
    found = run(case, tmp_path / "out")
    assert any("2 groups" in line for line in found.warnings)
    assert not any(f.observable for f in found.fingerprints)
    assert found.verdict.effect in ("none", "unknown", "contact_law")


@pytest.mark.battery
def test_poor_observations_are_answered_or_refused_in_one_line(
    everything: Path, tmp_path: Path
) -> None:
    poor, few, bare = (
        Path(shutil.copytree(everything, tmp_path / name)) for name in ("poor", "few", "bare")
    )
    # No masses, exact instruments, one station.
    for table in ("rocks", "passages", "deposits", "impacts"):
        rewrite(poor, table, lambda rows: [row | {"mass_kg": ""} for row in rows])
    rewrite(
        poor, "metadata", lambda rows: [r | {"value": "0"} for r in rows if "error" in r["key"]]
    )
    rewrite(poor, "stations", lambda rows: rows[:1])
    found = run(poor, tmp_path / "out")
    assert found.rocks == 24 and found.ladder
    rewrite(few, "rocks", lambda rows: rows[:3])
    with pytest.raises(InputError, match="too few rocks") as caught:
        run(few, tmp_path / "out3")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out3").exists()
    for table in ("passages", "deposits", "impacts"):
        rewrite(bare, table, lambda _rows: [])
    with pytest.raises(InputError, match="nothing to compare simulations with"):
        run(bare, tmp_path / "out4")


def test_the_frozen_thresholds_are_whole() -> None:
    content = read_thresholds()
    thresholds = thresholds_of(content)
    assert 2026 not in content["battery_seeds"]
    assert 0.0 < thresholds.level <= 0.05 < thresholds.second
