"""Draw the block volumes of docs/frequency.md: ``python sample_dem/volumes/make.py FOLDER``."""

from __future__ import annotations

import random
import sys
from pathlib import Path

BLOCKS, LEAST_M3, EXPONENT, SEED = 160, 0.05, 0.8, 1


def table() -> str:
    """A list of volumes to the litre, from a power law."""
    draws = random.Random(SEED)
    volumes = (LEAST_M3 * (1.0 - draws.random()) ** (-1.0 / EXPONENT) for _ in range(BLOCKS))
    return "\n".join(["volume_m3", *(f"{v:.3f}" for v in volumes)]) + "\n"


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    (folder / "blocks.csv").write_text(table(), encoding="utf-8")
