"""Write the tables of docs/maps.md and the list in README.md from the table of statistics.

``python docs/make_statistics.py`` rewrites what stands between the marks of both pages.
"""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

from sassgis.settings.statistics_table import STATISTICS

MAPS, README = Path(__file__).parent / "maps.md", Path(__file__).parents[1] / "README.md"
_INDENT = " " * 21


def tables() -> dict[str, str]:
    """The tables of docs/maps.md by the name of their mark."""
    maps = [f"| `{s.stem}` | {', '.join(s.bands)} | {s.meaning} |" for s in STATISTICS]
    bins = [
        f"| {s.title.split(',')[0].lower()} | {s.bins} | {s.resolution} |"
        for s in STATISTICS
        if s.edges is not None
    ]
    return {
        "maps": "\n".join(["| file | bands | one number means |", "|---|---|---|", *maps]),
        "bins": "\n".join(["| | bins | resolution |", "|---|---|---|", *bins]),
    }


def maps_page(text: str) -> str:
    """The page of the maps with its tables as they should be."""
    for name, table in tables().items():
        mark = f"<!-- statistics: {name} -->"
        text, n = re.subn(
            rf"{mark}\n.*?\n\n", lambda _, t=f"{mark}\n{table}\n\n": t, text, flags=re.S
        )
        assert n == 1, mark
    return text


def readme_page(text: str) -> str:
    """The README with the list of maps as it should be."""
    names = ", ".join([*(s.stem for s in STATISTICS), "terrain;"])
    lines = textwrap.wrap(names, 100 - len(_INDENT))
    text, n = re.subn(
        r"(?<=^  maps/\*\.tif         ).*? terrain;$",
        lambda _: f"\n{_INDENT}".join(lines),
        text,
        flags=re.S | re.M,
    )
    assert n == 1, "list of maps"
    return text


if __name__ == "__main__":
    for path, page in ((MAPS, maps_page), (README, readme_page)):
        path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
