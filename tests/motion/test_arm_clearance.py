"""Arms that a recording puts into the body come off it, gently, and no others move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pb4u
from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.errors import InputWarning
from pb4u.geometry.rotation import angle_between
from pb4u.motion.arm_clearance import eased, reach
from pb4u.motion.lead_in import lead_in
from pb4u.motion.library import load_motion
from pb4u.motion.retargeting import RecordedMotion

HANGING = {"LeftArm": {"Z": -90.0}, "RightArm": {"Z": 90.0}}


def wrist_depth(body: ShapedBody, poses: PoseSequence) -> np.ndarray:
    """How deep (frames,) [m] the skin about the wrists lies in legs and trunk; negative outside."""
    names = body.skeleton.names
    of_arm = np.array([name.startswith(("upperarm", "lowerarm", "wrist", "shoulder")) for name in names])
    wrists = np.flatnonzero(body.weights.share_of(np.array([name.startswith("lowerarm02") for name in names])) > 0.5)
    trunk = TriangleSurface(body.faces, len(body.vertices), body.weights.share_of(of_arm) < 0.5)
    placed = body.posed(poses).positions(0, len(poses)).double()
    return np.array([-float(trunk.at(each).nearest(each[wrists]).signed_distance.min()) for each in placed])


def test_hanging_arms_that_go_into_the_hips_are_held_off_and_told(bvh, woman):
    path = bvh(angles=HANGING)
    left_as_recorded = load_motion(path, arms_away_degrees=0.0).perform(woman, 30.0, 1)
    assert wrist_depth(woman, left_as_recorded.poses)[0] > 0.02
    assert not left_as_recorded.notes
    held = load_motion(path).perform(woman, 30.0, 1)
    assert wrist_depth(woman, held.poses)[0] < -0.004
    assert "arms are swung out by up to" in held.notes[0]
    assert "--arms-away 0 leaves them as recorded" in held.notes[0]
    turned = np.rad2deg(angle_between(left_as_recorded.poses.rotations[0], held.poses.rotations[0]))
    arms = np.array([name.startswith(("upperarm", "lowerarm", "wrist")) for name in woman.skeleton.names])
    assert 3.0 < turned[arms].max() < 30.0
    legs = np.array([name.startswith(("upperleg", "foot", "root", "head")) for name in woman.skeleton.names])
    assert turned[legs].max() == 0.0


def test_the_sentence_is_a_note_of_the_scene(bvh):
    path = bvh(angles=HANGING)
    with pytest.warns(InputWarning, match="arms are swung out"):
        scene = pb4u.make_scene("tanktop", "woman", path, triangles=700, frames=1, lead_in=0)
    assert any("arms are swung out" in note for note in scene.notes)


def test_arms_with_room_stay_exactly_as_they_are(bvh, woman):
    path = bvh(angles={"LeftArm": {"Z": -30.0}, "RightArm": {"Z": 30.0}})
    left, held = (load_motion(path, arms_away_degrees=away).perform(woman, 30.0, 1) for away in (0.0, None))
    np.testing.assert_array_equal(left.poses.rotations, held.poses.rotations)
    assert not held.notes


def test_turns_begin_before_they_are_needed_and_reach_their_height():
    turns = np.zeros((60, 3))
    turns[30:34, 2] = 0.2
    found = eased(turns, 30.0)
    assert reach(30.0) == 6
    np.testing.assert_allclose(found[30:34, 2], 0.2)
    assert (found[:24] == 0.0).all()
    assert (found[40:] == 0.0).all()
    assert np.abs(np.diff(found[:, 2])).max() < 0.06
    # The direction of what is needed most is the one that counts.
    turns[31, 2], turns[31, 0] = 0.0, 0.3
    assert eased(turns, 30.0)[31, 0] > 0.25


@pytest.mark.parametrize("trial", ["35/35_01", "127/127_09", "16/16_17"])
def test_recorded_walks_and_runs_have_their_arms_outside(test_data, woman, trial):
    path = test_data / f"motions/cmu_asfamc/{trial}.amc"
    frames = min(40, load_motion(path).available_frames(30.0))
    before = load_motion(path, arms_away_degrees=0.0).poses(woman, 30.0, frames)
    after = load_motion(path).poses(woman, 30.0, frames)
    assert (wrist_depth(woman, before) > 0.005).mean() > 0.5
    assert wrist_depth(woman, after).max() < 0.0
    # Nothing jerks: a few degrees a frame more than recorded.
    wrist = woman.skeleton.index("lowerarm01.L")
    speeds = [
        np.rad2deg(angle_between(each.rotations[1:, wrist], each.rotations[:-1, wrist])) for each in (before, after)
    ]
    assert (speeds[1] - speeds[0]).max() < 5.0


def test_a_lead_in_has_its_arms_held_off_as_the_motion_has(bvh, woman):
    """Arms that fly out at the first frame come from inside the hips, where the way there is thought back."""
    hanging, out = (
        load_motion(bvh(20, angles={"LeftArm": {"Z": -angle}, "RightArm": {"Z": angle}})).recording
        for angle in (78.0, 70.0)
    )
    rotations = np.concatenate([hanging.poses.rotations[:1], out.poses.rotations[1:]])
    motion = RecordedMotion(replace(out, poses=replace(out.poses, rotations=rotations)))
    poses = motion.poses(woman, 30.0, 12)
    led = lead_in(poses, woman, 12)
    assert wrist_depth(woman, led).max() > 0.02
    held = pb4u.make_scene("tanktop", woman, motion, triangles=700, frames=12, lead_in=12).colliders[0].poses
    assert wrist_depth(woman, held).max() < 0.0
    np.testing.assert_array_equal(held.rotations[12 + reach(30.0) :], poses.rotations[reach(30.0) :])
    np.testing.assert_array_equal(held.rotations[0], led.rotations[0])
