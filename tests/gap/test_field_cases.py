"""The field cases: as their sources say, and nothing is fitted on what is scored."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.scripts import run_script

from sassgis.gap.which.identifiable import what_is_identifiable
from sassgis.io.read.observation_files import read_observations, validate_observations
from sassgis.model.errors import InputError, OutputError
from sassgis.runs.gap_case import read_case

pytestmark = pytest.mark.battery

ROWS = {"tschamut2014": 62, "chant_sura_2020": 11, "authume_quarry_p1": 41}
PIPELINES = {
    "tschamut2014": "gap_tschamut2014",
    "chant_sura_2020": "gap_chant_sura",
    "authume_quarry_p1": "gap_authume",
}


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    import field_cases.tables

    return field_cases.tables


@pytest.fixture(scope="module")
def written(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    made: dict[str, Any] = {}

    def write(folder: str) -> Any:
        if not (shared_data / folder).is_dir():
            pytest.skip(f"{folder} is not in the folder of the field data")
        if folder not in made:
            script = __import__(PIPELINES[folder])
            made[folder] = script.write(shared_data, tmp_path_factory.mktemp(folder))
        return made[folder]

    return write


@pytest.mark.parametrize("folder", PIPELINES)
def test_a_case_is_readable_and_passes_the_check(
    folder: str, written: Callable[[str], Any], tables: ModuleType
) -> None:
    case = written(folder)
    grid = tables.terrain_of(case.config)
    for observations in case.observations.values():
        seen = read_observations(observations, grid)
        assert [f for f in validate_observations(seen, grid) if f.level == "error"] == []
        assert len(seen.rocks) > 0
    read = read_case(case.config, case.observations["all"])
    assert read.n_rocks == len(pd.read_csv(case.observations["all"] / "rocks.csv"))


@pytest.mark.parametrize("folder", PIPELINES)
def test_no_rock_is_fitted_and_scored(folder: str, written: Callable[[str], Any]) -> None:
    case = written(folder)
    everything = set(pd.read_csv(case.observations["all"] / "rocks.csv")["rock_id"])
    for fit, left_out in case.splits.values():
        ids = [
            set(pd.read_csv(case.observations[k] / "rocks.csv")["rock_id"]) for k in (fit, left_out)
        ]
        assert ids[0] and ids[1] and not ids[0] & ids[1]
        assert ids[0] | ids[1] <= everything
        for table in case.observations[fit].glob("*.csv"):
            frame = pd.read_csv(table)
            if "rock_id" in frame:
                assert set(frame["rock_id"]) <= ids[0]


def test_tschamut_has_the_runs_of_its_source_less_the_copy(written: Callable[[str], Any]) -> None:
    case = written("tschamut2014")
    rocks = pd.read_csv(case.observations["all"] / "rocks.csv")
    assert len(rocks) == ROWS["tschamut2014"] - 1
    assert any("['v034']" in note for note in case.notes)
    assert sorted(rocks["mass_kg"].unique()) == [40.0, 69.0, 79.0]
    fit, left_out = case.splits["plate"]
    masses = [
        set(pd.read_csv(case.observations[k] / "rocks.csv")["mass_kg"]) for k in (fit, left_out)
    ]
    assert masses == [{69.0, 79.0}, {40.0}]
    # The model gives the rock the mass that was weighed.
    axes = rocks[[f"semi_axis_{c}_m" for c in "abc"]].to_numpy()
    volume = 4.0 / 3.0 * np.pi * axes.prod(axis=1)
    assert np.allclose(volume * rocks["density_kgm3"], rocks["mass_kg"])


def test_run_outs_are_those_of_the_source(written: Callable[[str], Any], shared_data: Path) -> None:
    case = written("tschamut2014")
    source = pd.read_csv(shared_data / "tschamut2014" / "observed_deposition.csv")
    known = source.set_index("trajectory_id")["observed_runout_m"]
    rocks = pd.read_csv(case.observations["all"] / "rocks.csv").set_index("rock_id")
    stops = pd.read_csv(case.observations["all"] / "deposits.csv").set_index("rock_id")
    plan = np.hypot(stops["x"] - rocks["x"], stops["y"] - rocks["y"])
    assert np.allclose(plan, known.loc[plan.index], atol=1e-3)


def test_contacts_keep_the_energies_of_the_source(
    written: Callable[[str], Any], shared_data: Path
) -> None:
    case = written("chant_sura_2020")
    contacts = pd.read_csv(case.config.parent / "contacts.csv")
    source = pd.read_csv(shared_data / "chant_sura_2020" / "observed_contact_events_extended.csv")
    assert len(contacts) == ROWS["chant_sura_2020"]
    for side, column in (("in", "pre_impact_kinetic_j"), ("out", "post_impact_kinetic_j")):
        speed = np.hypot(contacts[f"vt_{side}_mps"], contacts[f"vn_{side}_mps"])
        energy = 0.5 * contacts["mass_kg"] * speed**2
        assert np.allclose(energy, source[column], rtol=1e-6)
    used = pd.read_csv(case.observations["all"] / "impacts.csv")
    assert 0 < len(used) == contacts["left_out"].isna().sum() < len(contacts)
    assert (used["vn_in_mps"] < 0.0).all() and (used["vn_out_mps"] > 0.0).all()
    assert (used["impact"] > 0).all()


def test_authume_keeps_its_terrain_where_it_lies(
    written: Callable[[str], Any], shared_data: Path
) -> None:
    case = written("authume_quarry_p1")
    rocks = pd.read_csv(case.observations["all"] / "rocks.csv")
    assert len(rocks) == ROWS["authume_quarry_p1"]
    assert not list(case.config.parent.rglob("*.tif"))
    told = what_is_identifiable(read_observations(case.observations["all"]))
    assert any(line.startswith("No release points") for line in told.not_identifiable)


def test_halves_are_even_in_each_stratum(tables: ModuleType) -> None:
    strata = {f"R{i}": "abbcccc"[i % 7] for i in range(63)}
    fit, left_out = tables.split_in_two(strata, seed=3)
    assert sorted(fit + left_out) == sorted(strata)
    for name in "abc":
        sizes = [sum(strata[r] == name for r in half) for half in (fit, left_out)]
        assert abs(sizes[0] - sizes[1]) <= 1
    assert abs(len(fit) - len(left_out)) <= 1
    assert tables.split_in_two(strata, seed=3) == (fit, left_out)
    assert tables.split_in_two(strata, seed=4) != (fit, left_out)


def test_data_that_are_not_there_are_told_in_one_line(
    repository: Path, tmp_path: Path, tables: ModuleType
) -> None:
    for script in PIPELINES.values():
        file = repository / "pipelines" / f"{script}.py"
        done = run_script(file, tmp_path, "-o", tmp_path / "out")
        assert done.code != 0
        assert len(done.err.strip().splitlines()) == 1
        assert "the field data are not here" in done.err
    with pytest.raises(InputError):
        tables.field_file(tmp_path, "tschamut2014", "terrain.asc")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(OutputError):
        tables.fresh(tmp_path / "full")
    assert (tmp_path / "full" / "file").is_file()


def test_a_plane_keeps_its_normal(tmp_path: Path) -> None:
    from field_cases.contacts import Ground

    rows, cols = np.indices((60, 60))
    heights = 100.0 + 0.5 * (cols + 0.5) * 0.05 + 0.25 * (rows + 0.5) * 0.05
    text = "ncols 60\nnrows 60\nxllcorner 10\nyllcorner 20\ncellsize 0.05\nNODATA_value -9999\n"
    file = tmp_path / "plane.asc"
    file.write_text(text + "\n".join(" ".join(f"{v:.9f}" for v in row) for row in heights))
    normal, height = Ground(file).plane(11.5, 21.5)
    # Up to the east by a half, and to the south by a quarter.
    expected = np.array([-0.5, 0.25, 1.0])
    assert np.allclose(normal, expected / np.linalg.norm(expected), atol=1e-6)
    assert height == pytest.approx(100.0 + 0.5 * 1.5 + 0.25 * 1.5, abs=1e-6)


def test_the_base_law_is_that_of_the_engine_and_soft_ground_takes_energy() -> None:
    from field_cases.impact_law import State, defaults, ground_class, predict

    from sassgis.engine.effects import hooks
    from sassgis.engine.simulate import physics_of
    from sassgis.gap.residuals.impact_step import impact_draws
    from sassgis.model.effects import EffectSettings
    from sassgis.model.ground import GroundTable
    from sassgis.model.settings import EngineSettings

    state = State(0.5, 9.0, -5.0, 12.0, (0.5, 0.4, 0.3), 500.0)
    ground = ground_class()
    made = {
        name: predict(state, law, np.random.default_rng(4), draws=3000)
        for name, law in defaults(ground).items()
    }
    rng = np.random.default_rng(5)
    drawn = np.zeros((1, 3000, 3))
    drawn[..., 0] = rng.uniform(0.0, np.pi, 3000)
    drawn[..., 1] = rng.uniform(ground.dp_min, ground.dp_max, 3000)
    out = np.empty((1, 3000, 3))
    impact_draws(
        np.array([[state.dip, state.vt, state.vn, state.omega]]), np.zeros(1, np.int64),
        np.tile(state.axes, (1, 3000, 1)), drawn,
        np.zeros((1, 3000), np.uint64), np.array([2700.0]),
        hooks.ground_of(EffectSettings(), GroundTable((ground,)).with_rolling_threshold(0.1)),
        np.zeros(1, hooks.BLOCK_DTYPE), physics_of(EngineSettings(readings="1986").resolved()),
        None, out,
    )  # fmt: skip
    base = made["base"]
    # The same law under other draws: means agree within their standard errors.
    for q in range(3):
        error = np.hypot(base[:, q].std(), out[0, :, q].std()) / np.sqrt(3000)
        assert abs(base[:, q].mean() - out[0, :, q].mean()) < 5.0 * error
    assert made["scar"][:, 3].mean() < base[:, 3].mean()
    assert made["velocity_scaled"][:, 1].mean() < base[:, 1].mean()


def test_a_gap_that_is_put_in_is_found() -> None:
    from field_cases.study import compare

    rng = np.random.default_rng(1)
    made = rng.normal(50.0, 5.0, (40, 60, 2))
    seen = rng.normal(50.0, 5.0, (40, 2))
    labels = ["near", "far"] * 20
    seen[1::2, 0] += 8.0
    report = compare(seen, made, labels, 3)
    far, near = report["far"]["runout_m"], report["near"]["runout_m"]
    assert far["ci95"][0] < 8.0 < far["ci95"][1] and far["p_adjusted"] < 0.01
    assert near["p_adjusted"] > 0.05 and abs(near["gap"]) < 4.0
    assert report["all"]["rocks"] == 40


def test_what_is_left_out_is_not_calibrated_on(monkeypatch: pytest.MonkeyPatch) -> None:
    import field_cases.impact_law
    from field_cases.impact_law import FORMS, State, left_out_scores

    monkeypatch.setattr(field_cases.impact_law, "ETA_MAX", (0.2, 0.7))

    states = [State(0.6, 8.0, -4.0, 10.0, (0.3, 0.3, 0.15), 200.0)] * 3
    seen = np.tile([4.0, 0.5, 12.0, 0.35, 0.3], (3, 1))
    seen[:, 0] += np.array([0.0, 0.2, 0.4])
    before = left_out_scores(states, seen, ["a", "b", "c"], (0, 2), 1, draws=60)
    other = seen.copy()
    other[2, :3] = 9.0, 3.0, 30.0
    after = left_out_scores(states, other, ["a", "b", "c"], (0, 2), 1, draws=60)
    assert set(before) == set(FORMS)
    for form in FORMS:
        # Another outcome of c leaves what is predicted for it alone.
        assert np.allclose(before[form]["mean"][2], after[form]["mean"][2])


def test_held_out_shrinkage_is_withheld_where_nothing_is_to_gain(
    written: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A base that is as good as its replicates leaves no gap to shrink."""
    import field_cases.study as module

    case = written("tschamut2014")
    read = read_case(case.config, case.observations["plate_left_out"])
    rng = np.random.default_rng(2)
    seen, made = rng.normal(size=(20, 2)), rng.normal(size=(20, module.CAMPAIGNS, 2))
    monkeypatch.setattr(module, "stops", lambda *_: (seen, made))
    named = SimpleNamespace(effect="air_drag")
    report = module.held_out(read, SimpleNamespace(base=None, effect=None, verdict=named), 1)
    assert report["shrinkage"] is None
    worse = made + 10.0
    monkeypatch.setattr(
        module, "stops", lambda _case, model, _seed: (seen, made if model == "effect" else worse)
    )
    answer = SimpleNamespace(base="base", effect="effect", verdict=named)
    report = module.held_out(read, answer, 1)
    assert 0.9 < report["shrinkage"] < 1.1
    answer.verdict = SimpleNamespace(effect="unknown")
    assert module.held_out(read, answer, 1)["shrinkage"] is None


def test_the_ground_is_calibrated_on_the_rocks_to_fit_on_alone(
    written: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    import field_cases.study as module

    case = written("tschamut2014")
    _, left_out = case.splits["plate"]
    scored = len(pd.read_csv(case.observations[left_out] / "rocks.csv"))
    wanted = {"fit": 0.3, "left_out": 0.6}

    def stops(read: Any, model: Any, seed: int) -> tuple[Any, Any]:
        """Rocks that come as far as 100 m times μ_0, and were seen at 30 m or 60 m."""
        n = read.n_rocks
        side = "left_out" if n == scored else "fit"
        mu_0 = model.table.classes[model.table.index("soft_meadow")].mu_0
        rng = np.random.default_rng(seed)
        made = 100.0 * mu_0 + rng.normal(size=(n, module.CAMPAIGNS, 2))
        return 100.0 * wanted[side] + rng.normal(size=(n, 2)), made

    monkeypatch.setattr(module, "stops", stops)
    report = module.recalibrated(case, *case.splits["plate"], 3)
    assert report["mu_0"] == 0.3
    assert report["recalibrated"]["gap_m"] == pytest.approx(30.0, abs=1.0)
    assert abs(report["untuned"]["gap_m"]) < 1.0


def test_pages_hold_the_tables_of_the_results(repository: Path) -> None:
    folder = repository / "docs" / "studies"
    spec = importlib.util.spec_from_file_location("gap_tables", folder / "gap_tables.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    seen = set()
    for page in folder.glob("gap_*.md"):
        text = page.read_text(encoding="utf-8")
        seen |= set(re.findall(r"<!-- gap: (.+?) -->", text))
        assert module.filled(text) == text, f"{page.name}: run python docs/studies/gap_tables.py"
    assert seen == set(module.TABLES)
