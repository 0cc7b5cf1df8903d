"""Commands that simulate: from a configuration, or from layers."""

from __future__ import annotations

from collections.abc import Sequence

from qgis.core import (
    QgsApplication,
    QgsProcessing,
    QgsProcessingException,
    QgsProcessingOutputFile,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterField,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterMatrix,
)

from .command import (
    ANY_GEOMETRY,
    GO_ON,
    GROUND_CLASSES,
    INTEGER,
    LINES,
    POLYGONS,
    Command,
    Inputs,
    Tool,
    advanced,
    box,
    choice,
    config,
    features,
    file,
    number,
    number_text,
    passed,
    raster,
)
from .program import check_program
from .site_files import SITE_LAYERS, site_package, written_configuration
from .steps import Scenario, table_problem

GROUP = "2 Simulate"
PRESETS = ("ch-so", "ti")
LANGUAGES = ("en", "de", "fr", "it")
#: Blocks of each release point at first; how many the map needs shows while it simulates.
FIRST_BLOCKS = 20
#: Reference width that a new site has (m).
REF_WIDTH_M = 10.0
#: Layers of a site: parameter, name of the layer, what it is, kind of geometry.
_LAYERS = (
    ("RELEASE", "release_areas", "Release areas (name, scenario)", ANY_GEOMETRY),
    ("GROUND_LAYER", "ground", "Ground: polygons with their class", POLYGONS),
    ("BARRIERS", "barriers", "Walls, nets, galleries (kind, height_m, ...)", LINES),
    ("STATIONS", "stations", "Stations where passing blocks are recorded (name)", LINES),
    ("FOREST", "forest", "Forest (stems_per_ha, dbh_cm)", POLYGONS),
    ("BUILDINGS", "buildings", "Buildings (value, persons, presence)", POLYGONS),
    ("ROADS", "roads", "Roads (value_per_m, traffic_per_day, ...)", LINES),
    ("PEOPLE", "people", "Places of people (persons, presence)", QgsProcessing.TypeVectorPoint),
    ("ASSESSED", "assessed_area", "Zone: area that was assessed completely", POLYGONS),
    ("EDITS", "edits", "Zone: edits by hand (level, limit, author, date, reason)", POLYGONS),
)
EXPOSED = ("BUILDINGS", "ROADS", "PEOPLE")
_COLUMNS = (
    "Name", "Least volume (m³)", "Greatest volume (m³)", "Onset frequency (blocks a year)",
)  # fmt: skip
_FROM_LAYERS = (
    "\n\nGive a configuration, or a terrain model, release areas and the settings below. From "
    "layers the tool writes a configuration into the folder <result>_inputs; edit it to use all "
    "settings. Layers need the attributes named in brackets; 'New site' writes such layers."
)


def _site_parameters(width: bool) -> list[QgsProcessingParameterDefinition]:
    """A configuration, or layers and the choices that every site needs."""
    layers = _LAYERS if width else _LAYERS[:-2]
    first, *others = (features(name, text, kind) for name, _, text, kind in layers)
    return [
        config("Configuration of the site (sassgis.toml), or the layers below", optional=True),
        raster("DEM", "Terrain model", optional=True),
        first,
        choice("GROUND", "Ground class outside the polygons", GROUND_CLASSES, "debris"),
        QgsProcessingParameterMatrix(
            "SCENARIOS", "Block scenarios", 1, False, list(_COLUMNS), ["blocks", 0.5, 2.0, ""], True
        ),
        number("SPACING", "Spacing of the release points (m)", default=5.0, low=0.01),
        number("BLOCKS", "Blocks per release point", INTEGER, default=FIRST_BLOCKS, low=1),
        *(
            [
                box("AUTO", "As many blocks as the map needs, beginning with those above", True),
                number(
                    "REF_WIDTH", "Reference width of all frequencies (m)", default=REF_WIDTH_M,
                    low=0.01,
                ),
                choice("PRESET", "Rules of the hazard levels", PRESETS, PRESETS[0]),
            ]
            if width
            else []
        ),
        *others,
        advanced(
            QgsProcessingParameterField(
                "GROUND_FIELD", "Attribute of the ground polygons with the class (class)",
                parentLayerParameterName="GROUND_LAYER", optional=True,
            )
        ),
        file("VULNERABILITY", "Table of vulnerability (CSV), with exposed objects", True),
    ]  # fmt: skip


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
    scenarios = [Scenario(*row) for row in inputs.rows("SCENARIOS")]
    problem = table_problem(scenarios)
    if problem:
        raise QgsProcessingException(f"Block scenarios: {problem}")
    language = next((own for own in LANGUAGES if QgsApplication.locale()[:2] == own), "en")
    name = inputs.out.name.replace('"', "'")
    # So many, or as many as the map needs, for which the former are a first sample.
    wanted = "auto" if inputs.flag("AUTO") else "given"
    settings = [
        f'project.name="{name}"',
        f'project.language="{language}"',
        f"ground.default={inputs.text('GROUND')}",
        f"blocks=[{', '.join(map(_block, scenarios))}]",
        f"release.spacing_m={number_text(inputs.number('SPACING'))}",
        f"release.rocks_per_point={number_text(inputs.number('BLOCKS'))}",
        f'hazard.blocks="{wanted}"',
        *more,
    ]
    if any(inputs.given(name) for name in EXPOSED):
        # Without it exposed objects have no risk, and zones no end.
        if not inputs.given("VULNERABILITY"):
            raise QgsProcessingException("Exposed objects need a table of vulnerability.")
        settings.append(f'risk.vulnerability="{inputs.file("VULNERABILITY").as_posix()}"')
    renamed = {"class": inputs.text("GROUND_FIELD")} if inputs.given("GROUND_FIELD") else {}
    layers = {
        layer: inputs.layer(name, layer, **(renamed if layer == "ground" else {}))
        for name, layer, _, _ in _LAYERS
        if inputs.given(name)
    }
    for layer, (source, columns) in layers.items():
        # Else a value under another name is a value of zero that nobody sees.
        absent = [column for column in SITE_LAYERS[layer] if column not in columns]
        if absent:
            inputs.feedback.pushWarning(f"{source.sourceName()}: no attribute {', '.join(absent)}")
    site = site_package(inputs.out, layers, inputs.context)
    inputs.config = written_configuration(
        inputs.out,
        ("--dem", inputs.terrain(), "--release", site),
        settings,
        replace=inputs.flag("OVERWRITE"),
        feedback=inputs.feedback,
    )
    return [inputs.config]


def _block(scenario: Scenario) -> str:
    """A scenario as TOML."""
    name = scenario.name.strip().replace('"', "'")
    low, high = (number_text(float(v)) for v in (scenario.low_m3, scenario.high_m3))
    frequency = scenario.frequency.strip()
    onset = f", onset_frequency = {number_text(float(frequency))}" if frequency else ""
    return f'{{name = "{name}", volume_m3 = [{low}, {high}]{onset}}}'


def _width(inputs: Inputs) -> list[str]:
    """Settings of zones from layers."""
    return [
        f"hazard.ref_width_m={number_text(inputs.number('REF_WIDTH'))}",
        f"hazard.preset={inputs.text('PRESET')}",
    ]


class Configuration(Tool):
    """``sassgis init``: a configuration from layers."""

    NAME = "configuration"
    TITLE = "Configuration from layers"
    GROUP = "1 Prepare a site"
    HELP = (
        "Writes the configuration that Run and Zone make from layers, and runs nothing: a text "
        "file (sassgis.toml) with the keys that every site must decide, and a GeoPackage."
    )

    def _parameters(self):
        return [
            *_site_parameters(width=True)[1:],
            box("OVERWRITE", "Replace a configuration with other settings"),
            QgsProcessingParameterFolderDestination(
                "OUTPUT", "Folder of the later result; the inputs go to <folder>_inputs"
            ),
        ]

    def initAlgorithm(self, configuration=None):
        """Declare parameters and outputs."""
        super().initAlgorithm(configuration)
        self.addOutput(QgsProcessingOutputFile("USED_CONFIG", "Configuration"))

    def processAlgorithm(self, parameters, context, feedback):
        """Write the files."""
        check_program(feedback)
        inputs = Inputs(self, parameters, context, feedback)
        (written,) = _site(inputs, _width(inputs))
        return {"USED_CONFIG": str(written)}


class Run(Command):
    """``sassgis run``."""

    NAME = "run"
    TITLE = "Run: simulate blocks"
    GROUP = GROUP
    HELP = (
        "Simulates blocks from release areas over a terrain model: reach probability, energy, "
        "passing height, speed, stops."
    ) + _FROM_LAYERS + GO_ON  # fmt: skip

    def _parameters(self):
        return _site_parameters(width=False)

    def _arguments(self, inputs):
        return _site(inputs)


class Zone(Command):
    """``sassgis zone``."""

    NAME = "zone"
    TITLE = "Zone: hazard levels, zones and risk"
    GROUP = GROUP
    HELP = (
        "Makes all results of Run, and hazard levels, intensities and zones; with exposed objects "
        "also risk. A message states the share of the zoned area that changes level with another "
        "random seed."
        + _FROM_LAYERS
        + "\n\nFrom layers, each scenario needs its onset frequency: blocks a year from each "
        "release area. The level depends on the reference width: use one width for maps that "
        "you compare." + GO_ON
    )

    def _parameters(self):
        return _site_parameters(width=True)

    def _arguments(self, inputs):
        if inputs.given("CONFIG"):
            return _site(inputs)
        for row in inputs.rows("SCENARIOS"):
            if not row[3]:
                raise QgsProcessingException(
                    f"Block scenarios: {row[0]}: zones from layers need its onset frequency"
                )
        return _site(inputs, _width(inputs))


class Profile(Command):
    """``sassgis profile``."""

    NAME = "profile"
    TITLE = "Profile along a drawn line"
    GROUP = GROUP
    PARALLEL = False
    HELP = (
        "Simulates blocks along one line over the terrain model, from its first vertex: "
        "trajectories, run-out, energy and passing height along the slope. Draw the line "
        "downwards, with the tool 'Draw a profile' of the plugin or in a layer of lines; of a "
        "layer with several lines select one. Ground, forest, stations and barriers are those of "
        "the configuration."
    )

    def _parameters(self):
        return [
            config(),
            features("LINE", "Line, drawn downwards", LINES, optional=False),
            passed("--rocks", number("BLOCKS", "Blocks of each scenario", INTEGER, low=1)),
        ]

    def _arguments(self, inputs):
        source, _ = inputs.layer("LINE", "lines")
        line = site_package(inputs.out, {"lines": (source, {})}, inputs.context)
        return [inputs.config, "--line", line]


class Batch(Command):
    """``sassgis batch``."""

    NAME = "batch"
    TITLE = "Batch: zone many release areas"
    GROUP = GROUP
    HELP = (
        "Zones each release area by itself, and all of them on one map. The map is loaded. "
        "Finished areas are not run again." + GO_ON
    )

    def _parameters(self):
        memory = number("MEMORY", "Memory for all processes together (GB)", low=1.0)
        return [
            config(),
            file("RELEASES", "Release areas, in place of those of the configuration", True),
            passed(
                "--mosaic-only",
                box("MOSAIC_ONLY", "Only the map of all areas, no files of single areas"),
            ),
            advanced(passed("--memory", memory)),
        ]

    def _arguments(self, inputs):
        if inputs.given("RELEASES"):
            return [inputs.file("RELEASES"), "--config", inputs.config]
        return [inputs.config]


class Sensitivity(Command):
    """``sassgis sensitivity``."""

    NAME = "sensitivity"
    TITLE = "Sensitivity to the ground classes"
    GROUP = GROUP
    HELP = (
        "Varies the values of the ground classes within their ranges. Shows how much levels, reach "
        "and energy change, and which parameter to measure first." + GO_ON
    )

    def _parameters(self):
        samples = number("SAMPLES", "Simulations that vary all ranges together", INTEGER, 32, low=4)
        rocks = number("ROCKS", "Blocks of each release point", INTEGER, low=2)
        return [
            config(),
            passed("--samples", samples),
            advanced(passed("--rocks", rocks)),
            advanced(passed("--ranges", file("RANGES", "Your ranges (CSV)", True))),
        ]
