"""What the site needs beyond docs/: pages that lie elsewhere, and links between the two.

A hook of MkDocs. Links are written for GitHub, relative to the file; those that lead to a file
that is no page of the site, as a script, become plain text.
"""

from __future__ import annotations

import os.path
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
#: Pages of the site by the file that they are, where it lies outside docs/.
ELSEWHERE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
    "sample_dem/README.md": "samples.md",
}
_FILES = {page: file for file, page in ELSEWHERE.items()}
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s]+)\)|(!\[[^\]]*\])\(([^)\s]+)\)")
_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.S | re.M)


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that lie elsewhere."""
    for file, page in ELSEWHERE.items():
        text = (ROOT / file).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, files: Files, **_: Any) -> str:
    """Links between files become links between pages."""
    pages = {f.src_uri for f in files}
    parts = _FENCE.split(markdown)
    parts[::2] = [linked(text, page.file.src_uri, pages) for text in parts[::2]]
    return "".join(parts)


def linked(text: str, page: str, pages: set[str]) -> str:
    """A text of a page with its links as the site has them."""
    file = _FILES.get(page, f"docs/{page}")

    def moved(found: re.Match[str]) -> str:
        words, target, picture, source = found.groups()
        name, hash_, anchor = (target or source).partition("#")
        if not name or re.match(r"\w+:", name):
            return found[0]
        place = os.path.normpath(os.path.join(os.path.dirname(file), name))
        there = ELSEWHERE.get(place, place.removeprefix("docs/") if place[:5] == "docs/" else "")
        if there not in pages and (ROOT / place).exists():
            return words or ""
        own = os.path.relpath(there or place, os.path.dirname(page) or ".")
        return f"{picture or f'[{words}]'}({own}{hash_}{anchor})"

    return _LINK.sub(moved, text)
