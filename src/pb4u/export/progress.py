"""How a writer reports that it gets on."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""
