"""The commands of sassgis as algorithms: what they ask for, and the arguments that follow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputFile,
    QgsProcessingOutputHtml,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFile,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
)

from .inputs import copied, written_configuration
from .program import check_program, program_path, run, what_is_missing
from .results import load_results

GROUND_CLASSES = (
    "rock", "debris", "talus", "soft_meadow", "forest_soil", "asphalt", "overgrown_slope",
)  # fmt: skip
_FLOAT = QgsProcessingParameterNumber.Double
_INTEGER = QgsProcessingParameterNumber.Integer
_GO_ON = (
    "\n\nCancelling keeps what was computed: the same call into the same folder goes on from there."
)


def _advanced(parameter):
    parameter.setFlags(parameter.flags() | QgsProcessingParameterDefinition.FlagAdvanced)
    return parameter


def _number(name, text, kind=_FLOAT, default=None, low=0.0):
    optional = default is None
    return QgsProcessingParameterNumber(name, text, kind, default, optional, low)


def _box(name, text, ticked=False):
    return QgsProcessingParameterBoolean(name, text, ticked)


def _file(name, text, optional=False, kinds=""):
    # The filter of QGIS itself, *.*, refuses folders and other names without a dot.
    return QgsProcessingParameterFile(
        name, text, optional=optional, fileFilter=f"{kinds}All files (*)"
    )


def _config(text="Configuration of the site (sassgis.toml)", optional=False):
    return _file("CONFIG", text, optional, "TOML (*.toml);;")


class Command(QgsProcessingAlgorithm):
    """A command of sassgis: base of the algorithms below."""

    NAME = TITLE = HELP = ""
    WORDS: tuple[str, ...] = ()
    PARALLEL = True

    def name(self):
        """Name in scripts."""
        return self.NAME

    def displayName(self):
        """Name in the toolbox."""
        return self.TITLE

    def shortHelpString(self):
        """Text beside the dialog."""
        return self.HELP

    def createInstance(self):
        """Another one of its kind."""
        return type(self)()

    def canExecute(self):
        """Whether the program is there; else the reason."""
        missing = what_is_missing()
        return not missing, missing

    def own_parameters(self) -> list[QgsProcessingParameterDefinition]:
        """What this command asks for, besides what all of them do."""
        return []

    def arguments(self, inputs: Inputs) -> list[object]:
        """What follows the words of the command."""
        raise NotImplementedError

    def initAlgorithm(self, configuration=None):
        """Declare parameters and outputs."""
        for parameter in self.own_parameters():
            self.addParameter(parameter)
        if self.PARALLEL:
            self.addParameter(_advanced(_number("JOBS", "Processor cores (0: all)", _INTEGER)))
        self.addParameter(_advanced(_number("SEED", "Seed of the random draws", _INTEGER)))
        self.addParameter(_box("OVERWRITE", "Replace a result that is in the folder"))
        self.addParameter(_box("LOAD", "Load the layers", True))
        self.addParameter(QgsProcessingParameterFolderDestination("OUTPUT", "Folder of the result"))
        self.addOutput(QgsProcessingOutputHtml("REPORT", "Report"))
        self.addOutput(QgsProcessingOutputFile("USED_CONFIG", "Configuration"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run the command."""
        check_program(feedback)
        inputs = Inputs(self, parameters, context, feedback)
        arguments = self.arguments(inputs)
        for key, option in (("JOBS", "--jobs"), ("SEED", "--seed")):
            arguments += inputs.option(key, option)
        overwrite = ["--overwrite"] if inputs.flag("OVERWRITE") else []
        run(
            [program_path(), *self.WORDS, *arguments, "-o", inputs.out, *overwrite],
            feedback,
        )
        self._folder = inputs.out if inputs.flag("LOAD") else None
        calibrated = [inputs.out / "config.toml", inputs.out / "model" / "config.toml"]
        results = {
            "REPORT": _first([inputs.out / "report.html", inputs.out / "mosaic" / "report.html"]),
            "USED_CONFIG": _first([*calibrated, inputs.config]),
        }
        return {"OUTPUT": str(inputs.out), **{k: v for k, v in results.items() if v}}

    def postProcessAlgorithm(self, context, feedback):
        """Load the layers; here, as the project belongs to the main thread."""
        if self._folder is not None:
            load_results(self._folder, context, feedback)
        return {}


def _first(files: Sequence[Path]) -> str:
    return next((str(file) for file in files if file.is_file()), "")


class Inputs:
    """What the user entered.

    Attributes
    ----------
    out : Path
        Folder of the result.
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

    def option(self, name: str, option: str) -> list[object]:
        """An option with its number, if one is given."""
        if self.algorithm.parameterDefinition(name) is None or not self.given(name):
            return []
        return [option, f"{self.number(name):g}"]

    def number(self, name: str) -> float:
        """A number."""
        return self.algorithm.parameterAsDouble(self.parameters, name, self.context)

    def file(self, name: str) -> Path:
        """A file that is there."""
        return Path(self.algorithm.parameterAsFile(self.parameters, name, self.context))

    def copy(self, name: str, stem: str) -> Path:
        """The features of a layer, or those of them that are selected, in a file of their own."""
        source = self.algorithm.parameterAsSource(self.parameters, name, self.context)
        if source is None:
            raise QgsProcessingException(f"{name}: the layer cannot be read")
        return copied(source, self.out, stem, self.context)


def _site_parameters() -> list[QgsProcessingParameterDefinition]:
    """A configuration, or layers and the choices that every site needs."""
    return [
        _config("Configuration of the site (sassgis.toml), or the layers below", optional=True),
        QgsProcessingParameterRasterLayer("DEM", "Terrain model", optional=True),
        QgsProcessingParameterFeatureSource(
            "RELEASE", "Release areas", [QgsProcessing.TypeVectorAnyGeometry], optional=True
        ),
        QgsProcessingParameterEnum(
            "GROUND", "Ground class", GROUND_CLASSES, defaultValue="debris", usesStaticStrings=True
        ),
        _number("VOLUME_FROM", "Least volume of the blocks (m³)", default=0.5, low=1e-6),
        _number("VOLUME_TO", "Greatest volume of the blocks (m³)", default=2.0, low=1e-6),
        _number("SPACING", "Spacing of the release points (m)", default=5.0, low=0.01),
        _number("BLOCKS", "Blocks per release point", _INTEGER, default=100, low=1),
    ]


def _site(inputs: Inputs, more: Sequence[str] = ()) -> list[object]:
    """The configuration that is given, or one that is written for the layers.

    Raises
    ------
    QgsProcessingException
        If there is neither, or both.
    """
    layers = [inputs.given("DEM"), inputs.given("RELEASE")]
    if inputs.given("CONFIG") and not any(layers):
        return [inputs.config]
    if inputs.given("CONFIG") or not all(layers):
        raise QgsProcessingException(
            "Give either a configuration, or a terrain model and release areas."
        )
    algorithm, parameters, context = inputs.algorithm, inputs.parameters, inputs.context
    dem = algorithm.parameterAsRasterLayer(parameters, "DEM", context)
    if dem is None or dem.providerType() != "gdal":
        raise QgsProcessingException("Terrain model: expected a raster file")
    low, high = inputs.number("VOLUME_FROM"), inputs.number("VOLUME_TO")
    settings = [
        f"ground.default={algorithm.parameterAsEnumString(parameters, 'GROUND', context)}",
        f'blocks.name="{low:g} to {high:g} m3"',
        f"blocks.volume_m3=[{low:g}, {high:g}]",
        f"release.spacing_m={inputs.number('SPACING'):g}",
        f"release.rocks_per_point={inputs.number('BLOCKS'):g}",
        *more,
    ]
    inputs.config = written_configuration(
        inputs.out,
        dem.source(),
        inputs.copy("RELEASE", "release"),
        settings,
        replace=inputs.flag("OVERWRITE"),
        feedback=inputs.feedback,
    )
    return [inputs.config]


class Run(Command):
    """``sassgis run``."""

    NAME = "run"
    TITLE = "Run: simulate blocks"
    WORDS = ("run",)
    HELP = (
        "Simulates blocks from release areas over a terrain model: reach probability, energy, "
        "passing height, speed, stops.\n\nGive a configuration, or a terrain model and release "
        "areas with the choices below. From layers a configuration is written beside the result, "
        "in the folder <result>_inputs; open it to see all choices, or to go on with it."
    ) + _GO_ON

    def own_parameters(self):
        """A configuration or layers."""
        return _site_parameters()

    def arguments(self, inputs):
        """The configuration."""
        return _site(inputs)


class Zone(Command):
    """``sassgis zone``."""

    NAME = "zone"
    TITLE = "Zone: hazard levels, zones and risk"
    WORDS = ("zone",)
    HELP = (
        "All that Run does, and hazard levels, intensities, zones and, where the configuration "
        "names exposed objects, risk.\n\nFrom layers, the rules are those of the preset "
        "ch-so; the onset frequency holds for each release area. The level depends on the "
        "reference width: choose the same for maps that are to be compared. Both count only with "
        "layers; a configuration states its own."
    ) + _GO_ON

    def own_parameters(self):
        """A configuration or layers; onset frequency and width."""
        return [
            *_site_parameters(),
            _number("FREQUENCY", "Onset frequency of each release area (blocks a year)"),
            _number("REF_WIDTH", "Reference width of all frequencies (m)"),
        ]

    def arguments(self, inputs):
        """The configuration."""
        if inputs.given("CONFIG"):
            return _site(inputs)
        for name in ("FREQUENCY", "REF_WIDTH"):
            if not inputs.given(name):
                text = self.parameterDefinition(name).description()
                raise QgsProcessingException(f"{text}: zones from layers need it")
        return _site(
            inputs,
            [
                f"blocks.onset_frequency={inputs.number('FREQUENCY'):g}",
                f"hazard.ref_width_m={inputs.number('REF_WIDTH'):g}",
            ],
        )


class Profile(Command):
    """``sassgis profile``."""

    NAME = "profile"
    TITLE = "Profile along a drawn line"
    WORDS = ("profile",)
    PARALLEL = False
    HELP = (
        "Simulates blocks along one line over the terrain model, from its first vertex: "
        "trajectories, run-out, energy and passing height along the slope. Draw the line "
        "downwards, with the tool 'Draw a profile' of the plugin or in a layer of lines; of a "
        "layer with several lines select one. Ground, forest, stations and barriers are those of "
        "the configuration."
    )

    def own_parameters(self):
        """A configuration and a line."""
        return [
            _config(),
            QgsProcessingParameterFeatureSource(
                "LINE", "Line, drawn downwards", [QgsProcessing.TypeVectorLine]
            ),
            _number("BLOCKS", "Blocks of each scenario", _INTEGER, low=1),
        ]

    def arguments(self, inputs):
        """The configuration and a file with the line."""
        line = inputs.copy("LINE", "line")
        return [inputs.config, "--line", line, *inputs.option("BLOCKS", "--rocks")]


_OBSERVATIONS = (
    "\n\nObservations: a GeoPackage, or any of the CSV tables of a folder ('sassgis gap template "
    "FOLDER' writes empty ones)."
)


def _observations() -> QgsProcessingParameterFile:
    return _file("OBSERVATIONS", "Observations: GeoPackage, or a table of their folder")


def _observed(inputs: Inputs) -> list[object]:
    file = inputs.file("OBSERVATIONS")
    return ["--observations", file.parent if file.suffix.lower() == ".csv" else file]


class Calibrate(Command):
    """``sassgis calibrate``."""

    NAME = "calibrate"
    TITLE = "Calibrate on observations"
    WORDS = ("calibrate",)
    HELP = (
        "Fits the ground classes to observed stops, passages or impacts, and states what the "
        "observations do not determine. Writes a report and a configuration that has the fitted "
        "classes where they predict rocks left out better." + _OBSERVATIONS + _GO_ON
    )

    def own_parameters(self):
        """A configuration and observations."""
        draws = _number("DRAWS", "Parameter sets to begin with", _INTEGER, low=16)
        return [_config(), _observations(), _advanced(draws)]

    def arguments(self, inputs):
        """The configuration and the observations."""
        return [inputs.config, *_observed(inputs), *inputs.option("DRAWS", "--draws")]


class Diagnose(Command):
    """``sassgis gap diagnose``."""

    NAME = "diagnose"
    TITLE = "Diagnose the gap to observations"
    WORDS = ("gap", "diagnose")
    HELP = (
        "Where observation and simulation differ, which effect missing in the model explains it, "
        "which explanations the data cannot distinguish, and how far the gap shrinks."
        + _OBSERVATIONS
        + _GO_ON
    )

    def own_parameters(self):
        """A configuration and observations."""
        draws = _number("DRAWS", "Parameter sets of each hypothesis", _INTEGER, low=8)
        return [
            _config(),
            _observations(),
            _box("MAP", "Run the map with the calibrated model, too"),
            _advanced(draws),
        ]

    def arguments(self, inputs):
        """The configuration, the observations, and whether the map is run."""
        with_map = ["--map"] if inputs.flag("MAP") else []
        return [
            inputs.config,
            *_observed(inputs),
            *inputs.option("DRAWS", "--draws"),
            *with_map,
        ]


class Batch(Command):
    """``sassgis batch``."""

    NAME = "batch"
    TITLE = "Batch: zone many release areas"
    WORDS = ("batch",)
    HELP = (
        "Zones each release area by itself, and all of them on one map, which is loaded. Areas "
        "that are done are not run again." + _GO_ON
    )

    def own_parameters(self):
        """A configuration, and what differs from it."""
        memory = _number("MEMORY", "Memory for all processes together (GB)", low=1.0)
        return [
            _config(),
            _file("RELEASES", "Release areas, in place of those of the configuration", True),
            _box("MOSAIC_ONLY", "No maps, zones and report of each area by itself"),
            _advanced(memory),
        ]

    def arguments(self, inputs):
        """The release areas, or the configuration that names them."""
        releases = inputs.given("RELEASES")
        named = [inputs.file("RELEASES"), "--config", inputs.config] if releases else []
        mosaic_only = ["--mosaic-only"] if inputs.flag("MOSAIC_ONLY") else []
        return [*(named or [inputs.config]), *mosaic_only, *inputs.option("MEMORY", "--memory")]


COMMANDS = (Run, Zone, Profile, Calibrate, Diagnose, Batch)
