"""Time PyRockfall: ``python pyrockfall_2d.py PROFILE ROCKS``, in an environment that has it."""

from __future__ import annotations

import csv
import json
import sys
import time

import numpy as np
import pyrockfall

#: Restitution R_n and R_t of the centre, friction angle (degrees), by class.
GROUND = {"rock": (0.35, 0.85, 25.0), "debris": (0.35, 0.8, 25.0), "soft_meadow": (0.3, 0.7, 30.0)}

rocks = int(sys.argv[2])
with open(sys.argv[1], newline="") as stream:
    rows = list(csv.DictReader(stream))
nodes = np.array([[float(row["s_m"]), float(row["z_m"])] for row in rows])
names = list(GROUND)
slope = pyrockfall.Slope(
    pyrockfall.Geometry(nodes),
    [pyrockfall.Material(n, r_n, r_t, angle, 0.0) for n, (r_n, r_t, angle) in GROUND.items()],
    np.array([names.index(row["ground"]) for row in rows[:-1]]),
)
x = np.array([4.0, 44.0])
start = np.vstack([x, np.interp(x, nodes[:, 0], nodes[:, 1]) + 0.5])
seeder = pyrockfall.Seeder(start, [pyrockfall.Rock("block", 950.0, 2700.0)])
seeder.numberOfRocks = rocks
analysis = pyrockfall.Analysis()
analysis.slope = slope
analysis.seeders = [seeder]
began = time.process_time()
analysis.run()
seconds = time.process_time() - began
ends = np.asarray(analysis.trajectories.endpoints)
print(json.dumps({"seconds": seconds, "rocks": rocks, "median_stop_m": float(np.median(ends[0]))}))
