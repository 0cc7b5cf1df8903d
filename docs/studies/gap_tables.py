"""Put the tables of the field cases into their pages.

``python docs/studies/gap_tables.py`` rewrites what stands between ``<!-- gap: NAME -->`` and
``<!-- end gap -->`` in the pages ``gap_*.md`` of this folder from the committed ``results.json``,
which ``python pipelines/gap_NAME.py DATA -o OUT`` writes.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


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


def markdown(head: list[str], body: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def untuned(case: str) -> str:
    """Observed and predicted stops by group."""
    found = results(case)
    body = []
    for group, one in found["untuned"].items():
        for quantity, word in (("runout_m", "run-out"), ("aside_m", "lateral offset")):
            q = one[quantity]
            body.append(
                [
                    f"{group} ({one['rocks']})" if quantity == "runout_m" else "",
                    word,
                    " / ".join(metres(v) for v in q["observed"]),
                    " / ".join(metres(v) for v in q["predicted"]),
                    f"{metres(q['gap'])} ({metres(q['ci95'][0])} to {metres(q['ci95'][1])})",
                    number(q["p_adjusted"], 2),
                ]
            )
    head = ["rocks", "(m)", "observed 10 / 50 / 90 %", "predicted", "gap of the mean (95 %)", "p"]
    return markdown(head, body)


def which(case: str, split: str) -> str:
    """Hypotheses of a diagnosis, most probable first."""
    found = results(case).get("splits", {}).get(split)
    if found is None:
        return "*Not diagnosed.*"
    body = [
        [c["effect"], c["form"], number(c["gain"], 2), number(c["probability"], 2)]
        for c in found["which"][:6]
    ]
    return markdown(["effect", "form", "gain in energy score", "probability"], body)


def verdict(case: str) -> str:
    """First sentences, and the answer of each split."""
    splits = results(case).get("splits", {})
    if not splits:
        return "*Not diagnosed.*"
    said = [f"> *{split}*: {one['first_sentence']}" for split, one in splits.items()]
    body = [
        [
            split,
            str(one["fitted_on"]),
            one["base"],
            one["verdict"],
            number(one["confidence"], 2),
            ", ".join(one["confusion_set"]),
        ]
        for split, one in splits.items()
    ]
    head = ["split", "rocks fitted", "base", "answer", "confidence", "confusion set"]
    return "\n>\n".join(said) + "\n\n" + markdown(head, body)


def ladder(case: str) -> str:
    """Rungs of each split, on rocks left out of the calibration."""

    def share(one: dict[str, Any]) -> str:
        if one["share"] is None:
            return "–"
        low, high = one["ci95"]
        return f"{100 * one['share']:.0f} % ({100 * low:.0f} to {100 * high:.0f})".replace("-", "−")

    body = [
        [split if k == 0 else "", r["rung"].replace("_", " "), number(r["distance"]), share(r)]
        for split, one in results(case).get("splits", {}).items()
        for k, r in enumerate(one["ladder"])
    ]
    if not body:
        return "*Not diagnosed.*"
    return markdown(["split", "rung", "energy distance", "share of the gap (95 %)"], body)


def left_out(case: str) -> str:
    """What was calibrated and handed over, on held-out rocks."""
    body = []
    for split, one in results(case).get("splits", {}).items():
        for model, q in one["left_out"].items():
            body.append(
                [
                    f"{split} ({q['rocks']})" if model == "uncalibrated" else "",
                    model if model == "uncalibrated" else f"`{model}`",
                    " / ".join(metres(v) for v in q["predicted"]),
                    f"{metres(q['gap_m'])} ({metres(q['ci95'][0])} to {metres(q['ci95'][1])})",
                    *(metres(q[f"{k}_m"]) for k in ("crps", "energy_distance")),
                    metres(q["aside_energy_distance_m"]),
                    f"{100.0 * q['to_the_end']:.0f} %",
                ]
            )
        seen = " / ".join(metres(v) for v in one["left_out"]["uncalibrated"]["observed"])
        body.append(["", "*observed*", seen, "", "", "", "", ""])
    if not body:
        return "*Not diagnosed.*"
    head = ["held out", "model", "run-out 10 / 50 / 90 % (m)", "mean gap (m, 95 %)", "CRPS (m)"]
    head += ["energy distance (m)", "the same, lateral offset (m)", "to the end of the path"]
    return markdown(head, body)


def parameters(case: str) -> str:
    """What ``sassgis calibrate`` sets on the fitted rocks."""
    found = {s: one["calibrated"] for s, one in results(case).get("splits", {}).items()}
    labels = list(dict.fromkeys(label for one in found.values() for label in one))
    return markdown(
        ["fitted on", *(f"`{label}`" for label in labels)],
        [[split, *(number(one.get(k), 2) for k in labels)] for split, one in found.items()],
    )


def contacts(which_ones: str) -> str:
    """Means over contacts: observed, uncalibrated, and calibrated on the contacts of other runs."""
    found = results("chant_sura")["contacts"][which_ones]

    def cells(values: list[float]) -> list[str]:
        return [number(v, 2) for v in values[:4]]

    body = [["observed", *cells(found["observed_mean"]), ""]]
    for form, mean in found["untuned_mean"].items():
        body.append([f"default: {form}", *cells(mean), ""])
    for form, one in found["left_out"].items():
        score = number(one["energy_score"])
        body.append([f"held out: {form}", *cells(one["mean"]), score])
    return markdown(
        ["", "v_t′ (m/s)", "v_n′ (m/s)", "ω′ (rad/s)", "energy kept", "energy score"], body
    )


def scars() -> str:
    """Translational energy kept in held-out impacts."""
    found = results("chant_sura")["scars"]["energy_kept_left_out"]
    body = []
    for form, one in found.items():
        chosen = {k: v for k, v in one.items() if k not in ("energy_score", "mean")}
        words = "; ".join(f"{k} {', '.join(number(x) for x in v)}" for k, v in chosen.items())
        body.append([form, number(one["mean"][4], 2), number(one["energy_score"]), words])
    return markdown(["form", "energy kept, mean", "energy score", "chosen on the other run"], body)


def program() -> str:
    """Answers on runs of another program."""
    body = []
    for row in results("authume_program")["campaigns"]:
        seen = "everything" if row["everything"] else "stations and stops"
        named = row["group"] if row["effect"] == "unknown" and row["group"] else ""
        confident = number(row["confidence"], 2)
        answer = row["effect"] + (f" ({named})" if named else "")
        body.append([row["truth"] or "none", f"{row['rocks']} rocks, {seen}", answer, confident])
    head = ["put on the runs", "observed", "answer (group)", "confidence"]
    return markdown(head, [[cell.replace("_", " ") for cell in row] for row in body])


TABLES = {
    **{f"{c} uncalibrated": (lambda c=c: untuned(c)) for c in ("tschamut", "authume")},
    **{f"{c} verdict": (lambda c=c: verdict(c)) for c in ("tschamut", "authume", "chant_sura")},
    **{f"{c} ladder": (lambda c=c: ladder(c)) for c in ("tschamut", "authume")},
    **{f"{c} parameters": (lambda c=c: parameters(c)) for c in ("tschamut", "authume")},
    **{f"{c} held out": (lambda c=c: left_out(c)) for c in ("tschamut", "authume")},
    "tschamut which": lambda: which("tschamut", "halves"),
    "authume which": lambda: which("authume", "halves"),
    "chant_sura contacts": lambda: contacts("used"),
    "chant_sura all contacts": lambda: contacts("all with a spin"),
    "chant_sura scars": scars,
    "authume program": program,
}


def filled(text: str) -> str:
    """A page with its tables written again."""

    def table(match: re.Match[str]) -> str:
        return f"<!-- gap: {match[1]} -->\n\n{TABLES[match[1]]()}\n\n<!-- end gap -->"

    return re.sub(r"<!-- gap: (.+?) -->\n.*?<!-- end gap -->", table, text, flags=re.S)


def main() -> None:
    """Rewrite the pages."""
    for page in sorted(HERE.glob("gap_*.md")):
        text = page.read_text(encoding="utf-8")
        if (new := filled(text)) != text:
            page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
