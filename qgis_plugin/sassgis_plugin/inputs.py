"""Files for the program: features of layers, and a configuration made for them.

They lie in the folder ``<result>_inputs``, so that a result can be made again. Equal inputs give
equal bytes, by which the program knows that an interrupted run may go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from qgis.core import (
    QgsFeatureSink,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSource,
    QgsProcessingFeedback,
    QgsVectorFileWriter,
)

from .program import program_path, run


def inputs_folder(out: Path) -> Path:
    """The folder of the inputs of a result."""
    folder = out.with_name(f"{out.name}_inputs")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise QgsProcessingException(f"{folder}: cannot be made ({error.strerror})") from error
    return folder


def copied(
    source: QgsProcessingFeatureSource, out: Path, stem: str, context: QgsProcessingContext
) -> Path:
    """Copy features into a file of their own, in their order.

    FlatGeobuf, since a GeoPackage holds the time at which it was written.

    Raises
    ------
    QgsProcessingException
        If there are none, or the file cannot be written.
    """
    if source.featureCount() == 0:
        raise QgsProcessingException(f"{source.sourceName()}: no feature, or none is selected")
    file = inputs_folder(out) / f"{stem}.fgb"
    options = QgsVectorFileWriter.SaveVectorOptions()
    options.driverName = "FlatGeobuf"
    options.layerOptions = ["SPATIAL_INDEX=NO"]
    writer = QgsVectorFileWriter.create(
        str(file), source.fields(), source.wkbType(), source.sourceCrs(),
        context.transformContext(), options,
    )  # fmt: skip
    written = writer.hasError() == QgsVectorFileWriter.NoError and writer.addFeatures(
        source.getFeatures(), QgsFeatureSink.FastInsert
    )
    if not written:
        raise QgsProcessingException(f"{file}: cannot be written ({writer.errorMessage()})")
    del writer  # It closes the file.
    return file


def written_configuration(
    out: Path,
    dem: str,
    release: Path,
    settings: Sequence[str],
    *,
    replace: bool,
    feedback: QgsProcessingFeedback,
) -> Path:
    """Let the program write a configuration for a terrain model and release areas.

    Parameters
    ----------
    out : Path
        Folder of the result.
    dem : str
    release : Path
    settings : sequence of str
        As ``sassgis init --set`` takes them.
    replace : bool
        Whether one with other settings may be replaced, unless it was edited by hand.
    feedback : QgsProcessingFeedback

    Raises
    ------
    QgsProcessingException
        If the program refuses, or there is another configuration.
    """
    config = inputs_folder(out) / "sassgis.toml"
    new = config.with_name("sassgis.new.toml")
    options = [part for setting in settings for part in ("--set", setting)]
    files = ("--dem", dem, "--release", release)
    arguments = (*files, *options, "--overwrite")
    run([program_path(), "init", new, *arguments], feedback)
    same = config.is_file() and config.read_bytes() == new.read_bytes()
    if config.is_file() and not same and not replace:
        raise QgsProcessingException(
            f"{config}: differs from what would be written (see {new.name}). Give it as the "
            "configuration, choose another folder, or tick 'Replace a result'."
        )
    new.unlink()
    if not same:
        # The program leaves one that was edited by hand as it is.
        run([program_path(), "init", config, *arguments], feedback)
    return config
