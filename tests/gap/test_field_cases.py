"""The field cases: as their sources say, and nothing is fitted on what is scored."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.scripts import load, run_script

from sassgis.errors import InputError, OutputError
from sassgis.gap.advice.measure_next import what_is_identifiable
from sassgis.gap.observations.observed import rock_radii_m
from sassgis.gap.observations.projection import contact_numbers, contacts_of
from sassgis.inputs.ground_map import built_in_table
from sassgis.inputs.observation_files import read_observations, validate_observations
from sassgis.runs.calibrate import read_case

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
            written = script.write(shared_data, tmp_path_factory.mktemp(folder))
            made[folder] = getattr(written, "case", written)
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


def test_contacts_at_tschamut_give_speeds_and_heights_all_along(
    written: Callable[[str], Any], shared_data: Path
) -> None:
    """As computed independently of the package from the contacts of the source."""
    if not (shared_data / "tschamut2014" / "contacts.csv").is_file():
        pytest.skip("no contacts at Tschamut in the folder of the field data")
    case = written("tschamut2014")
    read = read_case(case.config, case.observations["all"])
    seen = read.observations
    assert (~np.isfinite(seen.contacts.t_end_s)).sum() == 1
    assert "computed from contacts" in " ".join(f.problem for f in seen.findings)
    shares, passed = [0.1, 0.5, 0.9], seen.passages
    for station, speeds in {
        "20 m": [8.6, 10.9, 13.2], "40 m": [8.4, 11.6, 15.0], "60 m": [7.6, 11.1, 13.8],
    }.items():  # fmt: skip
        here = passed.station == station
        assert here.sum() > 50
        found = np.nanquantile(passed.speed_mps[here], shares)
        assert np.allclose(found, speeds, rtol=0.06), (station, found)
    rest = rock_radii_m(seen)[seen.rock_of("passages")]
    above = (passed.height_m - rest)[passed.station == "40 m"]
    assert np.allclose(np.nanquantile(above, [0.5, 0.9]), [0.33, 1.25], atol=0.15)
    numbers = contact_numbers(contacts_of(seen), read.radius_m)
    for name, values in {"contacts": [25, 29, 38], "fastest_second": [10.7, 13.0, 15.0]}.items():
        found = np.nanquantile(numbers[name], shares)
        assert np.allclose(found, values, rtol=0.03), (name, found)
    assert np.nanmedian(numbers["rim_ratio"]) == pytest.approx(0.79, abs=0.02)


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


def test_soft_ground_takes_energy() -> None:
    from field_cases.impact_law import State, defaults, ground_class, predict

    state = State(0.5, 9.0, -5.0, 12.0, (0.5, 0.4, 0.3), 500.0)
    made = {
        name: predict(state, law, np.random.default_rng(4), draws=3000, error=0.0)
        for name, law in defaults(ground_class()).items()
    }
    assert (made["base"][:, 3] <= ground_class().eta_max + 1e-9).all()
    assert made["scar"][:, 3].mean() < made["base"][:, 3].mean()
    assert made["velocity_scaled"][:, 1].mean() < made["base"][:, 1].mean()


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


def test_only_the_rocks_to_fit_on_are_fitted(
    written: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import field_cases.study as module

    case = written("tschamut2014")
    fit, left_out = case.splits["plate"]
    fitted, scored = [], []
    answer = SimpleNamespace(
        rocks=1, first_sentence="", not_identifiable=(), measure_next=(), which=(), ladder=(),
        where=(), verdict=SimpleNamespace(effect="", base="", confidence=0, confusion_set=(),
                                          reason=""),
        shrinkage=SimpleNamespace(value=None, ci95=None, note=""),
    )  # fmt: skip
    monkeypatch.setattr(
        module, "calibrate", lambda sites, out, **_: fitted.extend(sites) or
        SimpleNamespace(fitted=())
    )  # fmt: skip
    monkeypatch.setattr(
        module, "diagnose", lambda config, seen, out, **_: fitted.append((config, seen)) or answer
    )
    monkeypatch.setattr(
        module, "left_out_scores", lambda config, seen, seed: scored.append((config, seen))
    )
    given = SimpleNamespace(output=tmp_path, jobs=1, seed=3)
    module.diagnosed(case, "plate", fit, left_out, given)
    assert fitted == 2 * [(case.config, case.observations[fit])]
    assert {seen for _, seen in scored} == {case.observations[left_out]}
    assert len({config for config, _ in scored}) == 3


def test_the_case_at_tschamut_has_the_former_values(written: Callable[[str], Any]) -> None:
    case = written("tschamut2014")
    read = read_case(case.config, case.observations["all"])
    own = read.table.classes[read.table.index("soft_meadow")]
    assert (own.mu_v, own.restitution, own.mu_0, own.rolling_threshold) == (0.0, 0.5, 0.31, 1.0)
    engine = read.engine.resolved()
    assert (engine.outline_edges, engine.outline_share, engine.drift_deg) == (0.0, 1.0, 4.0)


def test_a_step_is_fitted_to_one_half_and_keeps_only_friction_to_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import field_cases.added_steps as module

    asked = []

    def fitted(problem: Any, ground: str, names: Any, held: Any) -> dict[str, float]:
        asked.append((problem, ground, set(names)))
        return {**held, **dict.fromkeys(names, float(len(asked)))}

    monkeypatch.setattr(module, "fitted", fitted)
    meadow, slope = (
        module.Halves(ground, f"fit {ground}", "scored") for ground in ("meadow", "slope")
    )
    here, there = module.fit_step(meadow, slope, "resistance")
    assert asked == [
        ("fit meadow", "meadow", {"mu_0", "mu_f", "mu_v"}), ("fit slope", "slope", {"mu_0", "mu_f"})
    ]  # fmt: skip
    assert here == {"mu_0": 1.0, "mu_f": 1.0, "mu_v": 1.0}
    assert there == {"mu_0": 2.0, "mu_f": 2.0, "mu_v": 1.0}


def test_errors_of_quantiles_are_those_put_in() -> None:
    from field_cases.added_steps import errors

    rng = np.random.default_rng(5)
    seen = rng.gamma(20.0, 0.5, 60)
    seen[:6] = np.nan
    made = 1.3 * rng.gamma(20.0, 0.5, (30, 60))
    found = errors(seen, made, 3)
    assert found["rocks"] == 54
    for k, share in enumerate((0.1, 0.5, 0.9)):
        known = np.nanquantile(made, share) / np.nanquantile(seen, share) - 1.0
        assert found["error"][k] == pytest.approx(known, abs=1e-9)
        low, high = found["ci95"][k]
        assert low < 0.3 < high and high - low < 0.3
    assert errors(seen, seen[None], 3)["ci95"] == pytest.approx(np.zeros((3, 2)))


def test_rocks_left_out_are_scored_with_the_configuration_that_is_handed_over(
    written: Callable[[str], Any], tmp_path: Path
) -> None:
    from field_cases.study import left_out_scores

    case = written("tschamut2014")
    folder = case.config.parent
    own = next(c for c in built_in_table().classes if c.name == "soft_meadow")
    names = ("eta_max", "dp_min", "dp_max", "mu_f", "mu_0", "k", "d_star_m", "restitution",
             "restitution_speed_mps", "rolling_threshold")  # fmt: skip
    values = {name: getattr(own, name) for name in names} | {"eta_max": 0.95, "mu_0": 0.1}
    (tmp_path / "classes.csv").write_text(
        f"name,{','.join(names)},source,trust\n"
        f"soft_meadow,{','.join(str(v) for v in values.values())},test,estimate\n"
    )
    text = case.config.read_text().replace("former_classes.csv", "classes.csv")
    for file in ("dem.tif", "release.gpkg"):
        text = text.replace(f'"{file}"', f'"{folder / file}"')
    (tmp_path / "config.toml").write_text(text)
    observed = case.observations[case.splits["plate"][1]]
    found = [left_out_scores(c, observed, 3) for c in (case.config, tmp_path / "config.toml")]
    assert found[0]["rocks"] == len(pd.read_csv(observed / "rocks.csv"))
    assert found[1]["predicted"][1] > 20.0 + found[0]["predicted"][1]
    for one in found:
        assert one["ci95"][0] < one["gap_m"] < one["ci95"][1]


def test_pages_hold_the_tables_of_the_results(repository: Path) -> None:
    folder = repository / "docs" / "studies"
    module = load(folder / "gap_tables.py")
    seen = set()
    for page in module.PAGES:
        text = page.read_text(encoding="utf-8")
        seen |= set(re.findall(r"<!-- gap: (.+?) -->", text))
        assert module.filled(text) == text, f"{page.name}: run python docs/studies/gap_tables.py"
    assert seen == set(module.TABLES)


def test_a_campaign_of_another_program_is_a_case_that_can_be_read(
    shared_data: Path, repository: Path, tmp_path: Path
) -> None:
    if not (shared_data / "authume_rockable_p1").is_dir():
        pytest.skip("authume_rockable_p1 is not in the folder of the field data")
    module = load(repository / "pipelines" / "gap_authume_program.py")
    options = ["-o", str(tmp_path / "out"), "--campaigns", "1", "--case-only"]
    module.main([str(shared_data), *options])
    stated = pd.read_csv(tmp_path / "out" / "00" / "observed" / "metadata.csv")
    assert {"speed_error_rel", "position_error_m"} <= set(stated["key"])


def test_campaigns_of_another_program_are_noted_as_their_observer_can(shared_data: Path) -> None:
    from field_cases.program_campaigns import ProgramRuns, campaign

    if not (shared_data / "authume_rockable_p1").is_dir():
        pytest.skip("authume_rockable_p1 is not in the folder of the field data")
    runs = ProgramRuns.read(shared_data)
    plain, scaled = (campaign(runs, 60, True, effect, 5) for effect in ("", "scale"))
    start = campaign(runs, 60, True, "start", 5)
    impacts = plain.tables["impacts"]
    own = runs.contacts[runs.contacts["rock_id"].isin(plain.rocks["rock_id"])]
    assert 0.3 * len(own) < len(impacts) < len(own)
    assert -impacts["vn_in_mps"].max() > 0.2 * 0.8 and not impacts.isna().any().any()
    for name, column in (("impacts", "vt_in_mps"), ("trajectories", "speed_mps")):
        np.testing.assert_allclose(
            scaled.tables[name][column], 1.2 * plain.tables[name][column], rtol=1e-12
        )
    moved = start.rocks[["x", "y"]].to_numpy() - plain.rocks[["x", "y"]].to_numpy()
    np.testing.assert_allclose(np.hypot(*moved.T), 15.0)
    stops = start.rocks[["x_stop", "y_stop"]] - plain.rocks[["x_stop", "y_stop"]]
    assert not stops.to_numpy().any()
