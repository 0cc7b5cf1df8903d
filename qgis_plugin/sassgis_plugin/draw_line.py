"""A tool of the map window with which one line is drawn."""

from __future__ import annotations

from qgis.core import QgsGeometry, QgsPointXY, QgsWkbTypes
from qgis.gui import QgsMapTool, QgsRubberBand
from qgis.PyQt.QtCore import Qt, pyqtSignal
from qgis.PyQt.QtGui import QColor


class LineTool(QgsMapTool):
    """Left clicks add vertices, a right click ends the line, Esc begins anew.

    ``drawn`` is emitted with the geometry, in the coordinates of the map window.
    """

    drawn = pyqtSignal(QgsGeometry)

    def __init__(self, canvas):
        super().__init__(canvas)
        self._points: list[QgsPointXY] = []
        self._band = QgsRubberBand(canvas, QgsWkbTypes.LineGeometry)
        self._band.setColor(QColor(213, 94, 0))
        self._band.setWidth(2)

    def canvasReleaseEvent(self, event):
        """Add a vertex, or end the line."""
        if event.button() == Qt.MouseButton.RightButton:
            points = self._points
            self._begin_anew()
            if len(points) > 1:
                self.drawn.emit(QgsGeometry.fromPolylineXY(points))
            return
        self._points.append(QgsPointXY(event.mapPoint()))
        self._show(self._points)

    def canvasMoveEvent(self, event):
        """Show the line up to the mouse."""
        if self._points:
            self._show([*self._points, QgsPointXY(event.mapPoint())])

    def keyPressEvent(self, event):
        """Begin anew."""
        if event.key() == Qt.Key.Key_Escape:
            self._begin_anew()

    def deactivate(self):
        """Forget a line that was begun."""
        self._begin_anew()
        super().deactivate()

    def _begin_anew(self):
        self._points = []
        self._band.reset(QgsWkbTypes.LineGeometry)

    def _show(self, points):
        self._band.setToGeometry(QgsGeometry.fromPolylineXY(points), None)
