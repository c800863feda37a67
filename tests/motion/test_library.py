"""Motions by name or file."""

from __future__ import annotations

import pytest

from pb4u.errors import InputError
from pb4u.motion.library import load_motion


def test_unknown_name_is_answered_with_near_ones():
    with pytest.raises(InputError, match="did you mean walk"):
        load_motion("wlak")


def test_name_unlike_any_lists_all():
    with pytest.raises(InputError, match="walk, run, jump"):
        load_motion("zzz")


def test_absent_file_is_refused():
    with pytest.raises(InputError, match="no motion file"):
        load_motion("absent.bvh")


def test_crop_of_a_clip_without_end_is_refused():
    with pytest.raises(InputError, match="no end to crop"):
        load_motion("walk", crop=(0, 10))


def test_crop_keeps_frames_at_the_rate_of_the_recording(bvh):
    motion = load_motion(bvh(frames=10, frame_time="0.1"), crop=(2, 7))
    assert motion.duration == pytest.approx(0.4)


@pytest.mark.parametrize("crop", [(-1, 3), (3, 3), (5, 2), (0, 11)])
def test_crop_outside_the_recording_is_refused(bvh, crop):
    with pytest.raises(InputError, match="frames 0:10"):
        load_motion(bvh(frames=10), crop=crop)


def test_recording_of_one_frame_stands_still(bvh, woman):
    motion = load_motion(bvh(frames=1))
    assert motion.available_frames(30.0) == 1
    assert len(motion.poses(woman, 30.0, 1)) == 1
