"""Time com4FlowPy: ``python flowpy_map.py DEM RELEASE FOLDER ALPHA``, where it is installed.

Prints the wall clock and processor time of the whole model on one core, with that of its processes,
and how far from the western edge the cells lie that it reaches.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import rasterio
from avaframe.com4FlowPy import com4FlowPy
from avaframe.in3Utils import cfgUtils

dem, release, folder = (Path(text) for text in sys.argv[1:4])
general = cfgUtils.getModuleConfig(com4FlowPy)["GENERAL"]
general["alpha"] = sys.argv[4]
general["cpuCount"] = "1"
results, scratch = folder / "results", folder / "scratch"
for made in (results, scratch):
    made.mkdir(parents=True)
paths = {
    "workDir": folder, "outDir": results, "resDir": results, "tempDir": scratch, "demPath": dem,
    "releasePath": release, "uid": "run", "timeString": "", "customDirs": "True",
    "deleteTemp": "False", "outputFileFormat": ".tif", "outputFiles": "zDelta|cellCounts",
    "outputNoDataValue": -9999.0, "useCompression": True,
}  # fmt: skip
before, began = os.times(), time.perf_counter()
com4FlowPy.com4FlowPyMain(paths, general)
seconds, after = time.perf_counter() - began, os.times()
(file,) = results.rglob("*cellCounts*.tif")
with rasterio.open(file) as raster:
    reached = raster.read(1) > 0.0
    width = raster.res[0]
x = (np.flatnonzero(reached.any(axis=0)) + 0.5) * width
print(
    json.dumps(
        {
            "seconds": seconds,
            "cpu_s": sum(after[:4]) - sum(before[:4]),
            "reached_cells": int(reached.sum()),
            "farthest_m": float(x.max()),
        }
    )
)
