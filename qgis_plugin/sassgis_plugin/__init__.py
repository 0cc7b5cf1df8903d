"""QGIS plugin: the commands of sassgis as algorithms of the Processing toolbox."""

from __future__ import annotations


def classFactory(iface):
    """Make the plugin; the interface is None where QGIS runs without a window."""
    from .plugin import SassgisPlugin

    return SassgisPlugin(iface)
