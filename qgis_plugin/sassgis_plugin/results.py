"""Results in the project: the layers in their order, with their styles."""

from __future__ import annotations

from pathlib import Path

from qgis.core import (
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


def load_results(
    folder: Path, context: QgsProcessingContext, feedback: QgsProcessingFeedback
) -> None:
    """Load the layers of a result into a group on top of the project.

    Parameters
    ----------
    folder : Path
    context : QgsProcessingContext
        Its project takes them.
    feedback : QgsProcessingFeedback
    """
    project = context.project()
    if project is None or QThread.currentThread() != QCoreApplication.instance().thread():
        feedback.pushInfo(f"Layers are not loaded from within a model: see {folder}")
        return
    group = project.layerTreeRoot().insertGroup(0, folder.name)
    projects = [folder / part / "project.qgz" for part in ("", "mosaic", "map")]
    if not projects[0].is_file():
        for layer in _layers_of(folder):
            project.addMapLayer(layer, False)
            group.addLayer(layer)
    for file in projects:
        if file.is_file():
            _take_over(file, project, group)
            feedback.pushInfo(f"{file} holds these layers too, with its sheets to print.")
    if not group.children():
        project.layerTreeRoot().removeChildNode(group)
    broken = [node.name() for node in group.findLayers() if not node.layer().isValid()]
    if broken:
        feedback.pushWarning(f"These layers cannot be read: {', '.join(broken)}")


def _take_over(file: Path, project: QgsProject, group: QgsLayerTreeGroup) -> None:
    """Copy the layers of a project file with their order, groups and visibility."""
    source = QgsProject()
    source.read(str(file))
    document = QDomDocument("qgis-layer-definition")
    context = QgsReadWriteContext()
    nodes = source.layerTreeRoot().children()
    QgsLayerDefinition.exportLayerDefinition(document, nodes, context)
    QgsLayerDefinition.loadLayerDefinition(document, project, group, context)


def _layers_of(folder: Path) -> list[QgsVectorLayer]:
    """Layers of GeoPackages; each brings its style along."""
    registry = QgsProviderRegistry.instance()
    found = [
        QgsVectorLayer(part.uri(), part.name(), part.providerKey())
        for file in sorted(folder.glob("*.gpkg"))
        for part in registry.querySublayers(str(file))
    ]
    return [layer for layer in found if layer.wkbType() != QgsWkbTypes.NoGeometry]
