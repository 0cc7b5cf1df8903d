"""Answers from a web server, and its failures as one line."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from sassgis.model.errors import InputError

#: No answer of a search is larger (bytes).
_LARGEST_ANSWER = 50_000_000


class NoAnswer(InputError):
    """Raised when a server cannot be reached or stops to answer; another try may help."""


@contextmanager
def opened(url: str, timeout_s: float, headers: dict[str, str] | None = None) -> Iterator[Any]:
    """Open a web address.

    Parameters
    ----------
    url : str
        Begins with ``http://`` or ``https://``.
    timeout_s : float
        Longest wait for the next bytes (s).

    Raises
    ------
    NoAnswer
        Also in place of what fails inside the block while the answer is read.
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
                "the server is busy or out of order" if busy else "the server refuses",
                file=url,
                found=f"HTTP {error.code} {error.reason}",
                expected="try again later" if busy else "an address that exists",
            ) from None
    except (URLError, TimeoutError, http.client.HTTPException, ConnectionError) as error:
        reason = error.reason if isinstance(error, URLError) else error
        slow = isinstance(reason, TimeoutError | socket.timeout)
        raise NoAnswer(
            f"no answer from {host}",
            file=url,
            found=f"nothing for {timeout_s:g} s" if slow else str(reason) or type(reason).__name__,
            expected="a connection to the internet",
        ) from None


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
