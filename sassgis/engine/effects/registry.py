"""The effects beyond the model of 1986: one row for each.

The configuration with its checks, the template, the documentation and the report follow from the
row; the motion follows from the hooks (``hooks.py``). Effects that the diagnosis can name have a
row in ``sassgis.gap.causes.all_causes`` as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import Wind
from sassgis.settings.blocks import EffectSection, ForestPlace
from sassgis.settings.schema import Declared, Section, declared

Phase = Literal["release", "flight", "impact", "ground", "path"]


@dataclass(frozen=True, slots=True)
class Effect:
    """One effect."""

    settings: type[EffectSection]  # with the name of the effect
    phase: Phase  # of the motion in which it acts; "path": on the heading of followed paths
    label: str  # its name in a sentence
    summary: str  # what it does, to follow "the gap is best explained by"
    # More settings of its section, which say where it acts and are read into a map.
    place: type[Section] | None = None

    @property
    def name(self) -> str:
        """Return the name, as in ``[effects.<name>]``."""
        return self.settings.name

    @property
    def keys(self) -> Mapping[str, Declared]:
        """Return all declared settings of the section ``[effects.<name>]``."""
        place = {} if self.place is None else declared(self.place)
        return {**place, **declared(self.settings)}


_ROWS = (
    Effect(AirDrag, "flight", "air drag", "the drag of the air"),
    Effect(Wind, "flight", "wind", "a steady wind on blocks in flight"),
    Effect(Trees, "flight", "trees", "trees that take energy from passing rocks", ForestPlace),
    Effect(
        SoftGround, "impact", "soft ground", "soft ground that yields at impacts and takes energy"
    ),
    Effect(
        Roughness, "impact", "roughness of the ground",
        "ground that is rougher than the terrain model shows",
    ),
    Effect(
        RockShape, "impact", "shape of the rocks",
        "the shape of the rocks, which the plane ellipse neglects",
    ),
    Effect(Fragmentation, "impact", "fragmentation", "blocks that break at impacts"),
    Effect(
        Entrainment, "impact", "entrainment", "blocks of the slope that passing rocks set in motion"
    ),
    Effect(
        LateralDeflection, "path", "lateral deflection", "rocks that leave the fall line laterally"
    ),
)  # fmt: skip

#: The effects by name, in the order in which they are listed everywhere.
EFFECTS: Mapping[str, Effect] = {row.name: row for row in _ROWS}
