"""Edits of experts as a layer to draw in, with what was computed below them."""

from __future__ import annotations

from collections.abc import Sequence

import geopandas as gpd
import numpy as np
import pandas as pd

from sassgis.hazard.zoning.applied_edits import AppliedEdit, shares_text
from sassgis.io.read.edit_polygons import edit_fields
from sassgis.io.vector_layer import VectorLayer, descriptions
from sassgis.model.edits import NO_LEVEL
from sassgis.model.hazard import HazardPreset
from sassgis.model.styles import EDIT_STYLE


def edits_layer(applied: Sequence[AppliedEdit], preset: HazardPreset, crs: str) -> VectorLayer:
    """Edits of a result; a layer without features if there are none, to draw in.

    What was computed at the time of an edit is noted, so that later runs know it.
    """
    codes = [NO_LEVEL, *(c.code for c in preset.levels)]
    edits = [a.edit for a in applied]
    columns = {
        "level": [codes[e.level] for e in edits],
        "limit": [e.limit or None for e in edits],
        "author": [e.author for e in edits],
        "date": [e.date for e in edits],
        "reason": [e.reason for e in edits],
        "computed": [shares_text(a.then or a.now) for a in applied],
        "computed_now": [shares_text(a.now) for a in applied],
    }
    frame = pd.DataFrame(columns, dtype="object")
    frame["changed_share"] = np.array([a.changed for a in applied], np.float64).round(3)
    shapes = gpd.GeoSeries([e.geometry for e in edits], crs=crs or None)
    row, frame = descriptions()["edits"][""], gpd.GeoDataFrame(frame, geometry=shapes)
    words, fields = (row["alias"], row["description"]), edit_fields(codes[1:], True)
    return VectorLayer("edits", *words, frame, fields, style=EDIT_STYLE)
