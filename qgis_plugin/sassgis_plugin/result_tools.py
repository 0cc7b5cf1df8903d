"""Commands on results: compare them, export zones, print sheets."""

from __future__ import annotations

from pathlib import Path

from qgis.core import (
    QgsLayoutExporter,
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputFolder,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterString,
    QgsProject,
    QgsRenderContext,
)

from .command import INTEGER, Algorithm, Command, Tool, box, choice, number, passed, result_folder

GROUP = "3 Results"


class Compare(Command):
    """``sassgis compare``."""

    NAME = "compare"
    TITLE = "Compare two results"
    GROUP = GROUP
    PARALLEL = SEEDED = False
    HELP = (
        "Shows what changes from one result to another, for example without and with nets: zones, "
        "energies, passing heights, objects."
    )

    def _parameters(self):
        return [
            result_folder("BEFORE", "Folder of the first result"),
            result_folder("AFTER", "Folder of the second result"),
        ]

    def _arguments(self, inputs):
        return [inputs.file("BEFORE"), inputs.file("AFTER")]


class Export(Tool):
    """``sassgis export``."""

    NAME = "export"
    TITLE = "Export zones or paths"
    GROUP = GROUP
    ANSWERS = True
    HELP = (
        "Writes zones of a result as INTERLIS 2 (federal model 166.1), or zones or paths of blocks "
        "as GeoJSON or KML. The suffix of the file gives the format."
    )

    def _parameters(self):
        return [
            result_folder("RESULT", "Folder of the result"),
            choice("LAYER", "What to write", ("zones", "paths"), "zones"),
            passed("--canton", QgsProcessingParameterString(
                "CANTON", "INTERLIS: canton responsible for the data (TI)", optional=True
            )),
            passed("--overwrite", box("OVERWRITE", "Overwrite, unless the file was edited")),
            QgsProcessingParameterFileDestination(
                "OUTPUT", "New file", "INTERLIS (*.xtf);;GeoJSON (*.geojson);;KML (*.kml)"
            ),
        ]  # fmt: skip

    def _arguments(self, inputs):
        return [inputs.file("RESULT"), "-o", inputs.out, "--layer", inputs.text("LAYER")]

    def _outputs(self, inputs):
        return {"OUTPUT": str(inputs.out)}


def sheets_of(folder: Path) -> list[str]:
    """Names of the map sheets of a result, without opening its layers."""
    file = folder / "project.qgz"
    if not file.is_file():
        return []
    project = QgsProject()
    project.read(str(file), QgsProject.FlagDontResolveLayers)
    return [layout.name() for layout in project.layoutManager().printLayouts()]


class Sheets(Algorithm):
    """Print the map sheets of a result; QGIS does it by itself."""

    NAME = "sheets"
    TITLE = "Print map sheets"
    GROUP = GROUP
    HELP = (
        "Prints the map sheets of a result (its project.qgz) as PDF files: hazard level, "
        "intensity by return period, energy, height, reach, risk."
    )

    def flags(self):
        """Layouts belong to the main thread."""
        return super().flags() | QgsProcessingAlgorithm.FlagNoThreading

    def initAlgorithm(self, configuration=None):
        """Declare the parameters."""
        self.addParameter(result_folder("RESULT", "Folder of the result"))
        self.addParameter(
            QgsProcessingParameterString("SHEET", "Name of one sheet; empty: all", optional=True)
        )
        self.addParameter(number("DPI", "Dots per inch", INTEGER, 300, low=30))
        self.addParameter(QgsProcessingParameterFolderDestination("OUTPUT", "Folder of the sheets"))
        self.addOutput(QgsProcessingOutputFolder("FOLDER", "Sheets"))

    def processAlgorithm(self, parameters, context, feedback):
        """Print each sheet."""
        result = Path(self.parameterAsFile(parameters, "RESULT", context))
        folder = Path(self.parameterAsString(parameters, "OUTPUT", context))
        wanted = self.parameterAsString(parameters, "SHEET", context)
        project = QgsProject()
        if not project.read(str(result / "project.qgz")):
            raise QgsProcessingException(f"{result}: no project.qgz in this folder")
        layouts = {own.name(): own for own in project.layoutManager().printLayouts()}
        if wanted and wanted not in layouts:
            raise QgsProcessingException(
                f"{result}: no sheet {wanted!r}; there are {', '.join(layouts) or 'none'}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        settings = QgsLayoutExporter.PdfExportSettings()
        settings.dpi = self.parameterAsDouble(parameters, "DPI", context)
        settings.textRenderFormat = QgsRenderContext.TextFormatAlwaysText
        chosen = [wanted] if wanted else list(layouts)
        for done, name in enumerate(chosen, start=1):
            safe = "".join(c if c.isalnum() or c in " -_." else "_" for c in name).strip()
            target = folder / f"{safe}.pdf"
            exporter = QgsLayoutExporter(layouts[name])
            if exporter.exportToPdf(str(target), settings) != QgsLayoutExporter.Success:
                raise QgsProcessingException(f"{target}: cannot be written")
            feedback.pushInfo(str(target))
            feedback.setProgress(100.0 * done / len(chosen))
            # The exporter must go before its layout does.
            del exporter
        return {"OUTPUT": str(folder), "FOLDER": str(folder)}
