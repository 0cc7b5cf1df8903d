"""The steps of the work on a site, and what is missing for each. No QGIS is needed here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

#: A map on which another sample would change the level of more than this is not finished, and of
#: more than the second it cannot be used.
LOOK_SHARE, BAD_SHARE = 0.02, 0.10


@dataclass(frozen=True)
class Scenario:
    """A row of the table of blocks, as it was entered."""

    name: str
    low_m3: str
    high_m3: str
    frequency: str

    def problem(self) -> str:
        """What is wrong with the row; empty if nothing."""
        if not self.name.strip():
            return "a scenario has no name"
        try:
            low, high = float(self.low_m3), float(self.high_m3)
        except ValueError:
            return f"{self.name}: volumes are numbers with a decimal point (m³)"
        if not 0.0 < low <= high:
            return f"{self.name}: the least volume is above 0 and not above the greatest"
        if not self.frequency.strip():
            return ""
        try:
            return "" if float(self.frequency) >= 0.0 else f"{self.name}: a frequency is 0 or more"
        except ValueError:
            return f"{self.name}: the onset frequency is a number of blocks a year"


@dataclass(frozen=True)
class Site:
    """What was entered, and what there is already."""

    terrain: str = ""
    release: str = ""
    ground: str = ""
    scenarios: tuple[Scenario, ...] = ()
    exposed: bool = False
    vulnerability: str = ""
    folder: str = ""
    ref_width_m: float = 0.0
    program: str = ""  # why the program cannot be started
    simulated: str = ""  # folder of a result
    changed_share: float | None = None  # of its zones; None without any
    sheets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """A step with what is missing for it; ``done`` says what there is, ``grade`` how good it is."""

    key: str
    title: str
    missing: str
    done: str = ""
    grade: str = "good"


def table_problem(scenarios: Sequence[Scenario]) -> str:
    """What is wrong with the table of blocks; empty if nothing."""
    if not scenarios:
        return "a row in the table of blocks"
    problems = [problem for own in scenarios if (problem := own.problem())]
    names = [own.name.strip() for own in scenarios]
    if not problems and len(set(names)) < len(names):
        return "a different name for each scenario"
    return problems[0] if problems else ""


def steps_of(site: Site) -> list[Step]:
    """The steps in the order of the work."""
    program = Step("program", "Program", site.program.rstrip("."), "" if site.program else "there")
    blocks = table_problem(site.scenarios)
    terrain = Step("terrain", "Terrain", "" if site.terrain else "a terrain model", site.terrain)
    release = Step("release", "Release areas", "" if site.release else "a layer of release areas",
                   site.release)  # fmt: skip
    ground = Step("ground", "Ground", "" if site.ground else "a ground class", site.ground)
    rows = Step("blocks", "Blocks", blocks, "" if blocks else f"{len(site.scenarios)} scenario(s)")
    before = ["the program" if site.program else "",
              *(own.missing for own in (terrain, release, ground, rows)),
              "" if site.folder else "a folder for the result"]  # fmt: skip
    wanted = [text for text in before if text]
    run = Step("run", "Run", "; ".join(wanted), site.simulated)
    more = list(wanted)
    if not blocks and any(not own.frequency.strip() for own in site.scenarios):
        more.append("an onset frequency in each row of the table of blocks")
    if not site.ref_width_m > 0.0:
        more.append("the reference width")
    if site.exposed and not site.vulnerability:
        more.append("a table of vulnerability for the objects")
    share = site.changed_share
    grade, text = ("good", "") if share is None else verdict(share)
    zones = Step("zones", "Zones", "; ".join(more), text, grade)
    sheet = Step("sheet", "Map sheets", "" if site.sheets else "a result with zones or maps",
                 ", ".join(site.sheets))  # fmt: skip
    return [program, terrain, release, ground, rows, run, zones, sheet]


def next_step(steps: Sequence[Step]) -> str:
    """What to do next, in a line."""
    for own in steps:
        if not own.done:
            why = "see below" if own.key == "program" else own.missing or "ready"
            return f"Next: {own.title.lower()} ({why})."
    if any(own.grade == "bad" for own in steps):
        return "Next: more blocks per release point, or as many as the map needs; then zones again."
    return "All steps are done."


def verdict(changed_share: float) -> tuple[str, str]:
    """Whether zones are settled ("good", "look", "bad"), and the sentence that says so."""
    grade = "good"
    if changed_share > LOOK_SHARE:
        grade = "look" if changed_share <= BAD_SHARE else "bad"
    text = (
        f"With another random seed, {100.0 * changed_share:.1f} % of the zoned area changes level."
    )
    advice = {
        "good": "",
        "look": " More blocks reduce this share.",
        "bad": " This is too much for a map. Simulate more blocks.",
    }
    return grade, text + advice[grade]
