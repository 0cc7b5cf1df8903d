"""The provider of the Processing toolbox."""

from __future__ import annotations

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from .environment import MakeEnvironment
from .observation_tools import Calibrate, Diagnose
from .program import PLUGIN_FOLDER, SETTING
from .result_tools import Compare, Export, Sheets
from .run_tools import Batch, Configuration, Profile, Run, Sensitivity, Zone
from .site_tools import Cliffs, DemCheck, Frequency, FromRockyfor3D, NewSite, Validate

#: In the order of the work.
TOOLS = (
    DemCheck, Cliffs, NewSite, FromRockyfor3D, Configuration, Frequency, Validate, Run, Zone,
    Profile, Batch, Sensitivity, Compare, Export, Sheets, Calibrate, Diagnose, MakeEnvironment,
)  # fmt: skip


class SassgisProvider(QgsProcessingProvider):
    """Commands of sassgis, and the tool that makes their environment."""

    def id(self):
        """Name in scripts."""
        return "sassgis"

    def name(self):
        """Name in the toolbox."""
        return "sassgis"

    def longName(self):
        """Name in full."""
        return "sassgis: rockfall hazard zoning"

    def icon(self):
        """Icon in the toolbox."""
        return QIcon(str(PLUGIN_FOLDER / "icon.png"))

    def load(self):
        """Declare the setting, then the algorithms."""
        ProcessingConfig.addSetting(
            Setting(
                self.name(),
                SETTING,
                "Program sassgis (empty: that of 'Make the environment')",
                "",
                valuetype=Setting.FILE,
            )
        )
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self):
        """Take the setting back."""
        ProcessingConfig.removeSetting(SETTING)

    def loadAlgorithms(self):
        """Add each command."""
        for tool in TOOLS:
            self.addAlgorithm(tool())
