"""Settings check themselves, however they are made."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
import pytest
from annotated_types import Interval

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.trees import Trees
from sassgis.errors import ConfigError
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.schema import Renamed, Section, Several, Span, checked, declared, is_file
from sassgis.settings.settings import BlockSettings, RunSettings, TerrainSettings


@checked(frozen=True, slots=True)
class Sample(Section):
    """A section."""

    length_m: Annotated[float | None, Interval(gt=0, lt=10), "a length (m)"] = None
    span_m: Annotated[Span[Annotated[float, Interval(ge=0)]], "two lengths (m)"] = (0.0, 1.0)
    rule: Annotated[Literal["a", "b"], "a rule", Renamed("law")] = "a"
    many: Annotated[Several[Annotated[int, Interval(ge=1, le=3)]], "numbers"] = (1,)
    file_note: str = "no setting"


def test_what_is_declared():
    keys = declared(Sample)
    assert list(keys) == ["length_m", "span_m", "rule", "many"]
    assert keys["rule"].old_name == "law" and keys["many"].old_name is None
    assert keys["length_m"].description == "a length (m)"
    assert not keys["length_m"].is_required
    assert declared(BlockSettings)["name"].is_required
    assert is_file(declared(TerrainSettings)["dem"].kind)
    assert not is_file(declared(TerrainSettings)["crs"].kind)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"length_m": 0.0}, ["length_m", "found 0.0", "above 0 and below 10"]),
        ({"length_m": float("nan")}, ["length_m", "found nan", "finite"]),
        ({"span_m": (2.0, 1.0)}, ["span_m", "reversed"]),
        ({"span_m": (-1.0, 1.0)}, ["span_m", "found -1.0", "0 or more"]),
        ({"rule": "c"}, ["rule", "found 'c'", "'a' or 'b'"]),
        ({"many": (1, 4)}, ["many", "found 4", "at most 3"]),
    ],
)
def test_a_value_beyond_its_limits_is_refused(wrong, words):
    with pytest.raises(ConfigError) as error:
        Sample(**wrong)
    assert all(word in str(error.value) for word in words), str(error.value)
    with pytest.raises(ConfigError):
        replace(Sample(), **wrong)


def test_numbers_of_numpy_are_taken():
    made = Sample(np.float32(9.5), span_m=np.float64(0.0), many=[np.int64(2).item()])
    assert (made.length_m, made.span_m, made.many) == (9.5, (0.0, 0.0), (2,))
    assert RunSettings(seed=np.int64(5)).seed == 5


def test_a_set_of_effects():
    drag, trees = AirDrag(), Trees("viscous")
    both = EffectSettings(drag, trees)
    assert both.names == ("air_drag", "trees")
    assert both.get(Trees) is trees and both.named("air_drag") is drag
    assert both.without(AirDrag) == EffectSettings(trees)
    assert EffectSettings(drag).get(Trees) is None and EffectSettings().names == ()
    other = AirDrag(drag_coefficient=1.0)
    assert both.having(other).get(AirDrag) == other
    with pytest.raises(ValueError, match="twice"):
        EffectSettings(drag, other)
