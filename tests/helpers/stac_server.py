"""A web server on this machine that offers tiles as swisstopo's STAC interface does."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

COLLECTION = "ch.swisstopo.swissalti3d"
ITEMS = f"/api/stac/v1/collections/{COLLECTION}/items"


@dataclass
class StacServer:
    """What the server holds and how it misbehaves.

    Attributes
    ----------
    items : list of dict
        Items as a STAC interface lists them; ``{server}`` in a link is its address.
    files : dict of name to bytes
    page : int
        Items on a page.
    cut : dict of name to int
        So many answers for a file break off in the middle.
    slow : dict of name to float
        The answer waits so long (s).
    asked : Counter
        Of paths.
    """

    items: list[dict[str, Any]] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)
    page: int = 2
    cut: dict[str, int] = field(default_factory=dict)
    slow: dict[str, float] = field(default_factory=dict)
    asked: Counter[str] = field(default_factory=Counter)
    url: str = ""

    @property
    def api(self) -> str:
        return f"{self.url}/api/stac/v1"

    def offer(
        self, name: str, data: bytes, box: tuple[float, ...], date: str, *, old_style: bool = False,
        checksum: bool = True, gsd: float = 2.0,
    ) -> None:  # fmt: skip
        """Offer a file, in the words of the present interface or of its version before."""
        self.files[name] = data
        digest = f"1220{hashlib.sha256(data).hexdigest()}"
        asset: dict[str, Any] = {
            "href": f"{{server}}/files/{name}",
            "type": "image/tiff; application=geotiff; profile=cloud-optimized",
            "eo:gsd" if old_style else "gsd": gsd,
        }
        if checksum:
            asset["checksum:multihash" if old_style else "file:checksum"] = digest
        west, south, east, north = box
        ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
        self.items.append(
            {
                "id": name.split("_2_")[0].removesuffix(".tif"),
                "type": "Feature",
                "bbox": list(box),
                "geometry": {"type": "Polygon", "coordinates": [ring]},
                "properties": {"datetime": f"{date}T00:00:00Z"},
                "assets": {name: asset, f"{name}.zip": {"href": "{server}/x.xyz.zip", "gsd": gsd}},
            }
        )

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        parts = urlsplit(handler.path)
        self.asked[parts.path] += 1
        if parts.path == ITEMS:
            query = parse_qs(parts.query)
            self._list(handler, query, int(query.get("cursor", ["0"])[-1]))
        elif parts.path.removeprefix("/files/") in self.files:
            self._send(handler, parts.path.removeprefix("/files/"))
        else:
            handler.send_error(404)

    def _list(self, handler: Any, query: dict[str, list[str]], first: int) -> None:
        west, south, east, north = map(float, query["bbox"][0].split(","))
        found = [
            i for i in self.items
            if i["bbox"][0] <= east and i["bbox"][2] >= west
            and i["bbox"][1] <= north and i["bbox"][3] >= south
        ]  # fmt: skip
        page: dict[str, Any] = {"features": found[first : first + self.page], "links": []}
        if first + self.page < len(found):
            box = query["bbox"][0]
            href = f"{{server}}{ITEMS}?bbox={box}&cursor={first + self.page}"
            page["links"] = [{"rel": "self", "href": "items"}, {"rel": "next", "href": href}]
        body = json.dumps(page).replace("{server}", self.url).encode()
        handler.send_response(200)
        handler.send_header("Content-Length", str(len(body)))
        handler.end_headers()
        handler.wfile.write(body)

    def _send(self, handler: Any, name: str) -> None:
        time.sleep(self.slow.get(name, 0.0))
        rest = self.files[name]
        handler.send_response(200)
        handler.send_header("Content-Length", str(len(rest)))
        handler.end_headers()
        if self.cut.get(name, 0) > 0:
            self.cut[name] -= 1
            rest = rest[: len(rest) // 2]
        handler.wfile.write(rest)


@contextmanager
def serving(server: StacServer) -> Iterator[StacServer]:
    """Run the server on a free port."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            with suppress(BrokenPipeError, ConnectionResetError):
                server.answer(self)

        def log_message(self, *_: object) -> None:
            pass

    own = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=own.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    server.url = f"http://127.0.0.1:{own.server_port}"
    try:
        yield server
    finally:
        own.shutdown()
        own.server_close()
