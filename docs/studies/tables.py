"""Put the tables of the studies into their pages.

``python docs/studies/tables.py`` rewrites what stands between ``<!-- table: NAME -->`` and
``<!-- end -->`` in the pages of this folder, from the committed CSV and JSON files.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import study_tables
from study_tables import table

HERE = Path(__file__).parent
PAGES = sorted(HERE.glob("*.md"))


def rows_of(name: str) -> pd.DataFrame:
    """A CSV file of this folder."""
    return pd.read_csv(HERE / f"{name}.csv")


def results(name: str) -> Any:
    """What a JSON file of this folder holds."""
    return json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))


def rounded(number: float, digits: int = 3) -> str:
    """A number with a few significant digits, whole where it is large."""
    return f"{number:.0f}" if abs(number) >= 10 ** (digits - 1) else f"{number:.{digits}g}"


def minus(text: str) -> str:
    """A text with true minus signs."""
    return text.replace("-", "−")


def discretisation() -> str:
    """Results in the valley over the tolerances: run-outs, energies and heights far down."""
    found = rows_of("discretisation/summary")
    found = found[(found["slope"] == "valley") & (found["tolerance_m"] <= 2.0)]
    lengths = found.groupby("tolerance_m")["segment_length_m"].first()
    rows = [" | ".join(["*segment length (m)*", *(f"*{v:.1f}*" for v in lengths), ""])]
    found = found[~found["quantity"].str.contains("arrivals|run-out 25 %| at (?:60|150) m ")]
    for quantity, own in found.groupby("quantity", sort=False):
        half = 0.5 * (own["high_95"] - own["low_95"]).max()
        rows.append(" | ".join([quantity, *map(rounded, own["value"]), f"± {rounded(half, 2)}"]))
    tolerances = " | ".join(f"{t:g}" for t in lengths.index)
    return table(f"tolerance (m) | {tolerances} | at most", rows)


#: Where the modelling assumptions change most, by slope and quantity.
MOST_CHANGED = (("valley", "run-out"), ("valley", "energy at"), ("bedrina", "energy at"))


def convergence() -> str:
    """Modelling assumptions against the base: a row for each change."""
    found = rows_of("convergence/convergence")
    place = ["slope", "quantity"]
    base = found.loc[found["kind"] == "base", [*place, "median", "q95"]]
    found = found[found["kind"] == "assumption"].merge(base, "left", place, suffixes=("", "_base"))
    shifts = ["median", "q95"]
    for q in shifts:
        found[q] = found[q] / found[f"{q}_base"] - 1.0
    rows = []
    for variant, own in found.groupby("variant", sort=False):
        same = own.groupby("slope")["same_rocks_percent"].first()
        cells = [variant, f"{same['valley']:.0f} / {same['bedrina']:.0f} %"]
        for slope, quantity in MOST_CHANGED:
            (one,) = own.loc[
                (own["slope"] == slope) & own["quantity"].str.startswith(quantity), shifts
            ].to_numpy()
            cells.append(" / ".join(map(percent, one)))
        cells += [f"{own['D_other_draws'].max():.3f}", f"{own['p_other_draws'].min():.2g}"]
        rows.append(" | ".join(cells))
    return table(
        "change | same blocks | run-out, valley | energy, valley | energy, Bedrina | "
        "D, other draws | least p",
        rows,
    )


def percent(share: float) -> str:
    """A relative error, whole."""
    return minus(f"{100.0 * share:+.0f} %".replace("+0 %", "0 %").replace("-0 %", "0 %"))


def error_95(share: float, limits: list[float]) -> str:
    """A relative error with its interval."""
    low, high = (percent(v).removesuffix(" %") for v in limits)
    return f"{percent(share)} ({low} to {high})"


def metres(values: list[float]) -> str:
    """Quantiles in whole metres."""
    return " / ".join(f"{v:.0f}" for v in values)


def class_label(site: str, label: str) -> str:
    """A site and the class of its slope, ``{own}``, or that of the other site, ``{other}``."""
    own = results("field/results")["classes"]
    other = dict(zip(own, reversed(own.values()), strict=True))
    return f"{site}, {label.format(own=own[site], other=other[site])}"


def field_untuned() -> str:
    """Stops with classes chosen by the description alone, and two other choices."""
    rows, seen = [], {}
    for key, label in (
        ("built_in", "`{own}`"),
        ("class_of_the_other_site", "`{other}`"),
        ("readings_and_classes_1986", "assumptions and classes of 1986"),
    ):
        for name, one in results("field/results")[key].items():
            errors = zip(one["error"][1:], one["error_95"][1:], strict=True)
            middle, far = (error_95(*own) for own in errors)
            width = error_95(one["width_error"], one["width_error_95"])
            beyond = one["beyond"]
            observed, simulated = (100.0 * beyond[side] for side in ("observed", "simulated"))
            edge = f"{observed:.0f} % beyond {beyond['edge_m']:.0f} m"
            seen[name] = f"{name} {metres(one['observed_m'])} m, {edge}"
            rows.append(
                f"{class_label(name, label)} | {metres(one['simulated_m'])} | {middle} | {far} | "
                f"{width} | {simulated:.0f} %"
            )
    head = "site, class of the slope | 10 / 50 / 90 % (m) | median | 90 % | width | beyond"
    return f"{table(head, rows)}\n\nObserved: {'; '.join(seen.values())}."


def field_left_out() -> str:
    """Errors on rocks left out, over random halves, and at the other site.

    Errors of the configured classes stand there only where others were recommended.
    """
    rows = []
    for name, one in results("field/results")["held_out"].items():
        labels = {
            "left_out": f"the other half ({one['rocks_left_out']} rocks)",
            "left_out_configured": "the same, configured classes",
            "halves_observed": "*observed halves*",
            **{key: key.removeprefix("at ") + ", all rocks" for key in one if key[:3] == "at "},
        }
        if one["left_out_configured"] == one["left_out"]:
            del labels["left_out_configured"]
        for key, label in labels.items():
            cells = []
            for measure in ("median", "q90", "width"):
                low, middle, high = one[key][measure]["quantiles"]
                cells.append(percent(middle) if low == high else error_95(middle, [low, high]))
            rows.append(" | ".join([name, label, *cells]))
    return table("fitted at | scored on | median | 90 % | width", rows)


def authume() -> str:
    """10, 50 and 90 % of the run-out at Authume: observed with limits, and predicted."""
    found = results("authume/results")
    seen = [f"{v:.1f} ({low:.1f}–{high:.1f})" for v, low, high in found["plan_m"]["observed"]]
    made = [f"{v:.1f}" for v in found["plan_m"]["predicted"]]
    edge = found["beyond_the_edge"]
    rows = [
        " | ".join([name, *values[::2], f"{rounded(100.0 * edge[f'{name}_share'], 2)} %"])
        for name, values in (("observed", seen), ("predicted", made))
    ]
    shares = " | ".join(f"{100.0 * share:.0f} %" for share in found["plan_m"]["shares"][::2])
    return table(f"run-out (m) | {shares} | beyond the edge", rows)


CONTACTS = ("r_n", "r_t", "energy_kept", "spin_share")


def low_mid_high(three: list[float]) -> str:
    """A median and, in brackets, the 10 and 90 % quantile."""
    low, middle, high = three
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def contacts_filmed() -> str:
    """Each filmed contact, observed and simulated."""
    found = results("contacts/results")
    rows = []
    for one in found["single"]:
        cells = [
            f"{one['observed'][key][1]:.2f} / {low_mid_high(one['simulated'][key])}"
            for key in CONTACTS
        ]
        speeds = f"{-one['vn_mps']:.1f} / {one['vt_mps']:.1f}"
        rows.append(" | ".join([f"{one['mass_kg']:.0f}", speeds, *cells]))
    for seen, made in zip(*found["grazing"].values(), strict=True):
        rows.append(f"780 | grazing |  | horizontal: {seen:.2f} / {made:.2f} |  | ")
    return table("kg | normal / along (m/s) | R_n | R_t | energy kept | spin / rolling", rows)


SLOPES = {
    "plain": "plain, fall lines",
    "rough": "rough, fall lines",
    "followed": "plain, followed paths",
}


def speed_slope() -> str:
    """Blocks per second on the benchmark slope, and walks of SAGA."""
    row = (
        "{label} | {trajectories_per_s_and_core:,.0f} | {walks:,.0f} ({ratio_whole:.1f}) | "
        "{first_call_compiling_s:.0f} / {first_call_from_cache_s:.1f} | {peak_mb:.0f}"
    )
    rows = []
    for name, label in SLOPES.items():
        one = results(f"speed/{name}")
        seconds = sorted(one["saga"]["seconds"])
        walks = one["saga"]["walks"] / seconds[len(seconds) // 2]
        rows.append(row.format(label=label, walks=walks, **one))
    return table(
        "slope | blocks/s | SAGA, walks/s | first call, compiling / from the cache (s) | "
        "memory (MB)",
        rows,
    )


def speed_effects() -> str:
    """What each effect costs, as a sentence."""
    costs = []
    for name, one in results("speed/effects").items():
        effect, _, form = name.partition(", ")
        words = [form, f"{one['pieces']:,} more blocks" if one["pieces"] else ""]
        within = ", ".join(filter(None, words))
        if name not in ("none", "off"):
            costs.append(f"`{effect}` {one['ratio']:.2f}" + f" ({within})" * bool(within))
    return "; ".join(costs) + "."


def speed_peers() -> str:
    """Rates of other programs, as a sentence."""
    what = {
        "sassgis": "ellipse with rotation",
        "PlatRock 2D": "lumped mass with rotation",
        "PyRockfall": "lumped mass",
    }
    rates = (
        f"{name} {one.get('version', '')}".strip() + f" {one['rocks_per_s']:,.0f} ({what[name]})"
        for name, one in results("speed/peers").items()
    )
    return f"{', '.join(rates)}."


def zone_seeds() -> str:
    """What is stated, and what another sample changes, by site and number of blocks."""
    row = (
        "{site} | {times} × | {stated:.1%} | {cells:.1%} | {zones:.1%} | {caught:.0%} | "
        "{found} of {pairs}"
    )
    found = rows_of("zone_seeds/seeds")
    rows = (
        row.format(**own).replace("%", " %")
        for own in found[found["times"].isin((1, 8))].to_dict("records")
    )
    return table(
        "site | blocks | stated | cells | zones | changes on hatched cells | changes in `compare`",
        rows,
    )


def kinematics_tschamut() -> str:
    """Motion at Tschamut, observed and simulated."""
    rows = []
    for name, one in results("kinematics/results")["tschamut"].items():
        if " of " in name or name.startswith("greatest"):
            continue
        seen, made = one["observed"], one["simulated"]
        digits = 1 if name.startswith("speed") else 2
        digits = 0 if name.startswith(("run-out", "contacts")) else digits
        cells = (" / ".join(f"{v:.{digits}f}" for v in values[1:]) for values in (seen, made))
        rows.append(
            f"{name}{_UNITS.get(name.split(' ')[0], '')} | {' | '.join(cells)} | {_off(one)}"
        )
    return table("50 / 90 % of the rocks | observed | simulated | error", rows)


_UNITS = {
    "run-out": " (m)",
    "energy": " (kJ)",
    "speed": " (m/s)",
    "height": " (m)",
    "hop": " (m)",
}


def _off(one: dict[str, list[float]]) -> str:
    """How far median and 90 % are off."""
    pairs = zip(one["observed"][1:], one["simulated"][1:], strict=True)
    return " / ".join(percent(made / seen - 1.0) for seen, made in pairs)


def kinematics_slopes() -> str:
    """95 % of speeds and heights on even slopes: a row for each class, columns for two sizes."""
    cells: dict[str, dict[str, list[str]]] = {}
    found = [one for one in results("kinematics/results")["slopes"] if one["drop_m"] == 200.0]
    found = [one for one in found if one["volume_m3"] != 1.0]
    for quantity, spec in (("speed", ".0f"), ("height", ".1f")):
        for one in found:
            own = cells.setdefault(one["class"], {})
            column = f"{quantity}, {one['volume_m3']:g} m³"
            own.setdefault(column, []).append(format(one[quantity][1], spec))
    slopes = dict.fromkeys(f"{one['slope_deg']:.0f}" for one in found)
    columns = next(iter(cells.values()))
    rows = (" | ".join([name, *map(" / ".join, own.values())]) for name, own in cells.items())
    return table(" | ".join([f"class; at {' / '.join(slopes)}°", *columns]), rows)


def kinematics_fan() -> str:
    """Shadow angles below a cliff: a row for each class, a column for each size."""
    cells: dict[str, dict[str, str]] = {}
    for one in results("kinematics/results")["fan"]:
        angles = " / ".join(f"{v:.1f}" for v in one["angle_deg"])
        cells.setdefault(one["class"], {})[f"{one['volume_m3']:g} m³"] = angles
    sizes = next(iter(cells.values()))
    head = " | ".join(["class; least / 5 / 50 % (degrees)", *sizes])
    return table(head, (" | ".join([name, *own.values()]) for name, own in cells.items()))


def tirol() -> str:
    """Least and largest of three terrains, as a sentence."""
    sites = results("tirol/results").values()
    parts = []
    for key, name, spec in (
        ("speed", "speeds {} m/s", ".0f"),
        ("passing_height", "passing heights {} m", ".1f"),
        ("energy", "energies {} kJ", ".0f"),
    ):
        ranges = ([one[key][k] for one in sites] for k in (0, 1))
        parts.append(name.format(" / ".join(f"{min(v):{spec}} to {max(v):{spec}}" for v in ranges)))
    return f"{', '.join(parts)}."


#: By the name of the mark.
TABLES = {
    made.__name__.replace("_", " "): made
    for made in (
        discretisation, convergence, zone_seeds, field_untuned, field_left_out,
        contacts_filmed, speed_slope, speed_effects, speed_peers, kinematics_tschamut,
        kinematics_slopes, kinematics_fan, tirol, authume,
    )
}  # fmt: skip


def filled(text: str) -> str:
    """A page with its tables written again."""
    return study_tables.filled(text, TABLES, "table", "end")


if __name__ == "__main__":
    study_tables.rewrite(PAGES, filled)
