"""Empty tables for a site, and which effects a campaign with them would show."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sassgis.errors import Interrupted, OutputError
from sassgis.gap.advice.power import (
    CampaignPower,
    PlannedCampaign,
    planned_case,
    powers_of,
    usual_rocks,
)
from sassgis.gap.constants import PLANNED_ROCKS
from sassgis.gap.fit.hypothesis_fit import families_to_try
from sassgis.inputs.observation_values import cause_weights_of, read_thresholds, thresholds_of
from sassgis.outputs.gap_files import write_power
from sassgis.outputs.site_template import observations_template
from sassgis.runs.calibrate import scenario_warnings
from sassgis.runs.draw_store import reported_tasks
from sassgis.runs.inputs import read_map_run
from sassgis.runs.resumable_run import AnyConfig, configured, workers_asked
from sassgis.simulation.workers import Jobs, OnProgress, one_algebra_thread, task_map

POWER_NAME = "power.csv"


def plan_campaign(
    path: str | Path,
    config: AnyConfig,
    *,
    crs: str | None = None,
    jobs: Jobs = None,
    seed: int = 1,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> CampaignPower:
    """Write empty tables of observations, and which effects they would show at a site.

    Simulated with the configured model: effects of three strengths, 20, 40 and 100 rocks, tables
    from stations alone to paths in time.

    Parameters
    ----------
    path : path
        New folder or GeoPackage, as for a template. The powers are in ``power.csv``, next to a
        GeoPackage in ``<name>_power.csv``.
    config : path, Config or mapping
        Configuration of the site.
    crs : str, optional
        System of a GeoPackage, by default that of the terrain model.
    jobs : int, optional
        Processes; 0: all cores. The answer does not depend on it.
    on_progress : callable, optional
        Called with trials done, trials in all, and rocks simulated; counts anew for each step.
    """
    tell, path = say or (lambda _text: None), Path(path)
    file = path.with_name(f"{path.stem}_{POWER_NAME}") if path.suffix else path / POWER_NAME
    if file.exists():
        raise OutputError(f"{file}: exists already")
    with one_algebra_thread():
        settings = configured(config, None)
        tell("Reading the inputs")
        run = read_map_run(settings)
        for text in scenario_warnings(settings):
            tell(text)
        case = planned_case(run, max(PLANNED_ROCKS), seed, Path(settings.label))
        observations_template(path, crs=crs or run.grid.crs or None)
        content = read_thresholds()
        causes = families_to_try(case)
        planned = PlannedCampaign(
            {n: usual_rocks(case, n, seed) for n in PLANNED_ROCKS}, causes,
            cause_weights_of(content), thresholds_of(content), seed,
        )  # fmt: skip
        tell(f"Simulating campaigns with each of {len(causes)} causes")
        try:
            with task_map(planned, workers_asked(settings, jobs)) as run_tasks:
                found = powers_of(causes, reported_tasks(run_tasks, 1, on_progress))
        except KeyboardInterrupt:
            raise Interrupted(f"stopped by the user; the tables are in {path}") from None
        rocks = case.observations.rocks
        stations = tuple(case.station_s[0].tolist())
        power = CampaignPower(
            causes=causes, powers=tuple(found), stations_m=stations, x=float(rocks.x[0]),
            y=float(rocks.y[0]), language=settings.project.language,
        )  # fmt: skip
        write_power(file, power)
    return power
