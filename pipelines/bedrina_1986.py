"""Do a wall and two nets protect the road at Bedrina 1, as the authors of 1986 found?

    python pipelines/bedrina_1986.py [FOLDER] -o OUT

FOLDER holds ``config_before.toml``, ``config_after.toml`` and ``config_restart.toml``, in which
blocks start from rest again below the nets; default: the sample slope, which resembles Bedrina 1
qualitatively. Writes both results, a comparison of the trajectories
like Fig. 13 of Bozzolo and Pamini (1986), histograms at the cameras like their Fig. 12 and of the
energy, ``hits.csv`` with the rocks on the road, and ``ranges.csv`` with the share of the rocks that
lie within the ranges of Fig. 12.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sassgis.errors import SassgisError
from sassgis.outputs.frames import write_table
from sassgis.outputs.site_template import sample_folder
from sassgis.report.figures import profile_figure, save, station_figure
from sassgis.report.map_report import profile_panel
from sassgis.runs.profile_run import run_profile
from sassgis.settings.results import Histogram
from sassgis.simulation.control_lines import trimmed
from sassgis.simulation.path_sample import ProfileResult, arrivals, line_number

#: Quantities of Fig. 12 with their unit and the range in which the paper's histograms mostly lie.
RANGES = {"speed_mps": ("m/s", 15.0), "rotation_hz": ("Hz", 5.0), "height_m": ("m", 5.0)}
CAMERAS = ("camera 2", "camera 3")


def _passages(result: ProfileResult, control_line: str, quantity: str) -> NDArray[Any]:
    own = result.passages["control_line"] == line_number(result, control_line)
    values: NDArray[Any] = result.passages[quantity][own]
    return values


def passage_histogram(
    result: ProfileResult, control_line: str, quantity: str, edges: Sequence[float], unit: str
) -> Histogram:
    """Return the histogram of one quantity of the passages at a station or barrier, by its name."""
    values = _passages(result, control_line, quantity)
    counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
    return Histogram(np.asarray(edges, float), counts.astype(np.int64), unit)


def share_within(
    result: ProfileResult, control_line: str, quantity: str, low: float, high: float
) -> tuple[int, float]:
    """Count passages at a station or barrier, and their share between two limits (inclusive)."""
    values = _passages(result, control_line, quantity)
    share = float(((values >= low) & (values <= high)).mean()) if values.size else float("nan")
    return int(values.size), share


def main(argv: list[str] | None = None) -> None:
    """Run both slopes and write figures and tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=sample_folder() / "bedrina")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--overwrite", action="store_true")
    given = parser.parse_args(argv)
    results = {
        name: run_profile(
            given.folder / f"config_{name}.toml", given.output / name, overwrite=given.overwrite
        ).found
        for name in ("before", "after", "restart")
    }
    hits = pd.DataFrame(
        [
            {"slope": name, "rocks": r.rocks.size, "on_road": arrivals(r, "road"),
             "share": arrivals(r, "road") / r.rocks.size}
            for name, r in results.items()
        ]
    )  # fmt: skip
    rows = []
    for camera in CAMERAS:
        for quantity, (unit, high) in RANGES.items():
            n, share = share_within(results["before"], camera, quantity, 0.0, high)
            rows.append(
                {"station": camera, "quantity": quantity, "unit": unit, "low": 0.0, "high": high,
                 "rocks": n, "share_within": share}
            )  # fmt: skip
    ranges = pd.DataFrame(rows)
    write_table(given.output / "hits.csv", [hits])
    write_table(given.output / "ranges.csv", [ranges])
    panels = [
        profile_panel(r, f"{name}: {arrivals(r, 'road')} of {r.rocks.size} rocks reach the road")
        for name, r in results.items()
    ]
    save(profile_figure(panels), given.output / "comparison.png")
    sums = results["before"].control_lines
    names = [line.name for line in sums.control_lines]
    for camera in CAMERAS:
        bins = [
            passage_histogram(
                results["before"], camera, q, np.linspace(0.0, 2.0 * high, 21).tolist(), unit
            )
            for q, (unit, high) in RANGES.items()
        ]
        energy = trimmed(sums.distribution(names.index(camera), "energy_kj").histogram)
        figure = station_figure(camera, *bins, energy, n=results["before"].rocks.size)
        save(figure, given.output / f"{camera.replace(' ', '_')}.png")
    print(hits.to_string(index=False))
    print(ranges.to_string(index=False))


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
