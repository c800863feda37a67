"""What a window shows, and what a clip hands it."""

from __future__ import annotations

import numpy as np
import pytest
from tests.viewer.clips import frame, header, trajectory

from pb4u.errors import InputError
from pb4u.viewer.clip import GrowingClip, RecordedClip
from pb4u.viewer.view_state import PlaybackClock, ViewState


def test_two_clips_share_one_timeline_in_seconds() -> None:
    state = ViewState(PlaybackClock(lambda: 0.0))
    slow, fast = RecordedClip(trajectory(9, fps=15.0), "slow"), RecordedClip(trajectory(31, fps=30.0), "fast")
    state.load((slow, fast))
    assert state.clock.frame_count == 16
    assert [state.frame_of(clip, 5) for clip in (slow, fast)] == [5, 10]
    assert [state.frame_of(clip, 15) for clip in (slow, fast)] == [8, 30]


def test_the_last_frame_of_a_clip_at_a_broken_rate_is_on_the_timeline() -> None:
    state = ViewState(PlaybackClock(lambda: 0.0))
    state.load((RecordedClip(trajectory(3, fps=59.94), "short"), RecordedClip(trajectory(12, fps=29.97), "long")))
    assert state.clock.frame_count == 23


def test_lost_frames_are_held_and_named() -> None:
    clip = RecordedClip(trajectory(8, lost=(3, 4)), "b.npz")
    state = ViewState()
    state.load((clip,))
    np.testing.assert_array_equal(clip.garment(4), clip.garment(2))
    assert not np.array_equal(clip.garment(5), clip.garment(2))
    assert state.held(4) == ("Frame 4 of b.npz is not finite: the last whole frame before it is shown.",)
    assert state.held(5) == ()
    assert np.isnan(clip.trajectory().positions[3]).any()


def test_a_clip_without_a_whole_frame_is_refused() -> None:
    with pytest.raises(InputError, match="No frame of the trajectory is finite"):
        RecordedClip(trajectory(2, lost=(0, 1)), "b.npz")


def test_a_growing_clip_is_a_trajectory_at_any_time() -> None:
    clip = GrowingClip(header(), capacity=5, label="live")
    state = ViewState()
    state.load((clip,))
    assert state.clock.frame_count == 0
    for t in range(3):
        clip.append(frame(t))
        state.grow()
    assert state.clock.frame_count == 3
    made = clip.trajectory()
    assert made.frame_count == 3
    np.testing.assert_array_equal(made.positions[2], frame(2).positions)
    np.testing.assert_array_equal(clip.body(1), frame(1).body_positions)


def test_a_frozen_state_stays_while_the_other_goes_on() -> None:
    seconds = [0.0]
    state = ViewState(PlaybackClock(lambda: seconds[0]))
    state.load((RecordedClip(trajectory(8), "a"),))
    state.clock.play()
    seconds[0] = 0.1
    frozen = state.frozen()
    seconds[0] = 0.2
    state.overlay = "strain"
    assert (frozen.clock.frame, frozen.clock.playing, frozen.overlay) == (3, True, "shaded")
    assert state.clock.frame == 6
    assert frozen.picture != state.picture == state.frozen().picture
