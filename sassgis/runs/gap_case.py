"""A configuration and observations put together: the case that a diagnosis looks at."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from sassgis.errors import InputError
from sassgis.files.input_parts import file_digest
from sassgis.gap.fit.parameters import learned_contacts
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.observations.case import Case, case_of, drop_and_density
from sassgis.inputs.config import settings_hash
from sassgis.inputs.observation_files import AnyObservations, observation_source, read_observations
from sassgis.runs.inputs import read_map_run
from sassgis.runs.resumable_run import AnyConfig, configured
from sassgis.settings.run_config import Config
from sassgis.settings.schema import Input


def comparable(problem: SiteData, observations: AnyObservations) -> SiteData:
    """Return problem; InputError if nothing was measured that a simulation can be compared with."""
    if not problem.scored:
        tables = problem.case.observations.tables
        rows = ", ".join(f"{len(t)} {name}" for name, t in tables.items() if len(t))
        raise InputError(
            "nothing to compare simulations with",
            file=observations_name(observations), field="deposits, passages, impacts",
            found=rows or "no rows",
            expected="stops, passages at stations, of 5 rocks or more, or impacts",
        )  # fmt: skip
    return problem


def read_case(config: AnyConfig, observations: AnyObservations) -> Case:
    """Read a configuration and observations: a GeoPackage, a folder of CSV files, or the tables."""
    run = read_map_run(configured(config, None))
    seen = read_observations(observations, run.grid, *drop_and_density(run.blocks))
    return case_of(run, seen, observations_name(observations))


def observations_name(observations: AnyObservations) -> Path:
    """Return the name of the observations in messages."""
    return Path("observations" if isinstance(observations, Mapping) else observations)


def observed_files(case: Case) -> dict[str, Input]:
    """Return the files of the observations, each once, by their role."""
    files = sorted({*case.observations.files.values()}, key=str)
    return {f"observations {file.name}": file for file in files}


def fingerprint_of(config: Config, observations: AnyObservations, options: str) -> str:
    """Return the fingerprint of settings, inputs, observations and options."""
    digest = hashlib.sha256(settings_hash(config).encode())
    source = observation_source(observations)
    tables = {"": source} if isinstance(source, Path) else source
    digest.update("".join(f"{name} {file_digest(own)}" for name, own in tables.items()).encode())
    digest.update(options.encode())
    return digest.hexdigest()


def prepared_case(
    settings: AnyConfig, observations: AnyObservations, seed: int, ground: float
) -> Case:
    """Return a case with the contacts that were recorded, and the range of the ground."""
    case = replace(read_case(settings, observations), ground_range=ground)
    return replace(case, learned=learned_contacts(case, seed))
