"""The energies and strains of a clip, frame after frame, beside everything else the page does."""

from __future__ import annotations

import numpy as np

from pb4u.evaluation.metrics import ENERGIES, Ruler
from pb4u.viewer.clip import Clip
from pb4u.viewer.worker import Worker, plain_sentence

QUANTITIES: dict[str, str] = {
    **{name: f"{name} energy [J]" for name in ENERGIES},
    "strain_p95": "strain, 95th percentile",
    "penetration_percent": "vertices inside the body [%]",
}
"""What can be plotted, and how it is written."""


class Measurement(Worker):
    """Measures every frame of a clip.

    Args:
        clip: with all of its frames.

    Attributes:
        failure: why it could not be measured, in one sentence; None while nothing is wrong.
    """

    def __init__(self, clip: Clip) -> None:
        super().__init__("measurement")
        self.clip = clip
        self.failure: str | None = None
        self._frames = clip.frame_count
        # Written by the worker alone, one whole row at a time; readers take a copy.
        self._rows: list[dict[str, float]] = []

    @property
    def done(self) -> int:
        """Frames measured so far."""
        return len(self._rows)

    def series(self, quantity: str) -> np.ndarray:
        """(frames,) of one of `QUANTITIES`, in its unit; NaN where it is not measured yet, or not finite."""
        values = [row.get(quantity, np.nan) for row in list(self._rows)]
        return np.pad(np.array(values, dtype=float), (0, self._frames - len(values)), constant_values=np.nan)

    def _work(self) -> None:
        try:
            ruler = Ruler(self.clip.trajectory())
            for t in range(self._frames):
                if self._cancelled.is_set():
                    return
                self._rows.append(ruler.frame(t)[0])
        except Exception as error:
            self.failure = plain_sentence(error)
