"""Models as plain values, so that a calibrated one can be kept in a file and used again."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from sassgis.engine.effects.registry import EFFECTS
from sassgis.gap.replicas.hypothesis_model import (
    ENGINE_KEYS,
    ForestStand,
    HypothesisModel,
    MeasurementError,
    ReleaseError,
)
from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundClass, GroundTable


def model_as_json(model: HypothesisModel) -> dict[str, Any]:
    """A model as dictionaries, lists, texts and numbers."""
    effects = {own.name: dataclasses.asdict(own) for own in model.effects}
    plain: dict[str, Any] = _plain({**dataclasses.asdict(model), "effects": effects})
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value


def model_from_json(plain: Mapping[str, Any]) -> HypothesisModel:
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
    stand = plain["stand"]
    return HypothesisModel(
        GroundTable(tuple(GroundClass(**own) for own in plain["table"]["classes"])),
        EffectSettings(*effects),
        None if stand is None else ForestStand(**stand),
        ReleaseError(**plain["release"]),
        MeasurementError(**plain["measurement"]),
        **{key: plain[key] for key in ENGINE_KEYS},
    )
