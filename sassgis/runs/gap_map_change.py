"""What a calibrated model makes of the map: the same release areas run before and after."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sassgis.hazard.result_change import ResultChange
from sassgis.io.read.config import load_config
from sassgis.io.read.result_folder import read_result
from sassgis.io.staging import staged_output
from sassgis.model.errors import ConfigError
from sassgis.model.run_config import Config
from sassgis.runs.compare import write_comparison
from sassgis.runs.inputs import input_files, placed_objects
from sassgis.runs.run import run
from sassgis.runs.workers import Jobs


def map_change(
    config_before: str | Path,
    config_after: str | Path,
    out: str | Path,
    jobs: Jobs = None,
    *,
    overwrite: bool = False,
    say: Callable[[str], None] | None = None,
) -> ResultChange:
    """Run two configurations and map what changes.

    Writes the results ``before`` and ``after`` (as ``sassgis run`` does), and beside them what
    ``sassgis compare`` writes, with the configured objects.

    Parameters
    ----------
    config_before, config_after : path
        With the same terrain. ``terrain.path`` of the second holds for both.
    out : path
        Folder of the result; appears whole or not at all.
    jobs : int, optional
        In place of that of the configurations.
    overwrite : bool
        Whether a result that is there already may be replaced.
    say : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    ConfigError
        A configuration has no release areas.
    InputError
        The cells of the two terrain models do not coincide, or a file cannot be used.
    OutputError
    """
    after = load_config(config_after)
    # Paths of another kind would be a change by themselves.
    before = load_config(config_before, {"terrain.path": after.terrain.path})
    for config in (before, after):
        _check(config)
    tell = say or (lambda _text: None)
    configs = {"before": before, "after": after}
    with staged_output(Path(out), overwrite) as work:
        for name, config in configs.items():
            tell(f"Running the map {name}")
            done = run(config, work / name, jobs=jobs)
        return write_comparison(
            work,
            read_result(work / "before"),
            read_result(work / "after"),
            placed_objects(after, done.run.grid),
            inputs={
                f"{role} ({name})": file
                for name, config in configs.items()
                for role, file in input_files(config).items()
            },
            base=before.base,
            say=say,
        )


def _check(config: Config) -> None:
    if config.release.file is None:
        raise ConfigError(
            "has no release areas, so that there is no map to compare",
            file=config.file,
            field="release.file",
            found="nothing",
            expected="polygons, lines or points of release",
        )
