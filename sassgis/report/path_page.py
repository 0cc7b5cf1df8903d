"""A page with a map and a profile on which paths of blocks can be followed, without a network."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import shapely
from jinja2 import Environment, StrictUndefined

from sassgis.hazard.along_profile import LinePaths
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.languages import current_language, translated
from sassgis.model.map_run import MapRun
from sassgis.model.noted_files import noted
from sassgis.model.ramps import rgb
from sassgis.model.results import RasterLayer
from sassgis.model.styles import class_colours, class_labels, class_name, class_tint
from sassgis.report.figures.map_figure import class_numbers, shown_values
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.figures.relief import footprint, hillshade, view_of
from sassgis.report.page import data_uri

_MOST_DOTS = 1200
#: Share of the colour of the map over the relief.
_COLOUR = 0.6


def _picture(part: Grid, values: FloatArray, layer: RasterLayer) -> bytes:
    """The map over the relief, a dot for each cell or some of them, as PNG."""
    factor = -(-max(part.shape) // _MOST_DOTS)
    grey = np.nan_to_num((hillshade(part) + 0.35) / 1.3, nan=1.0)[::factor, ::factor]
    image = np.repeat(grey[..., None], 3, axis=2)
    if layer.classes:
        colours = {float(c.value): class_tint(c) for c in layer.classes}
    else:
        colours = dict(enumerate(class_colours(layer.breaks, layer.ramp)))
        values = class_numbers(values, layer.breaks)
    shown = values[::factor, ::factor]
    for value, colour in colours.items():
        tint = np.array(rgb(colour)) / 255.0
        cells = shown == value
        image[cells] = (1.0 - _COLOUR) * image[cells] + _COLOUR * tint
    buffer = io.BytesIO()
    # An empty name in place of matplotlib's version: equal runs give equal pages.
    matplotlib.image.imsave(
        buffer, np.clip(image, 0.0, 1.0), format="png", metadata={"Software": ""}
    )
    return buffer.getvalue()


def _legend(layer: RasterLayer) -> list[tuple[str, str]]:
    """Colour and name of each class, the highest first."""
    if layer.classes:
        ordered = sorted(layer.classes, key=lambda entry: -entry.value)
        return [(class_tint(c), translated(class_name(c))) for c in ordered]
    labels = class_labels(layer.breaks, layer.bands[0].unit)
    colours = class_colours(layer.breaks, layer.ramp)
    return list(zip(colours, map(translated, labels), strict=True))[::-1]


def _around(
    run: MapRun, outlines: Sequence[FloatArray], objects: Sequence[MapObject]
) -> list[dict[str, Any]]:
    """What lies around the paths, as lines."""
    shapes = [("", "release", xy) for xy in outlines]
    shapes += [(line.name, line.kind, xy) for line, xy in run.control_lines]
    for name, geometry in objects:
        for number, part in enumerate(shapely.get_parts(geometry)):
            ring = part.exterior if isinstance(part, shapely.Polygon) else part
            shapes.append(("" if number else name, "object", shapely.get_coordinates(ring)))
    return [
        {"name": name, "kind": kind, "points": np.round(xy, 1).tolist()}
        for name, kind, xy in shapes
    ]


def _path(shown: LinePaths) -> dict[str, Any]:
    end = int(np.searchsorted(shown.s, max(float(s.max()) for s, _ in shown.paths))) + 1
    part = {k: np.round(getattr(shown, k)[:end], 1).tolist() for k in ("s", "z", "x", "y")}
    blocks = [{"s": np.round(s, 1).tolist(), "z": np.round(z, 1).tolist()} for s, z in shown.paths]
    return {"name": f"{shown.area}, {shown.scenario}", **part, "blocks": blocks}


def write_path_page(
    file: Path,
    title: str,
    run: MapRun,
    layer: RasterLayer,
    paths: Sequence[LinePaths],
    outlines: Sequence[FloatArray],
    objects: Sequence[MapObject],
) -> None:
    """Write the page: one path at least, over a layer in classes, with outlines of the release."""
    values = shown_values(layer.bands[0])
    places = np.concatenate([np.column_stack([p.x, p.y]) for p in paths])
    view = view_of(run.grid, footprint(run.grid, values, places))
    data = {
        "extent": view.grid.bounds,
        "picture": data_uri(_picture(view.grid, view.cut(values), layer)),
        "around": _around(run, outlines, objects),
        "paths": [_path(shown) for shown in paths],
    }
    source = files("sassgis.data").joinpath("path_page.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.globals["translated"] = translated
    words = {"chainage": "chainage", "ground": "ground at", "above": "block above the ground"}
    page = environment.from_string(source).render(
        title=title,
        layer=translated(layer.title),
        legend=_legend(layer),
        language=current_language(),
        data=data,
        words={key: translated(text) for key, text in words.items()},
    )
    noted(file).write_text(page, encoding="utf-8", newline="\n")
