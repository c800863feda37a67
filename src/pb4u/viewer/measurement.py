"""The energies and strains of a clip, frame after frame, beside everything else the page does."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from pb4u.evaluation.metrics import ENERGIES, Ruler
from pb4u.viewer.clip import Clip
from pb4u.viewer.plain_sentence import plain_sentence

QUANTITIES: dict[str, str] = {
    **{name: f"{name} energy [J]" for name in ENERGIES},
    "strain_p95": "strain, 95th percentile",
    "penetration_percent": "vertices inside the body [%]",
}
"""What can be plotted, and how it is written."""


class Measurement:
    """Measures every frame of a clip in a thread of its own.

    Args:
        clip: with all of its frames.
        advanced: called after each frame, in that thread.
    """

    def __init__(self, clip: Clip, advanced: Callable[[], None]) -> None:
        self.clip = clip
        self.failure: str | None = None
        self._advanced = advanced
        self._rows: list[dict[str, float]] = []
        self._frames = clip.frame_count
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pb4u measurement", daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """End before the next frame."""
        self._cancelled.set()

    def join(self, timeout: float) -> bool:
        """Wait; true when it has ended."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def done(self) -> int:
        """Frames measured so far."""
        return len(self._rows)

    def series(self, quantity: str) -> np.ndarray:
        """(frames,) of one quantity; NaN where it is not measured yet, or not finite."""
        values = np.full(self._frames, np.nan)
        for t, row in enumerate(list(self._rows)):
            values[t] = row.get(quantity, np.nan)
        return values

    def _run(self) -> None:
        try:
            ruler = Ruler(self.clip.trajectory())
            for t in range(self._frames):
                if self._cancelled.is_set():
                    return
                self._rows.append(ruler.frame(t)[0])
                self._advanced()
        except Exception as error:
            self.failure = plain_sentence(error)
            self._advanced()
