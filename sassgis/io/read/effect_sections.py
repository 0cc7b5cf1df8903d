"""``[effects.*]``: what the model of 1986 leaves out, as sections of the configuration."""

from __future__ import annotations

import dataclasses
import re
from typing import Annotated, Any, get_type_hints

from pydantic import Field, create_model, model_validator

from sassgis.io.read.sections import FileName, Flag, Int, Num, Section, between, refuse
from sassgis.model.effects import EffectSettings
from sassgis.model.errors import ConfigError


def attribute_notes(cls: type) -> dict[str, str]:
    """Text under each attribute of a numpydoc class docstring."""
    notes: dict[str, str] = {}
    current = ""
    for line in (cls.__doc__ or "").splitlines():
        head = re.match(r"    (\w+) : ", line)
        if head:
            current = head.group(1)
            notes[current] = ""
        elif current and line.startswith("        "):
            notes[current] = f"{notes[current]} {line.strip()}".strip()
    return notes


def model_of(cls: type, name: str, base: type[Section] = Section) -> type[Section]:
    """A section with exactly the fields of a settings class, so that the two cannot drift apart."""
    kinds: dict[Any, Any] = {float: Num, int: Int, bool: Flag}
    hints = get_type_hints(cls)
    notes = attribute_notes(cls)
    fields: dict[str, Any] = {
        f.name: (
            kinds.get(hints[f.name], hints[f.name]),
            Field(f.default, description=notes.get(f.name) or f.name.replace("_", " ")),
        )
        for f in dataclasses.fields(cls)
    }
    return create_model(name, __base__=base, **fields)


class ForestPlace(Section):
    """Where the forest of ``[effects.trees]`` stands."""

    file: FileName | None = Field(
        default=None, description="polygons of forest; without it and rasters, forest is everywhere"
    )
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    stems_field: str | None = Field(
        default=None, min_length=1, description="attribute with the stems per hectare"
    )
    dbh_field: str | None = Field(
        default=None, min_length=1, description="attribute with the diameter at breast height (cm)"
    )
    stems_raster: FileName | None = Field(
        default=None, description="raster of stems per hectare, in place of polygons"
    )
    dbh_raster: FileName | None = Field(
        default=None, description="raster of diameters at breast height (cm)"
    )
    stems_per_ha: Annotated[Num, between(0, 20_000)] | None = Field(
        default=None, description="stems per hectare where nothing else is said"
    )
    dbh_cm: Annotated[Num, between(0, 300)] | None = Field(
        default=None, description="diameter at breast height where nothing else is said (cm)"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> ForestPlace:
        rasters = self.stems_raster is not None or self.dbh_raster is not None
        if rasters and self.file is not None:
            raise refuse("forest is given twice", "polygons or rasters", key="stems_raster")
        for what, field, raster in (
            ("stems_per_ha", self.stems_field, self.stems_raster),
            ("dbh_cm", self.dbh_field, self.dbh_raster),
        ):
            if getattr(self, what) is None and field is None and raster is None:
                raise refuse("missing key", "a number, an attribute or a raster", key=what)
            if field is not None and self.file is None:
                raise refuse("has no file to go with", "effects.trees.file as well", key=what)
        return self


_SETTINGS = {
    f.name: get_type_hints(EffectSettings)[f.name].__args__[0]
    for f in dataclasses.fields(EffectSettings)
}
#: The model of each ``[effects.<family>]``.
EFFECT_SECTIONS: dict[str, type[Section]] = {
    name: model_of(cls, f"{cls.__name__}Section", ForestPlace if name == "trees" else Section)
    for name, cls in _SETTINGS.items()
}
_KEYS: dict[str, Any] = {
    name: (model | None, Field(default=None, description=f"section [effects.{name}]"))
    for name, model in EFFECT_SECTIONS.items()
}
EffectsSection = create_model("EffectsSection", __base__=Section, **_KEYS)


def effect_settings(section: Section) -> EffectSettings:
    """Settings of the effects that a section turns on.

    Raises
    ------
    ConfigError
        A number is out of range; the field is family and key.
    """
    on = {}
    for name, cls in _SETTINGS.items():
        own = getattr(section, name)
        if own is not None:
            try:
                on[name] = cls(**{f.name: getattr(own, f.name) for f in dataclasses.fields(cls)})
            except ConfigError as error:
                raise ConfigError(
                    error.problem,
                    field=f"{name}.{error.field}",
                    found=error.found,
                    expected=error.expected,
                ) from None
    return EffectSettings(**on)
