"""Which frame is shown when: playing, pausing, speed, loop and stepping, without a page."""

from __future__ import annotations

import time
from collections.abc import Callable

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)


class PlaybackClock:
    """Turns time into frame numbers.

    Args:
        now: seconds that only go forward.
    """

    def __init__(self, now: Callable[[], float] = time.perf_counter) -> None:
        self._now = now
        self._since = now()
        self._position = 0.0
        self._fps = 30.0
        self._speed = 1.0
        self._playing = False
        self.frame_count = 0
        self.loop = True

    def load(self, fps: float, frame_count: int) -> None:
        """Begin anew at frame 0, paused."""
        self._fps, self.frame_count = fps, frame_count
        self._playing = False
        self._move(0.0)

    def grow(self, frame_count: int) -> None:
        """More frames are there now."""
        self._settle()
        self.frame_count = frame_count

    @property
    def frame(self) -> int:
        """The frame to show now; 0 where there is none."""
        self._settle()
        return min(int(self._position + 1e-6), max(self.frame_count - 1, 0))

    @property
    def seconds(self) -> float:
        """Time of that frame since the first one [s]."""
        return self.frame / self._fps

    @property
    def playing(self) -> bool:
        """Whether time goes on; ends by itself at the last frame where it does not loop."""
        self._settle()
        return self._playing

    @property
    def wait(self) -> float:
        """Seconds until another frame is due; a quarter of one while paused."""
        self._settle()
        if not self._playing:
            return 0.25
        return max(1.0 - self._position % 1.0, 1e-3) / (self._fps * self._speed)

    def play(self) -> None:
        """Go on, from the start where the end was reached."""
        if self.frame >= self.frame_count - 1 and not self.loop:
            self._move(0.0)
        self._settle()
        self._playing = True

    def pause(self) -> None:
        """Stay where it is."""
        self._move(float(self.frame))
        self._playing = False

    def seek(self, frame: int) -> None:
        """Go to a frame, the nearest there is; playing goes on from it."""
        self._move(float(min(max(frame, 0), max(self.frame_count - 1, 0))))

    def step(self, frames: int) -> None:
        """Pause and go that many frames on, around the ends where it loops."""
        target = self.frame + frames
        self.pause_at(target % self.frame_count if self.loop and self.frame_count else target)

    def pause_at(self, frame: int) -> None:
        """Pause and go to a frame, the nearest there is."""
        self._playing = False
        self.seek(frame)

    @property
    def speed(self) -> float:
        """Playing seconds per second."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._settle()
        self._speed = speed

    def _move(self, position: float) -> None:
        self._position, self._since = position, self._now()

    def _settle(self) -> None:
        """Bring the position up to now."""
        now = self._now()
        if self._playing and self.frame_count:
            position = self._position + (now - self._since) * self._fps * self._speed
            if position >= self.frame_count:
                self._playing = self.loop
                position = position % self.frame_count if self.loop else self.frame_count - 1.0
            self._position = position
        self._since = now
