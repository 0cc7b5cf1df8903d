"""Numbers as files and reports show them."""

from __future__ import annotations

import pytest

from sassgis.settings.results import short


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.0123, "0.012"), (9.94, "9.9"), (9.96, "10"), (99.6, "100"), (1700.4, "1700"),
     (-0.5, "-0.5"), (-120.0, "-120")],
)  # fmt: skip
def test_no_digit_before_the_point_is_lost(value: float, text: str) -> None:
    assert short(value) == text
    assert short(value, "+") == (text if value < 0.0 else f"+{text}")
