"""Open a project to draw in with the real QGIS, draw one feature in each layer, print what it says.

Run by the system's Python: ``/usr/bin/python3 site_probe.py PROJECT.qgz FEATURES.json``.
"""

import json
import os
import sys

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from osgeo import ogr
from qgis import core


def form(layer):
    fields = {}
    for index, column in enumerate(layer.fields()):
        setup = layer.editorWidgetSetup(index)
        fields[column.name()] = {
            "widget": setup.type(), "config": setup.config(), "alias": layer.attributeAlias(index),
            "constraints": int(layer.fieldConstraints(index)),
        }  # fmt: skip
    return fields


def draw(layer, wanted):
    feature = core.QgsFeature(layer.fields())
    feature.setGeometry(core.QgsGeometry.fromWkt(wanted["wkt"]))
    for name, value in wanted["attributes"].items():
        feature.setAttribute(name, value)
    assert layer.startEditing()
    assert layer.addFeature(feature)
    saved = layer.commitChanges()
    return {"saved": saved, "errors": layer.commitErrors()}


def main():
    path, features = sys.argv[1:]
    core.QgsApplication.setPrefixPath("/usr", True)
    application = core.QgsApplication([], False)
    application.initQgis()
    project = core.QgsProject.instance()
    report = {"opened": project.read(path), "crs": project.crs().authid(), "layers": {}}
    with open(features, encoding="utf-8") as file:
        wanted = json.load(file)
    for layer in project.mapLayers().values():
        name = layer.source().partition("layername=")[2] or layer.name()
        facts = {"valid": layer.isValid(), "crs": layer.crs().authid()}
        if isinstance(layer, core.QgsVectorLayer):
            facts["form"] = form(layer)
            if name in wanted:
                facts |= draw(layer, wanted[name])
        report["layers"][name] = facts
    sources = [layer.source() for layer in project.mapLayers().values()]
    data = ogr.Open(next(own for own in sources if "layername" in own).partition("|")[0])
    domain = data.GetFieldDomain("barriers_kind") if hasattr(data, "GetFieldDomain") else None
    report["choices"] = None if domain is None else sorted(domain.GetEnumeration())
    sys.stdout.write(json.dumps(report, default=str) + "\n")
    sys.stdout.flush()
    del layer, domain, data
    project.clear()
    application.exitQgis()


if __name__ == "__main__":
    main()
