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
from sassgis.model.ground import GroundClass
from sassgis.model.hazard import BlockBudget

BUILT_IN = built_in_table("1986").classes


def with_blocks() -> GroundClass:
    """A verified class of the package with blocks on the ground."""
    return next(c for c in BUILT_IN if c.verified and c.d_star_m > 0.0)


def test_unverified_classes_are_named_in_one_sentence() -> None:
    first, second = (replace(with_blocks(), name=n, verified=False) for n in ("one", "two"))
    (text,) = ground_warnings([first, second], BUILT_IN)
    assert text.endswith("(unverified): one, two.")


def test_the_diameter_of_a_class_of_the_package_is_a_placeholder() -> None:
    known = with_blocks()
    (text,) = ground_warnings([known], BUILT_IN)
    assert f"{known.name} (d_star_m {known.d_star_m:g})" in text
    # A value of the site is the user's own.
    assert not ground_warnings([replace(known, d_star_m=known.d_star_m + 0.05)], BUILT_IN)
    assert not ground_warnings([], BUILT_IN)


def test_lines_without_a_width_are_told() -> None:
    assert len(path_warnings("fall_line")) == 1
    assert not path_warnings("followed")


def test_sources_that_never_release_are_named() -> None:
    texts = rule_warnings(swiss(), {("A", "small"): 0.0, ("A", "big"): 0.1, ("B", "big"): 0.0})
    assert texts[-1] == "Onset frequency 0, so without any hazard: A / small, B / big."
    assert not [t for t in rule_warnings(swiss(), {("A", "big"): 0.1}) if "Onset" in t]


def test_what_stays_uncertain_is_told_beyond_the_limit_only() -> None:
    assert not zone_warnings(0.3, None)
    assert not zone_warnings(0.05, BlockBudget(0.05))
    (text,) = zone_warnings(0.123, BlockBudget(0.05))
    assert "level on 12.3 % of the zoned area" in text and "wanted: 5 %" in text
