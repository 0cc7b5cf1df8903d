"""Models as plain values, so that a calibrated one can be kept in a file and used again."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from sassgis.engine.effects.registry import EFFECTS
from sassgis.gap.replicas import Aside, Measurement, Model, Release, Stand
from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundClass, GroundTable


def model_as_json(model: Model) -> dict[str, Any]:
    """A model as dictionaries, lists, texts and numbers; infinite limits become None."""
    effects = {own.name: dataclasses.asdict(own) for own in model.effects}
    plain: dict[str, Any] = _plain({**dataclasses.asdict(model), "effects": effects})
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def model_from_json(plain: Mapping[str, Any]) -> Model:
    """The model of ``model_as_json``.

    Raises
    ------
    KeyError, TypeError
        If the values are not those of a model.
    """
    effects = [
        EFFECTS[name].settings(
            **{k: tuple(v) if isinstance(v, list) else v for k, v in own.items()}
        )
        for name, own in plain["effects"].items()
    ]
    aside = dict(plain["aside"])
    aside["s0"] = -math.inf if aside["s0"] is None else aside["s0"]
    aside["s1"] = math.inf if aside["s1"] is None else aside["s1"]
    stand = plain["stand"]
    return Model(
        GroundTable(tuple(GroundClass(**own) for own in plain["table"]["classes"])),
        EffectSettings(*effects),
        None if stand is None else Stand(**stand),
        Aside(**aside),
        Release(**plain["release"]),
        Measurement(**plain["measurement"]),
        float(plain["turn_noise_deg"]),
    )
