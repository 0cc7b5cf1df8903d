"""Numbers as a person would write them, in figures and reports."""

from __future__ import annotations


def thousands(value: float, decimals: int = 0) -> str:
    """Write a number with a narrow space between thousands, at which no line breaks."""
    return f"{value:,.{decimals}f}".replace(",", "\u202f").replace("-", "\u2212")


def power_of_ten(exponent: int) -> str:
    """Write a power of ten, as '10⁻⁶'."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
