"""Files for the program: layers in a GeoPackage of the site, and a configuration made for them.

They lie in the folder ``<result>_inputs``, so that a result can be made again. Equal inputs give
equal bytes, by which the program knows that an interrupted run may go on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from osgeo import gdal
from qgis.core import (
    QgsFeature,
    QgsFeatureSink,
    QgsFields,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSource,
    QgsProcessingFeedback,
    QgsVectorFileWriter,
)

from .program import program_path, run

#: Layers of a site and their columns, as ``sassgis new`` writes them and ``sassgis init`` finds
#: them again.
SITE_LAYERS: Mapping[str, tuple[str, ...]] = {
    "stations": ("name",),
    "barriers": (
        "name", "kind", "height_m", "capacity_kj", "width_m", "roof_slope_deg", "cushion_kpa",
    ),
    "buildings": ("name", "value", "persons", "presence"),
    "roads": (
        "name", "value_per_m", "damage_length_m", "traffic_per_day", "speed_kmh",
        "vehicle_length_m", "persons_per_vehicle", "vehicle_value", "trips_per_day",
    ),
    "lines": ("name", "value_per_m", "damage_length_m"),
    "people": ("name", "persons", "presence"),
    "release_areas": ("name", "scenario"),
    "forest": ("stems_per_ha", "dbh_cm"),
    "ground": ("class",),
    "edits": ("level", "limit", "author", "date", "reason", "computed"),
    "assessed_area": (),
}  # fmt: skip
#: Columns that the features of a layer must have.
NEEDED: Mapping[str, tuple[str, ...]] = {
    "barriers": ("kind", "height_m"), "forest": ("stems_per_ha", "dbh_cm"), "ground": ("class",),
    "edits": ("level", "author", "date", "reason"),
}  # fmt: skip
#: A GeoPackage holds the time at which it was written; this one in every.
_MOMENT = "2000-01-01T00:00:00.000Z"


def inputs_folder(out: Path) -> Path:
    """The folder of the inputs of a result."""
    folder = out.with_name(f"{out.name}_inputs")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise QgsProcessingException(f"{folder}: cannot be made ({error.strerror})") from error
    return folder


def columns_of(
    layer: str, source: QgsProcessingFeatureSource, renamed: Mapping[str, str]
) -> dict[str, int]:
    """Positions of the fields of a source that are columns of a layer of the site, by column.

    ``renamed`` are fields that the user chose, by column.

    Raises
    ------
    QgsProcessingException
        A column that is needed is not there.
    """
    fields = source.fields()
    places = {fields.at(i).name().lower(): i for i in range(fields.count())}
    found = {}
    for column in SITE_LAYERS[layer]:
        at = places.get((renamed.get(column) or column).lower())
        if at is not None:
            found[column] = at
    missing = [column for column in NEEDED.get(layer, ()) if column not in found]
    if missing:
        raise QgsProcessingException(
            f"{source.sourceName()}: no attribute {' and '.join(missing)} (there are "
            f"{', '.join(fields.names()) or 'none'}; expected {', '.join(SITE_LAYERS[layer])})"
        )
    return found


def copied(
    file: Path,
    layer: str,
    source: QgsProcessingFeatureSource,
    columns: Mapping[str, int],
    context: QgsProcessingContext,
) -> None:
    """Copy features, in their order, into a layer of a GeoPackage.

    Raises
    ------
    QgsProcessingException
        If there are none, or the file cannot be written.
    """
    if source.featureCount() == 0:
        raise QgsProcessingException(f"{source.sourceName()}: no feature, or none is selected")
    options = QgsVectorFileWriter.SaveVectorOptions()
    options.driverName, options.layerName = "GPKG", layer
    options.actionOnExistingFile = (
        QgsVectorFileWriter.CreateOrOverwriteLayer
        if file.exists()
        else QgsVectorFileWriter.CreateOrOverwriteFile
    )
    fields = QgsFields()
    for column, place in columns.items():
        field = source.fields().at(place)
        field.setName(column)
        fields.append(field)
    before = gdal.GetConfigOption("OGR_CURRENT_DATE")
    gdal.SetConfigOption("OGR_CURRENT_DATE", _MOMENT)
    try:
        writer = QgsVectorFileWriter.create(
            str(file), fields, source.wkbType(), source.sourceCrs(), context.transformContext(),
            options,
        )  # fmt: skip
        written = writer.hasError() == QgsVectorFileWriter.NoError
        for own in source.getFeatures():
            feature = QgsFeature(fields)
            feature.setGeometry(own.geometry())
            feature.setAttributes([own.attribute(place) for place in columns.values()])
            written = written and writer.addFeature(feature, QgsFeatureSink.FastInsert)
        problem = writer.errorMessage()
        del writer  # It closes the file.
    finally:
        gdal.SetConfigOption("OGR_CURRENT_DATE", before)
    if not written:
        raise QgsProcessingException(f"{file}: cannot be written ({problem})")


def written_configuration(
    out: Path,
    arguments: Sequence[object],
    settings: Sequence[str],
    *,
    replace: bool,
    feedback: QgsProcessingFeedback,
) -> Path:
    """Let the program write a configuration for the inputs of the result in a folder.

    Arguments of ``sassgis init`` are terrain model and release areas; settings are as its option
    ``--set`` takes them. With ``replace`` one with other settings is replaced, unless it was edited
    by hand.

    Raises
    ------
    QgsProcessingException
        If the program refuses, or there is another configuration.
    """
    config = inputs_folder(out) / "sassgis.toml"
    new = config.with_name("sassgis.new.toml")
    options = [part for setting in settings for part in ("--set", setting)]
    words = (*arguments, *options, "--overwrite")
    run([program_path(), "init", new, *words], feedback)
    same = config.is_file() and config.read_bytes() == new.read_bytes()
    if config.is_file() and not same and not replace:
        raise QgsProcessingException(
            f"{config}: differs from what would be written (see {new.name}). Give it as the "
            "configuration, choose another folder, or tick 'Replace a result'."
        )
    new.unlink()
    if not same:
        # The program leaves one that was edited by hand as it is.
        run([program_path(), "init", config, *words], feedback)
    return config


def site_package(
    out: Path,
    layers: Mapping[str, tuple[QgsProcessingFeatureSource, Mapping[str, int]]],
    context: QgsProcessingContext,
) -> Path:
    """Write layers (sources and their columns) into the GeoPackage of the inputs of a result."""
    file = inputs_folder(out) / "site.gpkg"
    new = file.with_name("site.new.gpkg")
    new.unlink(missing_ok=True)
    for name, (source, columns) in layers.items():
        copied(new, name, source, columns, context)
    new.replace(file)
    return file
