"""The layers of the map, from the sums per cell."""

from __future__ import annotations

import numpy as np

from sassgis.hazard.statistics import MapSums, Sample, quantiles, reach_probability
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.results import Band, RasterLayer

# Breaks start at 0, as nothing that is mapped is negative: no class without cells, and not the
# palest colour of a ramp, which would be lost on the relief.
#: Probabilities of the quantiles that are mapped.
PROBABILITIES = (0.50, 0.90, 0.95, 0.99)


def _on_map(values: FloatArray, cells: IntArray, shape: tuple[int, int]) -> np.ndarray:
    out = np.full(shape[0] * shape[1], np.nan, np.float32)
    out[cells] = values.astype(np.float32)
    return out.reshape(shape)


def map_layers(
    sums: MapSums,
    shape: tuple[int, int],
    sample: Sample,
    edges: dict[str, FloatArray],
    cell_size: float,
    energy_classes_kj: tuple[float, ...] = (30.0, 300.0),
) -> tuple[RasterLayer, ...]:
    """Layers of all that is known per cell.

    Parameters
    ----------
    sums : MapSums
    shape : (n_rows, n_cols)
    sample : Sample
    edges : dict
        Edges of the histograms "energy" (kJ), "height" (m) and "speed" (m/s).
    cell_size : float
        Side of a cell: the reference width of the reach probability (m).
    energy_classes_kj : tuple of float
        Limits of the energy classes in the legend.

    Returns
    -------
    tuple of RasterLayer
        Cells that no rock comes to are NaN.
    """
    cells = sums.cells
    reach = sums.column("reach").astype(np.int64)
    stops = sums.column("stops").astype(np.int64)
    largest = {n: sums.column(f"{n}_max").astype(np.float64) for n in ("energy", "height", "speed")}

    def band(name: str, description: str, unit: str, values: FloatArray) -> Band:
        return Band(name, description, unit, _on_map(np.asarray(values), cells, shape))

    came = reach > 0

    def where_reached(values: FloatArray) -> FloatArray:
        return np.where(came, values, np.nan)

    probability, error = reach_probability(
        reach, sums.column("reach_square").astype(np.int64), sample
    )
    mean = sums.column("energy_sum").astype(np.float64) * 1e-3 / np.maximum(reach, 1)
    width = f"Reference width {cell_size:.4g} m (one cell)."
    once = "Each rock counts once per cell, with the largest value that it has there."

    def quantile_bands(name: str, what: str, unit: str) -> list[Band]:
        values = quantiles(
            sums.column(name).astype(np.int64), edges[name], PROBABILITIES, largest[name]
        )
        return [
            band(
                f"q{100 * p:.0f}",
                f"{what}, {100 * p:.0f} % quantile of the rocks that reach the cell",
                unit,
                where_reached(v),
            )
            for p, v in zip(PROBABILITIES, values, strict=True)
        ]

    energy = quantile_bands("energy", "Kinetic energy (translation + rotation)", "kJ")
    height = quantile_bands("height", "Passing height above the resting position", "m")
    speed = quantile_bands("speed", "Speed of the centre", "m/s")
    q95 = PROBABILITIES.index(0.95)

    def first(bands: list[Band], i: int) -> tuple[Band, ...]:
        return (bands[i], *bands[:i], *bands[i + 1 :])

    return (
        RasterLayer(
            "reach_probability",
            "Reach probability",
            f"Share of all {sample.rocks} rocks released that come into the cell. {width} "
            + (
                "Standard error with the release points as a random sample."
                if sample.random_points
                else "Standard error with the release points fixed: rocks are the sample."
            ),
            (
                band("reach", "Reach probability", "1", where_reached(probability)),
                band(
                    "standard_error",
                    "Sampling standard error of the reach probability",
                    "1",
                    where_reached(error),
                ),
            ),
            (0.0, 0.0001, 0.001, 0.01, 0.03, 0.1, 0.3),
            "plasma_r",
        ),
        RasterLayer(
            "passages",
            "Rocks passing",
            f"Number of rocks that come into the cell. {width}",
            (
                band(
                    "passages",
                    "Rocks that come into the cell",
                    "rocks",
                    where_reached(reach.astype(np.float64)),
                ),
            ),
            (0, 10, 100, 1000, 10000),
            "BuPu",
        ),
        RasterLayer(
            "energy",
            "Kinetic energy, 95 % quantile (kJ)",
            f"Translation and rotation. {once} {width} Quantiles from a histogram of 20 bins a "
            "decade (12 % of the value), 30 and 300 kJ among the edges; mean and maximum exact.",
            (
                *first(energy, q95),
                band("mean", "Kinetic energy, mean of the rocks", "kJ", where_reached(mean)),
                band("max", "Kinetic energy, largest", "kJ", where_reached(largest["energy"])),
            ),
            (0.0, *energy_classes_kj),
            "YlOrRd",
        ),
        RasterLayer(
            "passing_height",
            "Passing height, 95 % quantile (m)",
            "Vertical distance from the ground to the centre, less the resting height. "
            f"{once} Quantiles from a histogram of 0.1 m bins up to 2 m, 6 % beyond.",
            (
                *first(height, q95),
                band("max", "Passing height, largest", "m", where_reached(largest["height"])),
            ),
            (0.0, 0.5, 1.0, 2.0, 4.0, 8.0),
            "YlGnBu",
        ),
        RasterLayer(
            "speed",
            "Speed, 95 % quantile (m/s)",
            f"Speed of the centre. {once} Quantiles from a histogram of 0.5 m/s bins up to "
            "20 m/s, 1 m/s beyond.",
            (
                *first(speed, q95),
                band("max", "Speed, largest", "m/s", where_reached(largest["speed"])),
            ),
            (0.0, 5.0, 10.0, 15.0, 20.0, 30.0),
            "RdPu",
        ),
        RasterLayer(
            "stops",
            "Rocks that stop",
            "Number of rocks that come to rest in the cell or are stopped by a barrier there. "
            "Rocks that never started are not among them.",
            (
                band(
                    "stops",
                    "Rocks that end in the cell",
                    "rocks",
                    np.where(stops > 0, stops, np.nan),
                ),
            ),
            (0, 3, 10, 30, 100),
            "Blues",
        ),
    )
