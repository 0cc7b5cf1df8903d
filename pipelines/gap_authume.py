"""What does the diagnosis say of 41 stops in the Authume quarry, from half of the rocks?

    python pipelines/gap_authume.py [DATA] -o OUT [--jobs 2] [--case-only]

DATA holds the folder ``authume_quarry_p1`` (B. Garcia et al. 2022, Eng. Geol. 310, 106855; F.
Bourrier et al. 2021, Landslides 18, 639). The data state no licence: the terrain is read from its
folder, and apart from ``results.json`` and the figures the files in OUT must not be passed on.

Writes the configuration, observations of 41 stops and of two halves of them, the diagnoses, and
``results.json``.
"""

from __future__ import annotations

from field_cases.sites import authume as write
from field_cases.study import command

if __name__ == "__main__":
    command(__doc__, write)
