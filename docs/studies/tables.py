"""Put the tables of the studies into their pages.

``python docs/studies/tables.py`` rewrites what stands between ``<!-- table: NAME -->`` and
``<!-- end -->`` in the pages of this folder, and in docs/calibration.md, from the committed CSV and
JSON files.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import study_tables
from study_tables import table

HERE = Path(__file__).parent
PAGES = (*sorted(HERE.glob("*.md")), HERE.parent / "calibration.md")


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
    found = found[found["slope"] == "valley"]
    lengths = found.groupby("tolerance_m")["segment_length_m"].first()
    rows = [" | ".join(["*segment length (m)*", *(f"*{v:.1f}*" for v in lengths), ""])]
    found = found[~found["quantity"].str.contains("arrivals|run-out 25 %| at 60 m ")]
    for quantity, own in found.groupby("quantity", sort=False):
        half = 0.5 * (own["high_95"] - own["low_95"]).max()
        rows.append(" | ".join([quantity, *map(rounded, own["value"]), f"± {rounded(half, 2)}"]))
    tolerances = " | ".join(f"{t:g}" for t in lengths.index)
    return table(f"tolerance (m) | {tolerances} | sampling, at most", rows)


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


def span(limits: list[float], spec: str = ".0f") -> str:
    """An interval."""
    return " to ".join(format(v, spec) for v in limits)


def class_label(site: str, label: str) -> str:
    """A site and the class of its slope, ``{own}``, or that of the other site, ``{other}``."""
    own = results("field/results")["classes"]
    other = dict(zip(own, reversed(own.values()), strict=True))
    return f"{site}, {label.format(own=own[site], other=other[site])}"


def field_untuned() -> str:
    """Stops with classes chosen by the description alone, and two other choices."""
    rows = []
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
            rows.append(
                f"{class_label(name, label)} | {metres(one['observed_m'])} | "
                f"{metres(one['simulated_m'])} | {middle} | {far} | {width} | "
                f"{beyond['edge_m']:.0f} m: {observed:.0f} / {simulated:.0f} % | "
                f"{100.0 * one['left_the_terrain']:.0f} %"
            )
    return table(
        "site, class of the slope | observed 10 / 50 / 90 % (m) | simulated | median | 90 % | "
        "width | stopped beyond | left the terrain",
        rows,
    )


def field_site_bands() -> str:
    """Bands by the spread of classes between sites, beside what was observed."""
    rows = []
    for kind, label in (("own", "`{own}`"), ("other", "`{other}`")):
        for name, one in results("field/results")["bands_of_classes"][kind].items():
            cells = [class_label(name, label)]
            for own in one.values():
                cells += [f"{own['observed_m']:.0f}", f"{own['simulated_m']:.0f}"]
                cells.append(f"{span(own['band_m'])}{'' if own['holds'] else ' (not held)'}")
            rows.append(" | ".join(cells))
    return table(
        "site, class of the slope | median: observed (m) | simulated | 80 % band | "
        "90 %: observed (m) | simulated | 80 % band",
        rows,
    )


def field_left_out() -> str:
    """Errors on rocks left out, over random halves, and at the other site.

    Errors of the configured classes stand there only where others were recommended.
    """
    rows = []
    for name, one in results("field/results")["held_out"].items():
        labels = {
            "left_out": f"the other half ({one['rocks_left_out']} rocks)",
            "left_out_configured": "the same, configured classes",
            "halves_observed": "*observed halves against each other*",
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


def field_bands() -> str:
    """How many rocks lie in the bands of their own simulations.

    The configured classes have rows for rocks left out only where others were recommended.
    """
    found = results("field/results")
    bands = {f"{n}, built-in classes": one["bands"] for n, one in found["built_in"].items()}
    for name, one in found["held_out"].items():
        own = one["bands"]
        bands[f"{name}, calibrated, rocks left out"] = own["left_out"]
        if own["left_out_configured"] != own["left_out"]:
            bands[f"{name}, the same, as configured"] = own["left_out_configured"]
    rows = []
    for label, own in bands.items():
        cells = [
            f"{100 * band['inside']:.0f} % ({span([100 * v for v in band['inside_95']])})"
            for band in own.values()
        ]
        cells += [f"{100 * own['0.9'][side]:.0f} %" for side in ("short", "far")]
        rows.append(" | ".join([label, *cells]))
    return table(
        "site | in the 80 % band | in the 90 % band | stopped short of it | went beyond it", rows
    )


def field_repeated() -> str:
    """Spread of repeated runs of one block."""
    return table(
        "block | runs, places | observed spread (m) | simulated (m) | "
        "simulated, from one point (m)",
        (
            f"{name} | {one['runs']} from {one['places']} | {one['observed_m']:.0f} | "
            f"{one['simulated_m']:.0f} ({span(one['simulated_95'])}) | {one['one_release_m']:.0f}"
            for name, one in results("field/results")["repeated"].items()
        ),
    )


def field_mass() -> str:
    """How much farther a rock of twice the mass goes."""
    rows = []
    for name, one in results("field/results")["by_mass"].items():
        cells = [
            minus(f"{one[f'{side}_m']:+.1f} ({span(one[f'{side}_95'], '+.1f')})")
            for side in ("observed", "simulated")
        ]
        rows.append(" | ".join([name, *cells]))
    return table("site | observed (m) | simulated (m)", rows)


def field_groups() -> str:
    """Run-out by groups of rocks."""
    return table(
        "group | rocks | observed 10 / 50 / 90 % (m) | simulated",
        (
            f"{name} | {one['rocks']} | {metres(one['observed_m'])} | {metres(one['simulated_m'])}"
            for name, one in results("field/results")["by_group"].items()
        ),
    )


def field_published() -> str:
    """What others published for the same stops."""
    found = results("field/results")
    rows = [
        f"{one['site']} | {one['source'].split(' ')[0]} | {minus(one['value'])}"
        for one in found["published"]
    ]
    rows += [
        f"{name} | sassgis, built-in classes | {minus(format(one['mean_gap_m'], '+.1f'))}"
        for name, one in found["built_in"].items()
    ]
    return table("site | program | mean signed error of the run-out (m)", rows)


def field_parameters() -> str:
    """What calibrations on all rocks of a site say of the parameters that stops show."""
    rows = []
    for one in results("field/results")["parameters"]:
        notes = {"identified": one["identified"], "at a limit": one["at_limit"]}
        said = ", ".join(note for note, there in notes.items() if there)
        low, high = (rounded(v, 2) for v in one["ci95"])
        if said:
            rows.append(
                f"{one['site']}: `{one['class']}` | `{one['parameter']}` | "
                f"{rounded(one['configured'], 2)} | {rounded(one['value'], 2)} | {low} to {high} | "
                f"{said}"
            )
    head = "site and class | parameter | shipped | best | 95 % | "
    return table(head, rows or ["all | – | – | – | – | none identified"])


def field_widths() -> str:
    """Errors of the width against what turns the heading: a column for each drift."""
    found = results("field/results")["widths"]
    names = [name for name, own in found[0].items() if isinstance(own, dict)]
    cells: dict[str, dict[str, str]] = {}
    for one in found:
        both = " / ".join(percent(one[name]["width_error"]).removesuffix(" %") for name in names)
        cells.setdefault(f"{one['side_tilt_deg']:g}°", {})[f"{one['drift_deg']:g}°"] = both
    drifts = list(dict.fromkeys(drift for own in cells.values() for drift in own))
    head = [f"side tilt; {' / '.join(names)} (%)", *(f"drift {drift}" for drift in drifts)]
    return table(
        " | ".join(head), (" | ".join([tilt, *own.values()]) for tilt, own in cells.items())
    )


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


def contacts_program() -> str:
    """Contacts of the discrete-element program by ground and normal speed: medians."""
    rows = []
    for one in results("contacts/results")["by_speed"]:
        cells = [
            f"{one['observed'][key][1]:.2f} / {one['simulated'][key][1]:.2f}" for key in CONTACTS
        ]
        speeds = span(one["vn_mps"], "g")
        rows.append(" | ".join([one["ground"], speeds, str(one["contacts"]), *cells]))
    return table(
        "ground | normal (m/s) | contacts | R_n | R_t | energy kept | spin / rolling", rows
    )


def safety_kills() -> str:
    """What kills leave behind."""
    return table(
        "command | kills | with a saved state | workers left | half results | other bytes",
        (
            f"`{one['command']}` | {one['kills']} | {one['kept']} | {one['orphans']} | "
            f"{one['half']} | {len(one['different'])} files"
            for one in results("safety/kills")
        ),
    )


def safety_fuzz() -> str:
    """What readers do with damaged files: those that failed, the others together, all."""
    found = pd.DataFrame(results("safety/fuzz")["verdicts"]).T.fillna(0).astype(int)
    failed = found.sum(axis=1) > found["refused"] + found["read"]
    others = found[~failed]
    names = ", ".join(f"`{name}`" for name in others.index)
    shown = found[failed]
    shown = pd.concat([others.sum().rename(names).to_frame().T, shown])
    shown.loc["all"] = found.sum()
    rows = []
    for kind, own in shown.iterrows():
        bad = own.sum() - own["refused"] - own["read"]
        rows.append(f"{kind} | {own.sum():,} | {own['refused']:,} | {own['read']:,} | {bad:,}")
    return table("reader | files | refused in one line | read | failed", rows)


def safety_extremes() -> str:
    """What extreme settings do."""
    found = results("safety/extremes")
    names = ("profiles", "maps", "refused", "blocks", "given up", "failed")
    counts = (found["setups"], *(found["counts"].get(name, 0) for name in names))
    head = " | ".join(("set-ups", *names)).replace("given up", "aborted")
    return table(head, [" | ".join(f"{n:,}" for n in counts)])


SLOPES = {
    "plain": "plain, fall lines",
    "rough": "rough, fall lines",
    "followed": "plain, followed paths",
    "plain_1986": "plain, fall lines, assumptions of 1986",
    "followed_1986": "plain, followed paths, assumptions of 1986",
}


def speed_slope() -> str:
    """Blocks per second on the benchmark slope, and walks of SAGA."""
    row = (
        "{label} | {trajectories_per_s_and_core:,.0f} | {further_trajectories_per_s:,.0f} | "
        "{walks:,.0f} ({ratio_whole:.1f}) | {first_call_compiling_s:.0f} / "
        "{first_call_from_cache_s:.1f} | {peak_mb:.0f}"
    )
    rows = []
    for name, label in SLOPES.items():
        one = results(f"speed/{name}")
        seconds = sorted(one["saga"]["seconds"])
        walks = one["saga"]["walks"] / seconds[len(seconds) // 2]
        rows.append(row.format(label=label, walks=walks, **one))
    return table(
        "slope | blocks/s, whole | without set-up | SAGA, walks/s | "
        "first call, compiling / from the cache (s) | memory (MB)",
        rows,
    )


def speed_together() -> str:
    """Blocks per second of one area on several threads and processes."""
    cells: dict[str, dict[str, str]] = {}
    for name, label in SLOPES.items():
        for one in results(f"speed/{name}")["together"]:
            column = f"{one['workers']}: {one['count']}"
            cells.setdefault(label, {})[column] = f"{one['rocks_per_wall_s']:,.0f}"
    columns = list(dict.fromkeys(column for own in cells.values() for column in own))
    return table(
        " | ".join(["slope; blocks/s", *columns]),
        (" | ".join([label, *(own[c] for c in columns)]) for label, own in cells.items()),
    )


def speed_effects() -> str:
    """What each effect costs."""
    return table(
        "effect | time, none = 1 | mean run-out (m) | fragments and entrained blocks",
        (
            f"{name} | {one['ratio']:.2f} | {one['mean_runout_m']:.0f} | {one['pieces']}"
            for name, one in results("speed/effects").items()
        ),
    )


def speed_spots() -> str:
    """Where the engine spends its time."""
    found = results("speed/hot_spots")
    parts = found["fall_line"]
    rows = [" | ".join([p, *(f"{100 * own[p]:.0f} %" for own in found.values())]) for p in parts]
    return table("part of the engine | fall lines | followed paths", rows)


def speed_barriers() -> str:
    """Processor time with and without barriers."""
    found = results("speed/barriers")
    seconds = found["seconds"]
    rows = {
        "with barriers": seconds["with"],
        "with and without, only blocks that differ twice": seconds["both"],
        "with and without, all blocks twice": seconds["with"] + seconds["again"],
    }
    return table("simulated | processor time (s)", (f"{k} | {v:.1f}" for k, v in rows.items()))


def speed_peers() -> str:
    """Rates of other programs."""
    what = {
        "sassgis": "ellipse with rotation | impulse with friction, rolling, sliding",
        "PlatRock 2D": "lumped mass with rotation | R_n and R_t, rolling",
        "PyRockfall": "lumped mass | R_n and R_t, sliding",
    }
    rows = []
    for name, one in results("speed/peers").items():
        program = f"{name} {one.get('version', '')}".strip()
        found = f"– | {one.get('failure')} | –"
        if "failure" not in one:
            times = f"{one['sassgis_times']:,.0f} times as many" if name != "sassgis" else "–"
            found = f"{one['rocks_per_s']:,.0f} | {times} | {one['median_stop_m']:.0f}"
        rows.append(f"{program} | {what[name]} | {found}")
    return table("program | rock | contact | rocks/s | sassgis makes | median stop (m)", rows)


def speed_routed() -> str:
    """Release cells per second."""
    cells = 3000
    own, routed = results("speed/plain"), results("speed/flowpy")
    rate = own["further_trajectories_per_s"] * cells / own["rocks"]
    return table(
        "program | release cells/s",
        [f"com4FlowPy {routed['version']} | {routed['cells_per_s']:.2f}", f"sassgis | {rate:,.0f}"],
    )


def speed_canton() -> str:
    """A synthetic canton and parts of it."""
    row = (
        "{areas:,.0f} | {points:,.0f} | {rocks:,.0f} | {km2:,.0f} | {jobs:,.0f} | "
        "{areas_cpu_s:,.0f} | {mosaic_cpu_s:,.0f} | {wall_s:,.0f} | "
    )
    return table(
        "areas | points in each | blocks at a point | km² | processes | "
        "areas, processor time (s) | maps and zones, processor time (s) | whole (s) | memory (GB)",
        (
            row.format_map(one) + (f"{1e-3 * one['peak_mb']:.1f}" if one["peak_mb"] else "–")
            for one in (*results("speed/growth"), *results("speed/canton"))
        ),
    )


def changed_shares(own: pd.Series[float]) -> str:
    """What is stated, and what another sample changes."""
    shares = (f"{100 * own[key]:.1f} %" for key in ("stated", "cells", "zones"))
    marked = (f"{100 * own[key]:.0f} %" for key in ("flagged", "caught"))
    return " | ".join([*shares, *marked])


CHANGED = "stated | cells | zones | hatched, of the zoned area | changes on hatched cells"


def zone_seeds() -> str:
    """Changes by another sample, by site and number of blocks."""
    rows = (
        f"{own['site']} | {own['times']} × | {changed_shares(own)} | "
        f"{own['found']} of {own['pairs']}"
        for _, own in rows_of("zone_seeds/seeds").iterrows()
        if own["times"] in (1, 8)
    )
    return table(f"site | blocks | {CHANGED} | changes in `compare`", rows)


def zone_seeds_auto() -> str:
    """The same with as many blocks as the map needs."""
    rows = (
        f"{own['site']} | {own['blocks']:,.0f} | {own['minutes']:.1f} min | {changed_shares(own)}"
        for _, own in rows_of("zone_seeds/auto").iterrows()
    )
    return table(f"site | blocks | processor time | {CHANGED}", rows)


def calibration_coverage() -> str:
    """How often intervals hold the truth."""
    rows = []
    for one in results("calibration_coverage/results")["summary"]:
        held = " | ".join(f"{n} ({100.0 * n / one['intervals']:.0f} %)" for n in one["held"])
        rows.append(f"{one['parameter']} | {one['intervals']} | {held}")
    return table("parameter | intervals | 80 % hold | 95 % hold", rows)


def sampling() -> str:
    """How many times less variance times time other ways of sampling need than plain sampling."""
    found = results("sampling/sampling")
    cells = [
        f"cells, {100 * low:g} to {100 * high:g} %" if low else f"cells, below {100 * high:g} %"
        for low, high in found["classes"]
    ]
    cells[0] = f"cells, {100 * found['classes'][0][0]:g} % and more"
    far = [f"distance of {100 * share:g} %" for share in found["far"]]
    spread, bounds = [], []
    for one in found["rows"]:
        label = f"{one['site']} | {one['design']} | {one['time']:.2f} | "
        if one["design"] == "split at the start into 4":
            # Of four copies the variance is s + (1 − s)/4, s: share of what is drawn at the start.
            shares = [max(4.0 * v - 1.0, 0.0) / 3.0 for v in one["variance"]]
            most = " | ".join(f"{1.0 / (1.0 - share):.2f}" for share in shares)
            bounds.append(f"{one['site']} | any spreading at the start, at most | 1 | {most}")
        elif one["design"] != "plain":
            spread.append(label + " | ".join(f"{gain:.2f}" for gain in one["gain"]))
    errors = zip(*(one["error"] for one in found["rows"]), strict=True)
    largest = " | ".join(f"± {max(own):.2f}" for own in errors)
    rows = [*spread, *bounds, f" | *standard error, at most* |  | {largest}"]
    return table(f"terrain | sampling | time | {' | '.join([*cells, *far])}", rows)


#: The only block of 40 kg.
PLATE = "run-out of 40 kg"


def kinematics_tschamut() -> str:
    """Motion at Tschamut, observed and simulated: all rocks, and the run-out of the plate."""
    rows = []
    found = results("kinematics/results")
    for name, one in found["tschamut"].items():
        if " of " in name and name != PLATE:
            continue
        seen, made = one["observed"], one["simulated"]
        digits = 1 if name.startswith(("speed", "greatest")) else 2
        digits = 0 if name.startswith(("run-out", "contacts")) else digits
        cells = (" / ".join(f"{v:.{digits}f}" for v in values[1:]) for values in (seen, made))
        rows.append(
            f"{name}{_UNITS.get(name.split(' ')[0], '')} | {' | '.join(cells)} | {_off(one)} | "
            f"{_off(found['ellipses_of_boxes'][name])}"
        )
    head = "50 / 90 % of the rocks | observed | simulated | error | without outline"
    return table(head, rows)


_UNITS = {
    "run-out": " (m)",
    "energy": " (kJ)",
    "speed": " (m/s)",
    "height": " (m)",
    "greatest": " (m/s)",
    "hop": " (m)",
}


def _off(one: dict[str, list[float]]) -> str:
    """How far median and 90 % are off."""
    pairs = zip(one["observed"][1:], one["simulated"][1:], strict=True)
    return " / ".join(percent(made / seen - 1.0) for seen, made in pairs)


def kinematics_wheel() -> str:
    """A block of 780 kg below the cliff of Chant Sura, published and simulated."""
    found = results("kinematics/results")
    made = found["chant_sura"]
    rows = []
    for name, quantity, factor in (
        ("speed (m/s)", "translational speed", 1.0), ("spin (Hz)", "spin", 1.0 / 360.0),
    ):  # fmt: skip
        (seen,) = (r for r in found["published"] if r["quantity"].startswith(quantity))
        middle, rest = seen["value"].split(" (", 1)
        low, high = rest.split(";")[0].rstrip(")").split("-")
        cells = ([factor * float(v) for v in (low, middle, high)], made[name.split(" ")[0]])
        rows.append(f"{name} | {' | '.join(' / '.join(f'{v:.1f}' for v in own) for own in cells)}")
    rim = " / ".join(f"{v:.2f}" for v in made["rim over speed"])
    rows.append(f"spin × largest radius / speed | 0.58 to 0.80 (4 contacts) | {rim}")
    height = " / ".join(f"{v:.1f}" for v in made["height"])
    rows.append(f"height above that at rest (m) | about 0.8 (centre 1.2) | {height}")
    return table("25 / 50 / 75 % of the time in the air | published | simulated", rows)


def kinematics_slopes() -> str:
    """95 % of speeds and heights on even slopes: a row for each class, a column for each size."""
    cells: dict[str, dict[str, list[str]]] = {}
    found = [one for one in results("kinematics/results")["slopes"] if one["drop_m"] == 200.0]
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
    """Maps of three terrains before and after."""
    rows = []
    for site, of in results("tirol/results").items():
        for label, one in of.items():
            levels = " / ".join(f"{v:.1f}" for v in reversed(one["level_ha"]))
            rows.append(
                f"{site}, {label} | {one['speed'][0]:.0f} / {one['speed'][1]:.0f} | "
                f"{one['passing_height'][0]:.1f} / {one['passing_height'][1]:.1f} | "
                f"{one['energy'][0]:.0f} / {one['energy'][1]:.0f} | {levels}"
            )
    return table(
        "terrain | speed (m/s) | passing height (m) | energy (kJ) | "
        "red / blue / yellow / hatched (ha)",
        rows,
    )


#: By the name of the mark.
TABLES = {
    made.__name__.replace("_", " "): made
    for made in (
        discretisation, convergence, calibration_coverage, zone_seeds, zone_seeds_auto,
        sampling, field_untuned, field_site_bands, field_left_out, field_groups,
        field_published, field_bands, field_repeated, field_mass, field_parameters,
        field_widths, contacts_filmed, contacts_program, safety_kills, safety_fuzz,
        safety_extremes, speed_slope, speed_together, speed_effects, speed_spots,
        speed_barriers, speed_peers, speed_canton, speed_routed, kinematics_tschamut,
        kinematics_wheel, kinematics_slopes, kinematics_fan, tirol,
    )
}  # fmt: skip


def filled(text: str) -> str:
    """A page with its tables written again."""
    return study_tables.filled(text, TABLES, "table", "end")


if __name__ == "__main__":
    study_tables.rewrite(PAGES, filled)
