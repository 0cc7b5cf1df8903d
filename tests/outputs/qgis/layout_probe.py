"""Open a project in the real QGIS and print as JSON what its print layouts hold.

Run by the system's Python: ``/usr/bin/python3 layout_probe.py PROJECT.qgz``.
"""

import json
import os
import sys

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from qgis import core
from qgis.PyQt.QtCore import QRectF, Qt
from qgis.PyQt.QtGui import QFont, QFontMetricsF, QImage, QPainter


def legend_texts(legend):
    model = legend.model()
    out = []

    def walk(group):
        for child in group.children():
            if hasattr(child, "layerId"):
                nodes = model.layerLegendNodes(child)
                texts = [node.data(0) for node in nodes if not node.isEmbeddedInParent()]
                name = child.customProperty("legend/title-label") or child.name()
                out.append({"layer": name, "texts": [str(t) for t in texts if t is not None]})
            else:
                out.append({"group": child.name()})
                walk(child)

    walk(model.rootGroup())
    return out


def text_size(item, width_mm):
    """Width and height (mm) that the text of a label needs where it may be this wide."""
    # Measured large, as metrics of small type are rounded.
    font = QFont(item.font())
    font.setPixelSize(1000)
    metrics = QFontMetricsF(font)
    mm = item.font().pointSizeF() * 25.4 / 72.0 / 1000.0
    room = QRectF(0, 0, width_mm / mm, 1e9)
    needed = metrics.boundingRect(room, Qt.TextWordWrap, item.currentText())
    return [needed.width() * mm, needed.height() * mm]


def describe(item):
    rect = item.mapRectToScene(item.rect())
    facts = {"id": item.id(), "box": [rect.x(), rect.y(), rect.width(), rect.height()]}
    if isinstance(item, core.QgsLayoutItemLabel):
        facts["text"] = item.currentText()
        facts["needs"] = text_size(item, rect.width())
    elif isinstance(item, core.QgsLayoutItemMap):
        extent = item.extent()
        facts["scale"] = item.scale()
        facts["layers"] = [layer.id() for layer in item.layers()]
        facts["locked"] = item.keepLayerSet()
        corners = ("xMinimum", "yMinimum", "xMaximum", "yMaximum")
        facts["extent"] = [getattr(extent, corner)() for corner in corners]
    elif isinstance(item, core.QgsLayoutItemLegend):
        renderer = core.QgsLegendRenderer(item.model(), item.legendSettings())
        image = QImage(10, 10, QImage.Format_ARGB32)
        for set_dots in (image.setDotsPerMeterX, image.setDotsPerMeterY):
            set_dots(12000)
        painter = QPainter(image)
        context = core.QgsRenderContext.fromQPainter(painter)
        size = renderer.minimumSize(context)
        facts["needs"] = [size.width(), size.height()]
        painter.end()
        del context, painter, renderer
        facts["entries"] = legend_texts(item)
    elif isinstance(item, core.QgsLayoutItemScaleBar):
        facts["units_per_segment"] = item.unitsPerSegment()
        facts["segments"] = item.numberOfSegments()
        facts["unit"] = item.unitLabel()
        facts["map"] = item.linkedMap().id() if item.linkedMap() else None
    elif isinstance(item, core.QgsLayoutItemPicture):
        facts["found"] = not item.isMissingImage()
    return facts


def main():
    application = core.QgsApplication([], False)
    application.initQgis()
    project = core.QgsProject.instance()
    project.read(sys.argv[1])
    report = {"layouts": {}, "themes": {}}
    themes = project.mapThemeCollection()
    for name in themes.mapThemes():
        report["themes"][name] = [layer.id() for layer in themes.mapThemeVisibleLayers(name)]
    for layout in project.layoutManager().printLayouts():
        page = layout.pageCollection().page(0)
        items = [item for item in layout.items() if isinstance(item, core.QgsLayoutItem)]
        assert layout.pageCollection().pageCount() == 1
        assert page.positionWithUnits() == core.QgsLayoutPoint(0, 0)
        report["layouts"][layout.name()] = {
            "page": [page.pageSize().width(), page.pageSize().height()],
            "items": [describe(item) for item in items if item.type() != page.type()],
        }
    sys.stdout.write(json.dumps(report, ensure_ascii=False) + "\n")
    sys.stdout.flush()
    project.clear()
    application.exitQgis()


if __name__ == "__main__":
    main()
