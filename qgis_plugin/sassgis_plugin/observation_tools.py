"""Commands that compare simulations with observations."""

from __future__ import annotations

from qgis.core import QgsProcessingParameterFile

from .command import GO_ON, INTEGER, Command, advanced, box, config, file, number, passed

_OBSERVATIONS = (
    "\n\nObservations: a GeoPackage, or any CSV table of their folder ('sassgis gap template "
    "FOLDER' writes empty ones)."
)


def _observations() -> QgsProcessingParameterFile:
    return file("OBSERVATIONS", "Observations: GeoPackage, or one of the CSV tables")


class _OnObservations(Command):
    """A command that takes a configuration and observations."""

    GROUP = "4 Observations"

    def _arguments(self, inputs):
        own = inputs.file("OBSERVATIONS")
        folder = own.parent if own.suffix.lower() == ".csv" else own
        return [inputs.config, "--observations", folder]


class Calibrate(_OnObservations):
    """``sassgis calibrate``."""

    NAME = "calibrate"
    TITLE = "Calibrate on observations"
    HELP = (
        "Fits the ground classes to observed stops, passages or impacts. The report states which "
        "parameters the observations do not determine. The configuration has the fitted classes "
        "only if they predict held-out rocks better." + _OBSERVATIONS + GO_ON
    )

    def _parameters(self):
        draws = number("DRAWS", "Parameter sets of each round", INTEGER, low=16)
        return [config(), _observations(), advanced(passed("--draws", draws))]


class Diagnose(_OnObservations):
    """``sassgis gap diagnose``."""

    NAME = "diagnose"
    TITLE = "Diagnose the gap to observations"
    WORDS = ("gap", "diagnose")
    HELP = (
        "Shows where simulated and observed rocks differ, which missing effect explains it, which "
        "other causes the data allow, and how far the effect closes the gap."
        + _OBSERVATIONS
        + GO_ON
    )

    def _parameters(self):
        draws = number("DRAWS", "Parameter sets of each hypothesis", INTEGER, low=8)
        calibrated = box("MAP", "Also run the map with the calibrated model")
        return [
            config(),
            _observations(),
            advanced(passed("--draws", draws)),
            passed("--map", calibrated),
        ]
