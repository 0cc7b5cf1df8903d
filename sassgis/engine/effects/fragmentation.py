"""Breaking of blocks at impacts."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from sassgis.compiled import rng
from sassgis.compiled.jit import kernel, lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.engine.effects.spawning import MOST_SPAWNED, spawn
from sassgis.engine.ellipse import CountedRows, Record
from sassgis.engine.state import Block
from sassgis.grid import FloatArray
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import checked


@checked(frozen=True, slots=True)
class Fragmentation(EffectSection):
    """Breaking of blocks at impacts.

    "fractal" after RockGIS (Matas et al. 2017) and RFFM (Ruiz-Carulla et al. 2017): a threshold, a
    survival rate, volumes by a power law, a cone. How they are drawn is our own, as is "threshold".
    """

    name: ClassVar[str] = "fragmentation"

    form: Annotated[
        Literal["fractal", "threshold"],
        '"fractal": where an impact takes more energy per unit mass (e) than energy_jkg, all '
        "but the share survival_rate of the blocks break; the volumes of the fragments follow "
        'N(> V) ~ V^−D/3 down to smallest_m3. "threshold": all break there, into equal parts',
    ] = "fractal"
    energy_jkg: Annotated[float, Interval(ge=0.0, le=1e6), "threshold e_0 of e (J/kg)"] = 400.0
    survival_rate: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        'of "fractal": share of the blocks that stay whole at the threshold',
    ] = 0.7
    shape: Annotated[
        float,
        Interval(ge=0.0, le=20.0),
        'of "fractal": above it survival_rate^((e/e_0)^shape) stay whole; 0: as many at any energy',
    ] = 0.0
    fractal_dimension: Annotated[
        float, Interval(ge=0.5, le=2.9), 'D of "fractal": the exponent of the volumes is D/3'
    ] = 2.5
    pieces: Annotated[int, Interval(ge=2, le=20), 'most fragments of a break of "threshold"'] = 5
    loss: Annotated[
        float,
        Interval(ge=0.0, le=0.99),
        "share of the energy left after the impact that breaking takes",
    ] = 0.1
    cone_deg: Annotated[
        float,
        Interval(ge=0.0, le=89.0),
        "fragments leave within this angle of the direction of the whole (degrees)",
    ] = 20.0
    smallest_m3: Annotated[
        float,
        Interval(ge=1e-5, le=10.0),
        "no smaller fragment is made: fewer fragments, or the block stays whole (m3)",
    ] = 0.02


FRACTAL, THRESHOLD = 1, 2
#: Draws of a stream that are kept for one break: more than there is room for fragments.
_DRAWS = 8192


FragmentationNumbers, prepare = kernel_form(Fragmentation)


@lean
def breaks(breaking: Numbers, key: np.uint64, number: int, lost: float) -> bool:
    """Return whether an impact that takes ``lost`` (J/kg) breaks the block."""
    if lost <= max(breaking.energy_jkg, 0.0):
        return False
    if breaking.form == THRESHOLD:
        return True
    above = lost / breaking.energy_jkg if breaking.energy_jkg > 0.0 else 1.0
    whole = breaking.survival_rate ** (above**breaking.shape)
    return bool(rng.uniform(key, rng.BREAKS, number) < 1.0 - whole)


@lean
def most_fragments(breaking: Numbers, volume: float) -> int:
    """Count the most fragments of a volume (m³), none of them below the smallest.

    One more than there is room for counts as too many.
    """
    most = min(int(min(volume / breaking.smallest_m3, 1e6)), MOST_SPAWNED + 1)
    return min(most, breaking.pieces) if breaking.form == THRESHOLD else most


@lean
def shares(breaking: Numbers, key: np.uint64, number: int, volume: float, out: FloatArray) -> int:
    """Fill ``out`` with the shares of fragments in a volume (m³), largest first, that add up to 1.

    Of "fractal" the i-th is in proportion to Γ_i^(-1/b), Γ_i the i-th point of a Poisson process
    with the rate 1: N(> V) follows V^-b without a lower end, and the largest scatter as in nature.
    The list ends before a fragment that would be below the smallest; those on it share the volume,
    what the law has below the smallest included. Returns how many fragments there are, 0 if fewer
    than two: the block stays whole.
    """
    n = out.size
    if breaking.form == THRESHOLD:
        out[:] = 1.0 / max(n, 1)
        return n if n >= 2 else 0
    exponent = breaking.fractal_dimension / 3.0
    point = 0.0
    total = 0.0
    for i in range(n):
        point -= math.log(rng.uniform(key, rng.FRAGMENT_SIZE, _DRAWS * number + i))
        size = point ** (-1.0 / exponent)
        if volume * size < breaking.smallest_m3 * (total + size):
            n = i
            break
        out[i] = size
        total += size
    if n < 2:
        return 0
    for i in range(n):
        out[i] /= total
    return n


@lean
def sideways_speeds(
    breaking: Numbers, key: np.uint64, number: int, n: int, share: FloatArray, out: FloatArray
) -> float:
    """Fill ``out`` with the sideways speeds of n fragments over their common speed ahead.

    No sideways momentum is made: the mean over the masses is taken off. Returns the common speed
    ahead over that of the whole: the fragments together have 1 − loss of its energy.
    """
    mean = 0.0
    for i in range(n):
        angle = (
            2.0 * rng.uniform(key, rng.FRAGMENT_ANGLE, _DRAWS * number + i) - 1.0
        ) * math.radians(breaking.cone_deg)
        out[i] = math.tan(angle)
        mean += share[i] * out[i]
    sideways = 0.0
    for i in range(n):
        out[i] -= mean
        sideways += share[i] * out[i] * out[i]
    return math.sqrt((1.0 - breaking.loss) / (1.0 + sideways))


@lean
def angles_aside(
    breaking: Numbers, key: np.uint64, number: int, n: int, share: FloatArray, vx: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Fill ``out`` with the angles in plan (rad) between the paths of n fragments and of the whole.

    No lateral momentum arises: with the speeds ``vx`` along their paths, Σ m v_x sin(angle) = 0.
    """
    mean = 0.0
    weights = 0.0
    for i in range(n):
        angle = 2.0 * rng.uniform(key, rng.FRAGMENT_ASIDE, _DRAWS * number + i) - 1.0
        out[i] = math.sin(angle * math.radians(breaking.cone_deg))
        weight = share[i] * abs(vx[i])
        mean += weight * out[i]
        weights += weight
    if weights > 0.0:
        mean /= weights
    widest = 1.0
    for i in range(n):
        out[i] -= mean
        widest = max(widest, abs(out[i]))
    for i in range(n):
        out[i] = math.copysign(math.asin(out[i] / widest), out[i] * vx[i])


@kernel
def break_up(
    breaking: Numbers, spawned: CountedRows, block: Block, number: int, state: Record
) -> bool:
    """Break a block in flight into fragments; False if it is too small to break."""
    volume = 4.0 / 3.0 * math.pi * block.a * block.b * block.c
    share = np.empty(most_fragments(breaking, volume))
    n = shares(breaking, block.key, number, volume, share)
    if n < 2:
        return False
    side = np.empty(n)
    ahead = sideways_speeds(breaking, block.key, number, n, share, side)
    vx = ahead * (state.vx - side * state.vz)
    vz = ahead * (state.vz + side * state.vx)
    aside = np.empty(n)
    angles_aside(breaking, block.key, number, n, share, vx, aside)
    spin = math.sqrt(1.0 - breaking.loss) * state.omega
    for i in range(n):
        size = share[i] ** (1.0 / 3.0)
        spawn(
            spawned, state.x, state.z, vx[i], vz[i], state.theta, spin, block, size,
            share[i] * block.mass, state.began + state.t, aside[i],
        )  # fmt: skip
    return True
