"""What every built-in clip must be: endless, smooth, on the ground, and human."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.body.skeleton import joint_positions
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between
from pb4u.motion.library import load_motion, motion_names
from pb4u.motion.retargeting import lowest_heights

CLIPS = motion_names()
GROUNDED = [name for name in CLIPS if name not in ("jump", "run")]


@pytest.fixture(params=["woman", pytest.param("man", marks=pytest.mark.slow)])
def body(request, woman, man):
    return woman if request.param == "woman" else man


def travel(poses, fps):
    """Mean speed along each axis [m/s]."""
    return (poses.root_positions[-1] - poses.root_positions[0]) / ((len(poses) - 1) / fps)


def test_there_are_the_eight_clips():
    assert CLIPS == ("walk", "run", "jump", "arms", "twist", "squat", "turn", "dance")


@pytest.mark.parametrize("name", CLIPS)
def test_clip_is_a_function_of_time_without_end(body, name):
    motion = load_motion(name)
    assert motion.available_frames(30.0) is None
    early, late = motion.poses(body, 30.0, 200), motion.poses(body, 30.0, 20, start=150)
    np.testing.assert_allclose(late.rotations, early.rotations[150:170], atol=1e-9)
    np.testing.assert_allclose(late.root_positions, early.root_positions[150:170], atol=1e-9)
    slow = motion.poses(body, 60.0, 399)
    np.testing.assert_allclose(slow.root_positions[::2], early.root_positions, atol=1e-9)
    assert len(motion.poses(body, 30.0, 3, start=100_000)) == 3


@pytest.mark.parametrize("name", CLIPS)
def test_feet_stay_on_the_ground_and_never_in_it(body, name):
    low = lowest_heights(body, load_motion(name).poses(body, 60.0, 600))
    assert low.min() > -0.004
    if name in GROUNDED:
        assert low.max() < 0.004


@pytest.mark.parametrize("name", ["walk", "jump", "squat", "turn", "dance", "arms", "twist"])
def test_feet_that_carry_weight_do_not_slide(woman, name):
    fps = 120.0
    poses = load_motion(name).poses(woman, fps, 480)
    owner = woman.weights.bones[np.arange(len(woman.vertices)), woman.weights.weights.argmax(1)]
    names = np.array(woman.skeleton.names)[owner]
    sole = np.flatnonzero([bone.startswith(("foot", "toe")) for bone in names])
    positions = woman.posed(poses).positions(0, 480).numpy()[:, sole]
    speed = np.linalg.norm(np.diff(positions[..., [0, 2]], axis=0), axis=2) * fps
    down = (positions[:-1, :, 1] < 0.002) & (positions[1:, :, 1] < 0.002)
    # Of the points that touch the ground, those on which the body turns stand still.
    slowest = np.where(down, speed, np.inf).min(axis=1)
    slowest = slowest[np.isfinite(slowest)]
    assert len(slowest) > 240
    assert np.percentile(slowest, 98) < 0.05


@pytest.mark.parametrize("name", CLIPS)
def test_clip_is_smooth(body, name):
    fps = 120.0
    poses = load_motion(name).poses(body, fps, 1300)
    joints = joint_positions(body.skeleton, poses)
    acceleration = np.linalg.norm(np.diff(joints, 2, axis=0), axis=2) * fps**2
    # Toes and hands of a runner and a jumper reach this much; a kink would be at thousands.
    assert acceleration.max() < (200.0 if name in ("run", "jump") else 70.0)
    turning = np.rad2deg(angle_between(poses.rotations[:-1], poses.rotations[1:])) * fps
    assert turning.max() < 1800.0


@pytest.mark.parametrize("name", CLIPS)
def test_knees_and_elbows_fold_the_human_way(body, name):
    poses = load_motion(name).poses(body, 30.0, 300)
    joints, skeleton = joint_positions(body.skeleton, poses), body.skeleton
    for side in "LR":
        hip, knee, ankle, toe, shoulder, elbow, wrist = (
            joints[:, skeleton.index(f"{bone}.{side}")]
            for bone in ("upperleg01", "lowerleg01", "foot", "toe2-1", "upperarm01", "lowerarm01", "wrist")
        )
        # The knee lies in front of the line from hip to ankle, on the side to which the toes point.
        along = (ankle - hip) / np.linalg.norm(ankle - hip, axis=1, keepdims=True)
        bend = (knee - hip) - np.sum((knee - hip) * along, axis=1, keepdims=True) * along
        assert (np.sum(bend * (toe - ankle), axis=1) > -1e-4).all()
        upper, fore = elbow - shoulder, wrist - elbow
        cosine = np.sum(upper * fore, axis=1) / (np.linalg.norm(upper, axis=1) * np.linalg.norm(fore, axis=1))
        assert np.rad2deg(np.arccos(cosine)).max() < 120.0
        # Bones keep their lengths.
        assert np.ptp(np.linalg.norm(upper, axis=1)) < 1e-9


@pytest.mark.parametrize("name", CLIPS)
def test_arms_stay_outside_the_torso(body, name):
    poses = load_motion(name).poses(body, 30.0, 300)
    joints, skeleton = joint_positions(body.skeleton, poses), body.skeleton
    bottom, top = joints[:, skeleton.index("spine05")], joints[:, skeleton.index("spine01")]
    axis = top - bottom
    for bone in ("lowerarm01.L", "lowerarm01.R", "lowerarm02.L", "lowerarm02.R", "wrist.L", "wrist.R"):
        arm = joints[:, skeleton.index(bone)] - bottom
        s = np.clip(np.sum(arm * axis, axis=1) / np.sum(axis * axis, axis=1), 0.0, 1.0)
        assert np.linalg.norm(arm - s[:, None] * axis, axis=1).min() > 0.14


@pytest.mark.parametrize(("name", "low", "high"), [("walk", 1.2, 1.45), ("run", 2.5, 3.1)])
def test_gaits_travel_forward(body, name, low, high):
    speed = travel(load_motion(name).poses(body, 60.0, 1201), 60.0)
    assert low < speed[2] < high
    assert abs(speed[0]) < 0.01


@pytest.mark.parametrize("name", ["jump", "arms", "twist", "squat", "turn", "dance"])
def test_other_clips_stay_where_they_are(body, name):
    roots = load_motion(name).poses(body, 30.0, 900).root_positions
    assert np.abs(roots[:, [0, 2]]).max() < 0.8


def test_jump_leaves_the_ground_and_comes_back(body):
    low = lowest_heights(body, load_motion("jump").poses(body, 60.0, 300))
    assert 0.15 < low.max() < 0.4
    assert (low < 0.005).mean() > 0.6


def test_run_has_a_flight_and_walk_has_none(woman):
    assert lowest_heights(woman, load_motion("run").poses(woman, 120.0, 240)).max() > 0.006
    assert lowest_heights(woman, load_motion("walk").poses(woman, 120.0, 240)).max() < 0.004


def test_turn_goes_round(woman):
    poses = load_motion("turn").poses(woman, 30.0, 300)
    front = 2 * np.arctan2(poses.rotations[:, 0, 2], poses.rotations[:, 0, 0])
    turned = np.unwrap(front, period=2 * np.pi)
    assert abs(turned[-1] - turned[0]) > 3 * np.pi


def test_seed_changes_tempo_and_amplitude_a_little_and_repeats(woman):
    plain, one, again = (load_motion("dance", seed=seed).poses(woman, 30.0, 60) for seed in (0, 5, 5))
    np.testing.assert_array_equal(one.rotations, again.rotations)
    difference = np.rad2deg(angle_between(plain.rotations, one.rotations))
    assert 1.0 < difference.max() < 90.0


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))])
def test_varied_clips_stay_on_the_ground(woman, seed):
    for name in CLIPS:
        low = lowest_heights(woman, load_motion(name, seed=seed).poses(woman, 30.0, 150))
        assert low.min() > -0.005, name


def test_clips_play_on_smpl_bodies(smpl_body):
    body = smpl_body("smplx")
    for name in CLIPS:
        joints = joint_positions(body.skeleton, load_motion(name).poses(body, 30.0, 60))
        ankles = joints[:, [body.skeleton.index(f"{side}_ankle") for side in ("left", "right")], 1]
        assert np.isfinite(joints).all()
        assert ankles.min() > 0.0


def test_arms_away_lowers_nothing_else(woman):
    plain, away = (load_motion("walk", arms_away_degrees=angle).poses(woman, 30.0, 30) for angle in (0.0, 8.0))
    difference = np.rad2deg(angle_between(plain.rotations, away.rotations)).max(axis=0)
    names = np.array(woman.skeleton.names)
    arm = np.array([name.startswith(("shoulder", "upperarm", "lowerarm", "wrist", "finger", "meta")) for name in names])
    assert difference[~arm].max() < 1e-6
    assert 6.0 < difference[woman.skeleton.index("upperarm01.L")] <= 8.0 + 1e-6
    wrists = [joint_positions(woman.skeleton, poses)[:, woman.skeleton.index("wrist.L"), 0] for poses in (plain, away)]
    assert (wrists[1] > wrists[0] + 0.03).all()


@pytest.mark.parametrize(("fps", "frames", "start"), [(30.0, 0, 0), (0.0, 5, 0), (30.0, 5, -1)])
def test_senseless_requests_are_refused(woman, fps, frames, start):
    with pytest.raises(InputError, match=r"walk: .* do not exist"):
        load_motion("walk").poses(woman, fps, frames, start)
