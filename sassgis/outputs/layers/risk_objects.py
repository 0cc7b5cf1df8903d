"""Exposed objects as layers of the GeoPackage, and their risk as tables and layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import geopandas as gpd
import pandas as pd
import shapely

from sassgis.files.vector_layer import VectorLayer, described_layer
from sassgis.hazard import risk
from sassgis.hazard.object_values import ObjectEstimate, ObjectValues
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.languages import phrase
from sassgis.settings.results import rounded
from sassgis.settings.styles import FieldInfo, StyleClass, Symbol, VectorStyle, class_colours

#: No colours of hazard levels, under which objects would not be seen.
_RAMP = "RdPu"
_NOTHING_COLOUR = "#8c8c8c"
#: Less than any risk, and more than 0: what has none is a separate class.
_LEAST = 1e-30
_RISK_LIMITS = (1e-6, 1e-5, 1e-4, 1e-3)
_LOSS_LIMITS = (1.0, 10.0, 100.0, 1000.0, 10_000.0)

#: Dimension of the objects that a kind of symbol is for.
_DIMENSION = {"fill": 2, "line": 1, "marker": 0}
_COLOUR = "#5a4632"
_EXPOSED = {
    "exposed_areas": Symbol("fill", _COLOUR, outline="#ffffff", outline_mm=0.15),
    "exposed_lines": Symbol("line", _COLOUR, size_mm=0.8),
    "exposed_points": Symbol("marker", _COLOUR, size_mm=2.4, outline="#ffffff", shape="diamond"),
}
_RISK = {
    "risk_objects": Symbol("fill", "#808080", opacity=0.9, outline="#333333", outline_mm=0.2),
    "risk_lines": Symbol("line", "#808080", size_mm=1.6),
    "risk_points": Symbol("marker", "#808080", size_mm=3.0, outline="#333333", shape="diamond"),
}
_WORDS = {
    "hits": ("hits", "1/year", "blocks that reach the object, at any height above the ground"),
    "property_loss": ("loss of the object itself", "{}/year", ""),
    "vehicle_loss": ("loss of vehicles", "{}/year", ""),
    "loss": ("loss", "{}/year", "the object itself and vehicles"),
    "vehicles_hit": (
        "vehicles hit",
        "1/year",
        "by falling blocks; collisions with deposited blocks are excluded",
    ),
    "deaths": ("deaths", "1/year", "expected number: the collective risk"),
    "individual_risk": (
        "individual risk of death",
        "1/year",
        "of one person present; on a road, of one passing user",
    ),
}
_SE = "upper bound of the sampling error; none of the model or of the onset frequency"
_LIMITS = "from the sampling of blocks only, without errors of the model or the onset frequency"


def exposed_layers(
    placed: PlacedObjects, crs: str, values: ObjectValues | None = None
) -> list[VectorLayer]:
    """Return layers of areas, lines and points that have objects; a road is one object.

    With ``values`` they have those of all blocks that reach the object; a road has those of its
    stretch with the most energy.
    """
    whole = {"name": [t.whole for t in placed.objects], "kind": [t.kind for t in placed.objects]}
    frame = gpd.GeoDataFrame(whole, geometry=list(placed.geometries), crs=crs or None)
    frame = frame.dissolve(["name", "kind"], sort=False).reset_index()[["name", "kind", "geometry"]]
    # A name is written along a whole road, which its stretches are too short for.
    stretches = frame.geom_type == "MultiLineString"
    frame.geometry = frame.geometry.where(~stretches, frame.geometry.line_merge())
    shown, stretches = ["name", "kind"], list[int]()
    if values is not None:
        stretches = [values.stretch_of(placed.wholes[name]) for name in frame["name"]]
    for name, estimate in value_columns(values).items():
        for column, numbers in estimate.columns(name).items():
            frame[column] = [rounded(v, 4) for v in numbers[stretches].tolist()]
            shown.append(column)
    dimension = shapely.get_dimensions(frame.geometry.to_numpy())
    fields, layers = _value_fields(values), []
    for name, symbol in _EXPOSED.items():
        own = frame[dimension == _DIMENSION[symbol.kind]]
        if len(own):
            style = VectorStyle(symbol, label_column="name")
            columns = own[shown].reset_index(drop=True)
            shapes = list(own.geometry)
            layers.append(described_layer(name, columns, shapes, crs, style, fields=fields))
    return layers


def risk_frames(
    table: risk.RiskTable, currency: str, values: ObjectValues | None = None
) -> dict[str, pd.DataFrame]:
    """Return the tables of a run by the stem of their files; the currency is a separate column.

    ``risk_objects``: a row per object, with ``values`` where they are given. ``risk_sources``: a
    row per object and source that hits it. ``risk_total``: sums by road, kind, source, and over
    all; each is the correctly rounded sum of its rows in the other tables.
    """
    hits = [f"hits_{code}" for code in table.intensities]
    who = ["name", "kind", "part_of"]
    per_year = _with_errors([*hits, *risk.QUANTITIES])
    objects = [*who, "from_m", "length_m", "value", "value_per_m", "persons", "presence"]
    objects += ["traffic_per_day", *per_year, "hits_of_one_rock_per_year"]
    sources = [*who, "area", "scenario", *(f"{name}_per_year" for name in hits)]
    sources += [*_with_errors(risk.QUANTITIES), "share_of_loss", "share_of_deaths"]
    totals = ["scope", "name", "objects"]
    for q in risk.ADDITIVE:
        totals += [f"{q}_per_year", f"{q}_per_year_se", f"{q}_per_year_se_apart"]
    totals.append("individual_risk_largest_per_year")
    frames = {
        "risk_objects": pd.DataFrame(risk.object_rows(table), columns=objects),
        "risk_sources": pd.DataFrame(risk.source_rows(table), columns=sources),
        "risk_total": pd.DataFrame(risk.total_rows(table), columns=totals),
    }
    for name, estimate in value_columns(values).items():
        for limit, own in estimate.columns(name).items():
            frames["risk_objects"][limit] = [rounded(v, 4) for v in own.tolist()]
    for frame in frames.values():
        frame["currency"] = currency
    return frames


def value_columns(values: ObjectValues | None) -> dict[str, ObjectEstimate]:
    """Return energies and heights at the objects, by the names of their columns."""
    if values is None:
        return {}
    return {
        "energy_q95_kj": values.energy_q95_kj,
        **{f"energy_{years:g}y_kj": own for years, own in values.energy_kj.items()},
        "height_q95_m": values.height_q95_m,
    }


def risk_tables(
    table: risk.RiskTable,
    without: risk.RiskTable | None,
    currency: str,
    values: tuple[ObjectValues | None, ObjectValues | None] = (None, None),
) -> dict[str, pd.DataFrame]:
    """Return tables of a run with barriers, and those of ``without`` them if any."""
    frames = risk_frames(table, currency, values[0])
    if without is not None:
        before = risk_frames(without, currency, values[1])
        frames |= {f"{name}_without_barriers": frame for name, frame in before.items()}
    return frames


def _with_errors(quantities: Sequence[str]) -> list[str]:
    return [name for q in quantities for name in (f"{q}_per_year", f"{q}_per_year_se")]


def risk_vectors(
    table: risk.RiskTable,
    placed: PlacedObjects,
    crs: str,
    currency: str,
    values: ObjectValues | None = None,
) -> list[VectorLayer]:
    """Return ``risk_objects`` (polygons), ``risk_lines`` and ``risk_points``, those that there are.

    Colours show the individual risk where people are at stake (on roads: the deaths on each
    stretch), else the loss.
    """
    if placed.objects != table.objects:
        raise ValueError("the places are not those of the objects of the table")
    frame = risk_frames(table, currency, values)["risk_objects"].drop(columns="currency")
    fields = _fields(table, currency) | _value_fields(values)
    layers = []
    for name, symbol in _RISK.items():
        dimension = _DIMENSION[symbol.kind]
        own = [i for i, g in enumerate(placed.geometries) if shapely.get_dimensions(g) == dimension]
        if not own:
            continue
        rows = frame.iloc[own].reset_index(drop=True)
        shown = "individual_risk" if dimension != 1 else "deaths"
        if not (rows["deaths_per_year"] > 0.0).any():
            shown = "loss"
        shapes = [placed.geometries[i] for i in own]
        style = _style(symbol, shown, currency)
        words = {"shown": _words(shown, currency).label, "sources": len(table.sources)}
        words["currency"] = currency
        layers.append(described_layer(name, rows, shapes, crs, style, fields=fields, **words))
    return layers


def _words(quantity: str, currency: str) -> FieldInfo:
    alias, unit, text = _WORDS[quantity]
    return FieldInfo(alias, phrase(unit, currency), text)


def _fields(table: risk.RiskTable, currency: str) -> dict[str, FieldInfo]:
    """Describe the columns of numbers per year."""
    fields = {}
    described = {
        f"hits_{c}": FieldInfo(phrase("hits of intensity {}", c), "1/year")
        for c in table.intensities
    }
    described |= {q: _words(q, currency) for q in risk.QUANTITIES}
    for name, info in described.items():
        fields[f"{name}_per_year"] = info
        error = phrase("{}, standard error", phrase(info.alias))
        fields[f"{name}_per_year_se"] = FieldInfo(error, info.unit, _SE)
    return fields


def _value_fields(values: ObjectValues | None) -> dict[str, FieldInfo]:
    """Describe the columns of energies and heights."""
    fields = {}
    for name, estimate in value_columns(values).items():
        quantity, what, unit = name.split("_")
        alias = phrase("{}, 95 % of the blocks", phrase(quantity))
        if what != "q95":
            alias = phrase("{}, exceeded once in {} years", phrase(quantity), what.rstrip("y"))
        unit = "kJ" if unit == "kj" else "m"
        value, low, high = estimate.columns(name)
        fields[value] = FieldInfo(alias, unit)
        fields[low] = FieldInfo(phrase("{}, lower limit", alias), unit, _LIMITS)
        fields[high] = FieldInfo(phrase("{}, upper limit", alias), unit, _LIMITS)
    return fields


def _style(symbol: Symbol, quantity: str, currency: str) -> VectorStyle:
    limits = _LOSS_LIMITS if quantity == "loss" else _RISK_LIMITS
    unit = phrase("per year")
    if quantity == "loss":
        unit = phrase("{}/year", currency)
    # In short: 0.0001 is 1e-4.
    texts = [f"{v:.0e}".replace("e-0", "e-") if v < 0.01 else f"{v:g}" for v in limits]
    labels = [
        phrase("below {} {}", texts[0], unit),
        *(phrase("{} to {} {}", low, high, unit) for low, high in pairwise(texts)),
        phrase("{} {} and more", texts[-1], unit),
    ]
    edges = [_LEAST, *limits, float("inf")]
    classes = [StyleClass("none", replace(symbol, colour=_NOTHING_COLOUR), upper=_LEAST)]
    for k, colour in enumerate(class_colours((0.0, *limits), _RAMP)):
        own = replace(symbol, colour=colour)
        classes.append(StyleClass(labels[k], own, lower=edges[k], upper=edges[k + 1]))
    label = "" if symbol.kind == "line" else "name"
    return VectorStyle(symbol, "ranges", f"{quantity}_per_year", tuple(classes), label)
