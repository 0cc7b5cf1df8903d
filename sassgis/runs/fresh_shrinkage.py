"""How far the model handed over closes the gap, measured on rocks that no diagnosis has seen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.gap.calibration.problem import Scale, model_rows, problem_of
from sassgis.gap.inference.distances import RockDistances
from sassgis.gap.ladder.handover import CONFIGURED_NUMBER
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.gap.replicas.model_json import model_from_json
from sassgis.model.errors import InputError
from sassgis.runs.gap_case import read_case

ENSEMBLE = "model/ensemble.json"


def measured_shrinkage(
    config: str | Path, observations: str | Path, answer: str | Path
) -> dict[str, float | None]:
    """Measure how far the gap shrinks on other rocks of the same slope.

    The model as configured and those that the diagnosis calibrated, without and with the effect
    that it names, release the new rocks; nothing is calibrated again. The rocks of the diagnosis
    itself give the campaigns again by which its models were chosen.

    Parameters
    ----------
    observations : path
        Of the new rocks.
    answer : path
        Folder that ``diagnose`` wrote.

    Returns
    -------
    dict
        "S", from the configured model to the one handed over (None where the gap of the configured
        one may be chance); "D_configured", "D_base", "D_effect", "D_floor".

    Raises
    ------
    ConfigError, InputError
    """
    file = Path(answer) / ENSEMBLE
    try:
        kept: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        scale = Scale(
            tuple(kept["scale"]["names"]),
            np.array(kept["scale"]["centre"]),
            np.array(kept["scale"]["scale"]),
        )
        models = {name: model_from_json(kept[name]["model"]) for name in ("base", "effect")}
        numbers = {name: int(kept[name]["number"]) for name in models}
        count, seed = int(kept["count"]), int(kept["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "the calibrated models of a diagnosis cannot be read", file=file, found=str(error)
        ) from error
    problem = problem_of(read_case(config, observations), seed, scale)
    models["configured"] = configured_model(problem.case)
    numbers["configured"] = CONFIGURED_NUMBER
    base, effect, configured = (
        RockDistances.of(problem.rows, model_rows(problem, model, numbers[name], count))
        for name, model in models.items()
    )
    gap = configured.value() - effect.floor
    return {
        "S": (configured.value() - effect.value()) / gap if configured.above_chance else None,
        "D_configured": configured.value(),
        "D_base": base.value(),
        "D_effect": effect.value(),
        "D_floor": effect.floor,
    }
