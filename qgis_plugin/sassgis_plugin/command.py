"""What all commands of sassgis share as algorithms: parameters, and how they are run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputFile,
    QgsProcessingOutputHtml,
    QgsProcessingOutputNumber,
    QgsProcessingOutputString,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFile,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
)

from .program import check_program, program_path, run, what_is_missing
from .results import load_results, say_of_zones
from .site_files import columns_of

GROUND_CLASSES = (
    "rock", "debris", "talus", "soft_meadow", "forest_soil", "asphalt", "overgrown_slope",
)  # fmt: skip
FLOAT = QgsProcessingParameterNumber.Double
INTEGER = QgsProcessingParameterNumber.Integer
POLYGONS, LINES = QgsProcessing.TypeVectorPolygon, QgsProcessing.TypeVectorLine
ANY_GEOMETRY = QgsProcessing.TypeVectorAnyGeometry
GO_ON = "\n\nCancel keeps what was computed. Run the tool again with the same folder to resume."


def advanced(parameter):
    """A parameter that is shown on request."""
    parameter.setFlags(parameter.flags() | QgsProcessingParameterDefinition.FlagAdvanced)
    return parameter


def passed(option, parameter):
    """A parameter whose value, if there is one, follows an option of the command."""
    parameter.setMetadata({"option": option})
    return parameter


def number(name, text, kind=FLOAT, default=None, low=0.0):
    """A number; optional without a default."""
    optional = default is None
    return QgsProcessingParameterNumber(name, text, kind, default, optional, low)


def box(name, text, ticked=False):
    """A box to tick."""
    return QgsProcessingParameterBoolean(name, text, ticked)


def file(name, text, optional=False, kinds=""):
    """A file."""
    # The filter of QGIS itself, *.*, refuses folders and other names without a dot.
    return QgsProcessingParameterFile(
        name, text, optional=optional, fileFilter=f"{kinds}All files (*)"
    )


def result_folder(name, text):
    """The folder of a result."""
    return QgsProcessingParameterFile(name, text, behavior=QgsProcessingParameterFile.Folder)


def raster(name, text, optional=False):
    """A raster layer."""
    return QgsProcessingParameterRasterLayer(name, text, optional=optional)


def features(name, text, kind=ANY_GEOMETRY, optional=True):
    """A vector layer, or its selected features."""
    return QgsProcessingParameterFeatureSource(name, text, [kind], optional=optional)


def choice(name, text, options, default):
    """One of some texts."""
    return QgsProcessingParameterEnum(
        name, text, options, defaultValue=default, usesStaticStrings=True
    )


def config(text="Configuration of the site (sassgis.toml)", optional=False):
    """A configuration."""
    return file("CONFIG", text, optional, "TOML (*.toml);;")


def number_text(value: float) -> str:
    """A number as the program reads it: whole ones without a point, none in powers of ten."""
    return str(int(value)) if float(value).is_integer() else f"{value:.15g}"


class Inputs:
    """What the user entered.

    Attributes
    ----------
    out : Path
        Folder or file of the result.
    config : Path
        The configuration, once it is known.
    """

    def __init__(self, algorithm, parameters, context, feedback):
        self.algorithm, self.parameters = algorithm, parameters
        self.context, self.feedback = context, feedback
        self.out = Path(algorithm.parameterAsFileOutput(parameters, "OUTPUT", context))
        self.config = Path(algorithm.parameterAsFile(parameters, "CONFIG", context))

    def given(self, name: str) -> bool:
        """Whether there is a value."""
        return self.parameters.get(name) not in (None, "")

    def flag(self, name: str) -> bool:
        """Whether a box is ticked."""
        return self.algorithm.parameterAsBool(self.parameters, name, self.context)

    def options(self) -> list[object]:
        """Options of the command in the order of their parameters, those that are given."""
        found = []
        for own in self.algorithm.parameterDefinitions():
            name, option = own.name(), own.metadata().get("option")
            if option and isinstance(own, QgsProcessingParameterBoolean):
                found += self.ticked(name, option)
            elif option and self.given(name):
                is_number = isinstance(own, QgsProcessingParameterNumber)
                value = number_text(self.number(name)) if is_number else self.text(name)
                found += [option, value]
        return found

    def ticked(self, name: str, option: str) -> list[object]:
        """An option, if its box is ticked."""
        return [option] if self.flag(name) else []

    def system(self) -> str:
        """The coordinate system that was chosen; empty for none."""
        system = self.algorithm.parameterAsCrs(self.parameters, "CRS", self.context)
        return system.authid() if system.isValid() else ""

    def number(self, name: str) -> float:
        """A number."""
        return self.algorithm.parameterAsDouble(self.parameters, name, self.context)

    def text(self, name: str) -> str:
        """A text, or the one of a choice."""
        definition = self.algorithm.parameterDefinition(name)
        if isinstance(definition, QgsProcessingParameterEnum):
            return self.algorithm.parameterAsEnumString(self.parameters, name, self.context)
        return self.algorithm.parameterAsString(self.parameters, name, self.context).strip()

    def file(self, name: str) -> Path:
        """A file or a folder that is there."""
        return Path(self.algorithm.parameterAsFile(self.parameters, name, self.context))

    def rows(self, name: str) -> list[list[str]]:
        """Rows of a table; those without any entry are left out."""
        definition = self.algorithm.parameterDefinition(name)
        cells = self.algorithm.parameterAsMatrix(self.parameters, name, self.context)
        texts = ["" if cell is None else str(cell).strip() for cell in cells]
        width = len(definition.headers())
        rows = [texts[i : i + width] for i in range(0, len(texts), width)]
        return [row for row in rows if any(row)]

    def terrain(self, name: str = "DEM") -> str:
        """The file of a raster layer."""
        layer = self.algorithm.parameterAsRasterLayer(self.parameters, name, self.context)
        if layer is None or layer.providerType() != "gdal":
            raise QgsProcessingException("Terrain model: expected a raster file")
        return layer.source()

    def layer(self, name: str, site_layer: str, **renamed: str):
        """The features of a layer, or those that are selected, and their columns."""
        source = self.algorithm.parameterAsSource(self.parameters, name, self.context)
        if source is None:
            raise QgsProcessingException(f"{name}: the layer cannot be read")
        return source, columns_of(site_layer, source, renamed)


class Algorithm(QgsProcessingAlgorithm):
    """What has a name and a place in the toolbox: base of all."""

    NAME = TITLE = HELP = GROUP = ""

    def name(self):
        """Name in scripts."""
        return self.NAME

    def displayName(self):
        """Name in the toolbox."""
        return self.TITLE

    def group(self):
        """Heading in the toolbox."""
        return self.GROUP

    def groupId(self):
        """Heading in scripts."""
        return self.GROUP.lower().replace(" ", "_")

    def shortHelpString(self):
        """Text beside the dialog."""
        return self.HELP

    def createInstance(self):
        """Another one of its kind."""
        return type(self)()


class Tool(Algorithm):
    """A command of sassgis: base of those that call the program."""

    #: Of the command, where it is not called by the name.
    WORDS: tuple[str, ...] = ()
    #: Whether the program says its answer in lines, which become an output.
    ANSWERS = False

    def canExecute(self):
        """Whether the program is there; else the reason."""
        missing = what_is_missing()
        return not missing, missing

    def _parameters(self) -> list[QgsProcessingParameterDefinition]:
        """What this command asks for."""
        return []

    def _arguments(self, inputs: Inputs) -> list[object]:
        """What follows the words of the command, before the options of the parameters."""
        return [inputs.config]

    def _destination(self, inputs: Inputs) -> list[object]:
        """What follows the options."""
        return []

    def _outputs(self, inputs: Inputs) -> dict[str, object]:
        """What the algorithm gives, once the command has ended."""
        return {}

    def initAlgorithm(self, configuration=None):
        """Declare parameters and outputs."""
        for parameter in self._parameters():
            self.addParameter(parameter)
        if self.ANSWERS:
            self.addOutput(QgsProcessingOutputString("ANSWER", "Answer"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run the command."""
        check_program(feedback)
        inputs = Inputs(self, parameters, context, feedback)
        words = [
            *(self.WORDS or (self.NAME,)), *self._arguments(inputs), *inputs.options(),
            *self._destination(inputs),
        ]  # fmt: skip
        said = run([program_path(), *words], feedback)
        answer = {"ANSWER": "\n".join(said)} if self.ANSWERS else {}
        return {**answer, **self._outputs(inputs)}


class Command(Tool):
    """A command that writes a folder with a result."""

    PARALLEL = True
    SEEDED = True

    def initAlgorithm(self, configuration=None):
        """Declare parameters and outputs."""
        super().initAlgorithm(configuration)
        if self.PARALLEL:
            jobs = number("JOBS", "Processor cores (0: all)", INTEGER)
            self.addParameter(advanced(passed("--jobs", jobs)))
        if self.SEEDED:
            seed = number("SEED", "Seed of the random draws", INTEGER)
            self.addParameter(advanced(passed("--seed", seed)))
        self.addParameter(box("OVERWRITE", "Replace a result that is in the folder"))
        self.addParameter(box("LOAD", "Load the layers", True))
        self.addParameter(QgsProcessingParameterFolderDestination("OUTPUT", "Folder of the result"))
        self.addOutput(QgsProcessingOutputHtml("REPORT", "Report"))
        self.addOutput(QgsProcessingOutputFile("USED_CONFIG", "Configuration"))
        self.addOutput(
            QgsProcessingOutputNumber(
                "CHANGED_SHARE",
                "Share of the zoned area that changes level with another random seed",
            )
        )

    def _destination(self, inputs):
        return ["-o", inputs.out, *inputs.ticked("OVERWRITE", "--overwrite")]

    def _outputs(self, inputs):
        self._folder = inputs.out if inputs.flag("LOAD") else None
        self._share = changed_share(inputs.out)
        calibrated = [inputs.out / "config.toml", inputs.out / "model" / "config.toml"]
        results = {
            "REPORT": _first([inputs.out / "report.html", inputs.out / "mosaic" / "report.html"]),
            "USED_CONFIG": _first([*calibrated, inputs.config]),
            "CHANGED_SHARE": self._share,
        }
        known = {k: v for k, v in results.items() if v not in (None, "")}
        return {"OUTPUT": str(inputs.out), **known}

    def postProcessAlgorithm(self, context, feedback):
        """Load the layers; here, as the project belongs to the main thread."""
        if self._folder is not None:
            load_results(self._folder, context, feedback)
        if self._share is not None:
            say_of_zones(self._share, feedback)
        return {}


def _first(files: Sequence[Path]) -> str:
    return next((str(path) for path in files if path.is_file()), "")


def changed_share(folder: Path) -> float | None:
    """Share of the zoned area whose level another sample would change; None without zones."""
    for manifest in (folder / "manifest.json", folder / "mosaic" / "manifest.json"):
        try:
            found = json.loads(manifest.read_text(encoding="utf-8"))
            return float(found["settings"]["zoning"]["changed_share"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return None
