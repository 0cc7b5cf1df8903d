"""Models read back from ``model/ensemble.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sassgis.engine.effects.registry import EFFECTS
from sassgis.gap.forward.released_rocks import (
    ENGINE_KEYS,
    ForestStand,
    HypothesisModel,
    MeasurementError,
    ReleaseError,
)
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable


def model_from_json(plain: Mapping[str, Any]) -> HypothesisModel:
    """The model of ``model_as_json``."""
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
