"""What the plugin adds to QGIS: a provider, a menu, a panel, a tool to draw a profile."""

from __future__ import annotations

from functools import partial

from qgis.core import QgsApplication, QgsFeature, QgsProject, QgsVectorLayer
from qgis.PyQt.QtGui import QIcon

try:  # Qt 6 has moved it.
    from qgis.PyQt.QtGui import QAction
except ImportError:
    from qgis.PyQt.QtWidgets import QAction

from .dock import AREA, SiteDock
from .draw_line import LineTool
from .program import PLUGIN_FOLDER
from .provider import SassgisProvider

_MENU = "sassgis"


class SassgisPlugin:
    """The plugin, as QGIS loads and unloads it."""

    def __init__(self, iface):
        self._iface = iface
        self._provider = None
        self._actions = []
        self._tool = None
        self._dialog = None
        self._dock = None

    def initProcessing(self):
        """Add the provider; all that there is without a window."""
        self._provider = SassgisProvider()
        QgsApplication.processingRegistry().addProvider(self._provider)

    def initGui(self):
        """Add the provider and the menu."""
        self.initProcessing()
        self._dock = SiteDock(self._iface.mainWindow(), self._open)
        self._iface.addDockWidget(AREA, self._dock)
        self._dock.hide()
        site = self._add_action("Site: the work step by step", self._toggle)
        self._iface.addToolBarIcon(site)
        for command in ("run", "zone", "environment"):
            algorithm = self._provider.algorithm(command)
            self._add_action(f"{algorithm.displayName()} ...", partial(self._open, command))
        draw = self._add_action("Draw a profile", self._draw)
        draw.setCheckable(True)
        self._iface.addToolBarIcon(draw)
        self._tool = LineTool(self._iface.mapCanvas())
        self._tool.setAction(draw)
        self._tool.drawn.connect(self._profile)

    def unload(self):
        """Take away what was added."""
        for action in self._actions:
            self._iface.removePluginMenu(_MENU, action)
            self._iface.removeToolBarIcon(action)
        if self._dock is not None:
            self._iface.removeDockWidget(self._dock)
            self._dock.deleteLater()
        if self._tool is not None:
            self._iface.mapCanvas().unsetMapTool(self._tool)
        QgsApplication.processingRegistry().removeProvider(self._provider)

    def _add_action(self, text, slot):
        action = QAction(QIcon(str(PLUGIN_FOLDER / "icon.png")), text, self._iface.mainWindow())
        action.triggered.connect(lambda *_: slot())
        self._iface.addPluginToMenu(_MENU, action)
        self._actions.append(action)
        return action

    def _open(self, command, parameters=None):
        import processing

        self._dialog = processing.createAlgorithmDialog(f"sassgis:{command}", parameters or {})
        if self._dock is not None:
            self._dialog.algorithmFinished.connect(self._dock.refresh)
        self._dialog.show()

    def _toggle(self):
        self._dock.setVisible(not self._dock.isVisible())
        self._dock.refresh()

    def _draw(self):
        self._iface.mapCanvas().setMapTool(self._tool)
        self._iface.messageBar().pushInfo(
            "sassgis", "Click along the profile, downwards; right click ends it, Esc begins anew."
        )

    def _profile(self, geometry):
        """Put a drawn line into a layer and open the dialog with it."""
        system = self._iface.mapCanvas().mapSettings().destinationCrs()
        layer = QgsVectorLayer("LineString", "Profile line", "memory")
        layer.setCrs(system)
        feature = QgsFeature()
        feature.setGeometry(geometry)
        layer.dataProvider().addFeature(feature)
        QgsProject.instance().addMapLayer(layer)
        self._open("profile", {"LINE": layer.id()})
