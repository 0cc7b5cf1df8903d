"""Everything that a diagnosis writes: numbers, map, figures, report, calibrated model."""

from __future__ import annotations

from pathlib import Path

from sassgis.gap.diagnosis import Diagnosis
from sassgis.gap.observations.case import Case
from sassgis.io.write.gap_files import write_config_back, write_diagnosis_json, write_gap_gpkg
from sassgis.model.crs import crs_name
from sassgis.model.in_memory import Input
from sassgis.model.languages import in_language
from sassgis.model.run_config import Config
from sassgis.report.gap_report import gap_report, report_warnings
from sassgis.report.page import translated_report, write_report
from sassgis.runs.origin import Origin, write_origin


def observed_files(case: Case) -> dict[str, Input]:
    """The files of the observations, each once, by their role."""
    files = sorted({*case.observations.files.values()}, key=str)
    return {f"observations {file.name}": file for file in files}


def write_outputs(work: Path, case: Case, diagnosis: Diagnosis, config: Config) -> None:
    """Write a diagnosis into a folder; equal diagnoses give equal files.

    ``diagnosis.json``, ``gap.gpkg``, ``figures/*.png``, ``report.html``, ``model/config.toml`` with
    its files, and last ``manifest.json``.

    Parameters
    ----------
    work : Path
        Folder of the result, or the staged one beside it: paths in ``model/config.toml`` hold for
        both.
    config : Config
        The configuration that was diagnosed.

    Raises
    ------
    ConfigError, InputError
        If a file that the configuration names cannot be read.
    OutputError
        If the disk is full or not writable.
    """
    write_diagnosis_json(work / "diagnosis.json", diagnosis)
    write_gap_gpkg(work / "gap.gpkg", case, diagnosis)
    write_config_back(work / "model" / "config.toml", config, diagnosis, case)
    # What the console says, and what only the report has.
    warnings = list(dict.fromkeys((*diagnosis.warnings, *report_warnings(case, diagnosis))))
    with in_language(config.project.language):
        context = gap_report(
            case,
            diagnosis,
            work / "figures",
            project=config.project.name,
            terrain=config.dem_source.name,
            crs=crs_name(case.grid.crs or ""),
            configuration=config.label,
            warnings=warnings,
        )
        write_report(work / "report.html", translated_report(context))
    found = {
        "effect": diagnosis.verdict.effect,
        "confidence": diagnosis.verdict.confidence,
        "settings_hash": diagnosis.settings_hash,
    }
    counts = {
        "rocks": diagnosis.rocks,
        **{f"rows_{name}": int(n) for name, n in diagnosis.tables.items()},
        "comparisons": len(diagnosis.where),
        "explanations": len(diagnosis.which),
    }
    write_origin(
        work, config, counts, warnings, seed=diagnosis.seed, grid=case.grid, maps=False,
        origin=Origin(observed_files(case)), settings={"diagnosis": found},
    )  # fmt: skip
