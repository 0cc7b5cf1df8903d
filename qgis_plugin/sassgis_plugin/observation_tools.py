"""Commands that compare simulations with observations."""

from __future__ import annotations

from qgis.core import QgsProcessingParameterFile

from .command import GO_ON, INTEGER, Command, Inputs, advanced, box, config, file, number, passed

GROUP = "4 Observations"
_OBSERVATIONS = (
    "\n\nObservations: a GeoPackage, or any of the CSV tables of a folder ('sassgis gap template "
    "FOLDER' writes empty ones)."
)


def _observations() -> QgsProcessingParameterFile:
    return file("OBSERVATIONS", "Observations: GeoPackage, or a table of their folder")


def _observed(inputs: Inputs) -> list[object]:
    own = inputs.file("OBSERVATIONS")
    return ["--observations", own.parent if own.suffix.lower() == ".csv" else own]


class Calibrate(Command):
    """``sassgis calibrate``."""

    NAME = "calibrate"
    TITLE = "Calibrate on observations"
    GROUP = GROUP
    HELP = (
        "Fits the ground classes to observed stops, passages or impacts, and states what the "
        "observations do not determine. Writes a report and a configuration that has the fitted "
        "classes where they predict rocks left out better." + _OBSERVATIONS + GO_ON
    )

    def _parameters(self):
        draws = number("DRAWS", "Parameter sets of each round", INTEGER, low=16)
        return [config(), _observations(), advanced(passed("--draws", draws))]

    def _arguments(self, inputs):
        return [inputs.config, *_observed(inputs)]


class Diagnose(Command):
    """``sassgis gap diagnose``."""

    NAME = "diagnose"
    TITLE = "Diagnose the gap to observations"
    GROUP = GROUP
    WORDS = ("gap", "diagnose")
    HELP = (
        "Where observation and simulation differ, which effect missing in the model explains it, "
        "which explanations the data cannot distinguish, and how far the gap shrinks."
        + _OBSERVATIONS
        + GO_ON
    )

    def _parameters(self):
        draws = number("DRAWS", "Parameter sets of each hypothesis", INTEGER, low=8)
        calibrated = box("MAP", "Run the map with the calibrated model, too")
        return [
            config(),
            _observations(),
            advanced(passed("--draws", draws)),
            passed("--map", calibrated),
        ]

    def _arguments(self, inputs):
        return [inputs.config, *_observed(inputs)]
