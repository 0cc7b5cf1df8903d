"""The environment of the program: a folder with a Python and libraries of its own."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from qgis.core import QgsProcessingException, QgsProcessingParameterString

from .command import Algorithm, advanced, file
from .program import (
    PLUGIN_FOLDER,
    answer,
    check_program,
    environment_folder,
    in_environment,
    plugin_version,
    run,
)

#: What a Python must have; ensurepip is a package of its own on Debian.
_SUITS = "import sys, venv, ensurepip; print(sys.version_info >= (3, 11))"


def source_of_program() -> str:
    """Where the program comes from: a wheel that lies beside, else the package index."""
    folders = (environment_folder().parent, PLUGIN_FOLDER.parent)
    wheels = [wheel for folder in folders for wheel in sorted(folder.glob("sassgis-*.whl"))]
    return str(wheels[-1]) if wheels else f"sassgis=={plugin_version()}"


def find_python(chosen: str = "") -> list[str]:
    """The command of a Python that can make the environment.

    ``chosen`` is the only one to try; where it is empty those of this machine are, QGIS's own last.

    Raises
    ------
    QgsProcessingException
        If none suits.
    """
    names = ("python3", "python", "python3.13", "python3.12", "python3.11")
    own = [Path(sys.exec_prefix, "python.exe"), Path(sys.executable).parent / "bin" / "python3"]
    candidates = [
        *([found] for found in map(shutil.which, names) if found),
        *([[found, "-3"]] if (found := shutil.which("py")) else []),
        *([str(path)] for path in own if path.is_file()),
    ]
    for command in [[chosen]] if chosen else candidates:
        # Isolated: not from modules in the current folder.
        if answer([*command, "-I", "-c", _SUITS]) == "True":
            return command
    tried = chosen or ", ".join(" ".join(command) for command in candidates) or "none found"
    raise QgsProcessingException(
        f"no Python 3.11 or later with the modules venv and ensurepip (tried: {tried}). Install "
        "one from python.org (Debian and Ubuntu: python3-venv) and enter it as 'Python'."
    )


class MakeEnvironment(Algorithm):
    """Make the environment in which the program runs, or make it anew."""

    NAME = "environment"
    TITLE = "Make the environment"

    def shortHelpString(self):
        """Text beside the dialog."""
        return (
            "Installs the program sassgis and its libraries into a folder of your QGIS profile "
            f"({environment_folder()}). Nothing is installed into QGIS. You need Python 3.11 or "
            "later, and the network for the libraries. Run the tool again to update sassgis, or if "
            "sassgis does not start.\n\n"
            f"Source: a requirement for pip (sassgis=={plugin_version()}), a wheel (a file "
            "sassgis-*.whl) or a folder with the source code."
        )

    def initAlgorithm(self, configuration=None):
        """Declare the parameters."""
        self.addParameter(
            QgsProcessingParameterString(
                "SOURCE", "Source of sassgis: requirement, wheel or folder", source_of_program()
            )
        )
        self.addParameter(advanced(file("PYTHON", "Python 3.11 or later", optional=True)))

    def processAlgorithm(self, parameters, context, feedback):
        """Make a virtual environment and install into it."""
        folder = environment_folder()
        python = find_python(self.parameterAsFile(parameters, "PYTHON", context))
        feedback.setProgressText(f"Environment: {folder}")
        folder.parent.mkdir(parents=True, exist_ok=True)
        run([*python, "-I", "-m", "venv", "--clear", folder], feedback)
        feedback.setProgress(10)
        feedback.setProgressText("Libraries: this takes some minutes")
        source = self.parameterAsString(parameters, "SOURCE", context).strip()
        pip = (in_environment("python"), "-I", "-m", "pip", "--no-input")
        run([*pip, "install", "--disable-pip-version-check", source], feedback)
        check_program(feedback)
        return {"PROGRAM": str(in_environment("sassgis"))}
