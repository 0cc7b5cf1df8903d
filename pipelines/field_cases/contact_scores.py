"""Contacts that were filmed or published, what the contact law makes of them, and measures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from field_cases import tables
from field_cases.contacts import plate_axes, read_contacts
from field_cases.program_contacts import DENSITY_KGM3
from field_cases.sites import AXES
from sassgis.engine.effects import hooks
from sassgis.engine.simulate import physics_of
from sassgis.gap.residuals.impact_residuals import impact_draws
from sassgis.grid import FloatArray
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.settings import EngineSettings

#: Ground of Chant Sura, by its description.
MEADOW = "soft_meadow"
#: Normal speeds that divide the contacts (m/s).
EDGES = (0.5, 1.0, 2.0, 3.0, 5.0, 20.0)
#: With fewer contacts a group is not shown.
FEWEST = 10
STATES = ("vt_in_mps", "vn_in_mps", "omega_in_radps")
AFTER = ("vt_out_mps", "vn_out_mps", "omega_out_radps")
MEASURES = ("r_n", "r_t", "energy_kept", "spin_share")


def filmed(data: Path) -> pd.DataFrame:
    """The contacts at Chant Sura that were measured, before and after."""
    events, rocks = read_contacts(data / "chant_sura_2020")
    used = events[(events["left_out"] == "") & events["omega_out_radps"].notna()]
    sized = used.merge(rocks[["rock_id", *AXES]], on="rock_id", validate="m:1")
    return sized.assign(ground=MEADOW).reset_index(drop=True)


def published_grazing(data: Path) -> tuple[pd.DataFrame, FloatArray]:
    """States before the impacts of Lu et al. (2019), Table 2, and horizontal speed kept in each.

    The slope is that from one impact to the next; the last row has no flight after it.
    """
    table = pd.read_csv(
        tables.field_file(data, "chant_sura_2020/scarring_lu2019", "lu2019_table2_impacts.csv")
    )
    level = np.hypot(table["vx_mps"], table["vy_mps"]).to_numpy()
    run = np.hypot(np.diff(table["x_start_lv95"]), np.diff(table["y_start_lv95"]))
    dip = np.arctan2(-np.diff(table["z_start_m"]), run)
    down = -table["vz_mps"].to_numpy()[:-1]
    rows = pd.DataFrame(
        {
            "ground": MEADOW,
            "slope_deg": np.degrees(dip),
            "vt_in_mps": level[:-1] * np.cos(dip) + down * np.sin(dip),
            "vn_in_mps": level[:-1] * np.sin(dip) - down * np.cos(dip),
            "omega_in_radps": table["wres_radps"].to_numpy()[:-1],
            **dict(zip(AXES, plate_axes(780.0), strict=True)),
        }
    )
    use = (rows["vn_in_mps"] < 0.0).to_numpy()
    return rows[use].reset_index(drop=True), (level[1:] / level[:-1])[use]


def simulated(
    contacts: pd.DataFrame, table: GroundTable, draws: int, seed: int = 1986
) -> FloatArray:
    """v_t, v_n and spin after each contact, in orientations and slopes as the engine draws them.

    Shape (n, draws, 3). All rebound, as was observed, however slow they are.
    """
    rng = np.random.default_rng(seed)
    n = len(contacts)
    settings = EngineSettings().resolved()
    grounds = hooks.ground_of(EffectSettings(), table.with_rolling_threshold(0.0))
    kinds = np.array([table.index(name) for name in contacts["ground"]], np.int64)
    drawn = np.empty((n, draws, 3))
    drawn[..., 0] = rng.uniform(0.0, np.pi, (n, draws))
    low, high = (grounds[kinds][k][:, None] for k in ("dp_min", "dp_max"))
    drawn[..., 1] = low + (high - low) * rng.uniform(size=(n, draws))
    out = np.empty((n, draws, 3))
    axes = np.repeat(contacts[AXES].to_numpy(float)[:, None, :], draws, axis=1)
    states = np.column_stack(
        [np.radians(contacts["slope_deg"]), contacts[list(STATES)].to_numpy(float)]
    )
    impact_draws(
        states, kinds, np.ascontiguousarray(axes), drawn, np.zeros((n, draws), np.uint64),
        np.full(n, DENSITY_KGM3), grounds, np.zeros(1, hooks.BLOCK_DTYPE), physics_of(settings),
        hooks.prepare(EffectSettings(), has_stems=False), out,
    )  # fmt: skip
    return out


def measures(contacts: pd.DataFrame, after: FloatArray) -> FloatArray:
    """R_n, R_t, share of the energy kept and spin over that of rolling; shape (n, m, 4)."""
    vt, vn, spin = (contacts[name].to_numpy(float)[:, None] for name in STATES)
    a, b, _ = (contacts[name].to_numpy(float)[:, None] for name in AXES)
    inertia = (a**2 + b**2) / 5.0
    size = np.cbrt(contacts[AXES].to_numpy(float).prod(axis=1))[:, None]
    before = vt**2 + vn**2 + inertia * spin**2
    t, n, w = np.moveaxis(after, -1, 0)
    kept = (t**2 + n**2 + inertia * w**2) / before
    # Of a block that hardly goes on along the ground the share says nothing.
    share = w * size / np.where(np.abs(t) > 0.5, t, np.nan)
    return np.stack([n / -vn, t / vt, kept, share], axis=-1)


def observed(contacts: pd.DataFrame) -> FloatArray:
    """The measures of what was observed; shape (n, 1, 4)."""
    return measures(contacts, contacts[list(AFTER)].to_numpy(float)[:, None, :])


def _summary(values: FloatArray) -> dict[str, list[float]]:
    """10, 50 and 90 % quantile of each measure."""
    rows = values.reshape(-1, len(MEASURES))
    return {
        name: np.nanquantile(rows[:, k], [0.1, 0.5, 0.9]).tolist()
        for k, name in enumerate(MEASURES)
    }


def compared(contacts: pd.DataFrame, made: FloatArray) -> dict[str, Any]:
    """Observed and simulated measures of some contacts together."""
    return {
        "contacts": len(contacts),
        "observed": _summary(observed(contacts)),
        "simulated": _summary(measures(contacts, made)),
    }


def by_speed(contacts: pd.DataFrame, made: FloatArray) -> list[dict[str, Any]]:
    """The same by ground and normal speed, groups of FEWEST contacts or more."""
    group = pd.cut(-contacts["vn_in_mps"], EDGES, labels=False)
    rows = []
    for ground in sorted(set(contacts["ground"])):
        for k in range(len(EDGES) - 1):
            own = ((contacts["ground"] == ground) & (group == k)).to_numpy()
            if own.sum() >= FEWEST:
                found = compared(contacts[own], made[own])
                rows.append({"ground": ground, "vn_mps": list(EDGES[k : k + 2]), **found})
    return rows
