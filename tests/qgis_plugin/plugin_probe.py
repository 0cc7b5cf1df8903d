"""Load the plugin from its zip into the real QGIS, call its algorithms, print what happened.

Run by the system's Python: ``/usr/bin/python3 plugin_probe.py TASK.json``. The task names the
folder of the unpacked plugin, the program ``sassgis``, and the calls: ``algorithm``,
``parameters``, and ``cancel`` where progress beyond 10 % is answered by cancelling. A parameter
``@FILE|a,b`` is the layer of a file with these features selected.
"""

import json
import os
import signal
import sys
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from qgis import core

LAYERS = []


class Feedback(core.QgsProcessingFeedback):
    """Keeps what is said."""

    def __init__(self, cancel):
        super().__init__(False)
        self.said = {"info": [], "warnings": [], "errors": [], "progress": []}
        self.progressChanged.connect(self.said["progress"].append)
        if cancel:
            self.progressChanged.connect(lambda value: value > 10 and self.cancel())

    def setProgressText(self, text):
        # QGIS writes it to the log, as what is pushed.
        super().setProgressText(text)
        self.said["info"].append(text)

    def pushInfo(self, text):
        self.said["info"].append(text)

    def pushWarning(self, text):
        self.said["warnings"].append(text)

    def reportError(self, text, fatal=False):
        self.said["errors"].append(text)


def value_of(value):
    if not (isinstance(value, str) and value.startswith("@")):
        return value
    file, _, chosen = value[1:].partition("|")
    layer = core.QgsVectorLayer(file, Path(file).stem, "ogr")
    assert layer.isValid(), file
    core.QgsProject.instance().addMapLayer(layer, False)
    LAYERS.append(layer)
    if not chosen:
        return layer
    layer.selectByIds([int(n) for n in chosen.split(",")])
    return core.QgsProcessingFeatureSourceDefinition(layer.id(), True)


def tree(node):
    found = []
    for child in node.children():
        if hasattr(child, "layer"):
            layer = child.layer()
            facts = {"valid": layer.isValid(), "visible": child.isVisible()}
            found.append({**facts, "name": child.name(), "renderer": layer.renderer().type()})
        else:
            facts = {"name": child.name(), "exclusive": child.isMutuallyExclusive()}
            found.append({**facts, "within": tree(child)})
    return found


def call(task):
    import processing

    project = core.QgsProject.instance()
    project.clear()
    feedback = Feedback(task.get("cancel"))
    context = core.QgsProcessingContext()
    context.setProject(project)
    parameters = {k: value_of(v) for k, v in task["parameters"].items()}
    report = {"error": None, "results": None}
    try:
        results = processing.run(task["algorithm"], parameters, context=context, feedback=feedback)
        report["results"] = {k: str(v) for k, v in results.items()}
    except Exception as error:
        report["error"] = f"{type(error).__name__}: {error}"
    return {**report, **feedback.said, "tree": tree(project.layerTreeRoot())}


class Window:
    """What the plugin needs of the window of QGIS."""

    def __init__(self):
        from qgis.gui import QgsMapCanvas
        from qgis.PyQt.QtWidgets import QMainWindow

        self.main, self.canvas, self.menu = QMainWindow(), QgsMapCanvas(), []
        self.canvas.resize(100, 100)

    def mainWindow(self):
        return self.main

    def mapCanvas(self):
        return self.canvas

    def addPluginToMenu(self, menu, action):
        self.menu.append(action.text())

    def removePluginMenu(self, menu, action):
        self.menu.remove(action.text())

    def addDockWidget(self, area, dock):
        self.dock = dock
        self.main.addDockWidget(area, dock)

    def removeDockWidget(self, dock):
        self.main.removeDockWidget(dock)
        self.dock = None

    def addToolBarIcon(self, action):
        pass

    removeToolBarIcon = addToolBarIcon


def drawn(canvas):
    """Numbers of vertices of the lines that the tool of the map window makes of clicks."""
    from qgis.gui import QgsMapMouseEvent
    from qgis.PyQt.QtCore import QEvent, QPoint, Qt
    from sassgis_plugin.draw_line import LineTool

    tool, lines = LineTool(canvas), []
    tool.drawn.connect(lambda geometry: lines.append(len(geometry.asPolyline())))

    def click(button, x):
        tool.canvasReleaseEvent(
            QgsMapMouseEvent(canvas, QEvent.Type.MouseButtonRelease, QPoint(x, x), button)
        )

    left, right = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton
    for x, button in enumerate((left, right, left, left, left, right)):
        click(button, 10 + 10 * x)
    return lines


def states(dock):
    """What the panel says of each step, and which buttons can be pressed."""
    return {
        "next": dock._next.text(),
        "status": {key: label.text() for key, label in dock._status.items()},
        "run": dock.run_button.isEnabled(),
        "zone": dock.zone_button.isEnabled(),
    }


def steps(window, task):
    """Go through the steps of the panel as a user does."""
    from qgis.PyQt.QtCore import QEventLoop, Qt, QTimer
    from qgis.PyQt.QtWidgets import QTableWidgetItem, QTextEdit

    project = core.QgsProject.instance()
    project.clear()
    dock = window.dock
    dock.setVisible(True)
    dock.refresh()
    seen = {"begin": {**states(dock), "auto": dock.auto.isChecked(), "blocks": dock.count.value()}}
    window.main.resize(900, 600)
    window.main.setCentralWidget(QTextEdit())
    window.main.show()
    window.main.resizeDocks([dock], [50], Qt.Orientation.Horizontal)
    core.QgsApplication.processEvents()
    area = dock.widget()
    seen["hidden"] = area.widget().width() - area.viewport().width()
    dock.auto.setChecked(False)
    dem = core.QgsRasterLayer(task["dem"], "terrain")
    layers = {name: core.QgsVectorLayer(file, name, "ogr") for name, file in task["layers"].items()}
    project.addMapLayers([dem, *layers.values()])
    dock.dem.setLayer(dem)
    seen["terrain"] = states(dock)
    dock.release.setLayer(layers["release"])
    dock.ground_layer.setLayer(layers["ground"])
    dock.further["BARRIERS"].setLayer(layers["nets"])
    dock.spacing.setValue(6.0)
    dock.count.setValue(5)
    dock.table.setItem(0, 1, QTableWidgetItem("many"))
    seen["wrong row"] = states(dock)
    dock._add_row()
    for row, texts in enumerate((("small", "0.1", "0.3", "0.2"), ("large", "1", "2", ""))):
        for place, text in enumerate(texts):
            dock.table.setItem(row, place, QTableWidgetItem(text))
    dock.folder.setFilePath(task["folder"])
    seen["ready"] = states(dock)

    def wait(press):
        loop, ended = QEventLoop(), []
        dock.finished.connect(lambda good: (ended.append(good), loop.quit()))
        QTimer.singleShot(600_000, loop.quit)
        press()
        seen.setdefault("busy", states(dock))
        loop.exec() if hasattr(loop, "exec") else loop.exec_()
        return list(ended)

    seen["run ended"] = wait(dock.run_button.click)
    seen["after run"] = {**states(dock), "line": dock.line.text()}
    dock.table.setItem(1, 3, QTableWidgetItem("0.05"))
    dock.further["ROADS"].setLayer(layers["nets"])
    seen["exposed"] = states(dock)
    dock.further["ROADS"].setLayer(None)
    seen["zone ended"] = wait(dock.zone_button.click)
    shown = {"line": dock.line.text(), "share": dock.share_bar.text()}
    sheets = [dock.sheet.itemText(k) for k in range(dock.sheet.count())]
    bar = dock.share_bar.value()
    seen["after zone"] = {**states(dock), **shown, "bar": bar, "sheets": sheets}
    seen["tree"] = tree(project.layerTreeRoot())
    return seen


def main():
    # Deaf to Ctrl-C is whoever is started in the background; so would be what it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    task = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    sys.path[:0] = ["/usr/share/qgis/python/plugins", task["plugins"]]
    core.QgsApplication.setPrefixPath("/usr", True)
    application = core.QgsApplication([], True)
    application.initQgis()
    from processing.core.Processing import Processing
    from processing.core.ProcessingConfig import ProcessingConfig

    Processing.initialize()
    import sassgis_plugin

    window = Window()
    plugin = sassgis_plugin.classFactory(window)
    plugin.initGui()
    ProcessingConfig.setSettingValue("SASSGIS_PROGRAM", task["program"])
    provider = core.QgsApplication.processingRegistry().providerById("sassgis")
    report = {
        "icon": not provider.icon().isNull(),
        "algorithms": {a.name(): list(a.canExecute()) for a in provider.algorithms()},
        "calls": [call(own) for own in task["calls"]],
        "drawn": drawn(window.canvas),
        "steps": steps(window, task["steps"]) if "steps" in task else None,
        "menu": list(window.menu),
    }
    heavy = ("sassgis", "numba", "rasterio", "geopandas")
    report["imported"] = [name for name in heavy if name in sys.modules]
    plugin.unload()
    report["unloaded"] = (
        core.QgsApplication.processingRegistry().providerById("sassgis") is None
        and "SASSGIS_PROGRAM" not in ProcessingConfig.settings
        and window.menu == []
    )
    sys.stdout.write("\n" + json.dumps(report) + "\n")
    sys.stdout.flush()
    # QGIS may fall over its own widgets on the way out.
    os._exit(0)


if __name__ == "__main__":
    main()
