"""Progress reports of work that takes long."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (parts done, parts in all)."""


def unheard(done: int, total: int) -> None:
    """Ignore a progress report.

    Args:
        done: parts done.
        total: parts in all.
    """
