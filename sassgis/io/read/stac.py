"""Tiles of a terrain model that a STAC interface offers.

STAC (https://stacspec.org) lists items, each with a place, a time and files (assets). That of
swisstopo is at https://data.geo.admin.ch/api/stac; its collection of heights is swissALTI3D.
"""

from __future__ import annotations

import http.client
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlencode, urljoin, urlsplit
from urllib.request import Request, urlopen

import geopandas as gpd
import shapely

from sassgis.io.read.vector_features import open_layer
from sassgis.model.errors import InputError

SERVER = "https://data.geo.admin.ch/api/stac/v1"
COLLECTION = "ch.swisstopo.swissalti3d"
#: Items on a page, and pages at most: no area that one fetches has more.
_ITEMS, _PAGES = 100, 1000
#: No answer of a search is larger (bytes).
_LARGEST_ANSWER = 50_000_000
#: ``swissalti3d_2019_2501-1120``: what is offered, the year, and the square kilometre.
_ITEM_NAME = re.compile(r"^(?P<what>.+)_(?P<year>\d{4})_(?P<place>\d+-\d+)$")
_FILE_NAME = re.compile(r"^[\w.+-]+\.tiff?$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class TileOffer:
    """A tile that can be fetched."""

    name: str  # of its file
    href: str
    place: str  # the same for all editions of a tile
    date: str  # of the edition
    resolution_m: float
    checksum: str  # as multihash in hexadecimal digits; empty if none is stated


class NoAnswer(InputError):
    """Raised when a server cannot be reached or stops to answer; another try may help."""


@contextmanager
def opened(url: str, timeout_s: float, headers: dict[str, str] | None = None) -> Iterator[Any]:
    """Open a web address, which begins with ``http://`` or ``https://``.

    NoAnswer also takes the place of what fails inside the block while the answer is read. The next
    bytes are waited for no longer than ``timeout_s``.
    """
    if urlsplit(url).scheme not in ("http", "https"):
        raise InputError("is no web address", file=url, expected="http://... or https://...")
    host = urlsplit(url).netloc
    request = Request(url, headers={"User-Agent": "sassgis", **(headers or {})})
    try:
        with urlopen(request, timeout=timeout_s) as answer:
            yield answer
    except HTTPError as error:
        with error:
            busy = error.code >= 500 or error.code == 429
            kind = NoAnswer if busy else InputError
            raise kind(
                "the server is busy or out of order" if busy else "the server refuses", file=url,
                found=f"HTTP {error.code} {error.reason}",
                expected="try again later" if busy else "an address that exists",
            ) from None  # fmt: skip
    except (URLError, TimeoutError, http.client.HTTPException, ConnectionError) as error:
        reason = error.reason if isinstance(error, URLError) else error
        found = str(reason) or type(reason).__name__
        if isinstance(reason, TimeoutError):
            found = f"nothing for {timeout_s:g} s"
        expected = "a connection to the internet"
        raise NoAnswer(f"no answer from {host}", file=url, found=found, expected=expected) from None


def get_json(url: str, timeout_s: float) -> Any:
    """The answer of a server as JSON."""
    with opened(url, timeout_s) as answer:
        text = answer.read(_LARGEST_ANSWER)
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(
            "does not answer in JSON", file=url, found=repr(text[:60]), expected="a STAC interface"
        ) from None


def read_search_area(file: Path, layer: str | None = None) -> Any:
    """The polygons of a file, or of a layer of it, as one geometry in WGS 84 (degrees)."""
    frame: gpd.GeoDataFrame = open_layer(file, layer, "polygon", {})
    if frame.crs is None:
        raise InputError(
            "has no coordinate system", file=file, expected="one, so that it can be found on Earth"
        )
    shapes = [g for g in frame.to_crs("EPSG:4326").geometry if g is not None and not g.is_empty]
    kinds = sorted({g.geom_type for g in shapes} - {"Polygon", "MultiPolygon"})
    if kinds or not shapes:
        raise InputError(
            "holds no polygons", file=file, found=", ".join(kinds) or "nothing",
            expected="the area as polygons",
        )  # fmt: skip
    return shapely.union_all([shapely.force_2d(shapely.make_valid(g)) for g in shapes])


def find_tiles(
    area: Any,
    resolution_m: float,
    *,
    server: str = SERVER,
    collection: str = COLLECTION,
    timeout_s: float = 30.0,
) -> tuple[TileOffer, ...]:
    """The tiles over an area, of each the newest edition, by place.

    The area is a shapely geometry in longitude and latitude, the resolution the size of the cells
    (m).
    """
    west, south, east, north = area.bounds
    query = urlencode(
        {"bbox": f"{west:.7f},{south:.7f},{east:.7f},{north:.7f}", "limit": _ITEMS}, safe=","
    )
    url = f"{server.rstrip('/')}/collections/{collection}/items?{query}"
    offers: list[TileOffer] = []
    others: set[float] = set()
    for item in _items(url, timeout_s):
        if not _over(item, area):
            continue
        for offer in _offers(item, url):
            if abs(offer.resolution_m - resolution_m) < 1e-6:
                offers.append(offer)
            else:
                others.add(offer.resolution_m)
    if not offers:
        raise InputError(
            "offers no tile of this resolution here" if others else "offers no tile here",
            file=server,
            found=f"cells of {', '.join(f'{r:g}' for r in sorted(others))} m" if others
            else f"nothing over {west:.4f}, {south:.4f} to {east:.4f}, {north:.4f}",
            expected="another --resolution" if others else "a polygon in the area of the data",
        )  # fmt: skip
    newest = {o.place: o for o in sorted(offers, key=lambda o: (o.date, o.name))}
    return tuple(newest[place] for place in sorted(newest))


def _items(url: str, timeout_s: float) -> Iterator[dict[str, Any]]:
    """The items of all pages."""
    seen: set[str] = set()
    while url:
        if url in seen or len(seen) >= _PAGES:
            raise InputError(
                "its pages do not end", file=url, found=f"{len(seen)} pages",
                expected="a smaller polygon, or a server whose last page has no next one",
            )  # fmt: skip
        seen.add(url)
        page = get_json(url, timeout_s)
        if not isinstance(page, dict) or not isinstance(page.get("features"), list):
            raise InputError(
                "does not answer as a STAC interface", file=url, expected="a page with features"
            )
        yield from page["features"]
        links = [x for x in page.get("links", ()) if x.get("rel") == "next" and x.get("href")]
        if links and str(links[0].get("method", "GET")).upper() != "GET":
            raise InputError(
                "asks for its next page by another method", file=url,
                found=str(links[0]["method"]), expected="GET",
            )  # fmt: skip
        url = urljoin(url, links[0]["href"]) if links else ""


def _over(item: dict[str, Any], area: Any) -> bool:
    """Whether an item lies over the area; a page may hold more than was asked for."""
    if item.get("geometry"):
        return bool(shapely.geometry.shape(item["geometry"]).intersects(area))
    box = item.get("bbox")
    return bool(shapely.box(*box).intersects(area)) if box and len(box) == 4 else True


def _offers(item: dict[str, Any], url: str) -> Iterator[TileOffer]:
    """The rasters of an item."""
    properties = item.get("properties", {})
    known = _ITEM_NAME.match(str(item.get("id", "")))
    place = known["place"] if known else ",".join(f"{v:.5f}" for v in item.get("bbox", ()))
    date = str(properties.get("datetime") or properties.get("start_datetime") or "")[:10]
    for asset in item.get("assets", {}).values():
        href = urljoin(url, str(asset.get("href", "")))
        name = unquote(Path(urlsplit(href).path).name)
        # Names of files come from the server: nothing but a plain name is written.
        if not _FILE_NAME.match(name):
            continue
        size = asset.get(
            "gsd", asset.get("eo:gsd", properties.get("gsd", properties.get("eo:gsd")))
        )
        checksum = asset.get("file:checksum") or asset.get("checksum:multihash") or ""
        if size is not None:
            yield TileOffer(
                name, href, place or str(item.get("id")), date or (known["year"] if known else ""),
                float(size), str(checksum).lower(),
            )  # fmt: skip
