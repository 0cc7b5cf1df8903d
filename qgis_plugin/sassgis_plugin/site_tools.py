"""Commands before a simulation: terrain, release areas, layers to draw in, frequencies, checks."""

from __future__ import annotations

from pathlib import Path

from qgis.core import (
    QgsProcessingParameterCrs,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterString,
)

from .command import FLOAT, Tool, advanced, box, config, file, number, raster, result_folder
from .results import project_layers

GROUP = "1 Prepare a site"


def _system():
    return advanced(
        QgsProcessingParameterCrs("CRS", "Coordinate system where the file states none", None, True)
    )


def _override():
    return advanced(box("OVERRIDE_CRS", "The file states a wrong system: use this one"))


def _with_system(tool, inputs) -> list[object]:
    """The options of the coordinate system."""
    system = tool.parameterAsCrs(inputs.parameters, "CRS", inputs.context)
    if not system.isValid():
        return []
    return ["--crs", system.authid(), *inputs.ticked("OVERRIDE_CRS", "--override-crs")]


class _Writes(Tool):
    """A tool that writes a file, which is loaded."""

    KINDS, SUFFIX, TEXT = "GeoPackage (*.gpkg)", ".gpkg", "New GeoPackage"

    def initAlgorithm(self, configuration=None):
        """Declare parameters and outputs."""
        super().initAlgorithm(configuration)
        self.addParameter(box("OVERWRITE", "Replace one that nobody has changed"))
        self.addParameter(box("LOAD", "Load the layers", True))
        self.addParameter(QgsProcessingParameterFileDestination("OUTPUT", self.TEXT, self.KINDS))

    def processAlgorithm(self, parameters, context, feedback):
        """Run the command, and note what is to be loaded."""
        found = super().processAlgorithm(parameters, context, feedback)
        out = Path(self.parameterAsFileOutput(parameters, "OUTPUT", context))
        self._file = out if self.parameterAsBool(parameters, "LOAD", context) else None
        return {"OUTPUT": str(out), **found}

    def postProcessAlgorithm(self, context, feedback):
        """Load the layers."""
        if self._file is not None and self._file.suffix == ".gpkg":
            project_layers(self._file, context, feedback)
        return {}


class DemCheck(Tool):
    """``sassgis dem check``."""

    NAME = "dem_check"
    TITLE = "Check a terrain model"
    GROUP = GROUP
    WORDS = ("dem", "check")
    ANSWERS = True
    HELP = (
        "Judges a terrain model for rockfall, item by item: coordinate system, units, holes, "
        "resolution, steepness, terraces, spikes, pits and depressions."
    )

    def own_parameters(self):
        """A terrain model."""
        page = QgsProcessingParameterFileDestination(
            "HTML", "Page with the findings", "HTML (*.html)", optional=True, createByDefault=False
        )
        return [raster("DEM", "Terrain model"), _system(), _override(), page]

    def arguments(self, inputs):
        """The terrain model and its system."""
        page = self.parameterAsFileOutput(inputs.parameters, "HTML", inputs.context)
        html = ["--html", page, "--overwrite"] if page else []
        return [inputs.terrain(), *_with_system(self, inputs), *html]


class Cliffs(_Writes):
    """``sassgis cliffs``."""

    NAME = "cliffs"
    TITLE = "Propose release areas"
    GROUP = GROUP
    WORDS = ("cliffs",)
    ANSWERS = True
    HELP = (
        "Proposes release areas from the slopes of a terrain model, and from mapped rock where "
        "there is any. Check them in the field."
    )

    def own_parameters(self):
        """A terrain model, and where rock is mapped."""
        return [
            raster("DEM", "Terrain model"),
            file("GROUND", "File with polygons of ground classes", True),
            number("THRESHOLD", "Slope of cliffs (degrees), if not from slopes", FLOAT, low=1.0),
            number("MIN_AREA", "Smallest area in plan (m²)", FLOAT, 50.0),
            _system(),
            _override(),
        ]

    def arguments(self, inputs):
        """The terrain model and the limits."""
        return [
            inputs.terrain(), "-o", inputs.out, *inputs.words("GROUND", "--ground"),
            *inputs.option("THRESHOLD", "--threshold"), *inputs.option("MIN_AREA", "--min-area"),
            *_with_system(self, inputs), *inputs.ticked("OVERWRITE", "--overwrite"),
        ]  # fmt: skip


class NewSite(_Writes):
    """``sassgis new``."""

    NAME = "new_site"
    TITLE = "New site: empty layers to draw in"
    GROUP = GROUP
    WORDS = ("new",)
    HELP = (
        "Writes a GeoPackage with empty layers: release areas, ground, walls and nets, stations, "
        "forest, exposed objects. Their forms know the choices and limits of each attribute. Run "
        "and Zone take these layers as they are."
    )

    def own_parameters(self):
        """A terrain model."""
        return [raster("DEM", "Terrain model"), _system(), _override()]

    def arguments(self, inputs):
        """The file and the terrain model."""
        return [
            inputs.out, "--dem", inputs.terrain(), *_with_system(self, inputs),
            *inputs.ticked("OVERWRITE", "--overwrite"),
        ]  # fmt: skip


class FromRockyfor3D(_Writes):
    """``sassgis init --rockyfor3d``."""

    NAME = "rockyfor3d"
    TITLE = "Configuration from inputs of Rockyfor3D"
    GROUP = GROUP
    WORDS = ("init",)
    KINDS, SUFFIX, TEXT = "TOML (*.toml)", ".toml", "New configuration"
    HELP = (
        "Reads a folder of inputs of Rockyfor3D and writes a configuration with its layers; what "
        "has no counterpart is said in the log and stands in the configuration."
    )

    def own_parameters(self):
        """The folder."""
        return [result_folder("FOLDER", "Folder with dem.asc"), _system()]

    def arguments(self, inputs):
        """The file, the folder and its system."""
        system = self.parameterAsCrs(inputs.parameters, "CRS", inputs.context)
        told = ["--set", f"terrain.crs={system.authid()}"] if system.isValid() else []
        return [
            inputs.out, "--rockyfor3d", inputs.file("FOLDER"), *told,
            *inputs.ticked("OVERWRITE", "--overwrite"),
        ]  # fmt: skip


class Validate(Tool):
    """``sassgis validate``."""

    NAME = "validate"
    TITLE = "Check a configuration and its files"
    GROUP = GROUP
    WORDS = ("validate",)
    ANSWERS = True
    HELP = (
        "Reads a configuration and every file that it names as a run would; says what they are "
        "ready for, what is missing, and what a run takes."
    )

    def own_parameters(self):
        """A configuration."""
        return [config()]

    def arguments(self, inputs):
        """The configuration."""
        return [inputs.config]


class Frequency(Tool):
    """``sassgis frequency``."""

    NAME = "frequency"
    TITLE = "Onset frequencies from block volumes"
    GROUP = GROUP
    WORDS = ("frequency",)
    ANSWERS = True
    HELP = (
        "Fits a power law to volumes of blocks that were observed, and gives the onset frequency "
        "of scenarios: lines for the configuration, and numbers for the table of blocks.\n\n"
        "The table (CSV) has a column volume_m3, or from_m3, to_m3 and count."
    )

    def own_parameters(self):
        """Volumes, and the time in which they fell."""
        return [
            file("VOLUMES", "Table of volumes (CSV)", kinds="CSV (*.csv);;"),
            number("COMPLETE", "Volume from which no block was missed (m³)", FLOAT, 0.1, low=1e-6),
            number("YEARS", "Years in which the blocks were released", FLOAT, low=1e-3),
            QgsProcessingParameterString(
                "LIMITS", "Limits of the scenarios (m³), with commas between", "0.1,1,10"
            ),
            advanced(number("LARGEST", "Largest possible volume (m³)", FLOAT, low=1e-6)),
        ]

    def arguments(self, inputs):
        """Table, limits and years."""
        return [
            inputs.file("VOLUMES"), *inputs.option("COMPLETE", "--complete-from"),
            *inputs.option("YEARS", "--years"), *inputs.words("LIMITS", "--scenarios"),
            *inputs.option("LARGEST", "--up-to"),
        ]  # fmt: skip
