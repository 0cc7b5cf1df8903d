"""What does the diagnosis say of the stops of three blocks at Tschamut?

    python pipelines/gap_tschamut2014.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``tschamut2014`` (A. Volkwein and W. Gerber 2018, Repetitive trajectory
testing in Tschamut 2014, EnviDat, doi 10.16904/envidat.34; ODbL). Writes configuration, terrain,
observations of all runs and of two splits, the diagnoses, and ``results.json``. The terrain was not
surveyed: it is a surface of 5 m cells interpolated from the heights of the tracked rocks, clipped
10 m beyond them. Stops are last positions of the tracking. Three blocks were released repeatedly:
the unit of resampling is the run, not the block.
"""

from __future__ import annotations

from field_cases.sites import tschamut as write
from field_cases.study import command

if __name__ == "__main__":
    command(__doc__, write)
