"""The program ``sassgis`` in an environment of its own: where it is, and how it is run.

Nothing of it is imported: its libraries would meet those of QGIS in one process.
"""

from __future__ import annotations

import configparser
import os
import queue
import re
import signal
import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsApplication, QgsProcessingException, QgsProcessingFeedback

PLUGIN_FOLDER = Path(__file__).parent
#: Key of the setting that names another program than that of the environment.
SETTING = "SASSGIS_PROGRAM"
#: Variables with which QGIS points its own Python, GDAL and PROJ to their files.
_OF_QGIS = ("GDAL_DATA", "GDAL_DRIVER_PATH", "PROJ_DATA", "PROJ_LIB", "PYTHONHOME", "PYTHONPATH",
            "PYTHONSTARTUP", "__PYVENV_LAUNCHER__")  # fmt: skip
_PROGRESS = re.compile(r"\s*(\d+) %, ")
#: For saving its state, a program that is asked to stop has this long (s).
_PATIENCE_S = 60.0
_WINDOWS = os.name == "nt"


def plugin_version() -> str:
    """The version of the plugin, which is that of the program it was made with."""
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read(PLUGIN_FOLDER / "metadata.txt", encoding="utf-8")
    return metadata["general"]["version"]


def environment_folder() -> Path:
    """The environment in the folder of the user's profile."""
    return Path(QgsApplication.qgisSettingsDirPath()) / "sassgis" / "environment"


def in_environment(name: str) -> Path:
    """A program of the environment."""
    folder = environment_folder()
    return folder / "Scripts" / f"{name}.exe" if _WINDOWS else folder / "bin" / name


def program_path() -> Path:
    """The program ``sassgis``: that of the setting, else that of the environment."""
    chosen = ProcessingConfig.getSetting(SETTING)
    return Path(chosen) if chosen else in_environment("sassgis")


def what_is_missing() -> str:
    """Why the program cannot be started, with the remedy; empty if it is there."""
    path = program_path()
    if path.is_file():
        return ""
    if ProcessingConfig.getSetting(SETTING):
        return (
            f"{path}: there is no such program. Correct it under Settings > Options > Processing > "
            "Providers > sassgis, or leave it empty."
        )
    return (
        f"The program sassgis is not installed ({path}). Run 'Make the environment' of the "
        "provider sassgis in the Processing toolbox, or enter a program under Settings > Options > "
        "Processing > Providers > sassgis."
    )


def check_program(feedback: QgsProcessingFeedback) -> None:
    """See that the program starts; warn if its version is not that of the plugin.

    Raises
    ------
    QgsProcessingException
        If it is missing or does not start.
    """
    missing = what_is_missing()
    if missing:
        raise QgsProcessingException(missing)
    path = program_path()
    said = answer([path, "--version"])
    if not said:
        raise QgsProcessingException(
            f"{path}: does not start. Make the environment anew, or correct the setting of the "
            "provider sassgis."
        )
    found = said.split()[-1]
    if found != plugin_version():
        feedback.pushWarning(
            f"sassgis {found} is installed; the plugin has version {plugin_version()}. If a tool "
            "fails, make the environment anew or update the plugin."
        )


def answer(command: Sequence[object]) -> str:
    """What a short command prints; empty if it fails or does not start."""
    try:
        done = subprocess.run(
            [str(word) for word in command], stdin=subprocess.DEVNULL, capture_output=True,
            text=True, timeout=120, check=True, env=_surroundings(), **_window(),
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def run(command: Sequence[object], feedback: QgsProcessingFeedback) -> list[str]:
    """Run a command to its end; its lines go to the log, its progress to the bar.

    Returns the lines, without those of the progress. Where the user cancels, the command is asked
    to stop, as by Ctrl-C, so that it saves its state.

    Raises
    ------
    QgsProcessingException
        If it fails, with the one line that it gave; if it was cancelled.
    """
    words = [str(word) for word in command]
    feedback.pushCommandInfo(" ".join(f'"{w}"' if " " in w else w for w in words))
    try:
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, encoding="utf-8", errors="replace", env=_surroundings(),
            start_new_session=not _WINDOWS, **_window(),
        )  # fmt: skip
    except OSError as error:
        raise QgsProcessingException(f"{words[0]}: does not start ({error})") from error
    # Reading waits for the next line: it must not keep the user from cancelling.
    lines: queue.Queue[str | None] = queue.Queue()
    threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
    error = last = ""
    said: list[str] = []
    while not feedback.isCanceled():
        try:
            line = lines.get(timeout=0.1)
        except queue.Empty:
            continue
        if line is None:
            break
        last = line.strip() or last
        if line.lower().startswith("error: "):
            error = line[len("error: ") :]
        elif _report(line, feedback):
            said.append(line)
    else:
        _stop(process)
        raise QgsProcessingException("Stopped. Run the tool again with the same folder to resume.")
    code = process.wait()
    # A check that finds faults ends with 1 and its answer, without an error.
    if error or code not in (0, 1):
        raise QgsProcessingException(error or f"{words[0]} ended with code {code}; {last}")
    return said


def _read(stream, lines) -> None:
    with stream:
        for line in stream:
            lines.put(line.rstrip())
    lines.put(None)


def _report(line: str, feedback: QgsProcessingFeedback) -> bool:
    """Show a line; whether it is one of the answer."""
    progress = _PROGRESS.match(line)
    if progress:
        feedback.setProgress(int(progress.group(1)))
        feedback.setProgressText(line.strip())
        return False
    if line.endswith(" ..."):
        feedback.setProgressText(line)
        return False
    if line.startswith(("Warning: ", "Note: ")):
        feedback.pushWarning(line)
    elif line:
        feedback.pushInfo(line)
    return bool(line)


def _stop(process: subprocess.Popen) -> None:
    if _WINDOWS:  # There is no Ctrl-C for a program without a console: the last saved state stays.
        kill = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
        subprocess.run(kill, capture_output=True, check=False, **_window())
        process.wait()
        return
    process.send_signal(signal.SIGINT)
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _surroundings() -> dict[str, str]:
    """Environment variables without those of QGIS's own Python."""
    kept = {k: v for k, v in os.environ.items() if k not in _OF_QGIS}
    return {**kept, "PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "SASSGIS_PROGRESS_S": "1"}


def _window() -> dict[str, int]:
    return {"creationflags": subprocess.CREATE_NO_WINDOW} if _WINDOWS else {}
