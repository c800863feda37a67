"""State of one page: its clips, the timeline and the overlay; without the page itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import copy

from pb4u.export.selection import resampled_count
from pb4u.viewer.clip import Clip

SHADED = "shaded"
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)
IDLE_WAIT = 0.25
"""Seconds between looks at a page that stands still: plots and counts that grow there are still followed."""


class PlaybackClock:
    """Turns time into frame numbers: playing, pausing, speed, loop and stepping.

    Reading changes nothing, so that a reading thread cannot undo changes by another one.

    Args:
        now: seconds that only go forward.
    """

    def __init__(self, now: Callable[[], float] = time.perf_counter) -> None:
        self._now = now
        self._since = now()
        self._position = 0.0
        self._fps = 30.0
        self._speed = 1.0
        self._loop = True
        self._playing = False
        self.frame_count = 0

    def frozen(self) -> PlaybackClock:
        """A copy of the clock which stays at this moment."""
        other, now = copy(self), self._now()
        other._now = lambda: now
        return other

    def load(self, fps: float, frame_count: int) -> None:
        """Begin again at frame 0, paused.

        Args:
            fps: frames per second [1/s].
            frame_count: number of frames.
        """
        self._fps, self.frame_count = fps, frame_count
        self.pause_at(0)

    def grow(self, frame_count: int) -> None:
        """Set the number of frames that there are now.

        Args:
            frame_count: number of frames that there are now.
        """
        self._settle()
        self.frame_count = frame_count

    @property
    def frame(self) -> int:
        """Number of the frame to show now; 0 where there is none."""
        # The small addition keeps a position that rounding left just below a frame from showing the one before.
        return min(int(self._reading(self._now())[0] + 1e-6), max(self.frame_count - 1, 0))

    @property
    def seconds(self) -> float:
        """Time of that frame since the first one [s]."""
        return self.frame / self._fps

    @property
    def playing(self) -> bool:
        """Whether it is playing; ends at the last frame unless it loops."""
        return self._reading(self._now())[1]

    @property
    def wait(self) -> float:
        """Time [s] until another frame is due; `IDLE_WAIT` while paused."""
        position, playing = self._reading(self._now())
        return max(1.0 - position % 1.0, 1e-3) / (self._fps * self._speed) if playing else IDLE_WAIT

    def play(self) -> None:
        """Go on, from the start where the end was reached."""
        ended = self.frame >= self.frame_count - 1 and not self._loop
        self._settle()
        self._position, self._playing = 0.0 if ended else self._position, True

    def toggle(self) -> None:
        """Pause if playing, play if paused."""
        if self.playing:
            self.pause_at(self.frame)
        else:
            self.play()

    def seek(self, frame: int) -> None:
        """Go to a frame, or the nearest existing one; playing continues from it.

        Args:
            frame: frame to go to.
        """
        self._settle()
        self._position = float(min(max(frame, 0), max(self.frame_count - 1, 0)))

    def step(self, frames: int) -> None:
        """Pause and go that many frames on, around the ends where it loops.

        Args:
            frames: number of frames, negative to go back.
        """
        target = self.frame + frames
        self.pause_at(target % self.frame_count if self._loop and self.frame_count else target)

    def pause_at(self, frame: int) -> None:
        """Pause and go to a frame, the nearest there is.

        Args:
            frame: frame to go to.
        """
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

    @property
    def loop(self) -> bool:
        """Whether the last frame is followed by the first."""
        return self._loop

    @loop.setter
    def loop(self, loop: bool) -> None:
        self._settle()
        self._loop = loop

    def _settle(self) -> None:
        """Bring what is kept up to now, before it is changed."""
        now = self._now()
        (self._position, self._playing), self._since = self._reading(now), now

    def _reading(self, now: float) -> tuple[float, bool]:
        """The position [frames] at the time `now`, and whether it still plays then."""
        position, playing = self._position, self._playing
        if not playing or not self.frame_count:
            return position, playing
        position += (now - self._since) * self._fps * self._speed
        if position < self.frame_count:
            return position, True
        return (position % self.frame_count, True) if self._loop else (self.frame_count - 1.0, False)


class ViewState:
    """The state of one browser window; nothing in it is shared with another.

    Attributes:
        clips: the shown clips, side by side; the first gives the timeline its frame rate.
        clock: which frame.
        overlay: name in `pb4u.viewer.overlay.OVERLAYS`.
        body: whether bodies are shown.
        follow: whether the view travels with the bodies.
        shadows: whether the key light casts shadows.
        touchable: whether a mouse that drags the cloth pulls at it.
        hand: where it holds cloth, (3,) [m] in the view, or None.
    """

    def __init__(self, clock: PlaybackClock | None = None) -> None:
        self.clips: tuple[Clip, ...] = ()
        self.clock = clock or PlaybackClock()
        self.overlay = SHADED
        self.body = True
        self.follow = True
        self.shadows = False
        self.touchable = False
        self.hand: tuple[float, float, float] | None = None

    def load(self, clips: tuple[Clip, ...]) -> None:
        """Show other clips, from their first frame.

        Args:
            clips: clips to show, side by side.
        """
        self.clips = clips
        self.clock.load(clips[0].header.fps if clips else 30.0, self._length())

    def grow(self) -> None:
        """Add new frames."""
        self.clock.grow(self._length())

    def frozen(self) -> ViewState:
        """A copy of the present state, for a thread that reads it while others change the state."""
        other = copy(self)
        other.clock = self.clock.frozen()
        return other

    @property
    def follows_newest(self) -> bool:
        """Whether it is at the newest frame, and moves on to each new one."""
        return not self.clock.playing and self.clock.frame >= self.clock.frame_count - 1

    @property
    def picture(self) -> tuple[object, ...]:
        """Key of all values on which the drawing of the clips depends: equal keys give equal drawings."""
        return self.clips, self.clock.frame, self.overlay, self.body, self.follow

    def frame_of(self, clip: Clip, frame: int) -> int:
        """The clip's own frame at a frame of the timeline: the same time, or its last frame.

        Args:
            clip: one of the clips.
            frame: frame of the timeline, which the first clip gives.
        """
        clip_frame = round(frame * clip.header.fps / self.clips[0].header.fps)
        return min(clip_frame, max(clip.frame_count - 1, 0))

    def held(self, frame: int) -> tuple[str, ...]:
        """Sentences, one for every clip whose frame at `frame` of the timeline is not finite.

        Args:
            frame: of the timeline.
        """
        shown = [(clip, self.frame_of(clip, frame)) for clip in self.clips]
        return tuple(
            f"Frame {number} of {clip.label} is not finite: the last whole frame before it is shown."
            for clip, number in shown
            if number in clip.held
        )

    def _length(self) -> int:
        """Frames of the timeline: the longest clip, at the frame rate of the first."""
        if not self.clips:
            return 0
        fps = self.clips[0].header.fps
        return max(
            clip.frame_count if clip is self.clips[0] else resampled_count(clip.frame_count, clip.header.fps, fps)
            for clip in self.clips
        )
