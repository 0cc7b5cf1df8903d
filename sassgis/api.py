"""Simulations, zones and profiles for programs and notebooks: inputs and results in memory.

Nothing is written. The functions make the configuration that a file would hold, and run it as the
commands do.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
import xarray as xr

import sassgis
from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.hazard.assess import Hazard, Rules, assess
from sassgis.hazard.sources import sampled_sources
from sassgis.inputs.config import configure, resolved
from sassgis.inputs.presets import read_preset
from sassgis.inputs.site_layers import are_names
from sassgis.runs.inputs import named_preset, ref_width, yearly_frequencies
from sassgis.runs.profile_run import profile_input, simulate_profile
from sassgis.runs.resumable_run import Simulation, Workplace, read_job, simulate_job
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.ground import GroundClass
from sassgis.settings.hazard_rules import ZoningSettings
from sassgis.settings.map_run import Config
from sassgis.settings.results import StopReason
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.path_sample import ProfileInput
from sassgis.simulation.workers import Jobs, OnProgress

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd
    from affine import Affine
    from matplotlib.axes import Axes
    from numpy.typing import NDArray
    from pyproj import CRS
    from shapely import Geometry

    from sassgis.outputs.frames import ProfileTables
    from sassgis.settings.settings import BarrierSettings, BlockSettings, StationSettings

    #: Heights: a file, an array that knows its place, or one with transform and system.
    Place = Affine | Sequence[float]
    Terrain: TypeAlias = (
        str | PathLike[str] | xr.DataArray | Grid | tuple[NDArray[Any], Place, CRS | str | None]
    )
    #: Points, lines or polygons.
    Layer: TypeAlias = str | PathLike[str] | gpd.GeoDataFrame | gpd.GeoSeries | Geometry

#: A mapping of keys to values, as a section of the configuration file.
Section = Mapping[str, object]

#: What messages about keys of a configuration call the parameters of the functions below.
_PARAMETERS = {
    r"terrain\.override_crs": 'terrain={"override_crs": True}',
    r"terrain\.crs": "crs",
    r"terrain\.dem": "dem",
    r"release\.file": "release",
    r"ground\.(file|default)": "ground",
    r"hazard\.preset": "rules",
    r"hazard\.ref_width_m": "ref_width_m",
    r"run\.seed": "seed",
    r"profile\.file": "line",
    r"profile\.start_m": "start_m",
    r"profile\.rocks": "n_blocks",
    r"sections \[\[(\w+)\]\]: ": "",
    r"at least one \[\[blocks\]\]": 'at least one mapping, as {"volume_m3": (0.5, 2)}',
    r"missing (key|section)": "missing",
}


@contextmanager
def _in_parameters() -> Iterator[None]:
    """Have errors speak of parameters, not of keys of a configuration that nobody wrote."""

    def worded(text: object) -> object:
        if isinstance(text, str):
            for key, parameter in _PARAMETERS.items():
                text = re.sub(rf"(?<![\w./]){key}", parameter, text)
        return text

    try:
        yield
    except InputError as error:
        texts = {
            key: worded(getattr(error, key)) for key in ("problem", "field", "found", "expected")
        }
        raise type(error)(**error.parts(**texts)) from None


def simulate(
    dem: Terrain | Config,
    release: Layer | Section | None = None,
    *,
    blocks: Section | BlockSettings | Sequence[Section | BlockSettings] | None = None,
    ground: Layer | GroundClass | Section | None = None,
    barriers: Sequence[Section | BarrierSettings] | None = None,
    stations: Sequence[Section | StationSettings] | None = None,
    crs: str | None = None,
    rules: str = "ch-so",
    ref_width_m: float | None = None,
    seed: int = 1,
    jobs: Jobs = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
    **sections: Section | Sequence[Section],
) -> xr.Dataset:
    """Simulate blocks from release areas over a terrain model.

    Parameters
    ----------
    dem : path, DataArray, or (array, affine transform, coordinate system)
        Heights (m), shape (n_rows, n_cols), on square cells of a projected system in metres; NaN
        where unknown; the transform is that of rasterio, the first row lies in the north. Or a
        Config, which has all.
    release : path, GeoDataFrame, GeoSeries, geometry, or mapping
        Polygons, lines or points where blocks start; or the section ``[release]``, as
        ``{"file": frame, "spacing_m": 10}``. A column ``name`` of a GeoDataFrame, if its names
        differ, names the areas unless ``name_field`` is another.
    blocks : mapping, or sequence of mappings
        Block scenarios: sections ``[[blocks]]``, as ``{"volume_m3": (0.5, 2), "onset_frequency":
        0.1}``. Zones need the onset frequency, in blocks a year of each release area.
    ground : str, GroundClass, path, GeoDataFrame, or mapping, optional
        A ground class for all of the terrain, polygons with a column ``class``, or the section
        ``[ground]``.
    barriers, stations : sequence of mappings, optional
        Sections ``[[barriers]]`` and ``[[stations]]``.
    crs : str, optional
        Coordinate system, where the terrain model states none: "EPSG:2056", or "local".
    rules : str
        Preset of the zones, by name or as a TOML file: energies are counted for it.
    ref_width_m : float, optional
        Reference width of hazard curves (m). Without it there are no counts for zones.
    seed : int
        The same seed gives the same blocks.
    jobs, on_progress, say
        As for sassgis.run; default: all cores.
    **sections
        Further sections of the configuration, as ``engine={"readings": "1986"}``.

    Returns
    -------
    xarray.Dataset
        Maps by their names, of dimensions (y, x) with the centres of the cells, from the north; NaN
        where no block arrives: ``reach_probability`` (0 to 1), ``energy_q95`` (kJ),
        ``passing_height_q95`` (m), ``speed_q95`` (m/s), ``stops``, ``terrain`` (m) and more, each
        with its unit, meaning and denominator; settings, seed and warnings among the attributes.
        With ``ref_width_m`` also the counts that ``zones`` and ``hazard_maps`` are made of.

    Raises
    ------
    ConfigError, InputError
        An input or a setting cannot be used.

    Examples
    --------
    >>> import numpy as np, sassgis
    >>> from affine import Affine
    >>> from shapely import Point
    >>> row, _ = np.mgrid[0:60, 0:40]
    >>> heights = 1000.0 - 5.0 * 0.7 * np.minimum(row, 40)  # 35 degrees, then flat
    >>> place = Affine(5.0, 0.0, 2_700_000.0, 0.0, -5.0, 1_150_000.0)
    >>> ds = sassgis.simulate(
    ...     (heights, place, "EPSG:2056"),
    ...     Point(2_700_100, 1_149_960).buffer(10),
    ...     blocks={"volume_m3": (0.5, 2.0), "onset_frequency": 0.2},
    ...     ground="talus",
    ...     ref_width_m=10.0,
    ... )
    >>> ds.energy_q95.attrs["units"], ds.energy_q95.shape
    ('kJ', (60, 40))
    >>> zones = sassgis.zones(ds)
    >>> sorted(set(zones["hazard_level"])) != []
    True
    """
    if isinstance(dem, Config):
        return _simulated(dem, jobs, on_progress, say)
    with _in_parameters():
        hazard: Section = {"preset": rules, "ref_width_m": ref_width_m}
        config = configure(
            terrain={"dem": _input(dem, "dem"), "crs": crs} | _popped(sections, "terrain"),
            release=_release_section(release),
            ground=_ground_section(ground),
            blocks=_named_blocks(blocks),
            barriers=barriers or (),
            stations=stations or (),
            hazard={**hazard, **_popped(sections, "hazard")},
            run={"seed": seed} | _popped(sections, "run"),
            **sections,
        )
        return _simulated(config, jobs, on_progress, say)


def _simulated(
    config: Config, jobs: Jobs, on_progress: OnProgress | None, say: Callable[[str], None] | None
) -> xr.Dataset:
    from sassgis.outputs.layers.maps import map_layers, terrain_layer
    from sassgis.outputs.map_dataset import maps_dataset, with_sources
    from sassgis.simulation.accumulators import sample_of

    tell = say or (lambda _text: None)
    job = read_job(config, None, tell)
    if config.hazard.ref_width_m is not None:
        width = ref_width(config, job.run.grid.cell_size)
        thresholds = named_preset(config).thresholds_kj
        job = replace(job, run=replace(job.run, thresholds_kj=thresholds, ref_width_m=width))
    done = simulate_job(job, Workplace(None, jobs, on_progress, tell))
    run, progress = done.run, done.progress
    layers = map_layers(
        progress.sums, run.grid.shape, sample_of(run, progress), bins_of(run).edges,
        run.grid.cell_size, config.output.energy_classes_kj,
    )  # fmt: skip
    facts = {
        "title": config.project.name,
        "source": f"sassgis {sassgis.__version__}, SASS (Bozzolo and Pamini, 1986)",
        "seed": run.seed,
        "blocks": int(progress.reasons.sum()),
        **{f"blocks_{r.name.lower()}": int(progress.reasons[r]) for r in StopReason},
        "blocks_per_point": run.release.rocks_per_point,
        "random_points": int(run.release.placement == "random"),
        "release_spacing_m": run.release.spacing_m,
        "ref_width_m": run.ref_width_m or None,
        "settings": json.dumps(resolved(config)),
        "warnings": "\n".join(done.warnings),
    }
    maps = maps_dataset((*layers, terrain_layer(run.grid)), run.grid, facts)
    if config.hazard.ref_width_m is None:
        return maps
    sampled = sampled_sources(run, progress, _frequencies(config, done))
    return with_sources(maps, sampled, bins_of(run).threshold, run.ref_width_m)


def _frequencies(config: Config, done: Simulation) -> dict[tuple[str, str], float]:
    """Onset frequencies of the sources; NaN for all where one scenario has none."""
    stated = all(onset.frequency is not None for onset in config.onsets.values())
    if stated or config.hazard.frequencies is not None:
        return yearly_frequencies(config, done.run.areas)
    return {(a.name, s): np.nan for a in done.run.areas for s in a.scenarios}


def _input(value: object, name: str) -> object:
    """Return an input that messages call as the parameter is called; None for none."""
    from sassgis.inputs.in_memory import as_input

    return None if value is None else as_input(value, name)


def _popped(sections: dict[str, Section | Sequence[Section]], name: str) -> dict[str, object]:
    """Take a section out of those that were given besides the parameters."""
    return dict(cast(Section, sections.pop(name, {})))


def _release_section(release: Layer | Section | None) -> Section:
    section = dict(release) if isinstance(release, Mapping) else {"file": release}
    file = section.get("file")
    columns = getattr(file, "columns", ())
    if "name_field" not in section and "name" in columns and are_names(file["name"]):  # type: ignore[index]
        section["name_field"] = "name"
    return section | {"file": _input(file, "release")}


def _ground_section(ground: Layer | GroundClass | Section | None) -> Section:
    if ground is None:
        return {}
    if isinstance(ground, Mapping):
        return ground
    if isinstance(ground, GroundClass):
        return {"classes": [ground], "default": ground.name}
    # A text with a suffix is a file; the name of a class has none.
    if isinstance(ground, str) and not Path(ground).suffix:
        return {"default": ground}
    return {"file": _input(ground, "ground")}


def _named_blocks(
    blocks: Section | BlockSettings | Sequence[Section | BlockSettings] | None,
) -> Section | BlockSettings | Sequence[Section | BlockSettings]:
    """Block scenarios; one by itself needs no name."""
    return {"name": "blocks"} | dict(blocks) if isinstance(blocks, Mapping) else blocks or ()


def _assessed(
    maps: xr.Dataset, rules: str | PathLike[str] | None, confidence: float, zoning: Section
) -> tuple[Rules, Grid, Hazard]:
    """The rules with which zones are drawn, the grid, and what the counts say of the hazard."""
    if not 0.0 < confidence < 1.0:
        raise InputError(
            "is out of range", field="confidence", found=confidence,
            expected="a number above 0 and below 1",
        )  # fmt: skip
    from sassgis.inputs.dataset_sources import dataset_grid, dataset_sources
    from sassgis.outputs.qgis.layout import drawing_on_sheet

    grid = dataset_grid(maps)
    given = rules or json.loads(maps.attrs["settings"])["hazard"]["preset"]
    preset = read_preset(given, "rules")
    sampled, energies = dataset_sources(maps, preset)
    frequencies = {(s.source.area, s.source.scenario): s.source.frequency for s in sampled}
    width, spacing = (float(maps.attrs[name]) for name in ("ref_width_m", "release_spacing_m"))
    drawn, metres = ZoningSettings(**cast(dict[str, Any], zoning)), (width, spacing, grid.cell_size)
    own = Rules(
        preset=preset,
        frequencies=frequencies,
        placed=PlacedObjects((), ()),
        vulnerability=None,
        zones=drawn.drawing(preset.sheet, *metres),
        ref_width_m=width,
        notices=(),
    )
    found = assess(
        own, grid, energies, sampled, None, confidence=confidence, by_source=False,
        drawing_of=partial(drawing_on_sheet, drawn, preset.sheet, metres),
    )  # fmt: skip
    return own, grid, found.hazard


def zones(
    ds: xr.Dataset,
    rules: str | PathLike[str] | None = None,
    *,
    confidence: float = 0.95,
    **zoning: float | str | bool,
) -> gpd.GeoDataFrame:
    """Hazard zones from the dataset of a simulation.

    Parameters
    ----------
    ds : xarray.Dataset
        Of ``simulate`` with ``ref_width_m``. Onset frequencies are its variable
        ``onset_frequency``, which may be changed.
    rules : str, optional
        Preset with intensities, return periods and levels: its name, or a TOML file. Default: that
        of the simulation.
    confidence : float
        Of the interval that decides whether a level is statistically certain.
    **zoning
        Keys of the section ``[zones]``, as ``min_area_m2=500``.

    Returns
    -------
    GeoDataFrame
        A row for each zone: its hazard level, what governs it, how certain it is; columns as in
        the layer ``hazard_zones`` of a written result.

    Raises
    ------
    InputError, ConfigError
        The dataset has no counts for these rules, or a source no onset frequency.
    """
    return _zone_frame(*_assessed(ds, rules, confidence, zoning), confidence)


def _zone_frame(own: Rules, grid: Grid, hazard: Hazard, confidence: float) -> gpd.GeoDataFrame:
    from sassgis.outputs.layers.zones import hazard_zones

    return hazard_zones(hazard, own.preset, grid, own.ref_width_m, confidence).frame


def hazard_maps(
    ds: xr.Dataset, rules: str | PathLike[str] | None = None, *, confidence: float = 0.95
) -> xr.Dataset:
    """Make maps of level, intensity, energy and frequency by return period, with their certainty.

    Parameters and errors are those of ``zones``.

    Returns
    -------
    xarray.Dataset
        ``hazard_level``, ``intensity_<years>``, ``energy_at_return_period_e<years>``,
        ``return_period_t<kJ>``, ``frequency_...``, ``confidence_...``.
    """
    from sassgis.outputs.layers.hazard_maps import hazard_layers
    from sassgis.outputs.map_dataset import maps_dataset

    own, grid, hazard = _assessed(ds, rules, confidence, {})
    layers = hazard_layers(
        hazard.curves, hazard.chances, own.preset, grid, own.ref_width_m,
        return_periods=own.preset.return_periods, confidence=confidence,
    )  # fmt: skip
    facts = {key: ds.attrs.get(key) for key in ("title", "source", "seed", "ref_width_m")}
    shares = {name: getattr(hazard, name) for name in ("changed_share", "uncertain_share")}
    return maps_dataset(layers, grid, facts | {"preset": own.preset.name} | shares)


@xr.register_dataset_accessor("sassgis")  # type: ignore[no-untyped-call]
class Drawn:
    """What a dataset of ``simulate`` draws: ``ds.sassgis``."""

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def plot_zones(
        self,
        rules: str | PathLike[str] | None = None,
        *,
        ax: Axes | None = None,
        confidence: float = 0.95,
        **zoning: float | str | bool,
    ) -> Axes:
        """Draw hazard zones in the colours of the preset, over the relief.

        Parameters and errors are those of ``zones``; ``ax`` is where to draw, default: a new
        figure of matplotlib.
        """
        from sassgis.report.figures.map_figure import draw_zones

        own, grid, hazard = _assessed(self._ds, rules, confidence, zoning)
        frame = _zone_frame(own, grid, hazard, confidence)
        return draw_zones(frame, own.preset.levels, grid, ax)


def profile(
    line: pd.DataFrame | Layer | Config | None = None,
    *,
    blocks: Section | BlockSettings | Sequence[Section | BlockSettings] | None = None,
    dem: Terrain | None = None,
    point: tuple[float, float] | None = None,
    ground: Layer | GroundClass | Section | None = None,
    barriers: Sequence[Section | BarrierSettings] | None = None,
    stations: Sequence[Section | StationSettings] | None = None,
    crs: str | None = None,
    start_m: float | tuple[float, float] | None = None,
    n_blocks: int | None = None,
    seed: int = 1,
    **sections: Section | Sequence[Section],
) -> ProfileTables:
    """Simulate blocks down one profile.

    Parameters
    ----------
    line : DataFrame, path, or line; optional
        A table with the columns ``s_m``, ``z_m`` and, if wanted, ``ground``. With ``dem`` a line on
        the map, drawn downwards: a shapely LineString, a GeoDataFrame or a vector file. Or a
        Config, which has all but the point.
    blocks, ground, barriers, stations, crs, seed, **sections
        As of ``simulate``. Without ``dem`` stations and barriers have ``chainage_m``.
    dem : optional
        Terrain from which the profile is cut, as of ``simulate``.
    point : (x, y), optional
        With ``dem`` and without ``line``: where the fall line starts.
    start_m : float or (low, high), optional
        Chainages between which blocks start (m); default: the first of the profile.
    n_blocks : int, optional
        Blocks of each block scenario; default: 100.

    Examples
    --------
    >>> import pandas as pd, sassgis
    >>> slope = pd.DataFrame({"s_m": [0, 200, 500], "z_m": [170, 0, -10]})
    >>> tables = sassgis.profile(
    ...     slope,
    ...     blocks={"volume_m3": 1.0},
    ...     ground="talus",
    ...     stations=[{"name": "road", "chainage_m": 230}],
    ... )
    >>> len(tables.blocks), tables.passages["control_line"].unique().tolist()
    (100, ['road'])
    """
    from sassgis.inputs.in_memory import as_input

    if isinstance(line, Config):
        return _tables(line, profile_input(line, point=point), n_blocks)
    with _in_parameters():
        given = None if line is None else as_input(line, "line")
        own: Section = {"rocks": n_blocks, "start_m": start_m}
        config = configure(
            terrain={"dem": _input(dem, "dem"), "crs": crs} | _popped(sections, "terrain"),
            profile={
                **own,
                **({"file": given} if dem is None else {}),
                **_popped(sections, "profile"),
            },
            blocks=_named_blocks(blocks),
            ground=_ground_section(ground),
            barriers=barriers or (),
            stations=stations or (),
            run={"seed": seed} | _popped(sections, "run"),
            **sections,
        )
        drawn = None if dem is None else given
        return _tables(config, profile_input(config, point=point, line=drawn), n_blocks)


def _tables(config: Config, found: ProfileInput, n_blocks: int | None) -> ProfileTables:
    from sassgis.outputs.frames import profile_tables

    result = simulate_profile(config, found, rocks=n_blocks)
    return profile_tables(result, [b.name for b in config.blocks])
