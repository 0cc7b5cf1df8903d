"""Terrain that a STAC interface offers: found over an area, fetched, joined as one virtual raster.

STAC (https://stacspec.org) lists items, each with a place, a time and files (assets). That of
swisstopo is at https://data.geo.admin.ch/api/stac; its collection of heights is swissALTI3D.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urljoin, urlsplit
from xml.etree import ElementTree as ET

import geopandas as gpd
import rasterio
import shapely
from rasterio.errors import RasterioError

from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import write_new, writing
from sassgis.files.plain_file import seen_from
from sassgis.inputs.dem import open_raster
from sassgis.inputs.tiles import Terrain, open_tiles
from sassgis.inputs.vector_features import open_layer
from sassgis.outputs.qgis.entries import filled

SERVER = "https://data.geo.admin.ch/api/stac/v1"
COLLECTION = "ch.swisstopo.swissalti3d"
VRT, SOURCES = "terrain.vrt", "sources.json"
#: Items on a page, and in all: no area that one fetches has more.
_PAGE, _ITEMS = 100, 20_000
#: ``swissalti3d_2019_2501-1120``: what is offered, the year, and the square kilometre.
_ITEM_NAME = re.compile(r"^.+_\d{4}_(?P<place>\d+-\d+)$")
_FILE_NAME = re.compile(r"^[\w.+-]+\.tiff?$", re.IGNORECASE)
#: Beginning of a multihash of SHA-256: code of the function and length of the digest.
_SHA256 = "1220"
#: Times that a download is begun.
_TRIES = 3
#: Types that hold the nodata of the whole; heights in others are given as Float32.
_TYPES = {"float32": "Float32", "float64": "Float64", "int16": "Int16", "int32": "Int32"}
_NODATA = -9999.0


@dataclass(frozen=True, slots=True)
class TileOffer:
    """A tile that can be fetched."""

    file: str  # its name
    href: str
    date: str  # of the edition
    checksum: str  # as multihash in hexadecimal digits; empty if none is stated
    place: str  # the same for all editions of a tile
    resolution_m: float


def read_search_area(file: Path, layer: str | None = None) -> Any:
    """Return the polygons of a file, or of a layer of it, as one geometry in WGS 84 (degrees)."""
    frame: gpd.GeoDataFrame = open_layer(file, layer, "polygon", {})
    if frame.crs is None:
        expected = "one, so that it can be found on Earth"
        raise InputError("has no coordinate system", file=file, expected=expected)
    shapes = frame.to_crs("EPSG:4326").geometry.dropna()
    shapes = shapes[~shapes.is_empty]
    kinds = sorted({*shapes.geom_type} - {"Polygon", "MultiPolygon"})
    if kinds or shapes.empty:
        found, expected = ", ".join(kinds) or "nothing", "the area as polygons"
        raise InputError("holds no polygons", file=file, found=found, expected=expected)
    return shapely.union_all(shapely.force_2d(shapely.make_valid(shapes.to_numpy())))


def find_tiles(
    area: Any,
    resolution_m: float,
    *,
    server: str = SERVER,
    collection: str = COLLECTION,
    timeout_s: float = 30.0,
) -> tuple[TileOffer, ...]:
    """Return the tiles over an area, of each the newest edition, by place.

    The area is a shapely geometry in longitude and latitude, the resolution the size of the cells
    (m). InputError if there are none, or the server cannot be asked.
    """
    url = f"{server.rstrip('/')}/collections/{collection}/items"
    offers = [
        offer
        for item in _items(url, area.bounds, timeout_s)
        # A page may hold more than was asked for.
        if shapely.geometry.shape(item.get("geometry") or area).intersects(area)
        for offer in _offers(item, url)
    ]
    newest = {
        offer.place: offer
        for offer in sorted(offers, key=lambda o: (o.date, o.file))
        if abs(offer.resolution_m - resolution_m) < 1e-6
    }
    if newest:
        return tuple(newest[place] for place in sorted(newest))
    if offers:
        others = ", ".join(f"{r:g}" for r in sorted({offer.resolution_m for offer in offers}))
        problem, found = "offers no tile of this resolution here", f"cells of {others} m"
        raise InputError(problem, file=server, found=found, expected="another --resolution")
    found = "nothing over {:.4f}, {:.4f} to {:.4f}, {:.4f}".format(*area.bounds)
    expected = "a polygon in the area of the data"
    raise InputError("offers no tile here", file=server, found=found, expected=expected)


def _items(url: str, bounds: Sequence[float], timeout_s: float) -> list[dict[str, Any]]:
    """Return the items in a rectangle, of all pages, as plain values."""
    _check_address(url)
    try:
        from pystac_client import ItemSearch
        from pystac_client.exceptions import APIError
        from pystac_client.stac_api_io import StacApiIO
    except ImportError:
        raise InputError(
            "dem fetch needs pystac-client", expected="pip install 'sassgis[stac]'"
        ) from None
    service = StacApiIO(timeout=timeout_s, max_retries=None)
    area = {"bbox": list(bounds), "limit": _PAGE, "max_items": _ITEMS}
    try:
        items = list(ItemSearch(url, method="GET", stac_io=service, **area).items_as_dicts())
    except APIError as error:
        raise _refusal(url, getattr(error, "status_code", None), str(error)) from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        problem, expected = "does not answer as a STAC interface", "pages with features in JSON"
        raise InputError(problem, file=url, found=str(error)[:80], expected=expected) from None
    if len(items) >= _ITEMS:
        problem, found = "its pages do not end", f"{_ITEMS} items"
        raise InputError(problem, file=url, found=found, expected="a smaller polygon")
    return items


def _check_address(url: str) -> None:
    if urlsplit(url).scheme not in ("http", "https"):
        raise InputError("is no web address", file=url, expected="http://... or https://...")


def _refusal(url: str, code: int | None, reason: str) -> InputError:
    """Return one line for a server that refuses (an HTTP code) or cannot be reached (none)."""
    if code is None:
        problem, found = f"no answer from {urlsplit(url).netloc}", reason[:160]
        return InputError(problem, file=url, found=found, expected="a connection to the internet")
    problem, expected = "the server refuses", "an address that exists"
    if code >= 500 or code == 429:
        problem, expected = "the server is busy or out of order", "try again later"
    return InputError(problem, file=url, found=f"HTTP {code}", expected=expected)


def _offers(item: dict[str, Any], url: str) -> Iterator[TileOffer]:
    """Yield the rasters of an item."""
    properties, identity = item.get("properties", {}), str(item.get("id", ""))
    known = _ITEM_NAME.match(identity)
    date = str(properties.get("datetime") or properties.get("start_datetime") or "")[:10]
    for asset in item.get("assets", {}).values():
        href = urljoin(url, str(asset.get("href", "")))
        name = unquote(Path(urlsplit(href).path).name)
        sizes = [own[key] for own in (asset, properties) for key in ("gsd", "eo:gsd") if key in own]
        checksum = asset.get("file:checksum") or asset.get("checksum:multihash") or ""
        # Names of files come from the server: nothing but a plain name is written.
        if _FILE_NAME.match(name) and sizes:
            place = known["place"] if known else identity
            yield TileOffer(name, href, date, str(checksum).lower(), place, float(sizes[0]))


def fetch_terrain(
    offers: Sequence[TileOffer],
    folder: Path,
    *,
    timeout_s: float,
    most: int,
    say: Callable[[str], None],
) -> Path:
    """Fetch tiles into a folder, made if missing; returns ``terrain.vrt``, which joins them.

    Tiles that are there are kept; the virtual raster is written last. More than ``most`` tiles are
    refused; ``say`` gets a line for each. ``sources.json`` says where each tile comes from.
    """
    if len(offers) > most:
        expected = f"{most} or fewer: a smaller polygon, a coarser --resolution, or more --most"
        found = f"{len(offers)} tiles"
        raise InputError("too many tiles", field="--most", found=found, expected=expected)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for number, offer in enumerate(offers, start=1):
        try:
            fetched = _fetch(offer, folder, timeout_s)
        except InputError as error:
            problem = f"{error.problem}; run the same command to resume"
            problem = f"tile {number} of {len(offers)}: {problem}"
            raise InputError(**error.parts(problem=problem)) from None
        say(f"{number}/{len(offers)} {offer.file} {'fetched' if fetched else 'is there'}")
    terrain = open_tiles([folder / o.file for o in offers], folder)
    facts = [asdict(offer) for offer in offers]
    write_new(folder / SOURCES, json.dumps(facts, indent=1) + "\n", overwrite=True)
    return write_vrt(folder / VRT, terrain)


def _fetch(offer: TileOffer, folder: Path, timeout_s: float) -> bool:
    """Fetch a tile, ``.part`` until it is whole and checked; False if it was there already."""
    target, part = folder / offer.file, folder / f"{offer.file}.part"
    if target.exists():
        if wrong := _damage(offer, target):
            raise OutputError(
                f"{target}: is not the tile that the server offers ({wrong}); delete it or move it "
                "away, and the same command fetches it"
            )
        return False
    wrong = ""
    try:
        for _ in range(_TRIES):
            wrong = _download(offer, part, timeout_s) or _damage(offer, part)
            if not wrong:
                with writing(target):
                    part.replace(target)
                return True
    finally:
        part.unlink(missing_ok=True)
    problem = "what the server sends is damaged or breaks off"
    expected = "a whole GeoTIFF; try again later"
    raise InputError(problem, file=offer.href, found=wrong, expected=expected)


def _download(offer: TileOffer, part: Path, timeout_s: float) -> str:
    """Write what the server sends; why it broke off, if it did."""
    import requests

    _check_address(offer.href)
    try:
        with requests.get(offer.href, stream=True, timeout=timeout_s) as answer:
            if answer.status_code != requests.codes.ok:
                raise _refusal(offer.href, answer.status_code, "")
            with writing(part):
                file = part.open("wb")
            with file:
                for chunk in answer.iter_content(1 << 18):
                    with writing(part):
                        file.write(chunk)
    except (requests.ConnectionError, requests.Timeout) as error:
        raise _refusal(offer.href, None, str(error)) from None
    except requests.RequestException as error:
        return str(error)[:120]
    return ""


def _damage(offer: TileOffer, file: Path) -> str:
    """Describe what is wrong with a file; empty if nothing is."""
    if offer.checksum.startswith(_SHA256):
        want = offer.checksum.removeprefix(_SHA256)
        with file.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
        return "" if found == want else f"sha256 {found[:12]}..., stated {want[:12]}..."
    # Without a checksum all of it is read once.
    try:
        with rasterio.open(file, driver="GTiff") as raster:
            for _, window in raster.block_windows(1):
                raster.read(1, window=window)
    except (RasterioError, OSError) as error:
        return str(error).replace(str(file), file.name)[:120]
    return ""


def write_vrt(file: Path, terrain: Terrain) -> Path:
    """Write a virtual raster, which ends in ``.vrt``, over the tiles of a terrain model.

    Paths in it are relative to it. The tiles have square cells, as ``open_tiles`` returns them. One
    that is there already is replaced; OutputError if it has changed since it was written.
    """
    sources = []
    # GDAL lets a later source cover an earlier one; here the first tile counts.
    for tile in reversed(terrain.tiles):
        with open_raster(tile.dem.file, "terrain.dem") as raster:
            at = tile.dem.band - 1
            place = seen_from(file.resolve().parent, Path(str(tile.dem.file)).resolve())
            source = {"tile": tile, "file": place, "stored": raster.dtypes[at]}
            source |= {"block": raster.block_shapes[at], "nodata": raster.nodata}
            sources.append({**source, "kind": _TYPES.get(raster.dtypes[at], "Float32")})
    alike = len({source["stored"] for source in sources}) == 1
    kind = sources[0]["kind"] if alike else "Float64"
    root = filled("terrain.vrt.j2", terrain=terrain, sources=sources, kind=kind, nodata=_NODATA)
    ET.indent(root, " ")
    write_new(file, ET.tostring(root, "unicode") + "\n", overwrite=True)
    return file
