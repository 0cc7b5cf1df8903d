"""Words of maps and reports on a preset's rules."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from sassgis.settings.hazard_rules import HazardPreset, Provenance
from sassgis.settings.languages import joined, phrase


def period_labels(return_periods: Sequence[float]) -> tuple[str, ...]:
    """Name the classes of return period: "up to 30", "30 to 100", ..., "beyond 300" (years)."""
    limits = [f"{t:g}" for t in return_periods]
    between = [phrase("{} to {}", a, b) for a, b in pairwise(limits)]
    return (phrase("up to {}", limits[0]), *between, phrase("beyond {}", limits[-1]))


def energy_labels(preset: HazardPreset) -> tuple[str, ...]:
    """Return spans of energy of the classes of intensity: "below 30 kJ", ..., "300 kJ and more"."""
    limits = [f"{e:g}" for e in preset.thresholds_kj]
    if len(limits) == 1:
        return (phrase("any energy"),)
    between = [phrase("{} to {} kJ", a, b) for a, b in pairwise(limits[1:])]
    return (phrase("below {} kJ", limits[1]), *between, phrase("{} kJ and more", limits[-1]))


def preset_unverified(preset: HazardPreset) -> list[str]:
    """List values of a preset that were not read in its source: a warning for each source."""
    return [
        phrase(
            "Preset {}, unverified: {}. {}.",
            preset.name,
            joined(", ", what),
            phrase(source.rstrip(".")),
        )
        for source, what in _unverified(preset).items()
    ]


def unverified_in_short(preset: HazardPreset) -> list[str]:
    """Return the same without the sources, for sheets: one text, or none."""
    what = [text for own in _unverified(preset).values() for text in own]
    text = "Preset {}, unverified: {}. See the report."
    return [phrase(text, preset.name, joined(", ", what))] if what else []


def _unverified(preset: HazardPreset) -> dict[str, list[str]]:
    """Return unverified values by the text of their source, each in words."""
    periods = ", ".join(f"{t:g}" for t in preset.return_periods)
    values = [(phrase("intensity {}", phrase(c.label)), c.provenance) for c in preset.intensities]
    values.append((phrase("return periods {} years", periods), preset.return_period_provenance))
    if preset.rarest_provenance is not None:
        beyond = phrase("no level beyond {} years", f"{preset.rarest_years:g}")
        values.append((beyond, preset.rarest_provenance))
    if preset.sheet is not None:
        least = phrase(
            "zones of at least {} mm and {} mm² on the sheet",
            f"{preset.sheet.width_mm:g}",
            f"{preset.sheet.area_mm2:g}",
        )
        values.append((least, preset.sheet.provenance))
    values += [(phrase("level {}", phrase(c.label)), c.provenance) for c in preset.levels]
    by_source = _by_source(values)
    for source, text in _unverified_fields(preset).items():
        by_source.setdefault(source, []).append(text)
    return by_source


def _by_source(values: Sequence[tuple[str, Provenance]]) -> dict[str, list[str]]:
    """Return unverified values by the text of their source."""
    found: dict[str, list[str]] = {}
    for what, provenance in values:
        if not provenance.verified:
            found.setdefault(provenance.source, []).append(what)
    return found


def _unverified_fields(preset: HazardPreset) -> dict[str, str]:
    """Return unverified fields of the matrix in a few words, by their source."""
    fields = [
        (phrase("{} {} years", intensity.code, period), provenance)
        for intensity, row in zip(preset.intensities, preset.matrix_provenance, strict=True)
        for period, provenance in zip(period_labels(preset.return_periods), row, strict=True)
    ]
    words: dict[str, str] = {}
    for source, own in _by_source(fields).items():
        if len(own) == len(fields):
            words[source] = phrase("the whole matrix")
        elif 2 * len(own) > len(fields):
            words[source] = phrase("{} of {} fields of the matrix", len(own), len(fields))
        else:
            words[source] = phrase("matrix {}", joined(", ", own))
    return words
