"""What the classifiers were grown from, and that the trees are asked as they were grown."""

from __future__ import annotations

import importlib.util
import pickle
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sassgis.gap.check.worlds import WorldSpec
from sassgis.gap.check.worlds.battery import world_seeds
from sassgis.gap.check.worlds.world import FAMILIES
from sassgis.gap.which.classifier import DESIGNS, Classifier, calibrated
from sassgis.io.read.gap_thresholds import read_classifier, read_thresholds, write_classifiers

sklearn_ensemble = pytest.importorskip("sklearn.ensemble")


@pytest.fixture(scope="module")
def learning(repository: Path) -> ModuleType:
    path = repository / "docs/studies/gap_learning.py"
    spec = importlib.util.spec_from_file_location("gap_learning", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["gap_learning"] = module
    spec.loader.exec_module(module)
    return module


def test_no_world_was_learned_from_that_is_checked(learning: ModuleType) -> None:
    learned = {seed for _, seed in learning.development_worlds()}
    assert len(learned) == len(learning.development_worlds())
    for battery in (2026, *learning.EARLIER):
        assert not learned & set(world_seeds(battery, 1000))
    assert learning.SEED in read_thresholds()["battery_seeds"]


def test_every_cause_is_learned_alike(learning: ModuleType) -> None:
    worlds = [spec for spec, _ in learning.development_worlds()]
    single = [spec.effects[0].name for spec in worlds if len(spec.effects) == 1]
    counts = {name: single.count(name) for name in FAMILIES}
    assert len(set(counts.values())) == 1
    assert {name for name in single if name not in FAMILIES} == set(learning.SEEN_UNKNOWNS)


def test_trees_answer_as_those_that_were_grown(learning: ModuleType, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(300, 6)).astype(np.float32)
    label = np.array(["none", "pair", "trees"])[(x[:, 0] > 0).astype(int) + (x[:, 1] > 0.5)]
    model = sklearn_ensemble.ExtraTreesClassifier(20, min_samples_leaf=3, random_state=1)
    model.fit(x, label)
    causes = ("none", "pair", "roughness", "trees")
    names = tuple("abcdef")
    classifier = Classifier(
        names,
        causes,
        np.zeros(6, np.float32),
        np.ones(6, np.float32),
        learning.as_trees(model, causes),
        1.0,
        np.ones(4),
    )
    file = tmp_path / "classifiers.npz"
    write_classifiers(file, dict.fromkeys(DESIGNS, classifier))
    read = read_classifier("stops", file)
    asked = rng.normal(size=(40, 6)).astype(np.float32)
    expected = np.zeros((40, 4))
    expected[:, [0, 1, 3]] = model.predict_proba(asked)
    for row, shares in zip(asked, expected, strict=True):
        np.testing.assert_allclose(classifier.trees.shares(row), shares, atol=1e-6)
        found = read.probabilities(dict(zip(names, row.tolist(), strict=True)))
        told = [found[cause] for cause in causes]
        # Limits of half precision send few rows another way.
        np.testing.assert_allclose(told, calibrated(shares, 1.0, np.ones(4)), atol=0.06)


def test_prior_weights_are_those_of_a_battery(learning: ModuleType) -> None:
    cause = np.array(["none"] * 3 + ["trees"] * 5 + ["pair"] + ["unknown"] * 2)
    weight = learning.prior_weights(cause)
    assert weight[cause == "none"].sum() == pytest.approx(1 / 3)
    assert weight[cause == "trees"].sum() == pytest.approx(2 / 5)
    assert weight.sum() == pytest.approx(1.0)


def test_rows_of_a_world_hold_all_that_its_design_holds(
    learning: ModuleType, tmp_path: Path
) -> None:
    spec = WorldSpec("talus_fan", (), 20, "both")
    learning.make_rows((7, spec, 12345, str(tmp_path)))
    rows = pickle.loads((tmp_path / "007.pkl").read_bytes())
    assert [r.design for r in rows] == ["both", "stations", "stops"]
    for r in rows:
        assert r.rocks == 20 and r.world == 7 and r.truth == ()
        assert r.causes[0] == r.causes[-1] == "none"
        assert r.values.shape == (len(r.causes), len(r.names))
        assert {*r.causes} <= {*FAMILIES, "none"}
    seen = [read_classifier(r.design).seen(dict.fromkeys(r.names, 0.0)) for r in rows]
    assert min(seen) > 0.3
