"""A panel that goes through the work on a site in its order, and says what is missing."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

from qgis.core import (
    QgsApplication,
    QgsMapLayerProxyModel,
    QgsProcessingAlgRunnerTask,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProject,
)
from qgis.gui import QgsFileWidget, QgsMapLayerComboBox
from qgis.PyQt.QtCore import Qt, QUrl, pyqtSignal
from qgis.PyQt.QtGui import QDesktopServices
from qgis.PyQt.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDockWidget,
    QDoubleSpinBox,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QSpinBox,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from .command import GROUND_CLASSES
from .program import what_is_missing
from .result_tools import sheets_of
from .run_tools import EXPOSED, FIRST_BLOCKS, PRESETS, REF_WIDTH_M
from .steps import LOOK_SHARE, Scenario, Site, next_step, steps_of, verdict

_COLUMNS = ("Name", "From m³", "To m³", "Per year")
_COLOURS = {"good": "#1b7837", "look": "#b35806", "bad": "#b2182b", "none": "#6b6b6b"}
#: Further layers: parameter of the algorithms, what it is, kind of geometry.
_FURTHER = (
    ("BARRIERS", "Walls, nets, galleries", QgsMapLayerProxyModel.LineLayer),
    ("STATIONS", "Stations", QgsMapLayerProxyModel.LineLayer),
    ("FOREST", "Forest", QgsMapLayerProxyModel.PolygonLayer),
    ("BUILDINGS", "Buildings", QgsMapLayerProxyModel.PolygonLayer),
    ("ROADS", "Roads", QgsMapLayerProxyModel.LineLayer),
    ("PEOPLE", "Places of people", QgsMapLayerProxyModel.PointLayer),
)


#: The last line of a run; warnings that stand in the report and with the zones.
_SUMMARY, _ELSEWHERE = re.compile(r"\d+ blocks"), ("Warning: ", "Note: ")


class _Feedback(QgsProcessingFeedback):
    """Hands on what a command says, from whatever thread."""

    said = pyqtSignal(str)

    def __init__(self):
        super().__init__()
        self.error, self.kept = "", []

    def pushInfo(self, text):
        self.said.emit(text)
        if _SUMMARY.match(text):
            self.kept.append(text)

    def pushWarning(self, text):
        self.said.emit(text)
        if not text.startswith(_ELSEWHERE):
            self.kept.append(text)

    def setProgressText(self, text):
        self.said.emit(text)

    def reportError(self, text, fatalError=False):
        self.error = text


class SiteDock(QDockWidget):
    """The steps from the terrain to the map sheet.

    ``open_tool`` opens the dialog of an algorithm, with parameters.
    """

    finished = pyqtSignal(bool)

    def __init__(self, parent, open_tool):
        super().__init__("sassgis: site", parent)
        self.setObjectName("sassgis_site")
        self._open, self._task, self._feedback = open_tool, None, None
        self._result, self._share, self._sheets = "", None, ()
        self._status: dict[str, QLabel] = {}
        self._body = QVBoxLayout()
        self._next = QLabel()
        self._next.setWordWrap(True)
        self._body.addWidget(self._next)
        for fill in (
            self._program, self._terrain, self._release, self._ground, self._blocks, self._further,
            self._run, self._zones, self._sheet,
        ):  # fmt: skip
            fill()
        self._body.addStretch()
        inner = QWidget()
        inner.setLayout(self._body)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(inner)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setWidget(area)
        self.refresh()

    # -----------------------------------------------------------------------------------------
    # The steps

    def _step(self, key, title):
        """A box with a form and, below, what is missing."""
        box, form, status = QGroupBox(title), QFormLayout(), QLabel()
        form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.WrapLongRows)
        status.setWordWrap(True)
        self._status[key] = status
        outer = QVBoxLayout(box)
        outer.addLayout(form)
        outer.addWidget(status)
        self._body.addWidget(box)
        return form

    def _layers(self, kind):
        """A list of the layers of a kind, with none at first."""
        combo = QgsMapLayerComboBox()
        combo.setFilters(kind)
        combo.setAllowEmptyLayer(True)
        combo.setLayer(None)
        # Long names of layers must not make the panel wide.
        combo.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        combo.setMinimumContentsLength(10)
        combo.layerChanged.connect(self.refresh)
        return combo

    def _buttons(self, form, *buttons):
        """Buttons in a row; each is a text and what it does."""
        row = QHBoxLayout()
        made = []
        for text, slot in buttons:
            button = QPushButton(text)
            button.clicked.connect(lambda *_, slot=slot: slot())
            row.addWidget(button)
            made.append(button)
        form.addRow(row)
        return made

    def _program(self):
        form = self._step("program", "The program sassgis")
        self._buttons(form, ("Make the environment ...", lambda: self._open("environment", {})))

    def _terrain(self):
        form = self._step("terrain", "1  Terrain")
        self.dem = self._layers(QgsMapLayerProxyModel.RasterLayer)
        form.addRow("Terrain model", self.dem)
        self._buttons(form, ("Check it ...", lambda: self._open("dem_check", self._of_dem())))

    def _release(self):
        form = self._step("release", "2  Release areas")
        self.release = self._layers(QgsMapLayerProxyModel.VectorLayer)
        form.addRow("Layer", self.release)
        self._buttons(
            form,
            ("Propose ...", lambda: self._open("cliffs", self._of_dem())),
            ("Draw ...", lambda: self._open("new_site", self._of_dem())),
        )

    def _ground(self):
        form = self._step("ground", "3  Ground")
        self.ground = QComboBox()
        self.ground.addItems(GROUND_CLASSES)
        self.ground.setCurrentText("debris")
        self.ground.currentTextChanged.connect(self.refresh)
        self.ground_layer = self._layers(QgsMapLayerProxyModel.PolygonLayer)
        form.addRow("Class", self.ground)
        form.addRow("Polygons (class)", self.ground_layer)

    def _blocks(self):
        form = self._step("blocks", "4  Blocks")
        self.table = QTableWidget(1, len(_COLUMNS))
        self.table.setHorizontalHeaderLabels(list(_COLUMNS))
        self.table.verticalHeader().hide()
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.table.setMinimumHeight(110)
        for place, text in enumerate(("blocks", "0.5", "2", "")):
            self.table.setItem(0, place, QTableWidgetItem(text))
        self.table.itemChanged.connect(self.refresh)
        form.addRow(self.table)
        self._buttons(form, ("Add scenario", self._add_row), ("Remove scenario", self._remove_row))
        self._buttons(
            form, ("Onset frequencies from volumes ...", lambda: self._open("frequency", {}))
        )
        self.spacing, self.count = QDoubleSpinBox(), QSpinBox()
        self.spacing.setRange(0.01, 10_000.0)
        self.spacing.setValue(5.0)
        self.count.setRange(1, 1_000_000)
        self.count.setValue(FIRST_BLOCKS)
        form.addRow("Spacing of points (m)", self.spacing)
        form.addRow("Blocks per point", self.count)

    def _further(self):
        form = self._step("further", "Protection, forest, objects (if any)")
        self.further = {}
        for name, text, kind in _FURTHER:
            self.further[name] = self._layers(kind)
            form.addRow(text, self.further[name])
        self.vulnerability = QgsFileWidget()
        self.vulnerability.fileChanged.connect(self.refresh)
        form.addRow("Vulnerability (CSV)", self.vulnerability)

    def _run(self):
        form = self._step("run", "5  Run")
        self.folder = QgsFileWidget()
        self.folder.setStorageMode(QgsFileWidget.StorageMode.GetDirectory)
        self.folder.fileChanged.connect(self.refresh)
        form.addRow("Folder of the result", self.folder)
        self.run_button, self.stop_button = self._buttons(
            form, ("Simulate blocks", lambda: self.start("run")), ("Stop", self.stop)
        )
        self.bar, self.line = QProgressBar(), QLabel()
        self.line.setWordWrap(True)
        form.addRow(self.bar)
        form.addRow(self.line)

    def _zones(self):
        form = self._step("zones", "6  Zones")
        self.width_m, self.preset = QDoubleSpinBox(), QComboBox()
        self.width_m.setRange(0.0, 1000.0)
        self.width_m.setSpecialValueText("not stated")
        self.width_m.setValue(REF_WIDTH_M)
        self.width_m.valueChanged.connect(self.refresh)
        self.preset.addItems(PRESETS)
        self.edits = self._layers(QgsMapLayerProxyModel.PolygonLayer)
        self.assessed = self._layers(QgsMapLayerProxyModel.PolygonLayer)
        self.auto = QCheckBox("As many blocks as needed")
        self.auto.setChecked(True)
        form.addRow("Reference width (m)", self.width_m)
        form.addRow("Rules", self.preset)
        form.addRow("Edits by hand", self.edits)
        form.addRow("Assessed area", self.assessed)
        form.addRow(self.auto)
        (self.zone_button,) = self._buttons(form, ("Make zones", lambda: self.start("zone")))
        self.share_bar = QProgressBar()
        self.share_bar.setRange(0, 1000)
        form.addRow(self.share_bar)

    def _sheet(self):
        form = self._step("sheet", "7  Map sheets")
        self.sheet = QComboBox()
        form.addRow("Sheet", self.sheet)
        self.print_button, self.report_button = self._buttons(
            form, ("Print as PDF ...", self._print), ("Open the report", self._report)
        )

    # -----------------------------------------------------------------------------------------
    # What was entered

    def scenarios(self) -> tuple[Scenario, ...]:
        """Rows of the table of blocks that hold anything."""
        rows = []
        for row in range(self.table.rowCount()):
            items = [self.table.item(row, column) for column in range(len(_COLUMNS))]
            texts = ["" if item is None else item.text().strip() for item in items]
            if any(texts):
                rows.append(Scenario(*texts))
        return tuple(rows)

    def site(self) -> Site:
        """What was entered, and what there is already."""
        return Site(
            terrain=self._name(self.dem),
            release=self._name(self.release),
            ground=self.ground.currentText(),
            scenarios=self.scenarios(),
            exposed=any(self._name(self.further[name]) for name in EXPOSED),
            vulnerability=self.vulnerability.filePath(),
            folder=self.folder.filePath(),
            ref_width_m=self.width_m.value(),
            program=what_is_missing(),
            simulated=self._result,
            changed_share=self._share,
            sheets=self._sheets,
        )

    def parameters(self, command: str) -> dict[str, object]:
        """Parameters of the algorithm ``run`` or ``zone``."""
        cells = [
            cell
            for own in self.scenarios()
            for cell in (own.name, own.low_m3, own.high_m3, own.frequency)
        ]
        drawn = {"EDITS": self.edits, "ASSESSED": self.assessed} if command == "zone" else {}
        layers = {"DEM": self.dem, "RELEASE": self.release, "GROUND_LAYER": self.ground_layer}
        chosen = {
            name: combo.currentLayer()
            for name, combo in {**layers, **self.further, **drawn}.items()
            if combo.currentLayer() is not None
        }
        zoning = {
            "REF_WIDTH": self.width_m.value(),
            "PRESET": self.preset.currentText(),
            "AUTO": self.auto.isChecked(),
        }
        vulnerability = self.vulnerability.filePath()
        return {
            **chosen,
            "GROUND": self.ground.currentText(),
            "SCENARIOS": cells,
            "SPACING": self.spacing.value(),
            "BLOCKS": self.count.value(),
            **({"VULNERABILITY": vulnerability} if vulnerability else {}),
            **(zoning if command == "zone" else {}),
            "OUTPUT": self.folder.filePath(),
            "OVERWRITE": True,
        }

    def refresh(self, *_):
        """Say what is missing for each step, and what to do next."""
        steps = steps_of(self.site())
        self._next.setText(f"<b>{next_step(steps)}</b>")
        idle = self._task is None
        for step in steps:
            label = self._status[step.key]
            tick = "✔ " if step.grade == "good" else ""
            done = f"{tick}{step.done}" if step.done else "ready"
            label.setText(f"missing: {step.missing}" if step.missing else done)
            grade = "look" if step.missing else step.grade
            label.setStyleSheet(f"color: {_COLOURS[grade]}")
            if step.key == "program":
                label.parentWidget().setVisible(bool(step.missing))
            if step.key == "run":
                self.run_button.setEnabled(idle and not step.missing)
            if step.key == "zones":
                self.zone_button.setEnabled(idle and not step.missing)
        self.stop_button.setEnabled(not idle)
        self.print_button.setEnabled(bool(self._sheets))
        self.report_button.setEnabled(bool(self._result))
        self._show_share()
        self._fit()

    def _fit(self):
        """Keep the panel so wide that nothing is cut off at its right."""
        area = self.widget()
        bar = area.verticalScrollBar().sizeHint().width() + 2 * area.frameWidth()
        area.setMinimumWidth(area.widget().minimumSizeHint().width() + bar)

    def _show_share(self):
        share = self._share or 0.0
        self.share_bar.setVisible(self._share is not None)
        self.share_bar.setValue(round(1000.0 * share))
        self.share_bar.setFormat(f"changes level with another seed: {100.0 * share:.1f} %")
        self.share_bar.setStyleSheet(
            f"QProgressBar::chunk {{ background: {_COLOURS[verdict(share)[0]]} }}"
            " QProgressBar { text-align: center; }"
        )
        self.share_bar.setToolTip(f"Up to {100.0 * LOOK_SHARE:.0f} % is good enough.")

    # -----------------------------------------------------------------------------------------
    # What is done

    def start(self, command: str):
        """Run a command; the window stays free."""
        algorithm = QgsApplication.processingRegistry().algorithmById(f"sassgis:{command}")
        self._context = QgsProcessingContext()
        self._context.setProject(QgsProject.instance())
        self._feedback = _Feedback()
        self._feedback.said.connect(self.line.setText)
        self._feedback.progressChanged.connect(lambda value: self.bar.setValue(round(value)))
        self.bar.setValue(0)
        self._tell("Starting")
        self._task = QgsProcessingAlgRunnerTask(
            algorithm, self.parameters(command), self._context, self._feedback
        )
        self._task.executed.connect(partial(self._ended, self.folder.filePath()))
        self.refresh()
        QgsApplication.taskManager().addTask(self._task)

    def stop(self):
        """Ask the command to stop; what was computed is kept."""
        if self._feedback is not None:
            self._feedback.cancel()

    def _tell(self, text, grade="none"):
        self.line.setText(text)
        self.line.setStyleSheet(f"color: {_COLOURS[grade]}")

    def _ended(self, folder, successful, results):
        self._task = None
        said = self._feedback
        if successful:
            self._tell("\n".join(said.kept))
            self.bar.setValue(100)
            self._result, self._share = folder, results.get("CHANGED_SHARE")
            self._sheets = tuple(sheets_of(Path(folder)))
            self.sheet.clear()
            self.sheet.addItems(self._sheets)
        else:
            self._tell(said.error or self.line.text(), "bad")
        self.refresh()
        self.finished.emit(bool(successful))

    def _print(self):
        self._open("sheets", {"RESULT": self._result, "SHEET": self.sheet.currentText()})

    def _report(self):
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(Path(self._result) / "report.html")))

    def _add_row(self):
        self.table.insertRow(self.table.rowCount())
        self.refresh()

    def _remove_row(self):
        row = self.table.currentRow()
        self.table.removeRow(row if row >= 0 else self.table.rowCount() - 1)
        self.refresh()

    def _of_dem(self):
        layer = self.dem.currentLayer()
        return {} if layer is None else {"DEM": layer.id()}

    @staticmethod
    def _name(combo) -> str:
        layer = combo.currentLayer()
        return "" if layer is None else layer.name()


#: Where the panel is put at first.
AREA = Qt.DockWidgetArea.RightDockWidgetArea
