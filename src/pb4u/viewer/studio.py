"""The studio: a server on which every browser window has its own state and its own work."""

from __future__ import annotations

import io
import socket
import threading
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from pb4u.errors import InputError, extra
from pb4u.viewer.browser_window import BrowserWindow
from pb4u.viewer.clip import Clip
from pb4u.viewer.display import light
from pb4u.viewer.page_guard import PageGuard, guarded_server
from pb4u.viewer.worker import route_warnings

if TYPE_CHECKING:
    from viser import ClientHandle

DEFAULT_PORT = 8094


class Studio:
    """Serves the studio until it is closed.

    Args:
        clips: clips that every new window shows first: none, one, or two side by side.
        host: address to listen on.
        port: port to listen on; 0 chooses a free one.
        out: folder in which exports are also saved, or None.

    Raises:
        MissingExtraError: without the "view" extra.
        InputError: the port is in use, or the folder does not exist.
    """

    def __init__(
        self, clips: tuple[Clip, ...] = (), host: str = "127.0.0.1", port: int = DEFAULT_PORT, out: Path | None = None
    ) -> None:
        with extra("view", "The studio"):
            import viser
        if out is not None and not out.is_dir():
            raise InputError(f"The folder {out} does not exist; make it first.")
        check_port(host, port)
        self._clips, self._out = clips, out
        self._unroute = route_warnings()
        self._lock = threading.Lock()
        self._windows: dict[int, BrowserWindow] = {}
        # The library announces itself on standard output, where the caller has something of its own to say.
        guard = PageGuard(host, port)
        with redirect_stdout(io.StringIO()), guarded_server(guard):
            self._server = viser.ViserServer(host, port, label="pb4u studio", verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(42, 92, 158))
        light(self._server.scene)
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)
        name = "localhost" if host in ("", "0.0.0.0", "127.0.0.1") else f"[{host}]" if ":" in host else host
        #: Address to open; where others can reach the studio, with the token that it asks for.
        self.url = f"http://{name}:{self._server.get_port()}" + (f"/?token={guard.token}" if guard.token else "")

    @property
    def windows(self) -> tuple[BrowserWindow, ...]:
        """Browser windows that are open."""
        with self._lock:
            return tuple(self._windows.values())

    def _connected(self, client: ClientHandle) -> None:
        window = BrowserWindow(client, self._clips, self._out)
        with self._lock:
            self._windows[client.client_id] = window
        # It may be gone before it was ready.
        if client.client_id not in self._server.get_clients():
            self._disconnected(client)

    def _disconnected(self, client: ClientHandle) -> None:
        with self._lock:
            window = self._windows.pop(client.client_id, None)
        if window is not None:
            window.close()

    def close(self) -> None:
        """End the work of every window and stop listening."""
        for window in self.windows:
            window.close(timeout=2.0)
        with redirect_stdout(io.StringIO()):
            self._server.stop()
        self._unroute()


def check_port(host: str, port: int) -> None:
    """Refuse an address and port on which nobody can listen.

    Args:
        host: address.
        port: port; 0 is any.

    Raises:
        InputError: the port is in use, not allowed or not a port number, or the address does not belong to this
            machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OverflowError as error:
            raise InputError(f"A port must be a number from 0 to 65535, not {port}.") from error
        except OSError as error:
            raise InputError(
                f"Cannot listen on port {port} of {host} ({error.strerror}); choose another with --port, or 0 for any."
            ) from error
