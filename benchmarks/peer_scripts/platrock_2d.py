"""Time PlatRock 2D: ``python platrock_2d.py PROFILE ROCKS``, in an environment that has it."""

from __future__ import annotations

import csv
import json
import os
import sys
import tempfile
import time

import numpy as np
import platrock  # noqa: F401
from platrock.Common import BounceModels
from platrock.TwoD import Objects, Simulations

PROFILE, ROCKS = os.path.abspath(sys.argv[1]), int(sys.argv[2])
#: Classical rebound, restitution R_n and R_t of the centre, rolling coefficient, by class.
GROUND = {"rock": (0.35, 0.85, 0.3), "debris": (0.35, 0.8, 0.3), "soft_meadow": (0.3, 0.7, 0.5)}
# It would fetch a table of tree impacts from the network; no trees stand here.
BounceModels.Toe_Tree_2022 = lambda: None

# It writes its results into the current folder.
os.chdir(tempfile.mkdtemp())
with open(PROFILE, newline="") as stream:
    rows = list(csv.DictReader(stream))
with open("terrain.csv", "w") as out:
    out.write("X Z bounce_model_number R_t R_n roughness v_half phi mu_r\n")
    for row in rows:
        r_n, r_t, rolling = GROUND[row["ground"]]
        out.write(f"{row['s_m']} {row['z_m']} 0 {r_t} {r_n} 0 0 0 {rolling}\n")
simulation = Simulations.Simulation(
    name="peer",
    rocks_start_params={
        "nb_rocks": ROCKS, "rocks_min_x": 4.0, "rocks_max_x": 44.0, "rocks_min_z": 0.5,
        "rocks_max_z": 0.6, "rocks_min_vol": 0.3, "rocks_max_vol": 0.4, "rocks_density": 2700,
        "rocks_vx": 0.1, "rocks_vz": 0.0,
    },
)  # fmt: skip
simulation.terrain = Objects.Terrain("terrain.csv")
began = time.process_time()
simulation.run()
seconds = time.process_time() - began
stops = [float(simulation.output.get_contacts_pos(i)[-1, 0]) for i in range(ROCKS)]
print(json.dumps({"seconds": seconds, "rocks": ROCKS, "median_stop_m": float(np.median(stops))}))
