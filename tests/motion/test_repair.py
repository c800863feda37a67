"""Flips and false starts of recordings: found, mended, counted, and left alone where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pb4u.geometry.rotation import angle_between, from_axis_angle, multiply
from pb4u.motion.bvh import read_bvh
from pb4u.motion.library import load_motion
from pb4u.motion.repair import without_false_start, without_flips


@pytest.fixture
def still(bvh):
    return read_bvh(bvh(frames=120, frame_time="0.00833333"))


def turned(recording, bone, frames, degrees, axis=0):
    """The recording with one bone turned in the world during some frames."""
    rotations = recording.poses.rotations.copy()
    k = recording.skeleton.index(bone)
    turn = from_axis_angle(np.deg2rad(degrees) * np.eye(3)[axis])
    rotations[frames, k] = multiply(turn, rotations[frames, k])
    return replace(recording, poses=replace(recording.poses, rotations=rotations))


def fastest(recording, bone):
    rotations = recording.poses.rotations[:, recording.skeleton.index(bone)]
    return np.rad2deg(angle_between(rotations[:-1], rotations[1:])).max()


def test_flip_there_and_back_is_led_over_and_counted(still):
    flipped = turned(still, "LeftToeBase", slice(50, 54), 150.0)
    mended = without_flips(flipped)
    assert fastest(flipped, "LeftToeBase") > 100.0
    assert fastest(mended, "LeftToeBase") < 1.0
    assert mended.notes == ("clip: 1 sudden joint flip(s) replaced by a smooth turn (LeftToeBase 1).",)


def test_flip_that_stays_becomes_a_turn(still):
    mended = without_flips(turned(still, "RightToeBase", slice(60, None), 120.0))
    assert fastest(mended, "RightToeBase") < 600.0 / 120.0 * 2.0
    last = mended.poses.rotations[-1, mended.skeleton.index("RightToeBase")]
    assert np.rad2deg(2 * np.arccos(abs(last[0]))) == pytest.approx(120.0, abs=1.0)


def test_quick_twist_of_a_limb_is_a_flip(still):
    # 25 degrees a frame about the arm's own axis, which no shoulder does.
    recording = still
    for frame in range(40, 44):
        recording = turned(recording, "LeftHand", slice(frame, 80), 0.0)
        recording = turned(recording, "LeftForeArm", slice(frame, 80), 25.0, axis=0)
    assert len(without_flips(recording).notes) == 1


def test_quick_but_human_motion_is_left_alone(still):
    recording = still
    for frame in range(40, 60):
        recording = turned(recording, "LeftToeBase", slice(frame, None), 8.0)
    mended = without_flips(recording)
    assert mended is recording


def test_children_follow_a_mended_parent(still):
    mended = without_flips(turned(still, "LeftUpLeg", slice(50, 52), 170.0))
    assert fastest(mended, "LeftUpLeg") < 1.0


def test_calibration_pose_at_the_start_is_left_out(still):
    recording = still
    for bone in ("LeftUpLeg", "RightUpLeg", "LeftArm", "RightArm"):
        recording = turned(recording, bone, slice(0, 1), 70.0)
    mended = without_false_start(recording)
    assert len(mended.poses) == len(recording.poses) - 1
    assert "first 1 frame(s)" in mended.notes[0]
    assert without_false_start(still) is still


def test_flips_of_a_real_recording_are_counted(test_data):
    motion = load_motion(test_data / "motions/cmu_asfamc/05/05_20.amc")
    assert "lfemur 1" in motion.notes[0]
    assert "lfoot 1" in motion.notes[0]


def test_a_recording_that_leaps_is_told(bvh):
    assert not [note for note in load_motion(bvh(frames=20)).notes if "leaps" in note]
    path = bvh(frames=20)
    lines = path.read_text().splitlines()
    words = lines[-5].split()
    lines[-5] = " ".join(["100000.0", *words[1:]])
    path.write_text("\n".join(lines) + "\n")
    (note,) = [note for note in load_motion(path).notes if "leaps" in note]
    assert "2 time(s)" in note
    assert "--crop" in note
