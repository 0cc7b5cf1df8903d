"""One list of warnings: each says what it is about, and only where there is cause."""

from __future__ import annotations

from dataclasses import replace

from helpers.hazard_samples import swiss

from sassgis.hazard.warnings import (
    ground_warnings,
    path_warnings,
    rule_warnings,
    zone_warnings,
)
from sassgis.io.read.ground_map import built_in_table


def test_unverified_classes_are_named_in_one_sentence() -> None:
    own = built_in_table().classes[0]
    first, second = (replace(own, name=n, verified=False) for n in ("one", "two"))
    (text,) = ground_warnings([first, replace(own, name="three", verified=True), second])
    assert text.endswith("(unverified): one, two.")
    assert not ground_warnings([replace(own, verified=True)])


def test_lines_without_a_width_are_told() -> None:
    assert len(path_warnings("fall_line")) == 1
    assert not path_warnings("followed")


def test_sources_that_never_release_are_named() -> None:
    texts = rule_warnings(swiss(), {("A", "small"): 0.0, ("A", "big"): 0.1, ("B", "big"): 0.0})
    assert texts[-1] == "Onset frequency 0, so without any hazard: A / small, B / big."
    assert not [t for t in rule_warnings(swiss(), {("A", "big"): 0.1}) if "Onset" in t]


def test_what_stays_uncertain_is_told_beyond_the_limit_only() -> None:
    assert not zone_warnings(0.3, None, 8)
    assert not zone_warnings(0.05, 0.05, 8)
    (text,) = zone_warnings(0.123, 0.05, 8)
    assert "level on 12.3 % of the zoned area" in text and "after 8 repetitions" in text
