"""Results in the project: the layers in their order, with their styles."""

from __future__ import annotations

from pathlib import Path

from qgis.core import (
    Qgis,
    QgsLayerDefinition,
    QgsLayerTreeGroup,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProject,
    QgsProviderRegistry,
    QgsReadWriteContext,
    QgsVectorLayer,
    QgsWkbTypes,
)
from qgis.PyQt.QtCore import QCoreApplication, QThread
from qgis.PyQt.QtXml import QDomDocument

from .steps import verdict


def load_results(
    folder: Path, context: QgsProcessingContext, feedback: QgsProcessingFeedback
) -> None:
    """Load the layers of a result into a group on top of the project of the context."""
    group = _new_group(folder.name, folder, context, feedback)
    if group is None:
        return
    project = context.project()
    projects = [folder / part / "project.qgz" for part in ("", "mosaic", "map")]
    if not projects[0].is_file():
        for file in sorted(folder.glob("*.gpkg")):
            _add_layers(file, project, group)
    for file in projects:
        if file.is_file():
            _take_over(file, project, group)
            feedback.pushInfo(f"{file} has the same layers, and map sheets to print.")
    if not group.children():
        project.layerTreeRoot().removeChildNode(group)
    broken = [node.name() for node in group.findLayers() if not node.layer().isValid()]
    if broken:
        feedback.pushWarning(f"These layers cannot be read: {', '.join(broken)}")


def project_layers(
    file: Path, context: QgsProcessingContext, feedback: QgsProcessingFeedback
) -> None:
    """Load the layers of a GeoPackage into a group on top of the project."""
    group = _new_group(file.stem, file, context, feedback)
    if group is not None:
        _add_layers(file, context.project(), group)


def _new_group(
    name: str, place: Path, context: QgsProcessingContext, feedback: QgsProcessingFeedback
) -> QgsLayerTreeGroup | None:
    """A group on top of the project; None from within a model, which says where the layers are."""
    project = context.project()
    if project is None or QThread.currentThread() != QCoreApplication.instance().thread():
        feedback.pushInfo(f"Layers are not loaded from within a model: see {place}")
        return None
    return project.layerTreeRoot().insertGroup(0, name)


def _add_layers(file: Path, project: QgsProject, group: QgsLayerTreeGroup) -> None:
    """Add the layers of a GeoPackage to a group of the project."""
    for layer in layers_in(file):
        project.addMapLayer(layer, False)
        group.addLayer(layer)


def say_of_zones(share: float, feedback: QgsProcessingFeedback) -> None:
    """Say how far the zones are settled: in the log, and on top of the map window."""
    grade, text = verdict(share)
    (feedback.pushInfo if grade == "good" else feedback.pushWarning)(text)
    from qgis.utils import iface

    if iface is not None and hasattr(iface, "messageBar"):
        level = {"good": Qgis.Success, "look": Qgis.Warning, "bad": Qgis.Critical}[grade]
        iface.messageBar().pushMessage("sassgis", text, level, 0)


def _take_over(file: Path, project: QgsProject, group: QgsLayerTreeGroup) -> None:
    """Copy the layers of a project file with their order, groups and visibility."""
    source = QgsProject()
    source.read(str(file))
    document = QDomDocument("qgis-layer-definition")
    context = QgsReadWriteContext()
    nodes = source.layerTreeRoot().children()
    QgsLayerDefinition.exportLayerDefinition(document, nodes, context)
    QgsLayerDefinition.loadLayerDefinition(document, project, group, context)


def layers_in(file: Path) -> list[QgsVectorLayer]:
    """Layers with geometry of a GeoPackage; each brings its style along."""
    found = [
        QgsVectorLayer(part.uri(), part.name(), part.providerKey())
        for part in QgsProviderRegistry.instance().querySublayers(str(file))
    ]
    return [layer for layer in found if layer.wkbType() != QgsWkbTypes.NoGeometry]
