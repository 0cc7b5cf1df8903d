"""The commented configuration that ``sassgis init`` writes, made from the declared settings."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from typing import Any

from sassgis.engine.effects.registry import EFFECTS
from sassgis.io.read.config import LISTS, SECTIONS, declared_sections
from sassgis.model.declared import Declared

_HEAD = """\
# Configuration of a sassgis run.
#
# Paths are relative to this file. Units are part of the names: m, m/s (mps), rad/s (radps), kg/m3
# (kgm3), kJ (kj), degrees (deg). Where a range [low, high] is asked for, a single number will do.
# A line that starts with "# key =" shows an optional key: with its default, or with an example if
# it has none. Unknown keys are errors, so that a misspelt one cannot go unnoticed.
"""
#: Sections that are left out of a run unless they are asked for.
_OPTIONAL = ("stations", "barriers", "profile", "objects")
#: Sections whose defaults are seldom changed, and stand as comments.
_QUIET = ("engine", "blocks")


def config_template() -> str:
    """A commented configuration with every key; it loads once its paths are filled in."""
    parts = [_HEAD]
    for name, keys in declared_sections().items():
        optional = name in _OPTIONAL or "." in name
        hidden = "# " if optional else ""
        head = f"{hidden}[[{name}]]" if name in LISTS else f"{hidden}[{name}]"
        lines = [*_wrapped(_summary(name), "# "), head]
        for own in keys.values():
            shown = _is_shown(own, quiet=optional or name in _QUIET)
            lines.append(f"{'' if shown else '# '}{own.name} = {toml_value(_value(own))}")
            lines += _wrapped(_text(own), "#     ")
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _summary(section: str) -> str:
    """What a section is about: the first line of the docstring of its type."""
    if "." in section:
        return (EFFECTS[section.split(".")[1]].settings.__doc__ or "").splitlines()[0]
    return (SECTIONS[section].__doc__ or "").splitlines()[0]


def _is_shown(own: Declared, *, quiet: bool) -> bool:
    """Whether a key stands in the template as a setting, and not as a comment."""
    if own.example is not None and own.example.needed:
        return True
    return not quiet and not own.is_required and own.default is not None


def _value(own: Declared) -> Any:
    value = own.default if own.example is None else own.example.value
    # A range of equal limits is written as one number.
    if isinstance(value, tuple) and len(value) == 2 and value[0] == value[1]:
        return value[0]
    return value


def _text(own: Declared) -> str:
    text = own.description
    if own.is_required or (own.example is not None and own.example.needed):
        return text
    return f"{text} (no default)" if own.default is None and "default" not in text else text


def toml_value(value: Any) -> str:
    """A value on one line, as TOML has it."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _wrapped(text: str, start: str) -> list[str]:
    return textwrap.wrap(text, 100, initial_indent=start, subsequent_indent=start)
