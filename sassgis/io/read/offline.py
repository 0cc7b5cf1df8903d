"""Files are read from disks only: none of them makes GDAL fetch another one from a network.

A file of any name may be a list of sources (VRT) or the description of a server (WMS, WFS, ...),
which GDAL follows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pyogrio
import rasterio

#: No web address goes through such a proxy, and no remote file has such a name.
_NO_NETWORK = {
    "GDAL_HTTP_PROXY": "none://offline",
    "GDAL_HTTPS_PROXY": "none://offline",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".offline",
}


@contextmanager
def offline() -> Iterator[None]:
    """Keep rasterio and pyogrio, each with a GDAL of its own, off the network.

    Servers named in the environment variable ``NO_PROXY`` are left out: they can be reached.
    """
    before = {key: pyogrio.get_gdal_config_option(key) for key in _NO_NETWORK}
    pyogrio.set_gdal_config_options(_NO_NETWORK)
    try:
        with rasterio.Env(**_NO_NETWORK):
            yield
    finally:
        pyogrio.set_gdal_config_options(before)
