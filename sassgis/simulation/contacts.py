"""Contacts of a block with the ground along its path, from its event log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.ellipse import inertia
from sassgis.engine.simulate import moving_axes
from sassgis.engine.state import END, FLIGHT, IMPACT, ROLLING
from sassgis.settings.results import CONTACT_DTYPE, ContactKind
from sassgis.settings.settings import EngineSettings

_KINDS = {IMPACT: ContactKind.IMPACT, ROLLING: ContactKind.ROLLING}


def contacts_of(
    logs: Sequence[NDArray[np.void]], rocks: NDArray[np.void], engine: EngineSettings
) -> list[NDArray[np.void]]:
    """Return for each block a row for each contact: its state as it begins and as it ends.

    Parameters
    ----------
    logs : of EVENT_DTYPE, shape (n_events,) each
    rocks : ROCK_DTYPE, shape (n_blocks,)
        The blocks to which the logs belong.
    engine : EngineSettings
        With the outline as which they moved; without effects that change their inertia.

    Returns
    -------
    list of CONTACT_DTYPE, shape (n_contacts,) each
        Velocities along the ground (downhill positive) and normal to it (away from it positive).
        Rolling and sliding end where the ground bends or the block leaves it.
    """
    stated = np.column_stack([rocks[f"{axis}_m"] for axis in "abc"])
    turning = [inertia(a, b) for a, b, _ in moving_axes(stated, engine).tolist()]
    return [_contacts(*each) for each in zip(logs, rocks, turning, strict=True)]


def _contacts(log: NDArray[np.void], rock: np.void, turning: float) -> NDArray[np.void]:
    """Return the contacts of a block of a moment of inertia per unit mass (m²)."""
    phase = log["phase"]
    first = np.flatnonzero((phase[:-1] != FLIGHT) & (phase[:-1] != END))
    begin, end = log[first], log[first + 1]
    out = np.zeros(first.size, CONTACT_DTYPE)
    out["rock"], out["contact"] = rock["rock"], np.arange(1, first.size + 1)
    out["kind"] = [_KINDS.get(int(own), ContactKind.SLIDING) for own in begin["phase"]]
    out["t_s"], out["duration_s"] = begin["t_s"], end["t_s"] - begin["t_s"]
    out["chainage_m"], out["z_m"] = begin["x_m"], begin["z_m"]
    downhill = np.where(begin["ux"] < 0.0, -1.0, 1.0)
    tx, tz = downhill * begin["ux"], downhill * begin["uz"]
    out["slope_deg"] = np.degrees(np.arctan2(-tz, tx))
    for side, state in (("in", begin), ("out", end)):
        vx, vz, spin = state["vx_mps"], state["vz_mps"], state["omega_radps"]
        out[f"vt_{side}_mps"] = vx * tx + vz * tz
        out[f"vn_{side}_mps"] = vz * tx - vx * tz
        out[f"rotation_{side}_hz"] = spin / (2.0 * np.pi)
        out[f"energy_{side}_kj"] = 0.5e-3 * rock["mass_kg"] * (vx**2 + vz**2 + turning * spin**2)
    return out
