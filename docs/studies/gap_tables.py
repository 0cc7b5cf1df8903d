"""Put the tables of the field cases into their pages.

``python docs/studies/gap_tables.py`` rewrites what stands between ``<!-- gap: NAME -->`` and
``<!-- end gap -->`` in the pages of this folder, from the committed ``results.json``,
which ``python pipelines/gap_NAME.py DATA -o OUT`` writes.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import study_tables
from study_tables import table

HERE = Path(__file__).parent
NONE = "*Not diagnosed.*"


def results(case: str) -> dict[str, Any]:
    """Results of the pipeline of a case."""
    file = HERE / f"gap_{case}" / "results.json"
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def number(value: float | None, digits: int = 3) -> str:
    """A few significant digits; a dash where there is none."""
    if value is None:
        return "–"
    if value == 0.0 or abs(value) >= 10 ** (digits - 1):
        return f"{value:.0f}"
    text = f"{value:.{digits}g}"
    return (f"{float(text):f}".rstrip("0").rstrip(".") if "e" in text else text).replace("-", "−")


def metres(value: float | None) -> str:
    """To the decimetre."""
    return "–" if value is None else f"{value:.1f}".replace("-0.0", "0.0").replace("-", "−")


def quantiles(values: list[float]) -> str:
    """To the decimetre."""
    return " / ".join(map(metres, values))


def gap(value: float, limits: list[float]) -> str:
    """A gap with its interval."""
    return f"{metres(value)} ({metres(limits[0])} to {metres(limits[1])})"


def verdict(case: str) -> str:
    """The answer of each split, as a list."""
    lines = []
    for split, one in results(case).get("splits", {}).items():
        sure = one["confidence"]
        answer = one["verdict"] if sure is None else f"{one['verdict']} (confidence {sure:.2g})"
        lines.append(
            f"- {split} ({one['fitted_on']} rocks fitted): {answer}, base {one['base']}; confusion "
            f"set {', '.join(one['confusion_set'])}".replace("_", " ")
        )
    return "\n".join(lines) or NONE


#: Numbers of the quantiles that are shown.
MEDIAN, HIGH = 1, 2


def whole(share: float, sign: str = "") -> str:
    """Per cent, without their unit."""
    text = f"{100.0 * share:{sign}.0f}"
    return "0" if text in ("+0", "-0") else text.replace("-", "−")


def percent(value: float, limits: list[float], sign: str = "+") -> str:
    """A relative error, or a share, with its interval."""
    return f"{whole(value, sign)} % ({' to '.join(map(whole, limits))})"


def steps() -> dict[str, Any]:
    """What was added at Tschamut, step by step."""
    found: dict[str, Any] = results("tschamut")["steps"]
    return found


def shares() -> dict[str, dict[str, Any]]:
    """Rungs of the steps at Tschamut by name, on held-out rocks."""
    return {rung["rung"]: rung for rung in steps()["tschamut"]}


def added() -> str:
    """What each step closes on held-out rocks, what is left, and what it does at other sites."""
    found, rows = steps(), []
    for name, rung in shares().items():
        if name not in found["chant_sura"]:
            continue
        off = found["left_out"][name]
        closed = "" if rung["share"] is None else percent(rung["share"], rung["ci95"], "")
        cells = [
            name, number(rung["distance"]), closed,
            *(f"{whole(off[q]['error'][k], '+')} %" for q, k in (
                ("speed 60 m", MEDIAN), ("height 60 m", HIGH), ("contacts", MEDIAN),
                ("run-out", MEDIAN),
            )),
            f"{whole(found['chant_sura'][name]['speed_error'][MEDIAN], '+')} %",
        ]  # fmt: skip
        rows.append(" | ".join(cells))
    return table(
        "model | energy distance | gap closed (95 %) | speed at 60 m, 50 % | height at 60 m, 90 % "
        "| contacts, 50 % | run-out, 50 % | Chant Sura: speed, 50 %",
        rows,
    )


def answers() -> str:
    """Where the former class is off."""
    seen = steps()["where"]

    def middle(name: str) -> str:
        return percent(seen[name]["error"][MEDIAN], seen[name]["ci95"][MEDIAN])

    high = percent(seen["height 60 m"]["error"][HIGH], seen["height 60 m"]["ci95"][HIGH])
    contacts = seen["contacts"]
    return (
        f"Simulated speeds differ by {middle('speed 20 m')} at 20 m, {middle('speed 40 m')} at "
        f"40 m and {middle('speed 60 m')} at 60 m (medians, 95 % over rocks). At 60 m energies "
        f"differ by {middle('energy 60 m')} and 90 % heights by {high}; blocks have "
        f"{number(contacts['simulated'][MEDIAN], 2)} contacts for "
        f"{number(contacts['observed'][MEDIAN], 2)}. The run-out, to which the class was fitted, "
        f"differs by {middle('run-out')}."
    )


def left_out(case: str) -> str:
    """What was calibrated and handed over, on held-out rocks; equal results in one sentence."""
    parts = []
    for split, one in results(case).get("splits", {}).items():
        models: dict[str, list[str]] = {}
        for model, q in one["left_out"].items():
            found = (
                f"{quantiles(q['predicted'])} m, mean gap {gap(q['gap_m'], q['ci95'])} m, CRPS "
                f"{metres(q['crps_m'])} m, energy distance {metres(q['energy_distance_m'])} m"
            )
            name = model if model == "uncalibrated" else f"`{model}`"
            models.setdefault(found, []).append(name)
        seen = one["left_out"]["uncalibrated"]
        parts.append(
            f"Held-out {split} ({seen['rocks']} rocks), run-out 10 / 50 / 90 %: observed "
            f"{quantiles(seen['observed'])} m; "
            + "; ".join(f"{', '.join(names)}: {found}" for found, names in models.items())
        )
    return ". ".join([*parts, ""]).strip() or NONE


def program() -> str:
    """Answers on runs of another program: a row for each error, a column for what is observed."""
    kinds: dict[str, dict[str, dict[str, list[float]]]] = {}
    for one in results("authume_program")["campaigns"]:
        seen = "everything" if one["everything"] else "stations and stops"
        named = f" ({one['group']})" if one["effect"] == "unknown" and one["group"] else ""
        column = f"{one['rocks']} rocks, {seen}"
        answers = kinds.setdefault(one["truth"] or "none", {}).setdefault(column, {})
        answers.setdefault(f"{one['effect']}{named}", []).append(one["confidence"])
    columns = list(dict.fromkeys(column for own in kinds.values() for column in own))
    rows = []
    for kind, own in kinds.items():
        cells = (
            "; ".join(
                f"{answer} {len(found)} ({' to '.join(spread(found))})"
                for answer, found in own.get(column, {}).items()
            )
            for column in columns
        )
        rows.append(" | ".join([kind, *cells]).replace("_", " "))
    return table(" | ".join(["added error", *columns]), rows)


def spread(values: list[float]) -> list[str]:
    """The least and the largest; one of them where they are equal."""
    return list(dict.fromkeys(number(v, 2) for v in (min(values), max(values))))


def both(case: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Tables that cases with stops have."""
    made = {"verdict": verdict, "held out": left_out}
    return {f"{case} {name}": partial(made[name], case) for name in names}


TABLES = {
    **both("tschamut", ("verdict",)),
    **both("authume", ("verdict", "held out")),
    "tschamut steps": added,
    "tschamut answers": answers,
    "authume program": program,
}
#: Pages with tables of field cases.
PAGES = sorted(HERE.glob("*.md"))


def filled(text: str) -> str:
    """A page with its tables written again."""
    return study_tables.filled(text, TABLES, "gap", "end gap")


if __name__ == "__main__":
    study_tables.rewrite(PAGES, filled)
