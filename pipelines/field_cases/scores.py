"""How well simulated stops meet observed ones: all together, by rock, by block and by mass."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest

from field_cases.sites import Simulated, Site, run_out
from sassgis.files.atomic_output import staged_output
from sassgis.gap.fit.distances import energy_scores
from sassgis.grid import FloatArray
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import read_ranges
from sassgis.runs.resumable_run import Workplace, configured, read_job
from sassgis.runs.variant_lab import DRAWS, VariantLab, draws_in
from sassgis.settings.map_run import Config
from sassgis.simulation.loop import check_starts
from sassgis.simulation.workers import Jobs, OnProgress
from sassgis.studies.variants import BASE, FAR, MEDIAN, SpreadBand, Variant

SHARES = (0.1, 0.5, 0.9)
BOOTSTRAPS = 1000
#: Bands of single rocks whose coverage is counted.
BANDS = (0.8, 0.9)
#: Sideways tilts and drifts (degrees) whose widths are compared.
TILTS = (4.0, 7.0, 10.0, 15.0)
DRIFTS = (2.0, 4.0, 6.0)
#: Runs of one block from one place below which their spread is not looked at.
FEWEST_RUNS = 3
#: Draws of the classes, and simulations of each rock on each of them, about.
BAND_DRAWS = 60
BAND_COUNT = 16


def quantiles(values: FloatArray) -> FloatArray:
    """At SHARES."""
    return np.quantile(values, SHARES)


def width(offset: FloatArray) -> float:
    """From the 10 to the 90 % quantile (m)."""
    low, _, high = quantiles(offset)
    return float(high - low)


def score(site: Site, made: Simulated, seed: int = 1986) -> dict[str, Any]:
    """Observed and simulated run-out and offset, relative errors with intervals, and the CRPS.

    The intervals (95 %) are of the relative errors: the observed rocks drawn anew.
    """
    seen = run_out(site, site.stops)
    rows = run_out(site, made.stops)
    # Blocks that never start are told apart; they are no stops.
    pool = rows[made.started]
    want, got = quantiles(seen[:, 0]), quantiles(pool[:, 0])
    draw = np.random.default_rng(seed)
    errors = []
    for _ in range(BOOTSTRAPS):
        own = seen[draw.integers(0, len(seen), len(seen))]
        errors.append(
            [*(got / quantiles(own[:, 0]) - 1.0), width(pool[:, 1]) / width(own[:, 1]) - 1.0]
        )
    low, high = np.quantile(errors, [0.025, 0.975], axis=0)
    edge = widest_gap(seen[:, 0])
    return {
        "rocks": len(site),
        "observed_m": want,
        "simulated_m": got,
        "error": got / want - 1.0,
        "error_95": np.stack([low[:3], high[:3]], axis=1),
        "mean_gap_m": float(pool[:, 0].mean() - seen[:, 0].mean()),
        "crps_m": crps(site, made),
        "width_observed_m": width(seen[:, 1]),
        "width_simulated_m": width(pool[:, 1]),
        "width_error": width(pool[:, 1]) / width(seen[:, 1]) - 1.0,
        "width_error_95": [float(low[3]), float(high[3])],
        # A median between two heaps of stops jumps where their shares change by a per cent.
        "beyond": {
            "edge_m": edge,
            "observed": float(np.mean(seen[:, 0] > edge)),
            "simulated": float(np.mean(pool[:, 0] > edge)),
        },
        "bands": bands([ranks(site, made)]),
        "left_the_terrain": float(made.left.mean()),
        "never_started": float(1.0 - made.started.mean()),
    }


def crps(site: Site, made: Simulated) -> float:
    """Mean over the rocks of the CRPS of the run-out, each against its own simulations (m)."""
    seen, rows = run_out(site, site.stops)[:, :1], run_out(site, made.stops)[..., :1]
    return float(np.mean(energy_scores(seen, np.swapaxes(rows, 0, 1))))


def _run_outs(site: Site, made: Simulated) -> tuple[FloatArray, FloatArray]:
    """Observed, and simulated ones (m); NaN where a block never started."""
    rows = run_out(site, made.stops)[..., 0]
    return run_out(site, site.stops)[:, 0], np.where(made.started, rows, np.nan)


def widest_gap(values: FloatArray) -> float:
    """Middle of the widest gap between the stops of the middle half (m)."""
    low, high = np.quantile(values, [0.25, 0.75])
    middle = np.sort(values[(values >= low) & (values <= high)])
    k = int(np.argmax(np.diff(middle)))
    return float(middle[k : k + 2].mean())


def ranks(site: Site, made: Simulated) -> FloatArray:
    """Share of its own simulations that stop before each observed rock, ties by halves.

    What left the terrain went on beyond its edge, and beyond every stop that was observed.
    """
    seen = run_out(site, site.stops)[:, :1]
    rows = np.where(made.left, np.inf, run_out(site, made.stops)[..., 0])
    shares: FloatArray = np.mean(rows < seen, axis=1) + 0.5 * np.mean(rows == seen, axis=1)
    return shares


def bands(ranks: list[FloatArray]) -> dict[str, Any]:
    """Of rocks, by ranks among their own simulations: how many lie in the central bands.

    With 95 % intervals (Clopper and Pearson), and the shares below and above the band.
    """
    rank = np.concatenate(ranks)
    report: dict[str, Any] = {}
    for band in BANDS:
        low, high = 0.5 - 0.5 * band, 0.5 + 0.5 * band
        inside = int(np.sum((rank >= low) & (rank <= high)))
        limits = binomtest(inside, rank.size).proportion_ci()
        report[f"{band:g}"] = {
            "inside": inside / rank.size,
            "inside_95": [limits.low, limits.high],
            "short": float(np.mean(rank < low)),
            "far": float(np.mean(rank > high)),
        }
    return report


def site_bands(site: Site, made: Simulated, out: Path, jobs: Jobs) -> dict[str, Any]:
    """Middle 80 % of the draws of median and 90 % quantile, and whether it holds the observed one.

    The program measures run-out along the path, the observed stops are known in plan: the limits
    are those along the path over the value with the classes as they are, times its plan distance.

    Parameters
    ----------
    made : Simulated
        With the classes as they are.
    out : Path
        As of runout_bands.
    jobs
        Worker processes.
    """
    each = {"release.rocks_per_point": max(1, round(BAND_COUNT / site.points))}
    config = load_config(site.case.config, each)
    seen = quantiles(run_out(site, site.stops)[:, 0])[1:]
    plain = quantiles(run_out(site, made.stops)[made.started, 0])[1:]
    found = runout_bands(config, BAND_DRAWS, out, jobs=jobs)
    rows = {}
    for name, band, observed, simulated in zip(("median", "q90"), found, seen, plain, strict=True):
        low, high = simulated * np.array([band.low, band.high]) / band.base
        rows[name] = {
            "observed_m": observed,
            "simulated_m": simulated,
            "band_m": [low, high],
            "holds": bool(low <= observed <= high),
        }
    return rows


def errors_of(site: Site, made: Simulated) -> FloatArray:
    """Relative errors of median, 90 % quantile and width."""
    rows = run_out(site, made.stops)[made.started]
    return _measures(rows) / _measures(run_out(site, site.stops)) - 1.0


def between(site: Site, other: Site) -> FloatArray:
    """The same, of the observed stops of some rocks against those of others."""
    one, two = (_measures(run_out(s, s.stops)) for s in (site, other))
    return one / two - 1.0


def _measures(rows: FloatArray) -> FloatArray:
    return np.array([*quantiles(rows[:, 0])[1:], width(rows[:, 1])])


def by_group(site: Site, made: Simulated) -> dict[str, Any]:
    """Run-out of each group of rocks: 10, 50 and 90 % (m)."""
    seen, rows = _run_outs(site, made)
    report: dict[str, Any] = {}
    for label, frame in site.rocks.reset_index().groupby("label"):
        own = frame.index.to_numpy()
        report[f"{site.name}: {label}"] = {
            "rocks": len(own),
            "mass_kg": quantiles(frame["mass_kg"].to_numpy(float))[1],
            "observed_m": quantiles(seen[own]),
            "simulated_m": np.nanquantile(rows[own], SHARES),
        }
    return report


def by_mass(site: Site, made: Simulated, seed: int = 1986) -> dict[str, Any]:
    """How much farther a rock of twice the mass goes (m), by a straight line through all rocks.

    Observed with a 95 % interval, the rocks drawn anew; simulated with that of single campaigns.
    """
    doubled = np.log2(site.rocks["mass_kg"].to_numpy(float))

    def slope(values: FloatArray, rocks: NDArray[np.int64]) -> float:
        return float(np.polyfit(doubled[rocks], values[rocks], 1)[0])

    seen, rows = _run_outs(site, made)
    draw = np.random.default_rng(seed)
    drawn = [slope(seen, draw.integers(0, len(seen), len(seen))) for _ in range(BOOTSTRAPS)]
    each = [slope(column, np.flatnonzero(np.isfinite(column))) for column in rows.T]
    return {
        "observed_m": slope(seen, np.arange(len(seen))),
        "observed_95": np.quantile(drawn, [0.025, 0.975]),
        "simulated_m": float(np.mean(each)),
        "simulated_95": np.quantile(each, [0.025, 0.975]),
    }


def repeated(site: Site, made: Simulated) -> dict[str, Any]:
    """Spread of the run-outs of one block released repeatedly from one place.

    Standard deviation about the mean of each block and place, pooled over the places of a block.
    Each campaign, one simulation of every run, is measured as the observed runs are: its 95 %
    interval says what so few runs can tell.
    """
    seen, rows = _run_outs(site, made)
    rocks = site.rocks.reset_index(drop=True)
    size = rocks.groupby(["label", "place"])["rock_id"].transform("size")
    report: dict[str, Any] = {}
    for label, frame in rocks[size >= FEWEST_RUNS].groupby("label"):
        if frame["rock_id"].nunique() < 2 or rocks.loc[frame.index, "mass_kg"].nunique() > 1:
            continue
        own, place = frame.index.to_numpy(), frame["place"].to_numpy()
        each = [_within(column[own], place) for column in rows.T]
        report[f"{site.name}: {label}"] = {
            "runs": len(own),
            "places": len(set(place)),
            "observed_m": _within(seen[own], place),
            "simulated_m": float(np.mean(each)),
            "simulated_95": np.quantile(each, [0.025, 0.975]),
            # Of each run; NaN of blocks that never started.
            "one_release_m": float(pd.DataFrame(rows[own]).std(axis=1).mean()),
        }
    return report


def _within(values: FloatArray, place: NDArray[np.int64]) -> float:
    """Standard deviation about the mean of each place."""
    frame = pd.DataFrame({"value": values, "place": place}).dropna()
    away = frame["value"] - frame.groupby("place")["value"].transform("mean")
    return float(np.sqrt((away**2).sum() / (len(frame) - frame["place"].nunique())))


def widths(
    sites: Mapping[str, Site], run: Callable[[Site, str, Mapping[str, Any]], Simulated]
) -> list[dict[str, Any]]:
    """Run-out and width against what turns the heading; ``run`` takes a name and settings."""
    rows = []
    for tilt, drift in itertools.product(TILTS, DRIFTS):
        row: dict[str, Any] = {"side_tilt_deg": tilt, "drift_deg": drift}
        settings = {f"engine.{name}": value for name, value in row.items()}
        for name, site in sites.items():
            found = score(site, run(site, f"widths_{tilt:g}_{drift:g}", settings))
            row[name] = {"error": found["error"], "width_error": found["width_error"]}
        rows.append(row)
    return rows


def summary(errors: Mapping[str, list[FloatArray]]) -> dict[str, Any]:
    """Of the errors over the halves: 10, 50, 90 % and the root of the mean square."""
    return {
        name: {
            key: {"quantiles": quantiles(own), "rms": float(np.sqrt(np.mean(own**2)))}
            for key, own in zip(("median", "q90", "width"), np.array(found).T, strict=True)
        }
        for name, found in errors.items()
    }


def runout_bands(
    config: Config | str | Path,
    draws: int,
    out: str | Path,
    *,
    jobs: Jobs = None,
    on_progress: OnProgress | None = None,
) -> tuple[SpreadBand, SpreadBand]:
    """Return bands of the median and of the 90 % quantile of the run-out, without any maps.

    ``out`` is a new folder, which stays empty: while it works, what was simulated is kept next to
    it, and the same call goes on from there.
    """
    config = configured(config, None)
    with staged_output(Path(out), False) as work:
        place = Workplace(work, jobs, on_progress, lambda _text: None)
        job = read_job(config, None, place.tell)
        known = read_ranges(job.run.table, config.ground.ranges)
        check_starts(job.run, job.planned.points, lambda: job.planned, config.release.file)
        lab = VariantLab(job, None, place, DRAWS)
        lab.total = 1
        spread, _, _ = draws_in(lab, known, draws, lab.found(Variant(BASE)))
    return spread.band(MEDIAN), spread.band(FAR)
