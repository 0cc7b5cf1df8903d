"""One row makes an effect known everywhere but in the motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import pytest
from annotated_types import Interval

from sassgis.engine.effects.registry import EFFECTS, Effect
from sassgis.errors import ConfigError
from sassgis.inputs import config as reader
from sassgis.inputs.config import load_config, resolved
from sassgis.outputs.config_template import config_template
from sassgis.settings.blocks import EffectSection, EffectSettings

CONFIG = """
[terrain]
dem = "dem.tif"
[release]
file = "release.gpkg"
[[blocks]]
name = "one"
volume_m3 = 1
"""


@dataclass(frozen=True, slots=True)
class Breeze(EffectSection):
    """Air that moves."""

    name: ClassVar[str] = "breeze"

    speed_mps: Annotated[float, Interval(ge=-50, le=50), "speed of the air (m/s)"] = 5.0


@pytest.fixture
def breeze(monkeypatch: pytest.MonkeyPatch) -> Iterator[Effect]:
    row = Effect(Breeze, "flight", label="breeze", summary="air that moves")
    monkeypatch.setitem(EFFECTS, "breeze", row)  # type: ignore[arg-type]
    reader._document.cache_clear()
    yield row
    reader._document.cache_clear()


def read(folder: Path, text: str) -> reader.Config:
    file = folder / "run.toml"
    file.write_text(CONFIG + text)
    return load_config(file)


def test_a_row_is_a_section_of_the_configuration(breeze: Effect, tmp_path: Path) -> None:
    config = read(tmp_path, "[effects.breeze]\nspeed_mps = 7\n")
    assert config.effects == EffectSettings(Breeze(7.0))
    assert resolved(config)["effects"]["breeze"] == {"speed_mps": 7.0}
    assert resolved(read(tmp_path, ""))["effects"]["breeze"] is None
    assert (
        "# [effects.breeze]\n# speed_mps = 5.0\n#     speed of the air (m/s)" in config_template()
    )
    for text, words in (
        ("speed_mps = 51", ["effects.breeze.speed_mps", "found 51", "at most 50"]),
        ("speed = 5", ["effects.breeze.speed", "unknown key", "'speed_mps'"]),
    ):
        with pytest.raises(ConfigError) as error:
            read(tmp_path, f"[effects.breeze]\n{text}\n")
        assert all(word in str(error.value) for word in words), str(error.value)


def test_without_its_row_the_section_is_unknown(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"effects\.breeze: unknown key"):
        read(tmp_path, "[effects.breeze]\n")
