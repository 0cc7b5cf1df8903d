from __future__ import annotations

import json
import math
import re
import sqlite3
import tomllib
from contextlib import closing
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from helpers.figure_parts import find, texts
from helpers.made_diagnosis import (
    CONFIG,
    FINDINGS,
    calibrated,
    finding,
    made_case,
    unnamed,
    with_trees,
    write_slope,
)
from helpers.observed_slope import LV95, NORTH, TAN
from scipy import stats

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.trees import Trees
from sassgis.errors import ConfigError, InputError, OutputError
from sassgis.files.atomic_output import check_output
from sassgis.gap.causes.all_causes import FAMILIES
from sassgis.gap.causes.cause import ParameterDraws
from sassgis.gap.diagnosis import Comparison, Diagnosis, Hypothesis, Rung
from sassgis.gap.fit.hypothesis_fit import draw
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import HypothesisModel, configured_model, in_plane
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import residuals_of
from sassgis.gap.verdict.verdict import limits_on, line_stretch, used_lines, where
from sassgis.gap.words import (
    QUANTITY_NAMES,
    place_words,
    quantity_name,
    significance,
)
from sassgis.grid import Grid
from sassgis.inputs.config import load_config
from sassgis.outputs.gap_files import write_config_back, write_diagnosis_json, write_gap_gpkg
from sassgis.outputs.layers.gap_map import stand_polygon
from sassgis.report import gap_report
from sassgis.report.figures import gap_figures as figures
from sassgis.report.figures.gap_figures import GapMap, GapStretch, _band
from sassgis.report.figures.style import GREY
from sassgis.report.gap_answer import answer, finding_sentence, verdict_sentence
from sassgis.report.gap_report import headline, map_parts, report_warnings
from sassgis.report.page import translated_report, write_report
from sassgis.runs.calibrate import read_case
from sassgis.runs.compare import map_change
from sassgis.runs.diagnose import write_outputs
from sassgis.runs.inputs import read_map_run
from sassgis.runs.run import run
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.languages import in_language
from sassgis.settings.map_run import Config
from sassgis.studies.result_change import ENERGY_MEAN, difference

Made = tuple[Path, Case]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, slope: Grid) -> Made:
    return made_case(tmp_path_factory.mktemp("made"), slope)


#: The same on the paths that maps follow.
FOLLOWED = CONFIG.replace('path = "fall_line"\n', "")


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory, slope: Grid) -> Made:
    return made_case(tmp_path_factory.mktemp("followed"), slope, config=FOLLOWED)


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory, slope: Grid) -> Made:
    return made_case(tmp_path_factory.mktemp("few"), slope, 15)


@pytest.fixture(scope="module")
def case(made: Made) -> Case:
    return made[1]


@pytest.fixture(scope="module")
def few_case(few: Made) -> Case:
    return few[1]


@pytest.fixture(scope="module")
def stops_only(tmp_path_factory: pytest.TempPathFactory, slope: Grid) -> Made:
    return made_case(tmp_path_factory.mktemp("stops"), slope, 15, passages=False)


def outputs(made: Made, diagnosis: Diagnosis, folder: Path) -> Path:
    """All that is written of a diagnosis."""
    config, case = made
    write_diagnosis_json(folder / "diagnosis.json", diagnosis)
    write_outputs(folder, case, diagnosis, load_config(config))
    return folder


@pytest.fixture(scope="module")
def written(made: Made, tmp_path_factory: pytest.TempPathFactory) -> Path:
    diagnosis = replace(with_trees(made[1]), warnings=("Said on the console.",))
    return outputs(made, diagnosis, tmp_path_factory.mktemp("written") / "out")


def written_back(made: Made, folder: Path, effect: HypothesisModel) -> Path:
    """The configuration of a diagnosis that hands over this model."""
    config, case = made
    diagnosis = replace(with_trees(case), effect=effect)
    return write_config_back(folder / "config.toml", load_config(config), diagnosis, case)


def words_of(page: Path) -> str:
    """What a reader of the page sees."""
    text = re.sub(r"<style>.*?</style>|<[^>]+>", " ", page.read_text(), flags=re.S)
    return " ".join(unescape(text).split())


# --- all of it -------------------------------------------------------------------------------


def test_everything_is_written_and_listed(written: Path) -> None:
    manifest = json.loads((written / "manifest.json").read_text())
    listed = {entry["path"] for entry in manifest["files"]}
    assert {
        "diagnosis.json", "gap.gpkg", "report.html", "model/config.toml", "model/forest.gpkg",
        "model/ground_classes.csv", "figures/gap_map.png", "figures/gap_where.png",
        "figures/gap_distributions.png", "figures/gap_hypotheses.png",
        "figures/gap_ladder.png",
    } == listed  # fmt: skip
    roles = {entry["role"] for entry in manifest["inputs"]}
    assert {"config", "dem", "release", "observations rocks.csv"} <= roles
    assert manifest["counts"]["rocks"] == 40


def test_equal_diagnoses_give_equal_files(made: Made, written: Path, tmp_path: Path) -> None:
    diagnosis = replace(with_trees(made[1]), warnings=("Said on the console.",))
    # As deep as the first, so that relative paths are the same.
    again = outputs(made, diagnosis, written.parent / "again")
    files = [p.relative_to(written) for p in written.rglob("*") if p.is_file()]
    assert [f for f in files if (again / f).read_bytes() != (written / f).read_bytes()] == []


def test_what_is_seen_and_closes_nothing_is_said_so(made: Made) -> None:
    diagnosis = with_trees(made[1])
    assert verdict_sentence(diagnosis) == ""
    nothing = replace(diagnosis.shrinkage, value=-0.1)
    said = verdict_sentence(replace(diagnosis, shrinkage=nothing))
    assert said == "Adding the effect does not close the gap on held-out rocks."
    unsure = replace(diagnosis.shrinkage, value=0.1, ci95=(-0.1, 0.3))
    said = verdict_sentence(replace(diagnosis, shrinkage=unsure))
    assert said.startswith("It is not certain that adding the effect closes the gap")
    # What another cause closes, as a bound, says nothing of what is named.
    other = replace(nothing, effect="air_drag")
    assert verdict_sentence(replace(diagnosis, shrinkage=other)) == ""


def test_how_far_it_shrinks_is_left_out_where_nothing_was_added(few: Made, tmp_path: Path) -> None:
    heading = "How far the gap shrinks"
    calibrated_only = unnamed(few[1], "none")
    kept = replace(
        calibrated_only, advice=replace(calibrated_only.advice, recommended="configured")
    )
    pages = [
        outputs(few, own, tmp_path / name)
        for name, own in (("changed", calibrated_only), ("kept", kept))
    ]
    shown = [heading in words_of(page / "report.html") for page in pages]
    drawn = [(page / "figures" / "gap_ladder.png").is_file() for page in pages]
    assert shown == drawn == [True, False]


def test_no_text_has_a_negative_distance_or_closes_more_than_all(few: Made, tmp_path: Path) -> None:
    made = with_trees(few[1])
    shrinkage = replace(
        made.shrinkage, value=1.18, ci95=(0.9, 1.31), distance_effect=-0.0713,
        distance_floor=-0.0011,
        by_quantity={"runout": {"base": 0.3, "effect": -0.0713, "floor": -0.0011,
                                "shrinkage": 1.18}},
    )  # fmt: skip
    ladder = (*made.ladder[:3], Rung("trees", -0.0713, 1.18, (0.9, 1.31)), Rung("floor", -0.0011))
    out = outputs(few, replace(made, shrinkage=shrinkage, ladder=ladder), tmp_path / "out")
    words = words_of(out / "report.html")
    assert re.findall(r"\b(?:118|131) %|[−-]0\.07|[−-]0\.001", words) == []
    assert "trees chance 100" in words and "run-out 0.3 chance 100" in words
    said = texts(figures.gap_ladder_figure(ladder))
    assert "closes 100 % (90 to 100); not distinguishable from chance" in said
    lengths = [
        find(figures.gap_ladder_figure(ladder), f"rung-{r.rung}")[0].get_width()
        for r in ladder[:-1]
    ]
    assert lengths == [1.6, 1.0, 0.9, 0.0]


@pytest.mark.parametrize("effect", ["none", "unknown"])
def test_nothing_named_is_written_too(few: Made, tmp_path: Path, effect: str) -> None:
    diagnosis = unnamed(few[1], effect)
    out = outputs(few, diagnosis, tmp_path / "out")
    words = words_of(out / "report.html")
    assert verdict_sentence(diagnosis) in words
    assert "Only 15 rocks were observed" in words
    assert "effects" not in tomllib.loads((out / "model" / "config.toml").read_text())
    assert not (out / "model" / "forest.gpkg").exists()


def test_stops_alone_are_enough(stops_only: Made, tmp_path: Path) -> None:
    longer = finding("all", "stopping", "runout_m", -21.0)
    made = with_trees(stops_only[1])
    verdict = replace(made.verdict, probabilities={})
    diagnosis = replace(made, verdict=verdict, where=(longer,), which=())
    out = outputs(stops_only, diagnosis, tmp_path / "out")
    assert not (out / "figures" / "gap_hypotheses.png").exists()
    assert len(gpd.read_file(out / "gap.gpkg", layer="stations")) == 0
    assert len(gpd.read_file(out / "gap.gpkg", layer="stops")) == 16


def test_a_diagnosis_that_found_nothing_at_all_is_written(few: Made, tmp_path: Path) -> None:
    diagnosis = replace(
        unnamed(few[1], "none"), where=(), which=(), comparisons=(), not_identifiable=(),
        measure_next=(), tables={},
    )  # fmt: skip
    out = outputs(few, diagnosis, tmp_path / "out")
    assert "No place has enough data for a comparison." in words_of(out / "report.html")


def test_local_coordinates_are_written(slope: Grid, tmp_path: Path) -> None:
    text = CONFIG.replace("[terrain]", '[terrain]\ncrs = "local"')
    own = made_case(tmp_path, replace(slope, crs=""), 6, config=text)
    out = outputs(own, with_trees(own[1]), tmp_path / "out")
    stops = gpd.read_file(out / "gap.gpkg", layer="stops")
    assert stops.crs.name == "Undefined Cartesian SRS"
    assert "local coordinates" in words_of(out / "report.html")
    stand = read_map_run(load_config(out / "model" / "config.toml")).forest
    assert stand is not None and stand.stems_per_m2.max() > 0.0


# --- diagnosis.json --------------------------------------------------------------------------


def test_json_holds_the_agreed_keys_and_no_nan(case: Case, tmp_path: Path) -> None:
    diagnosis = with_trees(case)
    broken = replace(diagnosis, where=(*FINDINGS, finding("all", "release", "speed_mps", math.inf)))
    write_diagnosis_json(tmp_path / "deep" / "d.json", broken)

    def refuse(name: str) -> Any:
        raise AssertionError(name)

    read = json.loads((tmp_path / "deep" / "d.json").read_text(), parse_constant=refuse)
    assert read["verdict"]["effect"] == "trees"
    assert read["verdict"]["confusion_set"] == ["trees", "soft_ground"]
    assert read["where"][0]["ci95"] == [pytest.approx(-2.75), pytest.approx(-1.45)]
    assert read["where"][8]["x"] is None
    assert read["where"][-1]["gap"] == "inf"
    assert read["which"][0]["parameters"]["stems_per_ha"] == 420.0
    assert read["shrinkage"]["value"] == 0.74
    assert read["data"]["rocks"] == 40 and read["data"]["cannot_tell"]
    assert read["seed"] == 1 and len(read["settings_hash"]) == 64


# --- the map ---------------------------------------------------------------------------------


def test_every_finding_is_on_one_layer_of_the_map(written: Path) -> None:
    points = gpd.read_file(written / "gap.gpkg", layer="gap_points")
    stretches = gpd.read_file(written / "gap.gpkg", layer="gap_stretches")
    assert len(points) + len(stretches) == len(FINDINGS)
    assert set(points.place) == {"S1", "S2", "ground:debris"}
    assert set(stretches.place) == {"release-S1", "S1-S2", "S2-end", "all"}
    # Kinds of ground have no place of their own here.
    assert points.geometry.isna().tolist() == (points.place == "ground:debris").tolist()


def test_stretches_lie_between_the_stations(written: Path) -> None:
    stretches = gpd.read_file(written / "gap.gpkg", layer="gap_stretches")
    reach = stretches[stretches.place == "S1-S2"].geometry.iloc[0]
    _, low, _, high = reach.bounds
    # S1 lies 100 m, S2 190 m below the northern edge.
    assert low == pytest.approx(NORTH - 190.0, abs=0.01)
    assert high == pytest.approx(NORTH - 100.0, abs=0.01)
    assert len(reach.geoms) == 40


def test_what_is_surest_lies_on_top_and_has_the_label(written: Path) -> None:
    points = gpd.read_file(written / "gap.gpkg", layer="gap_points")
    at_s2 = points[points.place == "S2"]
    assert at_s2.shown_as.tolist() == ["less_likely", "less"]
    assert at_s2.label.iloc[-1] == "speed −2.1 m/s"
    assert at_s2.label.isna().tolist() == [True, False]
    # Not told from chance: no label, however it ranks.
    assert points[points.place == "S1"].label.isna().all()


def test_layers_bring_their_styles(written: Path) -> None:
    with closing(sqlite3.connect(written / "gap.gpkg")) as database:
        styles = dict(database.execute("SELECT f_table_name, styleQML FROM layer_styles"))
        facts = dict(database.execute("SELECT key, value FROM run_metadata"))
    assert set(styles) == {
        "gap_points", "gap_stretches", "stations", "fall_lines", "stops", "impacts", "stand",
    }  # fmt: skip
    assert 'label="less observed, significant"' in styles["gap_points"]
    assert facts["effect"] == "trees" and facts["confusion_set"] == "trees, soft_ground"


def test_stops_impacts_and_stations_tell_what_was_seen(case: Case, written: Path) -> None:
    stops, impacts, stations = (
        gpd.read_file(written / "gap.gpkg", layer=name) for name in ("stops", "impacts", "stations")
    )
    assert stops.kind.value_counts().to_dict() == {"rock": 39, "piece": 1, "unattributed": 1}
    assert stops[stops.kind == "piece"].rock.tolist() == ["R0"]
    runout = next(c for c in with_trees(case).comparisons if c.quantity == "runout_m")
    expected = stops.runout_m - np.mean(runout.base)
    assert np.allclose(stops.residual_m, expected, atol=0.02)
    before = math.hypot(10.0, 5.0)
    assert len(impacts) == 20 and np.allclose(impacts.speed_in_mps, before, atol=1e-3)
    assert np.allclose(impacts.energy_kept, (impacts.speed_out_mps / before) ** 2, atol=1e-3)
    assert stations.name.tolist() == ["S1", "S2"] and stations.rocks.tolist() == [40, 40]
    assert stations.chainage_m.tolist() == [pytest.approx(80, abs=1), pytest.approx(170, abs=1)]


def test_the_gpkg_is_not_overwritten(case: Case, written: Path) -> None:
    with pytest.raises(OutputError, match=r"gap\.gpkg: exists already"):
        write_gap_gpkg(written / "gap.gpkg", case, with_trees(case))


def test_reaches_of_a_line_end_at_its_own_crossings(case: Case) -> None:
    line = used_lines(case)[3]
    low, high = limits_on(case, finding("S1-S2", "flight", "speed_mps", -1.0), line)
    assert (low, high) == tuple(case.stations[line])
    part = line_stretch(case.traces, line, low, high)
    length = np.hypot(*np.diff(part, axis=0).T).sum()
    assert length == pytest.approx(high - low, rel=1e-6)
    assert line_stretch(case.traces, line, 1e5, 2e5).shape == (0, 2)


# --- the calibrated model --------------------------------------------------------------------


def test_the_calibrated_model_runs(case: Case, written: Path, tmp_path: Path) -> None:
    result = run(written / "model" / "config.toml", tmp_path / "out", jobs=1)
    assert result.n_blocks == 12
    job = result.run
    own = job.table.classes[job.table.index("debris")]
    assert (own.eta_max, own.mu_f, own.trust) == (0.612346, 0.75, "fitted")
    assert "Calibrated to observations of 40 rocks" in own.source
    assert "eta_max 0.55, mu_f 0.8" in own.source
    # The other classes are as they were.
    rest = [c for c in job.table.classes if c.name != "debris"]
    assert rest == [c for c in case.table.classes if c.name != "debris"]
    trees = job.effects.get(Trees)
    assert trees is not None and trees.efficiency == 0.8
    assert job.seed == 3


def test_the_stand_lies_between_its_chainages(case: Case, written: Path) -> None:
    job = read_map_run(load_config(written / "model" / "config.toml"))
    assert job.forest is not None
    stems = job.forest.stems_per_m2.reshape(job.grid.shape)
    assert np.unique(stems).tolist() == [0.0, pytest.approx(0.042)]
    for line in used_lines(case):
        own = slice(case.traces.offset[line], case.traces.offset[line + 1])
        s, x, y = (getattr(case.traces, c)[own] for c in "sxy")
        under = stems.ravel()[job.grid.cell_of(x, y)] > 0
        assert under[(s > 95) & (s < 155)].all()
        # Cells of 2 m on lines that lie askew.
        assert not under[(s < 85) | (s > 165)].any()


def test_a_stand_joins_lines_that_lie_apart(case: Case) -> None:
    order = np.argsort([line_stretch(case.traces, i, 50.0, 60.0)[0, 0] for i in used_lines(case)])
    ends = np.array(used_lines(case))[order[[0, -1]]]
    apart = replace(case, line=np.resize(ends, case.n_rocks))
    parts = [shapely.LineString(line_stretch(case.traces, i, 90.0, 160.0)) for i in ends]
    assert parts[0].distance(parts[1]) > 15.0
    area = stand_polygon(apart, (90.0, 160.0))
    assert len(area.geoms) == 1
    assert area.bounds[3] - area.bounds[1] == pytest.approx(70.0, abs=3.0)
    assert all(area.buffer(0.01).contains(p) for p in parts)
    assert stand_polygon(case, (1e5, 2e5)).is_empty


def test_paths_hold_in_the_new_place(slope: Grid, tmp_path: Path) -> None:
    text = CONFIG.replace('default = "debris"', 'default = "debris"\nclasses = "my.csv"')
    text += '\n[hazard]\npreset = "./rules.toml"\nfrequencies = "deep/f.csv"\n'
    text += '\n[risk]\nvulnerability = "v.csv"\n'
    text += '\n[[objects]]\nname = "h"\nkind = "building"\nfile = "h.gpkg"\n'
    text += '\n[effects.trees]\nfile = "wood.gpkg"\nstems_field = "n"\ndbh_cm = 30\n'
    (tmp_path / "a").mkdir()
    file = write_slope(tmp_path / "a", slope)
    _, case = made_case(tmp_path / "b", slope, 3)
    file.write_text(text)
    (tmp_path / "a" / "my.csv").write_text(
        "name,eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps,rolling_threshold\n"
        "scree,0.4,0.1,0.2,0.7,0.5,0.2,0.3,0,9,0.1\n"
    )
    before = load_config(file)
    new = write_config_back(
        tmp_path / "x" / "y" / "z" / "config.toml", load_config(file), unnamed(case, "none"), case
    )
    after = load_config(new)

    def places(config: Config) -> list[Path]:
        assert config.trees is not None
        named = (
            config.terrain.dem, config.release.file, config.hazard.preset,
            config.hazard.frequencies, config.risk.vulnerability, config.objects[0].file,
            config.trees.file,
        )  # fmt: skip
        return [Path(str(file)).resolve() for file in named if file is not None]

    assert places(before) == places(after) and len(places(after)) == 7
    assert after.dem_source.is_file()
    assert not Path(tomllib.loads(new.read_text())["terrain"]["dem"]).is_absolute()
    assert Path(str(after.ground.classes)).resolve() == new.parent / "ground_classes.csv"


def test_the_user_keeps_a_forest_of_their_own(slope: Grid, tmp_path: Path) -> None:
    text = CONFIG + '\n[effects.trees]\nform = "viscous"\nstems_per_ha = 300\ndbh_cm = 25\n'
    file, case = made_case(tmp_path, slope, 4, config=text)
    effect = HypothesisModel(case.table, EffectSettings(Trees("stems", efficiency=0.7)))
    new = written_back((file, case), tmp_path / "m", effect)
    trees = load_config(new).trees
    assert trees is not None
    assert (trees.stems_per_ha, trees.dbh_cm, trees.file) == (300.0, 25.0, None)
    section = tomllib.loads(new.read_text())["effects"]["trees"]
    assert (section["form"], section["efficiency"]) == ("stems", 0.7)


def test_lateral_deflection_is_handed_over_where_paths_turn(
    made: Made, followed: Made, tmp_path: Path
) -> None:
    for own, path in ((made, "fall_line"), (followed, "followed")):
        kicks = LateralDeflection("kicks", 12.0, 7.5)
        effect = HypothesisModel(own[1].table, EffectSettings(kicks))
        new = written_back(own, tmp_path / path, effect)
        assert load_config(new).terrain.path == path
        lateral = load_config(new).effects.get(LateralDeflection)
        turns = kicks if path == "followed" else None
        assert lateral == turns
        assert ("lateral_deflection] is left out" in new.read_text()) == (turns is None)


@pytest.mark.parametrize("family", [*FAMILIES, "contact_law"])
def test_every_part_of_a_draw_is_read_back_from_its_configuration(
    followed: Made, tmp_path: Path, family: str
) -> None:
    config, case = followed
    for seed in range(4):
        own = draw(case, (family,), ParameterDraws(np.random.default_rng(seed))).model
        new = written_back(followed, tmp_path / str(seed), own)
        read = read_case(new, config.parent / "observed")
        again = configured_model(read)
        assert np.array_equal(again.table.rows(), own.table.rows())
        assert set(again.effects) == set(own.effects)
        assert own.engine_of(case.engine) == read.engine
        if own.stand is not None:
            assert read.forest is not None
            stems = read.forest.stems_per_m2.max()
            assert stems == pytest.approx(own.stand.stems_per_ha / 1e4, rel=1e-6)


@pytest.mark.battery
def test_the_map_runs_what_was_scored(slope: Grid, tmp_path: Path) -> None:
    """Run-outs and offsets of blocks of the map from the stated places are those of the rocks."""
    fast = FOLLOWED.replace("axis_3_m = 0.32", "axis_3_m = 0.32\nspeed_mps = [8.0, 12.0]")
    config, _ = made_case(tmp_path, slope, 12, config=fast, passages=False)
    observed_at = config.parent / "observed"
    # Blocks as they are configured, from the places where rocks were released.
    rows = [line.split(",") for line in (observed_at / "rocks.csv").read_text().splitlines()]
    (observed_at / "rocks.csv").write_text("".join(",".join(r[:4]) + "\n" for r in rows))
    (observed_at / "metadata.csv").write_text("key,value\nposition_error_m,0.001\n")
    case = read_case(config, observed_at)
    # Rough enough for blocks to stop on the slope.
    table = calibrated(case.table, mu_0=TAN + 0.25, mu_f=0.9, eta_max=0.3)
    model = HypothesisModel(table, EffectSettings(LateralDeflection("kicks", 8.0, 6.0)))
    new = written_back((config, case), tmp_path / "m", model)
    points = gpd.GeoDataFrame(
        {"name": [r[0] for r in rows[1:]]},
        geometry=[shapely.Point(float(r[1]), float(r[2])) for r in rows[1:]],
        crs=LV95,
    )
    points.to_file(tmp_path / "points.gpkg", driver="GPKG", layer="release")
    run(
        load_config(new, {"release.file": str(tmp_path / "points.gpkg"),
                          "release.rocks_per_point": 200, "output.rock_table": "csv"}),
        tmp_path / "map",
    )  # fmt: skip
    ends = pd.read_csv(tmp_path / "map" / "tables" / "rocks.csv")
    rock = np.array([case.observations.rock_names.index(n) for n in ends["area"]])
    on_map = in_plane(case, rock, ends["x_m"].to_numpy(), ends["y_m"].to_numpy())
    scored = campaigns(case, rock_lines_of(case), model, count=200, seed=9)
    rows_of = [c.deposits for c in scored if c.deposits is not None]
    of_rocks = (
        np.concatenate([r.s for r in rows_of]),
        np.concatenate([r.lateral_m for r in rows_of]),
    )
    for one, other in zip(on_map, of_rocks, strict=True):
        assert stats.ks_2samp(one, other).pvalue > 1e-3
        assert np.std(one) > 0.3


def test_comments_say_where_the_model_comes_from(made: Made, tmp_path: Path) -> None:
    config, case = made
    write_config_back(tmp_path / "config.toml", load_config(config), with_trees(case), case)
    text = (tmp_path / "config.toml").read_text()
    assert text.startswith("# Made by sassgis")
    assert "Named: trees, with a confidence of 0.71; fitted: [effects.trees]." in text
    assert "do not separate: trees, soft ground" in text
    none = unnamed(case, "none")
    error = replace(
        none,
        verdict=replace(with_trees(case).verdict, effect="release_error"),
        advice=replace(none.advice, recommended="release_error"),
    )
    write_config_back(tmp_path / "b.toml", load_config(config), error, case)
    assert "not a part of the motion" in (tmp_path / "b.toml").read_text()


def test_what_is_named_and_not_recommended_is_said_apart(made: Made, tmp_path: Path) -> None:
    named = with_trees(made[1])
    why = "no certain gain on held-out rocks: trees over calibrated ground"
    apart = replace(
        named, effect=named.base, advice=replace(named.advice, recommended="ground", why=why)
    )
    out = outputs(made, apart, tmp_path / "out")
    text = (out / "model" / "config.toml").read_text()
    assert (
        "Named: trees, with a confidence of 0.71, but not added: the model has calibrated" in text
    )
    assert "effects" not in tomllib.loads(text) and why[1:] in text
    words = words_of(out / "report.html")
    assert "Trees: 71 %" in words and "The calibrated model contains calibrated ground" in words


# --- words -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("S3", "at S3"), ("S2-S3", "between S2 and S3"), ("release-S1", "above S1"),
        ("S4-end", "below S4"), ("release-end", "from the release to the stop"),
        ("all", "on the whole slope"), ("ground:soft_meadow", "on soft meadow"),
        ("A-1-B-2", "on the stretch A-1-B-2"), ("height_m", "passing height"),
        ("peak_energy_kj", "peak energy"), ("odd", "odd"), ("stop runout", "run-out"),
        ("runout_m_spread", "scatter of run-out about the prediction"),
        ("stop aside", "lateral offset of stops"),
    ],
)  # fmt: skip
def test_places_and_quantities_in_words(name: str, words: str) -> None:
    place = words.startswith(("at ", "between", "above", "below", "from", "on "))
    assert (place_words if place else quantity_name)(name) == words


def test_all_that_is_compared_has_a_name(few_case: Case) -> None:
    residuals = residuals_of(few_case, configured_model(few_case), seed=1, replicates=4)
    found = where(few_case, residuals, seed=1, draws=19)
    quantities = {f.quantity.removesuffix("_spread") for f in found}
    assert len(quantities) > 5
    assert quantities <= set(QUANTITY_NAMES)


def test_a_finding_as_a_sentence() -> None:
    text = finding_sentence(finding("S2", "flight", "speed_mps", -2.1, observed=11.9))
    assert "Speed at S2: observed 11.9 m/s, predicted 11.1 m/s" in text
    assert "2.1 m/s less (95 % interval 1.5 to 2.8; 38 rocks" in text
    open_ = finding("S1", "flight", "speed_mps", 0.2, ci95=(-0.3, 0.7), p_adjusted=0.6)
    assert "0.2 m/s more (95 % interval −0.3\u00a0to\u00a00.7;" in finding_sentence(open_)


def test_significance_has_two_levels() -> None:
    sure = finding("S1", "flight", "speed_mps", 1.0)
    assert significance(sure) == "sure"
    assert significance(replace(sure, p_adjusted=0.051)) == "likely"
    assert significance(replace(sure, p_adjusted=0.051, q_value=0.06)) == "open"


def test_the_answer_comes_first_with_its_uncertainty(written: Path) -> None:
    words = words_of(written / "report.html")
    told = (
        "In the run-out simulated blocks stop 12 % too far.",
        "Also possible: soft ground.",
        "Trees: 71 % Soft ground: 19 % Unknown or not testable with these data: 9 %",
        "Speeds of rocks of different mass in the stand.",
        "Where the gap lies with the configured model",
        "3 of 11 comparisons are significant after adjustment for their number",
        "Speed at S2",
        "Where the gap lies after calibration",
        "74 % of the gap that remains beyond chance after calibration (95 % interval 60 % to 85 %)",
        "No turns in plan",
        "Figure 2.",
        "Table 1.",
    )
    places = [words.index(text) for text in told]
    assert places == sorted(places)
    page = (written / "report.html").read_text()
    assert "http" not in re.sub(r"data:image/png;base64,[^\"]+", "", page).replace("http-equiv", "")


@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("de", ("Bäume: 71 %", "Wo die Abweichung des konfigurierten Modells liegt",
                "Geschwindigkeit bei S2: beobachtet", "Kalibrierte Modelle", "Ausbruch-S1"),
        ),
        ("fr", ("Arbres : 71 %", "Où se situe l'écart du modèle configuré",
                "Vitesse à S2 : observé", "Modèles calibrés", "départ-S1"),
        ),
    ],
)  # fmt: skip
def test_the_report_is_in_the_language_of_the_project(
    few_case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, language: Any, words: Any
) -> None:
    monkeypatch.setattr(gap_report, "gap_figures", lambda *_: [])
    # Sentences that were made by hand have no key.
    made_up = with_trees(few_case)
    diagnosis = replace(
        made_up, first_sentence="", verdict=replace(made_up.verdict, reason=""),
        shrinkage=replace(made_up.shrinkage, note=""), measure_next=(), not_identifiable=(),
    )  # fmt: skip
    with in_language(language):
        context = gap_report.gap_report(
            few_case, diagnosis, tmp_path, project="Hang", terrain="dem.tif", crs="LV95",
            configuration="config.toml", warnings=report_warnings(few_case, diagnosis),
        )  # fmt: skip
        page = words_of(write_report(tmp_path / "report.html", translated_report(context)))
    assert [text for text in words if text not in page] == []
    english = r"\b(the|is|are|of|with|gap|rocks|observed|from|release|stopping|flight)\b"
    assert re.findall(english, page) == []


def part(diagnosis: Diagnosis, heading: str) -> Any:
    """The part of the answer under a heading."""
    return next(p for p in answer(diagnosis) if p.heading == heading)


def test_reaches_that_follow_each_other_are_one_place(few_case: Case) -> None:
    made = with_trees(few_case)
    for segments, words in (
        (("release-S1", "S1-S2", "S2-end"), "from the release to the stop."),
        (("release-S1", "S2-S3", "S3-S4"), "above S1 and between S2 and S4."),
        (("A-1-B", "B-C"), "on the stretch A-1-B and between B and C."),
    ):
        own = replace(made, verdict=replace(made.verdict, segments=segments))
        assert words in " ".join(part(own, "How sure this is").sentences), words


def test_a_scale_of_speeds_that_is_named_is_told(few_case: Case) -> None:
    made = with_trees(few_case)
    own = replace(
        made.which[0], effect="measurement_error", parameters={"scale": 1.13},
        intervals={"scale": (1.01, 1.21)},
    )  # fmt: skip
    verdict = replace(made.verdict, effect="measurement_error")
    said = verdict_sentence(replace(made, verdict=verdict, which=(own,)))
    assert "This error lies in the observations." in said
    assert "Observed speeds are 1.13 times the speeds that fit the other data (95 %: 1.01" in said
    unsure = replace(own, intervals={"scale": (0.97, 1.21)})
    assert "times the speeds" not in verdict_sentence(
        replace(made, verdict=verdict, which=(unsure,))
    )


def test_what_is_possible_beside_an_unknown_cause_is_told(few_case: Case) -> None:
    made = unnamed(few_case, "unknown")
    for held, hidden, words in (
        (("unknown", "trees"), (), "Still possible: trees."),
        (("unknown",), ("air_drag",), "These data show no probable cause."),
    ):
        verdict = replace(made.verdict, confusion_set=held, cannot_exclude=hidden)
        said = part(replace(made, verdict=verdict), "Causes, most likely first").sentences
        assert said[0] == words and "remains possible" not in " ".join(said)


def test_withheld_shrinkage_is_told(case: Case) -> None:
    diagnosis = with_trees(case)
    withheld = replace(diagnosis.shrinkage, value=None, ci95=None, note="the gap is small")
    own = replace(diagnosis, shrinkage=withheld)
    *before, last = part(own, "How far the gap shrinks").sentences
    assert last == "The gap is small." and not any("that calibration leaves" in s for s in before)


def test_no_place_is_named_where_none_is_sure(few_case: Case) -> None:
    where = part(unnamed(few_case, "none"), "Where the gap lies after calibration")
    assert "cannot be located" in where.sentences[0] and not where.points


def test_tables_tell_what_changed_and_warnings_are_repeated(written: Path) -> None:
    words = words_of(written / "report.html")
    assert "Said on the console." in words
    assert "debris 0.55 → 0.612" in words
    assert "efficiency 0.8 0.5 to 1.2" in words
    assert "passages: 80" in words


def test_the_map_shows_what_matters_most_of_what_is_sure() -> None:
    height = finding("S1", "flight", "height_m", 0.3, p_adjusted=0.001)
    speed = finding("S2", "flight", "speed_mps", -2.0, p_adjusted=0.01)
    everywhere = finding("all", "stopping", "runout_m", -9.0, p_adjusted=0.001)
    assert headline([height, everywhere, speed]) is speed
    unsure = replace(speed, p_adjusted=0.5, q_value=0.4)
    assert headline([unsure, height, everywhere]) is height
    assert headline([unsure, everywhere]) is everywhere
    assert headline([replace(speed, s0_m=math.nan)]) is None


def test_one_sentence_for_each_quantity(few_case: Case) -> None:
    many = tuple(finding(p, "flight", "speed_mps", -2.0) for p in ("S1", "S2", "S1-S2"))
    many += (finding("S1", "flight", "height_m", 0.3, p_adjusted=0.0005),)
    points = part(
        replace(with_trees(few_case), where=many), "Where the gap lies after calibration"
    ).points
    assert [p.split(":")[0] for p in points] == ["Speed at S1", "Passing height at S1"]
    assert "p < 0.001" in points[1]


# --- figures ---------------------------------------------------------------------------------


def test_dots_are_filled_by_significance() -> None:
    figure = figures.gap_where_figure(FINDINGS)
    assert [len(find(figure, f"gap-{s}")) for s in ("sure", "likely", "open")] == [3, 2, 6]
    words = texts(figure)
    assert "speed (m/s)" in words and "S2-end · stopping" in words and "38" in words
    assert not find(figure, "configured-sure") and "the configured model" not in words
    both = figures.gap_where_figure(FINDINGS, [replace(FINDINGS[0], gap=-4.0)])
    (before,) = find(both, "configured-sure")
    assert before.get_xdata() == [-4.0] and "the configured model" in texts(both)


def test_many_comparisons_are_cut_and_the_figure_says_so() -> None:
    many = [finding("S1", f"phase{i}", "speed_mps", 1.0, p_adjusted=0.01 * i) for i in range(40)]
    figure = figures.gap_where_figure(many)
    assert "14 of 40 are shown" in texts(figure)
    kinds = [replace(many[0], quantity=f"kind{i:02d}_m") for i in range(20)]
    words = texts(figures.gap_where_figure(kinds))
    assert "12 of 20 are shown" in words and "kind11" in words and "kind12" not in words
    assert "S1 · phase0" in texts(figure) and "S1 · phase39" not in texts(figure)


def test_few_rocks_are_steps(few_case: Case) -> None:
    comparison = with_trees(few_case).comparisons[0]
    figure = figures.gap_distributions_figure([comparison], effect="trees")
    (line,) = find(figure, "observed")
    x, y = line.get_data()
    assert np.array_equal(x[1:], np.sort(comparison.observed))
    assert np.allclose(y, np.arange(16) / 15)
    assert line.get_drawstyle() == "steps-post"
    (dots,) = find(figure, "observed-values")
    assert len(dots.get_xdata()) == 15
    assert len(find(figure, "effect")) == len(find(figure, "configured")) == 1
    assert "n = 15" in texts(figure)


def test_a_distance_that_samples_of_the_model_have_too_is_called_chance() -> None:
    rng = np.random.default_rng(3)
    seen, alike, far = (tuple(rng.normal(m, 1.0, n)) for m, n in ((0, 30), (0, 600), (2, 600)))
    figure = figures.gap_distributions_figure([Comparison("S1", "speed_mps", "m/s", seen, alike)])
    assert "D: chance" in texts(figure)
    own = Comparison("S1", "speed_mps", "m/s", seen, alike, (), far)
    (text,) = find(figures.gap_distributions_figure([own]), "distance")
    assert re.match(r"D: \d\.\d+ → chance\n", text.get_text())


def test_the_band_holds_samples_of_the_base_model() -> None:
    rng = np.random.default_rng(8)
    base = rng.normal(0.0, 1.0, 4000)
    x, low, high = _band(base, 15)
    at = np.searchsorted(x, [-1.0, 0.0, 1.0])
    shares = (rng.normal(0.0, 1.0, (4000, 15))[:, :, None] <= x[at]).mean(axis=1)
    inside = ((shares >= low[at]) & (shares <= high[at])).mean(axis=0)
    # Counts are whole numbers: the band holds at least 95 %.
    assert (inside >= 0.94).all()


def test_what_was_not_observed_or_not_named_is_not_drawn(few_case: Case) -> None:
    figure = figures.gap_distributions_figure(unnamed(few_case, "none").comparisons)
    assert not find(figure, "effect") and "with the effect" not in texts(figure)
    comparison = replace(with_trees(few_case).comparisons[0], observed=(math.nan,))
    assert "not observed" in texts(figures.gap_distributions_figure([comparison]))
    lone = Hypothesis("none", "", 1.0, 0.0, (math.nan, math.nan), math.nan)
    figure = figures.gap_hypotheses_figure([lone], probabilities={}, verdict="none")
    assert not find(figure, "interval") and len(find(figure, "gain")) == 1


def test_hypotheses_show_what_is_confused(case: Case) -> None:
    diagnosis = with_trees(case)
    shares = diagnosis.verdict.probabilities
    figure = figures.gap_hypotheses_figure(
        diagnosis.which, probabilities=shares, verdict="trees", rivals=("soft_ground",)
    )
    (named,) = find(figure, "share-trees")
    (confused,) = find(figure, "share-soft_ground")
    (other,) = find(figure, "share-unknown")
    colours = {b.get_facecolor() for b in (named, confused, other)}
    assert len(colours) == 3
    assert named.get_width() == 0.71
    assert "71 %" in texts(figure) and "< 1 %" in texts(figure)
    # Where nothing is named there is no colour.
    grey = figures.gap_hypotheses_figure(
        diagnosis.which, probabilities=shares, verdict="unknown", rivals=("trees",)
    )
    assert {b.get_facecolor() for b in find(grey, "share-trees")} == {other.get_facecolor()}
    assert {d.get_color() for d in find(grey, "gain")} == {GREY}


def test_names_of_two_causes_lie_on_the_page() -> None:
    form = "sphericity + shifted contact + offset and speed"
    pair = Hypothesis("measurement_error+release_error", form, 1.0, 0.6, (0.4, 0.9), 0.9)
    figure = figures.gap_hypotheses_figure([pair], probabilities={}, verdict=pair.effect)
    figure.canvas.draw()
    (name,) = figure.axes[0].get_yticklabels()
    assert "error" in name.get_text() and form in " ".join(name.get_text().split())
    assert name.get_window_extent().x0 > 0.0


def map_figure(grid: Grid, lines: Any, maps: Any, *of: str) -> Any:
    quantity, unit = of or ("speed_mps", "m/s")
    return figures.gap_map_figure(
        grid, lines=lines, maps=maps, release=np.empty((0, 2)), stops=np.empty((0, 2)),
        quantity=quantity, unit=unit,
    )  # fmt: skip


def test_map_colours_lie_about_zero(case: Case) -> None:
    lines, maps, first = map_parts(case, with_trees(case))
    assert first is not None and first.quantity == "speed_mps"
    assert len(lines) == 40
    assert list(maps) == ["as configured", "calibrated base model"]
    own = maps["calibrated base model"]
    assert {s.gap for s in own.stretches} == {-1.6, 0.1, 0.9}
    assert {name: s.gap for name, s in own.stations.items()} == {"S1": -0.2, "S2": -2.1}
    assert [own.stations[n].sure for n in ("S1", "S2")] == [False, True]
    assert maps["as configured"].stations["S2"].gap == -4.2
    figure = map_figure(case.grid, lines, maps)
    assert len(find(figure, "gaps")) == 4
    bar = next(a for a in figure.axes if a.get_label() == "legend")
    low, high = bar.get_ylim()
    assert -low == high == pytest.approx(4.2)


def test_map_without_a_significant_gap_has_no_colours(case: Case) -> None:
    made = with_trees(case)
    lines, maps, first = map_parts(case, replace(made, where=(), where_configured=()))
    assert first is None and [own.stretches for own in maps.values()] == [[]]
    figure = map_figure(case.grid, lines, maps, "", "")
    assert "Colour:" not in texts(figure)
    assert [a.get_label() for a in figure.axes] == ["map"]
    quiet = tuple(replace(f, p_adjusted=0.7, q_value=0.5) for f in FINDINGS)
    lines, maps, _ = map_parts(case, replace(made, where=quiet, where_configured=()))
    figure = map_figure(case.grid, lines, maps)
    assert "Colour:" not in texts(figure) and "not distinguishable from chance" in texts(figure)
    shades = np.concatenate([own.get_colors()[:, :3] for own in find(figure, "gaps")])
    assert np.ptp(shades, axis=1).max() == 0.0
    assert [a.get_label() for a in figure.axes] == ["map"]
    # A station alone can be drawn.
    line = np.array([[2_700_050.0, 1_149_900.0], [2_700_150.0, 1_149_900.0]])
    lone = {"": GapMap([], {"S1": GapStretch(line, 0.0)})}
    assert "S1" in texts(map_figure(case.grid, [], lone))


# --- the change of the map -------------------------------------------------------------------


def test_change_of_the_map(made: Made, written: Path, tmp_path: Path) -> None:
    config, _ = made
    folder = tmp_path / "map"
    change = map_change(config, written / "model" / "config.toml", folder, 1)
    maps = {}
    for when in ("before", "after"):
        with rasterio.open(folder / when / "maps" / "energy.tif") as raster:
            maps[when] = raster.read(1, masked=True).filled(np.nan)
    with rasterio.open(folder / "maps" / "energy_change.tif") as raster:
        energy = raster.read(1, masked=True).filled(np.nan)
        assert raster.profile["tiled"] or raster.width <= 256
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    assert np.allclose(energy, difference(maps["before"], maps["after"]), equal_nan=True)
    assert np.nanmin(energy) < 0.0, "trees take energy"
    reached = [np.isfinite(maps[when]).sum() * 4.0 for when in ("before", "after")]
    area = change.row("map", "area reached")
    assert [area.before, area.after] == reached
    both = np.isfinite(maps["before"]) & np.isfinite(maps["after"])
    assert change.row("map", ENERGY_MEAN).change == pytest.approx(energy[both].mean(), rel=1e-5)
    assert len(change.lines()) == 3 and "m²" in change.lines()[0]
    assert (folder / "figures" / "energy_change.png").is_file()
    assert (folder / "figures" / "reach_probability_change.png").is_file()
    assert json.loads((folder / "manifest.json").read_text())["counts"]["rocks_before"] == 12
    check_output(folder, overwrite=True)


def test_no_release_areas_no_map(slope: Grid, tmp_path: Path) -> None:
    text = re.sub(r"(?m)^file = .*\nname_field.*\n", "", CONFIG) + "\n[profile]\n"
    config = write_slope(tmp_path, slope, config=text)
    with pytest.raises(ConfigError, match=r"release\.file: has no release areas"):
        map_change(config, config, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_maps_of_different_terrain_are_refused(slope: Grid, made: Made, tmp_path: Path) -> None:
    config, _ = made
    other = write_slope(tmp_path, replace(slope, west=slope.west + 0.5 * slope.cell_size))
    with pytest.raises(InputError, match="borders of the cells"):
        map_change(config, other, tmp_path / "out", 1)
    assert not (tmp_path / "out").exists()
