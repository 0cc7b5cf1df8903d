"""Everything that a calibration writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sassgis.gap.calibration.class_calibration import SiteCalibration
from sassgis.gap.observations.case import Case
from sassgis.io.read.config import resolved
from sassgis.io.write.calibration_files import (
    FITTED_NAME,
    write_calibrated_config,
    write_calibration_json,
    write_classes,
)
from sassgis.io.write.manifest import write_manifest
from sassgis.model.ground import GroundTable
from sassgis.model.in_memory import Input
from sassgis.model.languages import in_language
from sassgis.model.run_config import Config
from sassgis.report.calibration_report import calibration_report, calibration_warnings
from sassgis.report.page import translated_report, write_report
from sassgis.runs.gap_outputs import observed_files
from sassgis.runs.inputs import input_files


def write_calibration(
    work: Path, configs: Sequence[Config], cases: Sequence[Case], calibration: SiteCalibration
) -> None:
    """Write a calibration into a folder.

    ``fitted_classes.csv``, ``config.toml`` with the recommended ground (``config_2.toml`` and so on
    for further sites), ``calibration.json``, ``figures/*.png``, ``report.html`` and last
    ``manifest.json``.

    Raises
    ------
    ConfigError, InputError
        If a configuration could not be run again.
    OutputError
        If the disk is full or not writable.
    """
    write_classes(work / FITTED_NAME, calibration, _joined(cases))
    for k, config in enumerate(configs):
        name = "config.toml" if k == 0 else f"config_{k + 1}.toml"
        write_calibrated_config(work / name, config, calibration)
    write_calibration_json(work / "calibration.json", calibration)
    warnings = [
        *dict.fromkeys(note for config in configs for note in config.notes),
        *calibration_warnings(calibration),
    ]
    with in_language(configs[0].project.language):
        context = calibration_report(
            calibration,
            work / "figures",
            configurations=[config.label for config in configs],
            warnings=warnings,
        )
        write_report(work / "report.html", translated_report(context))
    write_manifest(
        work / "manifest.json",
        inputs=_inputs(configs, cases),
        base=configs[0].base,
        crs=cases[0].grid.crs,
        vertical_datum=cases[0].grid.vertical_datum,
        seed=calibration.seed,
        ref_widths_m={},
        preset="",
        settings={config.label if k == 0 else f"{config.label} ({k + 1})": resolved(config)
                  for k, config in enumerate(configs)},
        counts={
            "sites": len(cases),
            "rocks": calibration.rocks,
            "draws": calibration.draws,
            "parameters": len(calibration.fitted),
        },
        warnings=warnings,
    )  # fmt: skip


def _joined(cases: Sequence[Case]) -> GroundTable:
    """The classes of all sites."""
    classes = {c.name: c for case in reversed(cases) for c in case.table.classes}
    return GroundTable(tuple(classes.values()))


def _inputs(configs: Sequence[Config], cases: Sequence[Case]) -> dict[str, Input]:
    found: dict[str, Input] = {}
    for k, (config, case) in enumerate(zip(configs, cases, strict=True)):
        mark = "" if k == 0 else f" ({k + 1})"
        found |= {f"{role}{mark}": file for role, file in input_files(config).items()}
        found |= {f"{role}{mark}": file for role, file in observed_files(case).items()}
    return found
