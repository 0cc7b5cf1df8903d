"""Print the layouts of a project into PDF or PNG files, without a window.

To be run by a Python that has QGIS (Debian's ``/usr/bin/python3`` with ``python3-qgis``), not by
the one that runs sassgis::

    python3 export_layout.py PROJECT.qgz FOLDER [--layout NAME] [--format pdf|png] [--dpi 300]

Without ``--layout`` all layouts are printed, each into a file of its name.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from osgeo import gdal  # type: ignore[import-not-found]
from qgis.core import (  # type: ignore[import-not-found]
    QgsApplication,
    QgsLayoutExporter,
    QgsProject,
    QgsRenderContext,
)


def export(project_file: str, folder: Path, wanted: str, suffix: str, dpi: float) -> None:
    """Print layouts of a project; QGIS must be running. Without ``wanted`` all of them."""
    project = QgsProject.instance()
    if not project.read(project_file):
        raise SystemExit(f"{project_file}: cannot be read ({project.error()})")
    layouts = {layout.name(): layout for layout in project.layoutManager().printLayouts()}
    if wanted and wanted not in layouts:
        names = ", ".join(sorted(layouts)) or "none"
        raise SystemExit(f"{project_file}: no layout {wanted!r}; it has: {names}")
    for name in [wanted] if wanted else layouts:
        safe = "".join(c if c.isalnum() or c in " -_." else "_" for c in name).strip()
        target = folder / f"{safe}.{suffix}"
        exporter = QgsLayoutExporter(layouts[name])
        if suffix == "pdf":
            settings, printed = QgsLayoutExporter.PdfExportSettings(), exporter.exportToPdf
            settings.textRenderFormat = QgsRenderContext.TextFormatAlwaysText
        else:
            settings, printed = QgsLayoutExporter.ImageExportSettings(), exporter.exportToImage
        settings.dpi = dpi
        # QGIS writes a georeference, too, of which GDAL complains for a PNG; QGIS has its own
        # messages.
        gdal.PushErrorHandler("CPLQuietErrorHandler")
        done = printed(str(target), settings)
        gdal.PopErrorHandler()
        if done != QgsLayoutExporter.Success:
            raise SystemExit(f"{target}: cannot be written ({exporter.errorMessage()})")
        sys.stdout.write(f"{target}\n")
        # The exporter must go before its layout does.
        del exporter


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("project")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--layout", default="")
    parser.add_argument("--format", choices=("pdf", "png"), default="pdf")
    parser.add_argument("--dpi", type=float, default=300.0)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    application = QgsApplication([], False)
    application.initQgis()
    try:
        export(given.project, given.folder, given.layout, given.format, given.dpi)
    finally:
        QgsProject.instance().clear()
        application.exitQgis()
