"""The protocol names what the templates hold, and the templates what the protocol asks for."""

from __future__ import annotations

import re
from pathlib import Path

from sassgis.gap.constants import STRENGTH_SHARES
from sassgis.inputs.observation_files import read_observations, validate_observations
from sassgis.outputs.gap_files import POWER_COLUMNS
from sassgis.settings.ground import RANGED


def test_the_protocol_and_the_templates_fit(repository: Path, tmp_path: Path, printed) -> None:
    page = (repository / "docs" / "measuring.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z_0-9]+)`", page))
    folder = tmp_path / "observed"
    printed("gap", "template", folder)
    heads = {f.stem: f.read_text("utf-8").splitlines()[0].split(",") for f in folder.glob("*.csv")}
    keys = [row.rstrip(",") for row in (folder / "metadata.csv").read_text("utf-8").split()[1:]]
    known = {*heads, *keys, *(column for columns in heads.values() for column in columns)}
    known |= {*POWER_COLUMNS, *STRENGTH_SHARES}
    assert named <= {*known, *RANGED}, named - known
    assert {"rocks", "deposits", "stations", "passages", "impacts", "metadata"} <= named
    words = keys[keys.index("passages_missed_share") + 1 :]
    assert len(words) == 5 and set(words) <= named

    (folder / "rocks.csv").write_text("rock_id,x,y\nR1,10,20\n", encoding="utf-8")
    rows = "".join(f"{key},some words\n" for key in words)
    (folder / "metadata.csv").write_text(f"key,value\nfps,100\n{rows}", encoding="utf-8")
    read = read_observations(folder)
    assert dict(read.metadata.others) == dict.fromkeys(words, "some words")
    assert not [f for f in validate_observations(read) if "only passed on" in str(f)]
