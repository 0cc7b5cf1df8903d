"""Put the tables of the studies into their pages.

``python docs/studies/tables.py`` rewrites what stands between ``<!-- table: NAME -->`` and
``<!-- end -->`` in the pages of this folder, and in docs/calibration.md, from the committed CSV and
JSON files.
"""

from __future__ import annotations

import csv
import json
import re
import statistics
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGES = (*sorted(HERE.glob("*.md")), HERE.parent / "calibration.md")


def rows_of(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file of this folder."""
    with (HERE / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def results(name: str) -> Any:
    """What a JSON file of this folder holds."""
    return json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))


def markdown(head: list[str], body: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rounded(value: str | float, digits: int = 3) -> str:
    """A number with a few significant digits, whole where it is large."""
    number = float(value)
    return f"{number:.0f}" if abs(number) >= 10 ** (digits - 1) else f"{number:.{digits}g}"


def discretisation(slope: str) -> str:
    """Pooled results over the tolerances, with the interval at the default."""
    rows = [r for r in rows_of("discretisation/summary.csv") if r["slope"] == slope]
    tolerances = list(dict.fromkeys(r["tolerance_m"] for r in rows))
    length = {r["tolerance_m"]: r["segment_length_m"] for r in rows}
    body = [["*segment length (m)*", *(f"*{float(length[t]):.1f}*" for t in tolerances), ""]]
    for quantity in dict.fromkeys(r["quantity"] for r in rows):
        some = {r["tolerance_m"]: r for r in rows if r["quantity"] == quantity}
        half = [0.5 * (float(some[t]["high_95"]) - float(some[t]["low_95"])) for t in tolerances]
        body.append(
            [
                quantity,
                *(rounded(some[t]["value"]) for t in tolerances),
                f"± {rounded(max(half), 2)}",
            ]
        )
    return markdown(["tolerance (m)", *tolerances, "sampling, at most"], body)


def lines() -> str:
    """Change of single lines of the valley against the finest tolerance."""
    rows = rows_of("discretisation/lines_valley.csv")
    tolerances = list(dict.fromkeys(r["tolerance_m"] for r in rows))
    quantities = ("run-out 50 % (m)", "run-out 95 % (m)", "E95 at 150 m (kJ)")
    finest = {r["slope"]: r for r in rows if r["tolerance_m"] == tolerances[0]}
    body = []
    for quantity in quantities:
        for word, pick in (("median", 0.5), ("largest", 1.0)):
            cells = []
            for t in tolerances[1:]:
                gaps = sorted(
                    abs(float(r[quantity]) / float(finest[r["slope"]][quantity]) - 1.0)
                    for r in rows
                    if r["tolerance_m"] == t
                    and r[quantity] not in ("", "nan")
                    and finest[r["slope"]][quantity] not in ("", "nan")
                )
                cells.append(f"{100.0 * gaps[round(pick * (len(gaps) - 1))]:.0f} %")
            body.append([f"{quantity.split(' (')[0]}, {word} of the lines", *cells])
    return markdown([f"against {tolerances[0]} m", *(f"{t} m" for t in tolerances[1:])], body)


def splitting() -> str:
    """Polylines with divided segments against the original ones."""
    return markdown(
        [
            "slope",
            "parts",
            "same rocks",
            "mean change (m)",
            "D, same draws",
            "p, other draws",
            "p, uncut",
        ],
        [
            [
                r["slope"],
                r["parts"],
                f"{float(r['same_rocks_percent']):.0f} %",
                f"{float(r['mean_change_m']):+.2f} ± {float(r['standard_error_m']):.2f}",
                f"{float(r['D_same_seed']):.3f}",
                f"{float(r['p_other_seed']):.3f}",
                f"{float(r['p_other_seed_unsplit']):.3f}",
            ]
            for r in rows_of("discretisation/splitting.csv")
        ],
    )


def convergence(kind: str) -> str:
    """Numerical tolerances, or modelling assumptions, against the base."""
    base = {
        (r["slope"], r["quantity"]): r
        for r in rows_of("convergence/convergence.csv")
        if r["kind"] == "base"
    }
    body = []
    for r in rows_of("convergence/convergence.csv"):
        if r["kind"] != kind:
            continue
        reference = base[r["slope"], r["quantity"]]
        change = [
            f"{100.0 * (float(r[q]) / float(reference[q]) - 1.0):+.1f} %" for q in ("median", "q95")
        ]
        body.append(
            [
                r["variant"],
                r["slope"],
                r["quantity"],
                *change,
                f"{float(r['same_rocks_percent']):.0f} %",
                f"{float(r['D_same_draws']):.3f}",
                f"{float(r['D_other_draws']):.3f}",
                f"{float(r['p_other_draws']):.2g}",
            ]
        )
    head = ["change", "slope", "quantity", "median", "95 %", "same rocks", "D, same draws"]
    return markdown([*head, "D, other draws", "p"], body)


def percent(share: float) -> str:
    """A relative error, whole."""
    return f"{100.0 * share:+.0f} %".replace("+0 %", "0 %").replace("-0 %", "0 %").replace("-", "−")


def error_95(share: float, limits: list[float]) -> str:
    """A relative error with its interval."""
    low, high = (percent(v).removesuffix(" %") for v in limits)
    return f"{percent(share)} ({low} to {high})"


def metres(values: list[float]) -> str:
    """Quantiles in whole metres."""
    return " / ".join(f"{v:.0f}" for v in values)


def field_untuned() -> str:
    """Stops with classes chosen by the description alone, and two other choices."""
    found = results("field/results")
    slope = found["classes"]
    other = dict(zip(slope, reversed(slope.values()), strict=True))
    body = []
    for key, label in (
        ("built_in", "`{own}`"),
        ("class_of_the_other_site", "`{other}`, not fitted here"),
        ("readings_and_classes_1986", "readings and classes of 1986"),
    ):
        for name, one in found[key].items():
            limits, beyond = one["error_95"], one["beyond"]
            observed, simulated = (100.0 * beyond[key] for key in ("observed", "simulated"))
            body.append(
                [
                    f"{name}, {label.format(own=slope[name], other=other[name])}",
                    str(one["rocks"]),
                    metres(one["observed_m"]),
                    metres(one["simulated_m"]),
                    error_95(one["error"][1], limits[1]),
                    error_95(one["error"][2], limits[2]),
                    error_95(one["width_error"], one["width_error_95"]),
                    f"{one['crps_m']:.1f} m",
                    f"{beyond['edge_m']:.0f} m: {observed:.0f} / {simulated:.0f} %",
                    f"{100.0 * one['left_the_terrain']:.0f} %",
                ]
            )
    head = ["site, class of the slope", "rocks", "observed 10 / 50 / 90 % (m)", "simulated"]
    head += ["median", "90 %", "width", "CRPS", "stopped beyond", "left the terrain"]
    return markdown(head, body)


def field_site_bands() -> str:
    """Bands by the spread of classes between sites, beside what was observed."""
    found = results("field/results")
    slope = found["classes"]
    other = dict(zip(slope, reversed(slope.values()), strict=True))
    body = []
    for kind, label in (("own", "`{own}`"), ("other", "`{other}`, not fitted here")):
        for name, one in found["bands_of_classes"][kind].items():
            cells = [f"{name}, {label.format(own=slope[name], other=other[name])}"]
            for row in one.values():
                low, high = row["band_m"]
                cells += [f"{row['observed_m']:.0f}", f"{row['simulated_m']:.0f}"]
                cells.append(f"{low:.0f} to {high:.0f}{'' if row['holds'] else ' (not held)'}")
            body.append(cells)
    head = ["site, class of the slope"]
    for measure in ("median", "90 %"):
        head += [f"{measure}: observed (m)", "simulated", "80 % band"]
    return markdown(head, body)


def field_left_out() -> str:
    """Errors on rocks left out, over random halves, and at the other site."""
    body = []
    for name, one in results("field/results")["held_out"].items():
        labels = {
            "left_out": f"the other half ({one['rocks_left_out']} rocks)",
            "left_out_configured": "the same, configured classes",
            "halves_observed": "*observed halves against each other*",
            **{key: key.removeprefix("at ") + ", all rocks" for key in one if key[:3] == "at "},
        }
        for key, label in labels.items():
            cells = []
            for measure in ("median", "q90", "width"):
                row = one[key][measure]
                low, middle, high = (percent(v) for v in row["quantiles"])
                spread = f"({low.removesuffix(' %')} to {high.removesuffix(' %')})"
                cells.append(f"{middle} {spread}, rms {100.0 * row['rms']:.0f} %")
            body.append([f"{name}, {one['halves']} halves", label, *cells])
    return markdown(["fitted on", "scored on", "median", "90 %", "width"], body)


def field_gain() -> str:
    """What calibration says that it gains, and what it gains on the other half."""
    body = []
    for name, one in results("field/results")["held_out"].items():
        gain = one["gain"]
        cells = [" / ".join(f"{v:+.1f}" for v in gain[k]) for k in ("claimed_m", "crps_m")]
        chosen = f"{one['fitted_classes_recommended']} of {one['halves']}"
        body.append([name, *(c.replace("-", "−") for c in cells), chosen])
    head = ["site", "gain stated by `calibrate`, 10 / 50 / 90 % of the halves (CRPS, m)"]
    head += ["gain on the other half (CRPS, m)", "fitted classes recommended"]
    return markdown(head, body)


def field_bands() -> str:
    """How many rocks lie in the bands of their own simulations."""
    found = results("field/results")
    labels = {
        "left_out": "calibrated, rocks left out",
        "left_out_configured": "the same, as configured",
    }
    rows = [(f"{n}, built-in classes", one["bands"]) for n, one in found["built_in"].items()]
    rows += [
        (f"{name}, {label}", one["bands"][key])
        for name, one in found["held_out"].items()
        for key, label in labels.items()
    ]
    body = []
    for label, own in rows:
        cells = []
        for band in own.values():
            low, high = band["inside_95"]
            cells.append(f"{100 * band['inside']:.0f} % ({100 * low:.0f} to {100 * high:.0f})")
        last = own["0.9"]
        body.append([label, *cells, f"{100 * last['short']:.0f} %", f"{100 * last['far']:.0f} %"])
    head = ["site", "in the 80 % band", "in the 90 % band", "stopped short of it", "went beyond it"]
    return markdown(head, body)


def field_repeated() -> str:
    """Spread of repeated runs of one block."""
    body = [
        [
            name, f"{one['runs']} from {one['places']}", f"{one['observed_m']:.0f}",
            f"{one['simulated_m']:.0f} ({' to '.join(f'{v:.0f}' for v in one['simulated_95'])})",
            f"{one['one_release_m']:.0f}",
        ]
        for name, one in results("field/results")["repeated"].items()
    ]  # fmt: skip
    head = ["block", "runs, places", "observed spread (m)", "simulated (m)"]
    return markdown([*head, "simulated, from one point (m)"], body)


def field_mass() -> str:
    """How much farther a rock of twice the mass goes."""
    body = []
    for name, one in results("field/results")["by_mass"].items():
        cells = [
            f"{one[f'{side}_m']:+.1f} ({' to '.join(f'{v:+.1f}' for v in one[f'{side}_95'])})"
            for side in ("observed", "simulated")
        ]
        body.append([name, *(c.replace("-", "−") for c in cells)])
    return markdown(["site", "observed (m)", "simulated (m)"], body)


def field_groups() -> str:
    """Run-out by groups of rocks."""
    return markdown(
        ["group", "rocks", "observed 10 / 50 / 90 % (m)", "simulated"],
        [
            [name, str(one["rocks"]), metres(one["observed_m"]), metres(one["simulated_m"])]
            for name, one in results("field/results")["by_group"].items()
        ],
    )


def field_published() -> str:
    """What others published for the same stops."""
    found = results("field/results")
    body = [
        [one["site"], one["source"].split(" ")[0], one["value"].replace("-", "−")]
        for one in found["published"]
    ]
    for name, one in found["built_in"].items():
        gap = f"{one['mean_gap_m']:+.1f}".replace("-", "−")
        body.append([name, "sassgis, built-in classes", gap])
    return markdown(["site", "program", "mean signed error of the run-out (m)"], body)


def field_parameters() -> str:
    """What calibrations on all rocks of a site say of the parameters."""
    body = []
    for one in results("field/results")["parameters"]:
        low, high = one["ci95"]
        said = "identified" if one["identified"] else ""
        if one["at_limit"]:
            said = f"{said}, at a limit".removeprefix(", ")
        names = [f"{one['site']}: `{one['class']}`", f"`{one['parameter']}`"]
        values = [rounded(one[key], 2) for key in ("configured", "value")]
        body.append([*names, *values, f"{rounded(low, 2)} to {rounded(high, 2)}", said])
    return markdown(["site and class", "parameter", "shipped", "best", "95 %", ""], body)


def field_widths() -> str:
    """Errors against what turns the heading."""
    rows = results("field/results")["widths"]
    names = [key for key in rows[0] if isinstance(rows[0][key], dict)]
    body = [
        [
            f"{row['side_tilt_deg']:g}°",
            f"{row['drift_deg']:g}°",
            *(f"{percent(row[n]['width_error'])}, {percent(row[n]['error'][1])}" for n in names),
        ]
        for row in rows
    ]
    return markdown(["side tilt", "drift", *(f"{n}: width, median" for n in names)], body)


CONTACT_NAMES = {"r_n": "R_n", "r_t": "R_t", "energy_kept": "energy kept"}


def contacts_filmed() -> str:
    """Each filmed contact, observed and simulated."""
    body = [
        [
            f"{row['mass_kg']:.0f}",
            f"{-row['vn_mps']:.1f} / {row['vt_mps']:.1f}",
            *(
                f"{row['observed'][key][1]:.2f} / {low_mid_high(row['simulated'][key])}"
                for key in (*CONTACT_NAMES, "spin_share")
            ),
        ]
        for row in results("contacts/results")["single"]
    ]
    found = results("contacts/results")["grazing"]
    for seen, made in zip(found["observed"], found["simulated"], strict=True):
        body.append(["780", "grazing", "", f"horizontal: {seen:.2f} / {made:.2f}", "", ""])
    head = ["kg", "normal / along (m/s)", *CONTACT_NAMES.values(), "spin / rolling"]
    return markdown(head, body)


def low_mid_high(three: list[float]) -> str:
    """A median and, in brackets, the 10 and 90 % quantile."""
    low, middle, high = three
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def contacts_program() -> str:
    """Contacts of the discrete-element program by ground and normal speed."""
    body = [
        [
            row["ground"],
            "{:g} to {:g}".format(*row["vn_mps"]),
            str(row["contacts"]),
            *(
                f"{low_mid_high(row['observed'][key])}; {row['simulated'][key][1]:.2f}"
                for key in (*CONTACT_NAMES, "spin_share")
            ),
        ]
        for row in results("contacts/results")["by_speed"]
    ]
    head = ["ground", "normal (m/s)", "contacts", *CONTACT_NAMES.values(), "spin / rolling"]
    return markdown(head, body)


def safety_kills() -> str:
    """What kills leave behind."""
    rows = results("safety/kills")
    return markdown(
        ["command", "kills", "with a saved state", "workers left", "half results", "other bytes"],
        [
            [
                f"`{r['command']}`",
                *(str(r[key]) for key in ("kills", "kept", "orphans", "half")),
                f"{len(r['different'])} files",
            ]
            for r in rows
        ],
    )


def safety_fuzz() -> str:
    """What readers do with damaged files."""
    found = results("safety/fuzz")["verdicts"]
    total = {k: sum(v.get(k, 0) for v in found.values()) for k in ("refused", "read")}
    body = [[kind, *_verdicts(counts)] for kind, counts in found.items()]
    failed = sum(sum(v.values()) for v in found.values()) - sum(total.values())
    body.append(["all", *_verdicts(total | {"failed": failed})])
    return markdown(["reader", "files", "refused in one line", "read", "failed"], body)


def safety_extremes() -> str:
    """What extreme settings do."""
    found = results("safety/extremes")
    names = ("profiles", "maps", "refused", "blocks", "given up", "failed")
    counts = found["counts"]
    return markdown(
        ["set-ups", *names],
        [[f"{n:,}" for n in (found["setups"], *(counts.get(k, 0) for k in names))]],
    )


def _verdicts(counts: dict[str, int]) -> list[str]:
    refused, read = counts.get("refused", 0), counts.get("read", 0)
    total = sum(counts.values())
    return [f"{n:,}" for n in (total, refused, read, total - refused - read)]


SLOPES = {
    "plain": "plain, fall lines",
    "rough": "rough, fall lines",
    "followed": "plain, followed paths",
    "plain_1986": "plain, fall lines, readings of 1986",
    "followed_1986": "plain, followed paths, readings of 1986",
}


def speed_slope() -> str:
    """Blocks per second on the benchmark slope, and walks of SAGA."""
    body = []
    for name, label in SLOPES.items():
        one = results(f"speed/{name}")
        saga = one["saga"]
        walks = saga["walks"] / sorted(saga["seconds"])[len(saga["seconds"]) // 2]
        body.append(
            [
                label,
                f"{one['trajectories_per_s_and_core']:,.0f}",
                f"{one['further_trajectories_per_s']:,.0f}",
                f"{walks:,.0f} ({one['ratio_whole']:.1f})",
                f"{saga['walks_per_s']:,.0f} ({one['ratio_further']:.1f})",
                f"{one['first_call_compiling_s']:.0f}",
                f"{one['first_call_from_cache_s']:.1f}",
                f"{one['peak_mb']:.0f}",
            ]
        )
    head = ["slope", "blocks/s, whole", "without set-up", "SAGA, walks/s, whole", "without set-up"]
    head += ["first call, compiling (s)", "from the cache (s)", "memory (MB)"]
    return markdown(head, body)


def speed_together() -> str:
    """One area on several threads and processes."""
    body = [
        [
            SLOPES[name],
            f"{row['count']} {row['workers']}",
            f"{row['rocks_per_wall_s']:,.0f}",
            f"{row['wall_s']:.1f}",
            f"{row['cpu_s']:.1f}",
        ]
        for name in SLOPES
        for row in results(f"speed/{name}")["together"]
    ]
    head = ["slope", "workers", "blocks/s, whole", "whole (s)", "processor time (s)"]
    return markdown(head, body)


def speed_effects() -> str:
    """What each effect costs."""
    found = results("speed/effects")
    return markdown(
        ["effect", "time, none = 1", "mean run-out (m)", "fragments and entrained blocks"],
        [
            [name, f"{r['ratio']:.2f}", f"{r['mean_runout_m']:.0f}", f"{r['pieces']}"]
            for name, r in found.items()
        ],
    )


def speed_limits() -> str:
    """What the parts of a simulation cost."""
    return markdown(
        ["part", "for each block", "ns each", "µs for each block"],
        [
            [
                {"sum": "sum of the parts", "engine": "the engine"}.get(name, name),
                f"{r['per_block']:.1f}" if r.get("per_block") else "",
                f"{r['ns']:.0f}" if "ns" in r else "",
                f"{r['us']:.1f}" if r["us"] else "",
            ]
            for name, r in results("speed/limits").items()
        ],
    )


def speed_peers() -> str:
    """Rates of other programs."""
    what = {
        "sassgis": ("ellipse with rotation", "impulse with friction, rolling, sliding"),
        "PlatRock 2D": ("lumped mass with rotation", "R_n and R_t, rolling"),
        "PyRockfall": ("lumped mass", "R_n and R_t, sliding"),
    }
    return markdown(
        ["program", "rock", "contact", "rocks/s", "sassgis makes", "median stop (m)"],
        [
            [
                f"{name} {r.get('version', '')}".strip(),
                *what[name],
                *(
                    ["–", r["failure"], "–"]
                    if "failure" in r
                    else [
                        f"{r['rocks_per_s']:,.0f}",
                        "–" if name == "sassgis" else f"{r['sassgis_times']:,.0f} times as many",
                        f"{r['median_stop_m']:.0f}",
                    ]
                ),
            ]
            for name, r in results("speed/peers").items()
        ],
    )


def speed_routed() -> str:
    """Release cells per second."""
    cells = 3000
    own = results("speed/plain")
    rate = own["further_trajectories_per_s"] * cells / own["rocks"]
    routed = results("speed/flowpy")
    return markdown(
        ["program", "release cells/s"],
        [
            [f"com4FlowPy {routed['version']}", f"{routed['cells_per_s']:.2f}"],
            ["sassgis", f"{rate:,.0f}"],
        ],
    )


def speed_canton() -> str:
    """A synthetic canton and parts of it."""
    names = ("areas", "points", "rocks", "km2", "jobs")
    times = ("areas_cpu_s", "mosaic_cpu_s", "wall_s")
    head = ["areas", "points in each", "blocks at a point", "km²", "processes"]
    head += ["areas, processor time (s)", "maps and zones, processor time (s)", "whole (s)"]
    return markdown(
        [*head, "memory (GB)"],
        [
            [f"{r[k]:,.0f}" for k in (*names, *times)]
            + [f"{1e-3 * r['peak_mb']:.1f}" if r["peak_mb"] else "–"]
            for r in (*results("speed/growth"), *results("speed/canton"))
        ],
    )


def calibration_coverage() -> str:
    """Ranks of the truth, and how often intervals hold it."""
    found = results("calibration_coverage/results")
    body = []
    for row in found["summary"]:
        held = [f"{n} ({100.0 * n / row['intervals']:.0f} %)" for n in row["held"]]
        ranks = " / ".join(str(n) for n in row["ranks"])
        body.append(
            [
                row["parameter"],
                str(row["intervals"]),
                ranks,
                f"{row['p_uniform']:.2f}",
                *held,
                f"{row['off_sd']:.2f}",
                f"{row['narrowed']:.2f}",
            ]
        )
    head = ["parameter", "intervals", "ranks in five parts", "p", "80 % hold", "95 % hold"]
    return markdown([*head, "distance over sd", "width over prior"], body)


def sampling() -> str:
    """How many times less variance times time other ways of sampling need than plain sampling."""
    found = results("sampling/sampling")
    cells = [
        f"cells, {100 * low:g} to {100 * high:g} %" if low else f"cells, below {100 * high:g} %"
        for low, high in found["classes"]
    ]
    cells[0] = f"cells, {100 * found['classes'][0][0]:g} % and more"
    far = [f"distance of {100 * share:g} %" for share in found["far"]]
    body = [
        [
            row["site"],
            row["design"],
            f"{row['time']:.2f}",
            *(f"{g:.2f} ± {e:.2f}" for g, e in zip(row["gain"], row["error"], strict=True)),
            f"{row['reach'][1]:.2f}",
        ]
        for row in found["rows"]
    ]
    # Of four copies the variance is s + (1 − s)/4, s being the share of what is drawn at the start.
    for row in found["rows"]:
        if row["design"] == "split at the start into 4":
            shares = [max(4.0 * v - 1.0, 0.0) / 3.0 for v in row["variance"]]
            bounds = [f"{1.0 / (1.0 - share):.2f}" for share in shares]
            body.append([row["site"], "any spreading at the start, at most", "1", *bounds, "–"])
    head = ["terrain", "sampling", "time", *cells, *far, "blocks beyond the distance of 1 %"]
    return markdown(head, body)


def sampling_decided() -> str:
    """How much is decided where a block comes to a chainage: medians over release points."""
    rows = results("sampling/decided")["rows"]
    return markdown(
        ["terrain", "other draws from", "stop at the same place", "correlation of coming far"],
        [
            [
                row["site"],
                f"the distance of {100 * row['share']:g} %",
                f"{100 * statistics.median(row['same']):.0f} % "
                f"({100 * min(row['same']):.0f} to {100 * max(row['same']):.0f} %)",
                f"{statistics.median(row['alike']):.2f} "
                f"({min(row['alike']):.2f} to {max(row['alike']):.2f})",
            ]
            for row in rows
        ],
    )


TABLES = {
    "calibration coverage": calibration_coverage,
    "sampling": sampling,
    "sampling decided": sampling_decided,
    "discretisation valley": lambda: discretisation("valley"),
    "discretisation bedrina": lambda: discretisation("bedrina"),
    "discretisation piota_negra": lambda: discretisation("piota_negra"),
    "discretisation lines": lines,
    "discretisation splitting": splitting,
    "convergence tolerance": lambda: convergence("tolerance"),
    "convergence assumption": lambda: convergence("assumption"),
    "field untuned": field_untuned,
    "field site bands": field_site_bands,
    "field left out": field_left_out,
    "field groups": field_groups,
    "field published": field_published,
    "field gain": field_gain,
    "field bands": field_bands,
    "field repeated": field_repeated,
    "field mass": field_mass,
    "field parameters": field_parameters,
    "field widths": field_widths,
    "contacts filmed": contacts_filmed,
    "contacts program": contacts_program,
    "safety kills": safety_kills,
    "safety fuzz": safety_fuzz,
    "safety extremes": safety_extremes,
    "speed slope": speed_slope,
    "speed together": speed_together,
    "speed effects": speed_effects,
    "speed limits": speed_limits,
    "speed peers": speed_peers,
    "speed canton": speed_canton,
    "speed routed": speed_routed,
}


def filled(text: str) -> str:
    """A page with its tables written again."""

    def table(match: re.Match[str]) -> str:
        name = match[1]
        return f"<!-- table: {name} -->\n\n{TABLES[name]()}\n\n<!-- end -->"

    return re.sub(r"<!-- table: (.+?) -->\n.*?<!-- end -->", table, text, flags=re.S)


def main() -> None:
    """Rewrite the pages."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        new = filled(text)
        if new != text:
            page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
