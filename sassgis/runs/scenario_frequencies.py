"""From a list of block volumes to the onset frequencies of block scenarios."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from sassgis.errors import ConfigError, InputError
from sassgis.hazard.volume_frequency import (
    Estimate,
    PowerLaw,
    fit_power_law,
    fit_test,
    higher_thresholds,
)
from sassgis.inputs.frequencies import read_block_survey
from sassgis.outputs.config_template import toml_value
from sassgis.settings.hazard_rules import OnsetUnit

#: Below this p a power law is in doubt (Clauset, Shalizi and Newman 2009; not checked against the
#: source).
_DOUBT = 0.1
_FEW = 30
_PER = {"per_year": "a year", "per_year_ha": "a year and hectare", "per_year_m": "a year and metre"}


@dataclass(frozen=True, slots=True)
class Scenario:
    """A class of volumes (m3), its share of the blocks and, if it is known, its frequency."""

    low: float
    high: float
    share: Estimate
    frequency: Estimate | None

    @property
    def name(self) -> str:
        """As it stands in the configuration."""
        return f"{self.low:g} to {self.high:g} m3"


@dataclass(frozen=True, slots=True)
class ScenarioFrequencies:
    """A fitted law and what it says of scenarios."""

    file: Path
    blocks: int  # in the file; the law has those from its volume of completeness on
    law: PowerLaw
    higher: tuple[PowerLaw, ...]  # the same, fitted from larger volumes on
    distance: float  # of the test of the fit, as p
    p: float
    total: Scenario  # all volumes of the law
    scenarios: tuple[Scenario, ...]
    unit: OnsetUnit
    warnings: tuple[str, ...]

    def lines(self) -> list[str]:
        """Write all for people, line by line; the last are lines of a configuration."""
        law, per = self.law, _PER[self.unit]
        up_to = "" if math.isinf(law.up_to) else f" up to {law.up_to:g} m3"
        out = [
            f"blocks         {law.survey.blocks} of {self.blocks} from {law.complete_from:g} m3 on",
            f"exponent       {_text(law.exponent)}, power law from {law.complete_from:g} m3{up_to}",
        ]
        out += [
            f"               {_text(h.exponent)} from {h.complete_from:g} m3, "
            f"{h.survey.blocks} blocks"
            for h in self.higher
        ]
        out.append(f"fit            largest distance {self.distance:.3f}, p = {self.p:.2g}")
        if self.total.frequency is not None:
            out.append(
                f"frequency      {_text(self.total.frequency)} blocks {per} "
                f"from {law.complete_from:g} m3 on"
            )
        for one in self.scenarios:
            if one.frequency is None:
                text = f"{_text(one.share)} of these blocks"
            else:
                text = f"{_text(one.frequency)} blocks {per}"
            out.append(f"scenario       {one.name}: {text}")
        out += [f"WARNING        {text}" for text in self.warnings]
        if self.total.frequency is not None:
            out += self.toml()
        return out

    def toml(self) -> list[str]:
        """Return lines of the configuration, with a section for each scenario."""
        out = []
        for one in self.scenarios:
            assert one.frequency is not None
            keys = {
                "name": one.name,
                "volume_m3": (one.low, one.high),
                "volume_exponent": _rounded(self.law.exponent.value),
                "onset_frequency": _rounded(one.frequency.value),
                "onset_unit": self.unit,
            }
            out += ["", "[[blocks]]", *(f"{key} = {toml_value(v)}" for key, v in keys.items())]
        return out

    def as_dict(self) -> dict[str, Any]:
        """Return all values as plain data for programs."""

        def scenario(one: Scenario) -> dict[str, Any]:
            frequency = None if one.frequency is None else asdict(one.frequency)
            limits = {"volume_m3": [one.low, one.high], "share": asdict(one.share)}
            return {**limits, "onset_frequency": frequency, "onset_unit": self.unit}

        return {
            "file": self.file,
            "blocks": self.blocks,
            "fits": [
                {
                    "complete_from_m3": law.complete_from, "up_to_m3": law.up_to,
                    "blocks": law.survey.blocks, "exponent": asdict(law.exponent),
                }
                for law in (self.law, *self.higher)
            ],
            "fit_distance": self.distance,
            "fit_p": self.p,
            "total": scenario(self.total),
            "scenarios": [scenario(one) for one in self.scenarios],
            "warnings": self.warnings,
        }  # fmt: skip


def scenario_frequencies(
    file: Path,
    limits: Sequence[float],
    *,
    complete_from: float,
    up_to: float | None,
    years: float | None,
    rate: float | None,
    area_ha: float | None,
    length_m: float | None,
) -> ScenarioFrequencies:
    """Fit a power law to a table of block volumes, and return the frequencies of scenarios.

    InputError: no power law fits. ConfigError: the limits do not rise, or leave the law.

    Parameters
    ----------
    limits : sequence of float
        Limits of the volumes of the scenarios (m3), rising.
    complete_from, up_to : float
        Volumes between which the law holds (m3); None: no largest volume.
    years, rate : float or None
        In which the blocks of the list were released; or blocks of the law a year.
    area_ha, length_m : float or None
        Hectares or metres on which they were released; None for a release area as a whole.
    """
    survey, left_out = read_block_survey(file)
    largest = math.inf if up_to is None else up_to
    _check_limits(limits, complete_from, min(largest, 1000.0))
    try:
        law = fit_power_law(survey, complete_from, largest)
    except InputError as error:
        raise InputError(**error.parts(file=file)) from None
    distance, p = fit_test(law)
    if years is not None:
        rate = law.survey.blocks / years
    extent = 1.0
    unit: OnsetUnit = "per_year"
    if area_ha is not None:
        extent, unit = area_ha, "per_year_ha"
    elif length_m is not None:
        extent, unit = length_m, "per_year_m"

    def scenario(low: float, high: float) -> Scenario:
        frequency = None
        if rate is not None:
            frequency = law.frequency(low, high, rate / extent, years is not None)
        return Scenario(low, high, law.frequency(low, high, 1.0, False), frequency)

    scenarios = tuple(scenario(low, high) for low, high in pairwise(limits))
    warnings = [f"columns that were not read: {', '.join(left_out)}"] if left_out else []
    if law.survey.blocks < _FEW:
        warnings.append(f"only {law.survey.blocks} blocks: the interval is wide")
    if p < _DOUBT:
        warnings.append(f"the volumes hardly follow a power law (p = {p:.2g})")
    seen = float(law.survey.low.max())
    if limits and limits[-1] > seen:
        warnings.append(f"above {seen:g} m3 no volume was measured: the law is extrapolated")
    if limits and limits[-1] < largest:
        rest = law.frequency(limits[-1], largest, 1.0, False).value
        warnings.append(
            f"{100 * rest:.2g} % of the blocks are above {limits[-1]:g} m3, in no scenario"
        )
    return ScenarioFrequencies(
        file=file, blocks=survey.blocks, law=law, higher=tuple(higher_thresholds(law)),
        distance=distance, p=p, total=scenario(complete_from, largest), scenarios=scenarios,
        unit=unit, warnings=tuple(warnings),
    )  # fmt: skip


def _check_limits(limits: Sequence[float], least: float, most: float) -> None:
    rising = all(low < high for low, high in pairwise(limits))
    if len(limits) == 1 or not rising or (limits and not least <= limits[0] <= limits[-1] <= most):
        raise ConfigError(
            "cannot be limits of scenarios", field="--scenarios",
            found=",".join(f"{v:g}" for v in limits),
            expected=f"two or more rising volumes within {least:g} and {most:g} m3, as 0.1,1,10",
        )  # fmt: skip


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _text(found: Estimate) -> str:
    if found.lower == found.upper:
        return f"{found.value:.3g}"
    return f"{found.value:.3g} ({found.lower:.3g} to {found.upper:.3g})"
