"""Access to the studio: its own page only, and on a network only with its token.

Any page that a browser shows may send requests to this machine and open a websocket to it. A browser tells where such a
request comes from (`Origin`) and which name it was sent to (`Host`): a foreign page has another origin, and a name that
was made to point here has another host. Both are looked at before any message is read.
"""

from __future__ import annotations

import hmac
import http
import ipaddress
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit


class PageGuard:
    """Decides on a request by its headers.

    Args:
        host: address that the studio listens on.
        port: port on which it listens; 0 if not yet known.
    """

    def __init__(self, host: str, port: int) -> None:
        self.is_local = _is_here(host)
        #: What whoever comes from another machine has to show; empty where the studio listens on this one alone.
        self.token = "" if self.is_local else secrets.token_urlsafe(24)
        # A browser keeps one cookie of a name for all ports of a host.
        self._cookie = f"pb4u-{port or secrets.token_hex(4)}"

    def refusal(self, path: str, headers: Any) -> str | None:
        """Sentence on why a request is refused; None if it is allowed.

        Args:
            path: path and query that it asks for.
            headers: its headers, by name.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return "The request needs one Host header, and at most one Origin header."
        if self.is_local and not _is_here(_name(hosts[0])):
            return "The studio listens only on this machine; open it as http://localhost and its port."
        is_websocket = "websocket" in headers.get("Upgrade", "").lower()
        # A browser sends the origin with every websocket; one without is not a page of the studio.
        if (is_websocket or origins) and (not origins or not _is_same_origin(origins[0], hosts[0])):
            return "The studio answers only its own page."
        if self.token and not self._is_known(path, headers):
            return "Open the studio at the full address that it printed when it started, token included."
        return None

    def cookie(self, path: str) -> str | None:
        """Cookie for a browser that opened the address with the token; its later requests carry it.

        Args:
            path: path and query of the request.
        """
        if not self.token or not _is_equal(_token_of(path), self.token):
            return None
        return f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def _is_known(self, path: str, headers: Any) -> bool:
        try:
            cookies = SimpleCookie("; ".join(headers.get_all("Cookie")))
        except CookieError:
            cookies = SimpleCookie()
        shown = cookies[self._cookie].value if self._cookie in cookies else ""
        return _is_equal(shown, self.token) or _is_equal(_token_of(path), self.token)


def _is_equal(shown: str, secret: str) -> bool:
    return hmac.compare_digest(shown.encode(), secret.encode())


def _token_of(path: str) -> str:
    return (parse_qs(urlsplit(path).query).get("token") or [""])[0]


def _name(host: str) -> str:
    """The name of `name:port`, without the brackets of an IPv6 address."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_same_origin(origin: str, host: str) -> bool:
    scheme, separator, rest = origin.partition("://")
    return bool(separator) and scheme in ("http", "https") and rest.lower() == host.lower()


def _is_here(host: str) -> bool:
    """Whether a name or address is this machine's for itself."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@contextmanager
def guarded_server(guard: PageGuard) -> Iterator[None]:
    """Within it, a viser server that starts asks `guard` about each request.

    viser passes its own request function to `websockets` and has no hook for another one, so this function is wrapped
    there.

    Args:
        guard: what decides.
    """
    import websockets.asyncio.server
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    serve = websockets.asyncio.server.serve

    def wrapped(*arguments: Any, process_request: Callable | None = None, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            sentence = guard.refusal(request.path, request.headers)
            if sentence is not None:
                body = (sentence + "\n").encode()
                headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
            response = process_request(connection, request) if process_request else None
            cookie = guard.cookie(request.path)
            if response is not None:
                # Neither shown inside of a foreign page, nor told to one that a link leads to.
                response.headers["X-Frame-Options"] = "DENY"
                response.headers["Referrer-Policy"] = "no-referrer"
                if cookie:
                    response.headers["Set-Cookie"] = cookie
            return response

        return serve(*arguments, process_request=process, **options)

    websockets.asyncio.server.serve = wrapped  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
