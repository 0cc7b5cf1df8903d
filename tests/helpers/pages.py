"""Pages of docs/: their commands and the outputs that they show."""

from __future__ import annotations

import re


def commands(page: str) -> list[list[str]]:
    """The commands of a page, word by word: fenced blocks below ``<!-- commands -->``."""
    blocks = re.findall(r"<!-- commands -->\n```sh\n(.*?)```", page, re.S)
    assert blocks
    lines = (line.split("#")[0].split() for block in blocks for line in block.splitlines())
    return [words for words in lines if words]


def shown(page: str, name: str) -> list[str]:
    """Lines of an output on a page: the fenced block below ``<!-- output: NAME -->``."""
    found = re.search(rf"<!-- output: {name} -->\n```\n(.*?)```", page, re.S)
    assert found is not None
    return found[1].splitlines()
