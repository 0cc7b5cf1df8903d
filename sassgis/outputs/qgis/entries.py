"""The layers of a QGIS project, and the groups in which its legend lists them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sassgis.files.vector_layer import VectorLayer, translated_raster, translated_vector
from sassgis.settings.languages import translated
from sassgis.settings.results import RasterLayer


@dataclass(frozen=True, slots=True)
class LayerEntry:
    """A layer of the project; its source is a path from there, as ``maps/energy.tif``."""

    content: RasterLayer | VectorLayer
    source: str
    visible: bool = True
    though_empty: bool = False  # kept though it has no features
    part: str = ""  # name of a part of the layer that is shown by itself
    part_where: str = ""  # which features are in it: a condition in SQL

    @property
    def key(self) -> str:
        """Identity of the layer in the project."""
        if isinstance(self.content, RasterLayer):
            return f"raster_{self.content.stem}"
        return "_".join(filter(None, ("vector", self.content.name, self.part)))

    @property
    def datasource(self) -> str:
        """The source as QGIS writes it."""
        if isinstance(self.content, RasterLayer):
            return f"./{self.source}"
        subset = f"|subset={self.part_where}" if self.part_where else ""
        return f"./{self.source}|layername={self.content.name}{subset}"

    @property
    def provider(self) -> str:
        """QGIS's name of the program that reads it."""
        return "gdal" if isinstance(self.content, RasterLayer) else "ogr"

    @property
    def translated(self) -> LayerEntry:
        """The same in the language in which the program writes."""
        if isinstance(self.content, RasterLayer):
            return replace(self, content=translated_raster(self.content))
        return replace(self, content=translated_vector(self.content))


@dataclass(frozen=True, slots=True)
class LayerGroup:
    """A group of the legend, the first on top; an ``exclusive`` one shows one layer at a time."""

    name: str
    layers: tuple[LayerEntry | LayerGroup, ...]
    exclusive: bool = False
    expanded: bool = True

    @property
    def entries(self) -> list[LayerEntry]:
        """All layers of the group and of the groups in it, the top first."""
        out: list[LayerEntry] = []
        for member in self.layers:
            out += member.entries if isinstance(member, LayerGroup) else [member]
        return out

    @property
    def first_shown(self) -> int:
        """Place of the first layer that is shown; -1 for none."""
        shown = (isinstance(m, LayerEntry) and m.visible for m in self.layers)
        return next((place for place, visible in enumerate(shown) if visible), -1)

    @property
    def translated(self) -> LayerGroup:
        """The same in the language in which the program writes."""
        return replace(
            self, name=translated(self.name), layers=tuple(m.translated for m in self.layers)
        )


def without_empty(group: LayerGroup) -> LayerGroup:
    """Return group without layers that have no features, and without groups that have no layers."""

    def filled(member: LayerEntry | LayerGroup) -> bool:
        if isinstance(member, LayerGroup):
            return bool(member.layers)
        if isinstance(member.content, RasterLayer) or member.though_empty:
            return True
        return not member.content.frame.empty

    members = (without_empty(m) if isinstance(m, LayerGroup) else m for m in group.layers)
    return replace(group, layers=tuple(m for m in members if filled(m)))
