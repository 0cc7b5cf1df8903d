"""The side of a check that knows the truth: it makes cases, labels and fresh rocks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sassgis.gap.check.blinded_labels import label_of
from sassgis.gap.check.worlds import World, WorldSpec, fresh_rocks, make_world, observe, setup
from sassgis.gap.check.worlds.observe import KINDS, ObservedTables
from sassgis.io.write.gap_case_files import folder_digest, write_case, write_observations

#: The campaign that is observed; fresh rocks are another one.
_CAMPAIGN = 0


def make_case(spec: WorldSpec, seed: int, case: str, folder: str) -> dict[str, Any]:
    """Make a site, and write what its observers have and know into a folder.

    ``case`` is the number of the site, without meaning. Returns ``label`` (see ``label_of``) and
    ``digest`` of the files.
    """
    world = make_world(spec, seed)
    # It appears whole: a process that was lost may have written it.
    if not Path(folder).exists():
        seen = observe(world, spec.kind, spec.n_rocks, _CAMPAIGN)
        write_seen(world, Path(folder), f"World {case}", seen)
    return {"label": label_of(world, case), "digest": folder_digest(Path(folder))}


def write_seen(world: World, folder: Path, title: str, seen: ObservedTables) -> Path:
    """Write what was seen at a synthetic site, with what its observers know; the configuration."""
    known = setup(world)
    return write_case(
        folder,
        title=title,
        dem=known.dem,
        class_names=known.class_names,
        class_codes=known.class_codes,
        releases=known.releases,
        blocks=known.blocks,
        tables=seen.tables,
        metadata=seen.metadata,
    )


def make_label(spec: WorldSpec, seed: int, case: str) -> dict[str, Any]:
    """The label alone, from a site that is made anew."""
    return label_of(make_world(spec, seed), case)


def make_fresh(spec: WorldSpec, seed: int, rocks: int, folder: str) -> None:
    """Release fresh rocks in a site that is made anew, and write what a case of it shows.

    Of the same kind of observations as the case: the same quantities are compared.
    """
    world = make_world(spec, seed)
    fresh = fresh_rocks(world, rocks)
    tables = {name: fresh.tables[name] for name in KINDS[spec.kind]}
    write_observations(Path(folder), tables, fresh.metadata)
