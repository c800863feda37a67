"""From the rest pose into a motion."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.body.skeleton import joint_positions
from pb4u.errors import InputError
from pb4u.motion.lead_in import lead_in
from pb4u.motion.library import load_motion
from pb4u.motion.retargeting import heading, lowest_heights


@pytest.mark.parametrize("name", ["walk", "run", "squat", "turn", "dance"])
def test_lead_in_goes_from_rest_to_the_motion_on_the_ground(woman, name):
    poses = load_motion(name).poses(woman, 30.0, 20, start=17)
    led = lead_in(poses, woman, 30)
    assert len(led) == 50
    np.testing.assert_array_equal(led.rotations[30:], poses.rotations)
    np.testing.assert_array_equal(led.root_positions[30:], poses.root_positions)
    # Frame 0 is the rest pose, turned and moved on the ground only.
    np.testing.assert_allclose(led.rotations[0], np.tile(heading(poses.rotations[0, 0]), (104, 1)), atol=1e-9)
    assert led.root_positions[0, 1] == pytest.approx(woman.skeleton.joints[0, 1], abs=0.002)
    np.testing.assert_allclose(led.root_positions[0, [0, 2]], poses.root_positions[0, [0, 2]], atol=1e-9)
    low = lowest_heights(woman, led)[:31]
    assert low.min() > min(-0.003, low[30] - 0.002)
    assert low.max() < max(0.003, low[30] + 0.002)


def test_velocity_is_kept_at_the_junction(woman):
    fps = 60.0
    poses = load_motion("walk").poses(woman, fps, 30)
    joints = joint_positions(woman.skeleton, lead_in(poses, woman, 60))
    velocity = np.diff(joints, axis=0) * fps
    before, after = velocity[59], velocity[60]
    assert np.linalg.norm(after - before, axis=1).max() < 0.6
    assert np.linalg.norm(after, axis=1).max() > 1.0
    # It starts from standstill.
    assert np.linalg.norm(velocity[0], axis=1).max() < 0.02


def test_no_frames_change_nothing(woman):
    poses = load_motion("walk").poses(woman, 30.0, 3)
    assert lead_in(poses, woman, 0) is poses


def test_lead_in_into_a_single_frame(woman):
    assert len(lead_in(load_motion("jump").poses(woman, 30.0, 1), woman, 5)) == 6


def test_negative_number_of_frames_is_refused(woman):
    with pytest.raises(InputError, match="-1 frames is not possible"):
        lead_in(load_motion("walk").poses(woman, 30.0, 2), woman, -1)
