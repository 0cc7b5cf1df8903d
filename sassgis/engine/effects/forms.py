"""Settings of effects as kernels read them: numbers under the names of the settings."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from typing import Any, Literal, TypeVar, get_args, get_origin

from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import declared

#: A named tuple of the numbers of an effect. ``form`` is 0 where it is off, else the place of its
#: form among those that there are, from 1 on; other choices count from 0, and texts are left out.
Numbers = Any

#: The number of a form that is off.
OFF = 0

Kind = TypeVar("Kind", bound=EffectSection)


def kernel_form(
    kind: type[Kind],
    neutral: Callable[[Kind], bool] = lambda _: False,
    more: Callable[[], dict[str, float]] = dict,
) -> tuple[Any, Callable[[Kind | None], Numbers]]:
    """Return the type of the numbers of an effect, and what makes them of its settings.

    ``neutral`` is whether settings change nothing, so that the effect is off; ``more`` are numbers
    that are no settings. The type is kept with the machine code: its module has it under the name
    of the settings with "Numbers" after it.
    """
    plain = {key: get_args(one.kind)[0] for key, one in declared(kind).items()}
    choices = {key: get_args(of) for key, of in plain.items() if get_origin(of) is Literal}
    keys = [key for key, of in plain.items() if key in choices or of in (float, int)]
    fields = ["form", *(key for key in keys if key != "form"), *more()]
    name = f"{kind.__name__}Numbers"
    made: Any = namedtuple(name, fields, module=kind.__module__)  # type: ignore[misc]

    def number(key: str, given: Any) -> Any:
        if key in choices:
            return 0 if given is None else choices[key].index(given) + int(key == "form")
        return plain[key](given or 0)

    def prepare(settings: Kind | None) -> Numbers:
        """Convert the settings to the form of the kernel; None: the effect is off."""
        on = settings is not None and not neutral(settings)
        given = {key: getattr(settings, key) if on else None for key in keys}
        numbers = {key: number(key, own) for key, own in given.items()}
        return made(**{"form": int(on)} | numbers | more())

    return made, prepare
