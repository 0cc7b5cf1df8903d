"""Diagnosers that answer without looking, for the tests of the check."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import Any


def answer(
    out: str,
    effect: str,
    confidence: float = 0.7,
    *,
    confusion: tuple[str, ...] | None = None,
    phase: str = "",
    segments: tuple[str, ...] = (),
    shrinkage: float | None = None,
) -> None:
    """Write the part of diagnosis.json that a check reads."""
    verdict = {
        "effect": effect,
        "confidence": confidence,
        "confusion_set": list(confusion or (effect,)),
        "phase": phase,
        "segments": list(segments),
        "reason": "",
    }
    Path(out).mkdir(parents=True, exist_ok=True)
    rung = "ground" if effect in ("none", "unknown") else effect
    ladder = [{"rung": rung, "share": shrinkage, "ci95": None}]
    content = {"verdict": verdict, "ladder": ladder, "advice": {"recommended": rung}}
    (Path(out) / "diagnosis.json").write_text(json.dumps(content))


def all_none(config: str, observations: str, out: str, **options: Any) -> None:
    assert options == {"jobs": 1, "seed": 1, "overwrite": True}
    assert Path(config).is_file()
    assert (Path(observations) / "rocks.csv").is_file()
    answer(out, "none")


def told(config: str, observations: str, out: str, **_: Any) -> None:
    """Answer what a file far from the check says; the number of the world is in the path."""
    case = Path(out).name
    root = Path(out).parents[1]
    said = json.loads((root.parent / "told.json").read_text())[case]
    if said["effect"] == "break":
        raise ZeroDivisionError("no\nway")
    answer(out, said.pop("effect"), **said)


def peeks_at_modules(config: str, observations: str, out: str, **_: Any) -> None:
    assert not [name for name in sys.modules if name.startswith("sassgis.gap.check.worlds")]
    try:
        import sassgis.gap.check.worlds  # noqa: F401
    except ImportError as error:
        Path(out).mkdir(parents=True)
        (Path(out) / "refused.txt").write_text(str(error))


def peeks_at_files(config: str, observations: str, out: str, **_: Any) -> None:
    root = Path(out).parents[1]
    refused = []
    for path in (
        "check.json",
        "blinded/salt.txt",
        "cases/001/config.toml",
        "cases/002/config.toml",
    ):
        try:
            (root / path).read_text()
        except PermissionError:
            refused.append(path)
    try:
        list((root / "cases").iterdir())
    except PermissionError:
        refused.append("cases")
    answer(out, "none")
    (Path(out) / "refused.json").write_text(json.dumps(refused))


def stops_at_four(config: str, observations: str, out: str, **_: Any) -> None:
    """Ends its process at the fourth world, as a lack of memory would; the fourth time goes on."""
    marker = Path(out).parents[2] / "ended"
    times = len(marker.read_text()) if marker.exists() else 0
    if Path(out).name == "004" and times < 3:
        marker.write_text("x" * (times + 1))
        sys.exit(3)
    answer(out, "none")


def is_killed(config: str, observations: str, out: str, **_: Any) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def threads() -> dict[str, Any]:
    import numba
    import numpy  # noqa: F401
    import threadpoolctl

    found = {info["num_threads"] for info in threadpoolctl.threadpool_info()}
    return {"numba": numba.get_num_threads(), "others": sorted(found)}


def measured(config: str, fresh: str, answer_folder: str) -> dict[str, Any]:
    rows = len((Path(fresh) / "rocks.csv").read_text().splitlines()) - 1
    distances = {"D_configured": 2.0, "D_base": 1.0, "D_effect": 0.5, "D_floor": float("nan")}
    return {"S": rows / 2000.0, **distances}
