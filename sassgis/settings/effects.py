"""Base of the settings of effects; each stands with its kernels in sassgis/engine/effects.

None is on unless it is configured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from sassgis.settings.schema import Section


class EffectSection(Section):
    """Base of the settings of an effect: a frozen dataclass of declared settings with a name."""

    __slots__ = ()

    name: ClassVar[str]  # of the effect, as in ``[effects.<name>]``


Kind = TypeVar("Kind", bound=EffectSection)


@dataclass(frozen=True, slots=True, init=False)
class EffectSettings:
    """The effects of a run that are on, each with its settings."""

    on: tuple[EffectSection, ...]  # at most one of a kind

    def __init__(self, *on: EffectSection) -> None:
        if len({type(own) for own in on}) < len(on):
            raise ValueError("the settings of an effect are given twice")
        object.__setattr__(self, "on", on)

    def __iter__(self) -> Iterator[EffectSection]:
        return iter(self.on)

    def get(self, kind: type[Kind]) -> Kind | None:
        """Return settings of an effect; None if it is off."""
        return next((own for own in self.on if isinstance(own, kind)), None)

    def named(self, name: str) -> EffectSection | None:
        """Return settings of an effect by its name; None if it is off."""
        return next((own for own in self.on if own.name == name), None)

    def having(self, own: EffectSection) -> EffectSettings:
        """Return the same effects with this one, in place of another of its kind."""
        return EffectSettings(*self.without(type(own)), own)

    def without(self, kind: type[EffectSection]) -> EffectSettings:
        """Return the same effects but this one."""
        return EffectSettings(*(own for own in self.on if not isinstance(own, kind)))

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are on."""
        return tuple(own.name for own in self.on)
