"""What one page shows, without the page: clips on one timeline, and how they are looked at."""

from __future__ import annotations

from pb4u.viewer.clip import Clip
from pb4u.viewer.playback_clock import PlaybackClock

SHADED = "shaded"


class ViewState:
    """The state of one browser window; nothing in it is shared with another.

    Attributes:
        clips: what is shown, side by side; the first gives the timeline its frame rate.
        clock: which frame.
        overlay: name in `pb4u.viewer.overlay.OVERLAYS`.
        body: whether bodies are shown.
        follow: whether the view travels with the bodies.
        shadows: whether the key light casts shadows.
    """

    def __init__(self, clock: PlaybackClock | None = None) -> None:
        self.clips: tuple[Clip, ...] = ()
        self.clock = clock or PlaybackClock()
        self.overlay = SHADED
        self.body = True
        self.follow = True
        self.shadows = False

    def load(self, clips: tuple[Clip, ...]) -> None:
        """Show other clips, from their first frame."""
        self.clips = clips
        self.clock.load(clips[0].header.fps if clips else 30.0, self._length())

    def grow(self) -> None:
        """Take notice of frames that have come."""
        self.clock.grow(self._length())

    def frame_of(self, clip: Clip, frame: int) -> int:
        """The clip's own frame at a frame of the timeline: the same moment, or its last one."""
        own = round(frame * clip.header.fps / self.clips[0].header.fps)
        return min(own, max(clip.frame_count - 1, 0))

    def held(self, frame: int) -> list[str]:
        """A sentence for every clip whose frame there is not finite."""
        found = []
        for clip in self.clips:
            own = self.frame_of(clip, frame)
            if own in clip.held:
                found.append(f"Frame {own} of {clip.label} is not finite: the last whole frame before it is shown.")
        return found

    def _length(self) -> int:
        """Frames of the timeline: the longest clip, at the frame rate of the first."""
        if not self.clips:
            return 0
        fps = self.clips[0].header.fps
        return max(
            clip.frame_count if clip is self.clips[0] else int((clip.frame_count - 1) * fps / clip.header.fps) + 1
            for clip in self.clips
        )
