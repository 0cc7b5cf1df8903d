"""Open a project in the real QGIS and print as JSON what QGIS makes of it.

Run by the system's Python, which has QGIS: ``/usr/bin/python3 probe.py PROJECT.qgz PICTURE.png``.
With ``--at X,Y`` (repeatable, map units) the colours of the picture there are printed too; with
``--alone PATH`` (repeatable) a raster, or ``FILE.gpkg|layername=NAME``, is opened by itself to see
the style that it brings along. ``--only NAME`` (repeatable) draws these layers in place of those
that the project shows.
"""

import argparse
import json
import os
import sys

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from qgis.core import (
    QgsApplication,
    QgsLayerTreeGroup,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsProject,
    QgsRasterLayer,
    QgsReferencedRectangle,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

WIDTH = 1000


def described(entry):
    return {"label": entry.label(), "colour": entry.symbol().color().name()}


def describe_renderer(layer):
    renderer = layer.renderer()
    if renderer is None:
        return {"type": None}
    facts = {"type": renderer.type()}
    if isinstance(layer, QgsRasterLayer):
        if facts["type"] == "singlebandpseudocolor":
            shader = renderer.shader().rasterShaderFunction()
            items = shader.colorRampItemList()
            facts["ramp_type"] = shader.colorRampType()
            facts["items"] = [
                {"value": repr(item.value), "colour": item.color.name(), "label": item.label}
                for item in items
            ]
            facts["transparent"] = [
                [entry.min, entry.max, entry.percentTransparent]
                for entry in renderer.rasterTransparency().transparentSingleValuePixelList()
            ]
        elif facts["type"] == "paletted":
            facts["items"] = [
                {"value": entry.value, "colour": entry.color.name(), "label": entry.label}
                for entry in renderer.classes()
            ]
    elif facts["type"] == "categorizedSymbol":
        facts["column"] = renderer.classAttribute()
        facts["classes"] = [
            {"value": entry.value(), **described(entry)} for entry in renderer.categories()
        ]
    elif facts["type"] == "graduatedSymbol":
        facts["column"] = renderer.classAttribute()
        facts["classes"] = [described(entry) for entry in renderer.ranges()]
    elif facts["type"] == "singleSymbol":
        symbol = renderer.symbol()
        facts["colour"] = symbol.color().name()
        facts["symbol_layers"] = [
            symbol.symbolLayer(i).layerType() for i in range(symbol.symbolLayerCount())
        ]
    return facts


def describe(layer):
    facts = {
        "name": layer.name(),
        "source": layer.source(),
        "valid": layer.isValid(),
        "crs": layer.crs().authid(),
        "abstract": layer.abstract(),
        "renderer": describe_renderer(layer),
    }
    if isinstance(layer, QgsVectorLayer):
        facts["features"] = layer.featureCount()
        facts["aliases"] = {
            field.name(): layer.attributeAlias(i) for i, field in enumerate(layer.fields())
        }
        facts["labels"] = (
            layer.labeling().settings().fieldName
            if layer.labelsEnabled() and layer.labeling()
            else None
        )
    else:
        facts["bands"] = [layer.bandName(i + 1) for i in range(layer.bandCount())]
    return facts


def describe_tree(node):
    out = []
    for child in node.children():
        if isinstance(child, QgsLayerTreeGroup):
            out.append(
                {
                    "group": child.name(),
                    "exclusive": child.isMutuallyExclusive(),
                    "layers": describe_tree(child),
                }
            )
        else:
            out.append({"layer": child.name(), "visible": child.isVisible()})
    return out


def render(project, only):
    canvas = project.viewSettings().defaultViewExtent()
    settings = QgsMapSettings()
    settings.setDestinationCrs(project.crs())
    settings.setBackgroundColor(QColor(255, 255, 255))
    order = project.layerTreeRoot().layerOrder()
    if only:
        shown = [layer for layer in order if layer.name() in only]
    else:
        visible = {
            node.layerId() for node in project.layerTreeRoot().findLayers() if node.isVisible()
        }
        shown = [layer for layer in order if layer.id() in visible]
    settings.setLayers(shown)
    extent = QgsReferencedRectangle(canvas, canvas.crs())
    height = max(1, round(WIDTH * extent.height() / extent.width()))
    settings.setOutputSize(QSize(WIDTH, height))
    settings.setExtent(extent)
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    errors = [error.message for error in job.errors()]
    return job.renderedImage(), settings.mapToPixel(), errors


def background_share(image):
    step = 4
    seen = blank = 0
    colours = set()
    for row in range(0, image.height(), step):
        for column in range(0, image.width(), step):
            seen += 1
            name = image.pixelColor(column, row).name()
            colours.add(name)
            blank += name == "#ffffff"
    return blank / seen, len(colours)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("project")
    parser.add_argument("picture")
    parser.add_argument("--at", action="append", default=[])
    parser.add_argument("--alone", action="append", default=[])
    parser.add_argument("--only", action="append", default=[])
    given = parser.parse_args()

    QgsApplication.setPrefixPath("/usr", True)
    application = QgsApplication([], False)
    application.initQgis()
    project = QgsProject.instance()
    opened = project.read(given.project)
    layers = list(project.mapLayers().values())
    view = project.viewSettings().defaultViewExtent()
    report = {
        "opened": opened,
        "error": project.error(),
        "title": project.title(),
        "crs": project.crs().authid(),
        "crs_valid": project.crs().isValid(),
        "absolute_paths": project.readBoolEntry("Paths", "/Absolute", True)[0],
        "extent": [view.xMinimum(), view.yMinimum(), view.xMaximum(), view.yMaximum()],
        "layers": [describe(layer) for layer in layers],
        "tree": describe_tree(project.layerTreeRoot()),
    }
    if opened:
        image, to_pixel, errors = render(project, given.only)
        image.save(given.picture)
        report["render_errors"] = errors
        report["blank_share"], report["colours"] = background_share(image)
        report["at"] = {}
        for place in given.at:
            x, y = map(float, place.split(","))
            pixel = to_pixel.transform(x, y)
            report["at"][place] = image.pixelColor(int(pixel.x()), int(pixel.y())).name()
    alone = []
    for source in given.alone:
        if ".gpkg" in source:
            layer = QgsVectorLayer(source, "alone", "ogr")
        else:
            layer = QgsRasterLayer(source, "alone", "gdal")
        alone.append(describe(layer))
        del layer
    report["alone"] = alone
    sys.stdout.write(json.dumps(report, ensure_ascii=False) + "\n")
    sys.stdout.flush()

    # QGIS crashes on exit if layers outlive the application.
    layers.clear()
    project.clear()
    application.exitQgis()


if __name__ == "__main__":
    main()
