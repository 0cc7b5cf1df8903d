"""Commands before a simulation: terrain, release areas, layers to draw in, frequencies, checks."""

from __future__ import annotations

from pathlib import Path

from qgis.core import (
    QgsProcessingParameterCrs,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterString,
)

from .command import FLOAT, Tool, advanced, box, config, file, number, passed, raster, result_folder
from .results import project_layers

GROUP = "1 Prepare a site"


def _system():
    return advanced(
        QgsProcessingParameterCrs("CRS", "Coordinate system where the file states none", None, True)
    )


def _override():
    return advanced(box("OVERRIDE_CRS", "The file states a wrong system: use this one"))


def _with_system(inputs) -> list[object]:
    """The options of the coordinate system."""
    if not inputs.system():
        return []
    return ["--crs", inputs.system(), *inputs.ticked("OVERRIDE_CRS", "--override-crs")]


class _Loads(Tool):
    """A tool whose file is loaded, if it is a GeoPackage."""

    def postProcessAlgorithm(self, context, feedback):
        """Load the layers."""
        if self._file is not None and self._file.suffix == ".gpkg":
            project_layers(self._file, context, feedback)
        return {}


class _Writes(_Loads):
    """A tool that writes a file, which is loaded."""

    KINDS, TEXT = "GeoPackage (*.gpkg)", "New GeoPackage"

    def initAlgorithm(self, configuration=None):
        """Declare parameters and outputs."""
        super().initAlgorithm(configuration)
        overwrite = box("OVERWRITE", "Overwrite, unless it was edited")
        self.addParameter(passed("--overwrite", overwrite))
        self.addParameter(box("LOAD", "Load the layers", True))
        self.addParameter(QgsProcessingParameterFileDestination("OUTPUT", self.TEXT, self.KINDS))

    def _outputs(self, inputs):
        self._file = inputs.out if inputs.flag("LOAD") else None
        return {"OUTPUT": str(inputs.out)}


class DemCheck(_Loads):
    """``sassgis dem check``."""

    NAME = "dem_check"
    TITLE = "Check a terrain model"
    GROUP = GROUP
    WORDS = ("dem", "check")
    ANSWERS = True
    HELP = (
        "Rates a terrain model for rockfall, item by item: coordinate system, units, holes, "
        "resolution, steepness, terraces, spikes, pits and depressions. A layer has the cells "
        "to look at."
    )

    def _parameters(self):
        page = QgsProcessingParameterFileDestination(
            "HTML", "Page with the findings", "HTML (*.html)", optional=True, createByDefault=False
        )
        cells = QgsProcessingParameterFileDestination(
            "CELLS", "Cells that need a look", "GeoPackage (*.gpkg)", optional=True
        )
        return [raster("DEM", "Terrain model"), _system(), _override(), page, cells]

    def _arguments(self, inputs):
        page, cells = (
            self.parameterAsFileOutput(inputs.parameters, name, inputs.context)
            for name in ("HTML", "CELLS")
        )
        self._file = Path(cells) if cells else None
        written = [*(["--html", page] if page else []), *(["-o", cells] if cells else [])]
        overwrite = ["--overwrite"] if written else []
        return [inputs.terrain(), *_with_system(inputs), *written, *overwrite]

    def _outputs(self, inputs):
        return {"CELLS": str(self._file)} if self._file else {}


class Cliffs(_Writes):
    """``sassgis cliffs``."""

    NAME = "cliffs"
    TITLE = "Propose release areas"
    GROUP = GROUP
    ANSWERS = True
    HELP = (
        "Proposes release areas from the slopes of a terrain model, and from mapped rock where "
        "there is any. Check them in the field."
    )

    def _parameters(self):
        threshold = number(
            "THRESHOLD", "Slope of cliffs (degrees); empty: from the slope angles", FLOAT, low=1.0
        )
        return [
            raster("DEM", "Terrain model"),
            passed("--ground", file("GROUND", "File with polygons of ground classes", True)),
            passed("--threshold", threshold),
            passed("--min-area", number("MIN_AREA", "Smallest area in plan (m²)", FLOAT, 50.0)),
            _system(),
            _override(),
        ]

    def _arguments(self, inputs):
        return [inputs.terrain(), "-o", inputs.out, *_with_system(inputs)]


class NewSite(_Writes):
    """``sassgis new``."""

    NAME = "new_site"
    TITLE = "New site: empty layers to draw in"
    GROUP = GROUP
    WORDS = ("new",)
    HELP = (
        "Writes a GeoPackage with empty layers: release areas, ground, barriers, stations, forest, "
        "exposed objects. Their forms offer the choices and limits of each attribute. Run "
        "and Zone take these layers as they are."
    )

    def _parameters(self):
        return [raster("DEM", "Terrain model"), _system(), _override()]

    def _arguments(self, inputs):
        return [inputs.out, "--dem", inputs.terrain(), *_with_system(inputs)]


class FromRockyfor3D(_Writes):
    """``sassgis init --rockyfor3d``."""

    NAME = "rockyfor3d"
    TITLE = "Configuration from inputs of Rockyfor3D"
    GROUP = GROUP
    WORDS = ("init",)
    KINDS, TEXT = "TOML (*.toml)", "New configuration"
    HELP = (
        "Reads a folder of inputs of Rockyfor3D and writes a configuration with its layers. Log "
        "and configuration list what has no counterpart."
    )

    def _parameters(self):
        return [result_folder("FOLDER", "Folder with dem.asc"), _system()]

    def _arguments(self, inputs):
        told = ["--set", f"terrain.crs={inputs.system()}"] if inputs.system() else []
        return [inputs.out, "--rockyfor3d", inputs.file("FOLDER"), *told]


class Validate(Tool):
    """``sassgis validate``."""

    NAME = "validate"
    TITLE = "Check a configuration and its files"
    GROUP = GROUP
    ANSWERS = True
    HELP = (
        "Reads a configuration and every file that it names. States which commands can run, what "
        "is missing, and the time and memory that a run takes."
    )

    def _parameters(self):
        return [config()]


class Frequency(Tool):
    """``sassgis frequency``."""

    NAME = "frequency"
    TITLE = "Onset frequencies from block volumes"
    GROUP = GROUP
    ANSWERS = True
    HELP = (
        "Fits a power law to volumes of blocks that were observed, and gives the onset frequency "
        "of scenarios: lines for the configuration, and numbers for the table of blocks.\n\n"
        "The table (CSV) has a column volume_m3, or from_m3, to_m3 and count."
    )

    def _parameters(self):
        complete = number(
            "COMPLETE", "Volume from which on no block was missed (m³)", FLOAT, 0.1, low=1e-6
        )
        limits = QgsProcessingParameterString(
            "LIMITS", "Limits of the scenarios (m³), separated by commas", "0.1,1,10"
        )
        return [
            file("VOLUMES", "Table of volumes (CSV)", kinds="CSV (*.csv);;"),
            passed("--complete-from", complete),
            passed("--years", number("YEARS", "Years in which the blocks were released", low=1e-3)),
            passed("--scenarios", limits),
            advanced(
                passed("--up-to", number("LARGEST", "Largest possible volume (m³)", low=1e-6))
            ),
        ]

    def _arguments(self, inputs):
        return [inputs.file("VOLUMES")]
