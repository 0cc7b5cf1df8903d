"""Do numerical tolerances, halved, move run-out and energy?

``python docs/studies/convergence.py -o FOLDER [--rocks N]`` writes convergence.csv, .json and .png.

Constants of the compiled code are changed before it is compiled, each set of them in a process and
a cache of compiled code of its own. Every variant is simulated twice: with the same draws as the
base, which shows how many rocks take exactly the same path, and with other draws, for a
comparison of two independent samples. To show what the comparison can detect, settings
that are meant to matter (the modelling assumptions of docs/model.md) are compared in the same way.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from study_tables import write_csv

SEED, OTHER_SEED = 1986, 1987
LINES = 8
STATION_M = {"valley": 150.0, "bedrina": 118.0}
#: Rocks that stop this close to each other have had the same path (m).
SAME_M = 1e-3


@dataclass(frozen=True)
class Variant:
    """One change: constants of sassgis.engine by a factor, or settings by a value."""

    name: str
    kind: str
    constants: dict[str, float] = field(default_factory=dict)
    settings: dict[str, object] = field(default_factory=dict)


#: Constants of sassgis.engine that exist only because numbers are finite, halved one after another.
NUMERICAL = (
    ("ground_motion._TOUCH",),
    ("profile._PAST",),
    ("profile.STRAIGHT", "profile._STRAIGHT_M"),
    ("landing.FIRST_TURN",),
    ("ellipse_contact._TINY", "ellipse_contact._WAIT", "ellipse_contact._DEEP"),
    # Criterion of rest for repeated contacts at one point.
    ("landing._REST_SHARE", "landing._SAME_SPOT"),
)


def variants() -> list[Variant]:
    """All variants; the base first."""
    half = [
        Variant(
            " and ".join(", ".join(c.split(".")[1] for c in some).rsplit(", ", 1)) + " halved",
            "tolerance",
            dict.fromkeys(some, 0.5),
        )
        for some in NUMERICAL
    ]
    return [
        Variant("base", "base"),
        Variant(
            "contact_tolerance_m halved", "tolerance", settings={"contact_tolerance_m": 0.5e-6}
        ),
        *half,
        Variant(
            "all of these halved",
            "tolerance",
            {c: 0.5 for some in NUMERICAL for c in some},
            {"contact_tolerance_m": 0.5e-6},
        ),
        Variant("rolling_threshold 0.05", "assumption", settings={"rolling_threshold": 0.05}),
        Variant("rolling_threshold 0.2", "assumption", settings={"rolling_threshold": 0.2}),
        Variant("rolling ellipse", "assumption", settings={"rolling": "ellipse"}),
        Variant("end_sliding false", "assumption", settings={"end_sliding": False}),
        Variant("slope_variation off", "assumption", settings={"slope_variation": "off"}),
        Variant("eta_max_rule coulomb", "assumption", settings={"eta_max_rule": "coulomb"}),
    ]


def change_constant(name: str, factor: float) -> None:
    """Multiply a constant of sassgis.engine, also where other files of the engine import it.

    Nothing is compiled before its first call, so the compiled code sees the new value.
    """
    import_module("sassgis.engine.simulate")
    file, constant = name.split(".")
    value = getattr(import_module(f"sassgis.engine.{file}"), constant)
    for module in [m for path, m in sys.modules.items() if path.startswith("sassgis.engine.")]:
        if hasattr(module, constant):
            # Two constants of one name would be changed together.
            assert getattr(module, constant) == value, (module.__name__, constant)
            setattr(module, constant, value * factor)


def work(
    constants: dict[str, float], jobs: list[tuple[str, dict[str, object]]], rocks: int
) -> None:
    """Simulate rocks with changed constants; runs in a process of its own."""
    for name, factor in constants.items():
        change_constant(name, factor)
    from slopes import follow, table_slope, valley_slopes

    from sassgis.settings.settings import EngineSettings

    sets = {
        "valley": (valley_slopes(LINES), -(-rocks // LINES)),
        "bedrina": ([table_slope("bedrina", "config_before.toml")], rocks),
    }
    for target, settings in jobs:
        out: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
        for seed in (SEED, OTHER_SEED):
            for name, (slopes, each) in sets.items():
                for slope in slopes:
                    table, (energy,), _ = follow(
                        slope,
                        slope.profile(0.25),
                        each,
                        seed,
                        [STATION_M[name]],
                        EngineSettings(readings="1986", **settings),  # type: ignore[arg-type]
                    )
                    out[f"{name}-{seed}-runout"].append(table["runout_m"])
                    out[f"{name}-{seed}-energy"].append(energy)
                    out[f"{name}-{seed}-most"].append(table["max_energy_kj"])
        np.savez(target, **{key: np.concatenate(parts) for key, parts in out.items()})


def simulated(rocks: int) -> dict[str, dict[str, NDArray[np.float64]]]:
    """The rocks of every variant; variants with the same constants share a process."""
    groups: dict[str, list[Variant]] = defaultdict(list)
    for v in variants():
        groups[json.dumps(v.constants, sort_keys=True)].append(v)
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (constants, members) in enumerate(groups.items()):
            targets = {v.name: f"{folder}/{number}-{k}.npz" for k, v in enumerate(members)}
            task = {
                "constants": json.loads(constants),
                "jobs": [(targets[v.name], v.settings) for v in members],
                "rocks": rocks,
            }
            environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
            cache = Path(folder) / f"cache-{number}"
            if number:
                # The files of the engine hold the constants, or contain what does.
                changed = shutil.ignore_patterns("sassgis.engine*")
                assert any(Path(folder, "cache-0").rglob("sassgis.engine*")), "no compiled engine"
                shutil.copytree(Path(folder) / "cache-0", cache, ignore=changed)
            environment["SASSGIS_CACHE_DIR"] = str(cache)
            subprocess.run(
                [sys.executable, __file__, "--task", json.dumps(task)], check=True, env=environment
            )
            for name, path in targets.items():
                results[name] = dict(np.load(path))
            print("done:", ", ".join(targets), flush=True)
    return results


def compared(results: dict[str, dict[str, NDArray[np.float64]]]) -> list[dict[str, object]]:
    """A row for each variant, slope and quantity."""
    from scipy.stats import ks_2samp

    base = results["base"]
    rows: list[dict[str, object]] = []
    for v in variants():
        for slope in STATION_M:
            runs = [results[v.name][f"{slope}-{s}-runout"] for s in (SEED, OTHER_SEED)]
            same = np.abs(runs[0] - base[f"{slope}-{SEED}-runout"]) < SAME_M
            for quantity in ("runout", "energy", "most"):
                reference = base[f"{slope}-{SEED}-{quantity}"]
                reference = reference[np.isfinite(reference)]
                values = [results[v.name][f"{slope}-{s}-{quantity}"] for s in (SEED, OTHER_SEED)]
                paired, fresh = (x[np.isfinite(x)] for x in values)
                rows.append(
                    {
                        "variant": v.name,
                        "kind": v.kind,
                        "slope": slope,
                        "quantity": {
                            "runout": "run-out (m)",
                            "energy": f"energy at {STATION_M[slope]:g} m (kJ)",
                            "most": "largest energy (kJ)",
                        }[quantity],
                        "rocks": fresh.size,
                        "median": float(np.median(fresh)),
                        "q95": float(np.quantile(fresh, 0.95)),
                        "same_rocks_percent": 100.0 * float(same.mean()),
                        "D_same_draws": float(ks_2samp(reference, paired).statistic),
                        "D_other_draws": float(ks_2samp(reference, fresh).statistic),
                        "p_other_draws": float(ks_2samp(reference, fresh).pvalue),
                    }
                )
    return rows


def draw(rows: list[dict[str, object]], path: Path) -> None:
    """Kolmogorov-Smirnov distances of all variants, with the critical value of chance."""
    from sassgis.report.figures import save
    from sassgis.report.figures.style import BLUE, GREY, ORANGE, WIDTH_IN, house_style, new_figure

    with house_style():
        fig = new_figure(WIDTH_IN, 4.2)
        axes = fig.subplots(1, 2, sharey=True)
        names = list(dict.fromkeys(str(r["variant"]) for r in rows))
        for ax, quantity in zip(axes, ("run-out", "largest energy"), strict=True):
            for marker, slope in (("o", "valley"), ("D", "bedrina")):
                some = [
                    r for r in rows
                    if r["slope"] == slope and str(r["quantity"]).startswith(quantity)
                ]  # fmt: skip
                ax.scatter(
                    [r["D_other_draws"] for r in some],
                    [names.index(str(r["variant"])) for r in some],
                    marker=marker,
                    s=22,
                    color=[ORANGE if r["kind"] == "assumption" else BLUE for r in some],
                    label=slope,
                )
                # Critical value of the two-sample test at 5 % (Smirnov, 1948).
                n = float(np.mean([float(r["rocks"]) for r in some]))  # type: ignore[arg-type]
                ax.axvline(1.358 * np.sqrt(2.0 / n), color=GREY, lw=0.8, ls=":")
            ax.set_title(quantity, loc="left", size=9)
            ax.set_xlabel("distance D from the base")
            ax.set_xlim(0.0, 0.2)
            ax.set_xticks([0.0, 0.05, 0.1, 0.15, 0.2])
            ax.set_yticks(range(len(names)), names)
            ax.invert_yaxis()
        axes[0].invert_yaxis()
        axes[1].legend(loc="lower right")
        fig.supxlabel(
            "blue: numerical, halved; orange: assumptions; dotted: exceeded by 5 % of pairs of "
            "equal samples", size=7, color=GREY, x=0.01, ha="left",
        )  # fmt: skip
        save(fig, path)


def main() -> None:
    """Run the study, or one process of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--rocks", type=int, default=2000, help="rocks on each slope")
    parser.add_argument("--task", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.task:
        work(**json.loads(options.task))
        return
    if options.output is None:
        parser.error("-o FOLDER is missing")
    out: Path = options.output
    out.mkdir(parents=True, exist_ok=True)
    rows = compared(simulated(options.rocks))
    write_csv(out / "convergence.csv", rows, 5)
    numerical = [r for r in rows if r["kind"] == "tolerance"]
    import sassgis

    facts = {
        "program": f"sassgis {sassgis.__version__}",
        "rocks_on_each_slope": options.rocks,
        "seeds": [SEED, OTHER_SEED],
        "comparisons": len(numerical),
        "smallest_p": min(float(r["p_other_draws"]) for r in numerical),  # type: ignore[arg-type]
        "below_5_percent": sum(float(r["p_other_draws"]) < 0.05 for r in numerical),  # type: ignore[arg-type]
        "largest_D_same_draws": max(float(r["D_same_draws"]) for r in numerical),  # type: ignore[arg-type]
    }
    (out / "convergence.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    draw(rows, out / "convergence.png")
    print(json.dumps(facts))


if __name__ == "__main__":
    main()
