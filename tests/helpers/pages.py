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


def steps(page: str) -> list[tuple[str, str, str]]:
    """What a page has its reader do, in order: kind ("commands", "file", "edit"), file, text."""
    return re.findall(r"<!-- (commands|file|edit)(?:: (\S+))? -->\n```\w+\n(.*?)```", page, re.S)


def rows(page: str, name: str) -> list[list[str]]:
    """Cells of the table below ``<!-- table: NAME -->``, without its head."""
    found = re.search(rf"<!-- table: {name} -->\n((?:\|.*\n)+)", page)
    assert found is not None
    lines = found[1].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
