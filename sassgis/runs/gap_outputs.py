"""Everything that a diagnosis writes: numbers, map, figures, report, calibrated model."""

from __future__ import annotations

from pathlib import Path

from sassgis.gap.diagnosis import Diagnosis
from sassgis.gap.observations.case import Case
from sassgis.io.read.config import load_config, resolved
from sassgis.io.write.calibrated_config import write_config_back
from sassgis.io.write.gap_files import write_diagnosis_json, write_gap_gpkg
from sassgis.io.write.manifest import write_manifest
from sassgis.model.crs import crs_name
from sassgis.report.gap_report import gap_report, report_warnings
from sassgis.report.page import write_report
from sassgis.runs.inputs import input_files


def write_outputs(
    work: Path,
    case: Case,
    diagnosis: Diagnosis,
    config_file: Path,
) -> None:
    """Write a diagnosis into a folder; equal diagnoses give equal files.

    ``diagnosis.json``, ``gap.gpkg``, ``figures/*.png``, ``report.html``, ``model/config.toml`` with
    its files, and last ``manifest.json``.

    Parameters
    ----------
    work : Path
        Folder of the result, or the staged one beside it: paths in ``model/config.toml`` hold for
        both.
    case : Case
    diagnosis : Diagnosis
    config_file : Path
        The configuration that was diagnosed.

    Raises
    ------
    ConfigError, InputError
        If the configuration or a file that it names cannot be read.
    OutputError
        If the disk is full or not writable.
    """
    config = load_config(config_file)
    write_diagnosis_json(work / "diagnosis.json", diagnosis)
    write_gap_gpkg(work / "gap.gpkg", case, diagnosis)
    write_config_back(work / "model" / "config.toml", config_file, diagnosis, case)
    warnings = [*config.notes, *report_warnings(case, diagnosis)]
    context = gap_report(
        case,
        diagnosis,
        work / "figures",
        project=config.project.name,
        terrain=config.dem_path.name,
        crs=crs_name(case.grid.crs or ""),
        configuration=config.file.name,
        warnings=warnings,
    )
    write_report(work / "report.html", context)
    observed = {Path(file) for file in case.observations.files.values() if file}
    inputs = input_files(config)
    for file in sorted(observed):
        inputs[f"observations {file.name}"] = file
    verdict = diagnosis.verdict
    write_manifest(
        work / "manifest.json",
        inputs=inputs,
        base=config.file.parent,
        crs=case.grid.crs,
        vertical_datum=case.grid.vertical_datum,
        seed=diagnosis.seed,
        ref_widths_m={},
        preset="",
        settings=resolved(config)
        | {
            "diagnosis": {
                "effect": verdict.effect,
                "confidence": verdict.confidence,
                "settings_hash": diagnosis.settings_hash,
            }
        },
        counts={
            "rocks": diagnosis.rocks,
            **{f"rows_{name}": int(n) for name, n in diagnosis.tables.items()},
            "comparisons": len(diagnosis.where),
            "explanations": len(diagnosis.which),
        },
        warnings=warnings,
    )
