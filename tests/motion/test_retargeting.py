"""07_02 against an independent retargeter, and what retargeting promises about any recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pb4u.body.skeleton import joint_positions
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between, conjugate, multiply, rotate
from pb4u.motion.library import load_motion, read_recording
from pb4u.motion.retargeting import RecordedMotion, heading, lowest_heights

SAMPLE = ("01/01_01", "05/05_20", "14/14_20", "16/16_35", "29/29_25", "49/49_02", "91/91_01", "127/127_04")
TO_WORLD = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])


def test_walk_agrees_with_the_check_file_within_a_degree_and_a_centimetre(test_data, woman):
    check = np.load(test_data / "motions/check/07_02_on_anny.npz")
    rest = np.load(Path(__file__).parent / "data/anny_rest_orientations.npz")
    names = check["bone_labels"].tolist()
    order = [rest["bones"].tolist().index(name) for name in names]
    # The file gives Anny's own bone axes in Anny's world (Z up, facing -Y); poses here are counted from rest.
    absolute = multiply(TO_WORLD, check["quat_xyzw_world"].astype(np.float64)[..., [3, 0, 1, 2]])
    expected = multiply(absolute, conjugate(rest["quaternions"].astype(np.float64)[order]))
    # It was made with arms swung 8 degrees outward, and on the floor as it was recorded, which slopes.
    motion = RecordedMotion(read_recording(test_data / "motions/cmu_asfamc/07/07_02.amc"), arms_away_degrees=8.0)
    poses = motion.poses(woman, 30.0, len(expected))
    found = poses.rotations[:, [woman.skeleton.index(name) for name in names]]
    assert np.rad2deg(angle_between(expected, found)).max() < 1.0
    arms = np.array(
        [name.startswith(("shoulder", "upperarm", "lowerarm", "wrist", "finger", "meta")) for name in names]
    )
    assert np.rad2deg(angle_between(expected, found))[:, ~arms].max() < 0.05
    expected_roots = rotate(TO_WORLD, check["root_pos"].astype(np.float64))
    offset = poses.root_positions - expected_roots
    # The height is counted from another floor, which is the same in all frames.
    offset[:, 1] -= np.median(offset[:, 1])
    assert np.abs(offset).max() < 0.01


# Hands are turned by up to 40 degrees from one another in the two files, and arms are swung out for hands.
@pytest.mark.parametrize(("arms_away", "degrees"), [(0.0, 1.0), (None, 3.0)])
def test_bvh_and_amc_of_one_recording_agree(test_data, woman, arms_away, degrees):
    from_amc, from_bvh = (
        RecordedMotion(read_recording(test_data / "motions" / file), arms_away_degrees=arms_away).poses(woman, 30.0, 80)
        for file in ("cmu_asfamc/07/07_02.amc", "bvh/cmu_07_02.bvh")
    )
    for bone in ("root", "spine01", "head", "upperarm01.L", "lowerarm01.R", "upperleg01.R", "lowerleg01.L", "foot.R"):
        k = woman.skeleton.index(bone)
        assert np.rad2deg(angle_between(from_amc.rotations[:, k], from_bvh.rotations[:, k])).max() < degrees, bone
    assert np.abs(from_amc.root_positions - from_bvh.root_positions).max() < 0.01


@pytest.mark.parametrize("trial", SAMPLE)
def test_recordings_load_and_stand_on_the_ground(test_data, woman, trial):
    motion = load_motion(test_data / f"motions/cmu_asfamc/{trial}.amc")
    poses = motion.poses(woman, 15.0, motion.available_frames(15.0))
    low = lowest_heights(woman, poses)
    # Feet stand on it; toes dip as they roll off, in a tango by a hand's breadth.
    assert abs(np.percentile(low[np.abs(low) < 0.05], 50)) < 0.01
    assert low.min() > -0.12
    # The highest is a tuck jump, hips at 1.29 m.
    assert poses.root_positions[:, 1].max() < 1.4
    assert np.isfinite(poses.root_positions).all()
    np.testing.assert_allclose(np.linalg.norm(poses.rotations, axis=-1), 1.0, atol=1e-9)


@pytest.mark.parametrize("trial", ["02/02_02", "07/07_05", "08/08_04"])
def test_walks_on_a_floor_that_was_recorded_askew_do_not_float(test_data, woman, trial):
    motion = load_motion(test_data / f"motions/cmu_asfamc/{trial}.amc")
    low = lowest_heights(woman, motion.poses(woman, 30.0, motion.available_frames(30.0)))
    # As the lowest moments tell, 60 to 90 % of the frames were 3 to 12 cm above it.
    assert (low > 0.03).mean() < 0.02
    assert any("slopes" in note for note in motion.notes)


@pytest.mark.parametrize("name", ["cmu_12_01_cgspeed", "jumping_jacks", "salsa_01"])
def test_other_skeletons_stand_upright_with_the_head_on_top(test_data, woman, name):
    motion = load_motion(test_data / f"motions/bvh/{name}.bvh")
    poses = motion.poses(woman, 30.0, 30)
    joints = joint_positions(woman.skeleton, poses)
    head, feet = joints[:, woman.skeleton.index("head")], joints[:, woman.skeleton.index("foot.L")]
    assert (head[:, 1] - feet[:, 1]).min() > 1.2
    left = joints[:, woman.skeleton.index("upperarm01.L")] - joints[:, woman.skeleton.index("upperarm01.R")]
    front = rotate(heading(poses.rotations[:, 0]), np.array([0.0, 0.0, 1.0]))
    # Left is left: up x front points to it.
    assert np.sum(np.cross([0.0, 1.0, 0.0], front) * left, axis=1).min() > 0.2


def test_travel_is_scaled_by_leg_length(test_data, woman, man):
    motion = load_motion(test_data / "motions/cmu_asfamc/16/16_21.amc")
    frames = motion.available_frames(30.0)
    far = [np.ptp(motion.poses(body, 30.0, frames).root_positions[:, 2]) for body in (woman, man)]
    leg = [
        body.skeleton.joints[body.skeleton.index("upperleg01.L"), 1]
        - body.skeleton.joints[body.skeleton.index("foot.L"), 1]
        for body in (woman, man)
    ]
    assert far[1] / far[0] == pytest.approx(leg[1] / leg[0], rel=0.02)


def test_recording_starts_over_the_origin_facing_forward(test_data, woman):
    first = load_motion(test_data / "motions/cmu_asfamc/16/16_17.amc", crop=(200, 500)).poses(woman, 30.0, 1)
    np.testing.assert_allclose(first.root_positions[0, [0, 2]], 0.0, atol=1e-9)
    np.testing.assert_allclose(heading(first.rotations[0, 0]), [1.0, 0.0, 0.0, 0.0], atol=1e-9)


def test_frames_do_not_depend_on_where_reading_starts(test_data, woman):
    motion = load_motion(test_data / "motions/cmu_asfamc/07/07_02.amc")
    whole, part = motion.poses(woman, 25.0, 40), motion.poses(woman, 25.0, 10, start=30)
    np.testing.assert_allclose(part.rotations, whole.rotations[30:], atol=1e-9)
    np.testing.assert_allclose(part.root_positions, whole.root_positions[30:], atol=1e-9)


def test_frames_beyond_the_end_are_refused(test_data, woman):
    motion = load_motion(test_data / "motions/cmu_asfamc/07/07_02.amc")
    assert motion.available_frames(30.0) == 83
    with pytest.raises(InputError, match="ends after 83 frames"):
        motion.poses(woman, 30.0, 84)
