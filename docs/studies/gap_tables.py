"""Put the tables of the field cases into their pages.

``python docs/studies/gap_tables.py`` rewrites what stands between ``<!-- gap: NAME -->`` and
``<!-- end gap -->`` in the pages ``gap_*.md`` of this folder from the committed ``results.json``,
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


def untuned(case: str) -> str:
    """Observed and predicted stops by group."""
    rows = []
    for group, one in results(case)["untuned"].items():
        for quantity, word in (("runout_m", "run-out"), ("aside_m", "lateral offset")):
            q = one[quantity]
            rocks = f"{group} ({one['rocks']})" if quantity == "runout_m" else ""
            rows.append(
                f"{rocks} | {word} | {quantiles(q['observed'])} | {quantiles(q['predicted'])} | "
                f"{gap(q['gap'], q['ci95'])} | {number(q['p_adjusted'], 2)}"
            )
    return table(
        "rocks | (m) | observed 10 / 50 / 90 % | predicted | gap of the mean (95 %) | p", rows
    )


def quantiles(values: list[float]) -> str:
    """To the decimetre."""
    return " / ".join(map(metres, values))


def gap(value: float, limits: list[float]) -> str:
    """A gap with its interval."""
    return f"{metres(value)} ({metres(limits[0])} to {metres(limits[1])})"


def which(case: str) -> str:
    """Hypotheses of a diagnosis on halves, most probable first."""
    found = results(case).get("splits", {}).get("halves")
    if found is None:
        return NONE
    rows = (
        f"{c['effect']} | {c['form']} | {number(c['gain'], 2)} | {number(c['probability'], 2)}"
        for c in found["which"][:6]
    )
    return table("effect | form | gain in energy score | probability", rows)


def verdict(case: str) -> str:
    """First sentences, and the answer of each split."""
    splits = results(case).get("splits", {})
    if not splits:
        return NONE
    said = [f"> *{split}*: {one['first_sentence']}" for split, one in splits.items()]
    rows = (
        f"{split} | {one['fitted_on']} | {one['base']} | {one['verdict']} | "
        f"{number(one['confidence'], 2)} | {', '.join(one['confusion_set'])}"
        for split, one in splits.items()
    )
    answers = table("split | rocks fitted | base | answer | confidence | confusion set", rows)
    return "\n>\n".join(said) + "\n\n" + answers


def ladder(case: str) -> str:
    """Rungs of each split, on rocks left out of the calibration."""

    def share(one: dict[str, Any]) -> str:
        if one["share"] is None:
            return "–"
        low, high = one["ci95"]
        return f"{100 * one['share']:.0f} % ({100 * low:.0f} to {100 * high:.0f})".replace("-", "−")

    rows = [
        f"{'' if k else split} | {r['rung'].replace('_', ' ')} | {number(r['distance'])} | "
        f"{share(r)}"
        for split, one in results(case).get("splits", {}).items()
        for k, r in enumerate(one["ladder"])
    ]
    head = "split | rung | energy distance | share of the gap (95 %)"
    return table(head, rows) if rows else NONE


def left_out(case: str) -> str:
    """What was calibrated and handed over, on held-out rocks."""
    rows = []
    for split, one in results(case).get("splits", {}).items():
        for model, q in one["left_out"].items():
            name = f" | `{model}`"
            if model == "uncalibrated":
                name = f"{split} ({q['rocks']}) | {model}"
            distances = ("crps_m", "energy_distance_m", "aside_energy_distance_m")
            rows.append(
                f"{name} | {quantiles(q['predicted'])} | {gap(q['gap_m'], q['ci95'])} | "
                f"{' | '.join(metres(q[k]) for k in distances)} | {100.0 * q['to_the_end']:.0f} %"
            )
        seen = quantiles(one["left_out"]["uncalibrated"]["observed"])
        rows.append(f" | *observed* | {seen} |  |  |  |  | ")
    head = (
        "held out | model | run-out 10 / 50 / 90 % (m) | mean gap (m, 95 %) | CRPS (m) | "
        "energy distance (m) | the same, lateral offset (m) | to the end of the path"
    )
    return table(head, rows) if rows else NONE


def parameters(case: str) -> str:
    """What ``sassgis calibrate`` sets on the fitted rocks."""
    found = {s: one["calibrated"] for s, one in results(case).get("splits", {}).items()}
    labels = list(dict.fromkeys(label for one in found.values() for label in one))
    return table(
        " | ".join(["fitted on", *(f"`{label}`" for label in labels)]),
        (
            " | ".join([split, *(number(one.get(k), 2) for k in labels)])
            for split, one in found.items()
        ),
    )


def contacts(which_ones: str) -> str:
    """Means over contacts: observed, uncalibrated, and calibrated on the contacts of other runs."""
    found = results("chant_sura")["contacts"][which_ones]
    means = [("observed", found["observed_mean"], "")]
    means += [(f"default: {form}", mean, "") for form, mean in found["untuned_mean"].items()]
    means += [
        (f"held out: {form}", one["mean"], number(one["energy_score"]))
        for form, one in found["left_out"].items()
    ]
    return table(
        " | v_t′ (m/s) | v_n′ (m/s) | ω′ (rad/s) | energy kept | energy score",
        (
            f"{name} | {' | '.join(number(v, 2) for v in mean[:4])} | {score}"
            for name, mean, score in means
        ),
    )


def scars() -> str:
    """Translational energy kept in held-out impacts."""
    rows = []
    for form, one in results("chant_sura")["scars"]["energy_kept_left_out"].items():
        chosen = {k: v for k, v in one.items() if k not in ("energy_score", "mean")}
        words = "; ".join(f"{k} {', '.join(number(x) for x in v)}" for k, v in chosen.items())
        rows.append(
            f"{form} | {number(one['mean'][4], 2)} | {number(one['energy_score'])} | {words}"
        )
    return table("form | energy kept, mean | energy score | chosen on the other run", rows)


def program() -> str:
    """Answers on runs of another program."""
    rows = []
    for one in results("authume_program")["campaigns"]:
        seen = "everything" if one["everything"] else "stations and stops"
        named = f" ({one['group']})" if one["effect"] == "unknown" and one["group"] else ""
        rows.append(
            f"{one['truth'] or 'none'} | {one['rocks']} rocks, {seen} | {one['effect']}{named} | "
            f"{number(one['confidence'], 2)}".replace("_", " ")
        )
    return table("put on the runs | observed | answer (group) | confidence", rows)


TABLES = {
    **{
        f"{case} {name}": partial(made, case)
        for case in ("tschamut", "authume")
        for name, made in (
            ("uncalibrated", untuned), ("verdict", verdict), ("ladder", ladder), ("which", which),
            ("parameters", parameters), ("held out", left_out),
        )
    },
    "chant_sura verdict": partial(verdict, "chant_sura"),
    "chant_sura contacts": partial(contacts, "used"),
    "chant_sura all contacts": partial(contacts, "all with a spin"),
    "chant_sura scars": scars,
    "authume program": program,
}  # fmt: skip


def filled(text: str) -> str:
    """A page with its tables written again."""
    return study_tables.filled(text, TABLES, "gap", "end gap")


if __name__ == "__main__":
    study_tables.rewrite(sorted(HERE.glob("gap_*.md")), filled)
