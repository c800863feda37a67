"""Whether a browser keeps up: a question after every frame, which it answers when it has taken the frame in."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viser import ClientHandle

_IN_FLIGHT = 2
"""Frames that may be under way: one is drawn while the next one travels."""

_PATIENCE = 5.0
"""Seconds after which a frame counts as lost, so that a browser that never answers is sent another."""


class Echo:
    """Asks one window.

    Messages are handled in the order sent, so an answer says that the frame before it was taken in. What is asked for
    is an entry of the browser's local storage that nobody wrote; it is the library's one question that costs nothing.
    """

    def __init__(self, client: ClientHandle) -> None:
        self._client = client
        self._pool = ThreadPoolExecutor(_IN_FLIGHT, thread_name_prefix="pb4u echo")
        self._asked: list[Future[None]] = []
        self.answers = 0

    def ask(self) -> None:
        """After a frame was sent."""
        self._asked.append(self._pool.submit(self._wait))

    @property
    def ready(self) -> bool:
        """Whether another frame may be sent."""
        self._asked = [future for future in self._asked if not future.done()]
        return len(self._asked) < _IN_FLIGHT

    def _wait(self) -> None:
        try:
            self._client.local_storage.get_item("pb4u", timeout=_PATIENCE)
            self.answers += 1
        except (RuntimeError, TimeoutError):
            # The window is gone, has no storage, or is out of sight and does not draw.
            pass

    def close(self) -> None:
        """Ask no more."""
        self._pool.shutdown(wait=False, cancel_futures=True)
