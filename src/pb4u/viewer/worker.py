"""Work for one window in a thread of its own, which ends with the window; what fails there becomes one sentence."""

from __future__ import annotations

import sys
import threading
import traceback
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from pb4u.errors import InputWarning, sentence_on


class Worker(ABC):
    """A thread that can be stopped.

    Args:
        name: what the thread is called in a debugger.
    """

    def __init__(self, name: str) -> None:
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"pb4u {name}", daemon=True)

    def start(self) -> None:
        """Begin the work in the thread."""
        self._thread.start()

    def cancel(self) -> None:
        """End before the next frame; computed frames stay."""
        self._cancelled.set()

    @property
    def running(self) -> bool:
        """Whether it still computes."""
        return self._thread.is_alive()

    def join(self, timeout: float) -> bool:
        """Wait for at most `timeout` seconds; true when it has ended.

        Args:
            timeout: [s].
        """
        self._thread.join(timeout)
        return not self.running

    @abstractmethod
    def _work(self) -> None:
        """Work of the thread; it checks `_cancelled` between two frames."""


_HEARING: ContextVar[list[str] | None] = ContextVar("hearing", default=None)
"""Where the warnings of the work of this thread go; to the terminal by default."""


@contextmanager
def heard_warnings(sentences: list[str]) -> Iterator[None]:
    """Send pb4u's warnings in this thread to a page instead of the terminal; other threads are unaffected.

    Args:
        sentences: gets their sentences.
    """
    token = _HEARING.set(sentences)
    try:
        yield
    finally:
        _HEARING.reset(token)


def route_warnings() -> Callable[[], None]:
    """Let the warnings of work in `heard_warnings` go there from now on; returns what undoes that."""
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        sentences = _HEARING.get()
        if sentences is not None and issubclass(category, InputWarning):
            sentences.append(" ".join(str(message).split()))
        else:
            before(message, category, *rest, **more)

    def undo() -> None:
        # Another may have put its own in place since.
        if warnings.showwarning is show:
            warnings.showwarning = before

    warnings.showwarning = show
    return undo


def plain_sentence(error: BaseException) -> str:
    """Sentence on an error for a page; tracebacks of errors outside pb4u are printed.

    Args:
        error: the error.
    """
    if (sentence := sentence_on(error)) is not None:
        return sentence
    traceback.print_exception(error, file=sys.stderr)
    return f"An unexpected error occurred ({type(error).__name__}); the terminal shows where. The studio keeps running."
