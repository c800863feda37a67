"""Biovision files: channel orders, naming schemes, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.body.skeleton import joint_positions
from pb4u.errors import InputError
from pb4u.geometry.rotation import rotate
from pb4u.motion.bvh import read_bvh
from pb4u.motion.library import load_motion


def test_channels_turn_in_the_order_written(bvh):
    recording = read_bvh(bvh(order="ZXY", angles={"LeftArm": {"Z": 90.0, "X": 90.0}}))
    arm = recording.poses.rotations[0, recording.skeleton.index("LeftArm")]
    # R = Rz Rx: the Z axis goes to -Y by Rx and on to X by Rz.
    np.testing.assert_allclose(rotate(arm, np.array([0.0, 0.0, 1.0])), [1.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("order", ["XYZ", "YXZ", "ZYX", "YZX"])
def test_any_channel_order_of_a_single_turn_is_the_same_motion(bvh, order):
    angles = {"LeftArm": {"Z": -70.0}, "RightLeg": {"X": 40.0}}
    one, other = read_bvh(bvh(angles=angles)), read_bvh(bvh(angles=angles, order=order))
    np.testing.assert_allclose(one.poses.rotations, other.poses.rotations, atol=1e-9)


def test_mixamo_arm_lowered_by_a_right_angle_hangs_on_the_body(bvh, woman):
    angles = {"LeftArm": {"Z": -90.0}, "RightArm": {"Z": 90.0}}
    poses = load_motion(bvh(angles=angles), arms_away_degrees=0.0).poses(woman, 30.0, 1)
    skeleton = woman.skeleton
    upper, elbow = skeleton.index("upperarm01.L"), skeleton.index("lowerarm01.L")
    along = rotate(poses.rotations[0, upper], skeleton.joints[elbow] - skeleton.joints[upper])
    np.testing.assert_allclose(along / np.linalg.norm(along), [0.0, -1.0, 0.0], atol=1e-6)


def test_mixamo_elbow_folds_forward(bvh, woman):
    # In a T-pose a left forearm comes forward by a negative turn about Y.
    poses = load_motion(bvh(angles={"LeftForeArm": {"Y": -90.0}})).poses(woman, 30.0, 1)
    skeleton = woman.skeleton
    elbow, wrist = skeleton.index("lowerarm01.L"), skeleton.index("wrist.L")
    along = rotate(poses.rotations[0, elbow], skeleton.joints[wrist] - skeleton.joints[elbow])
    np.testing.assert_allclose(along / np.linalg.norm(along), [0.0, 0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_hips_below_a_root_of_their_own_keep_their_travel(bvh, turned):
    path = bvh()
    plain = read_bvh(path)
    head, motion, tail = path.read_text().partition("MOTION")
    channels = "CHANNELS 1 Yrotation" if turned else "CHANNELS 0"
    above = head.replace("HIERARCHY", f"HIERARCHY\nROOT Reference\n{{\nOFFSET 5 0 0\n{channels}").replace(
        "ROOT mixamorig", "JOINT mixamorig"
    )
    if turned:
        first, second, *frames = tail.strip().splitlines()
        tail = "\n".join(["", first, second, *(f"90 {frame}" for frame in frames)])
    path.write_text(f"{above}}}\n{motion}{tail}")
    below = read_bvh(path)
    hips = joint_positions(below.skeleton, below.poses)[:, below.skeleton.index("Hips")]
    x, y, z = plain.poses.root_positions.T
    np.testing.assert_allclose(hips, np.column_stack([5.0 + z, y, -x] if turned else [5.0 + x, y, z]), atol=1e-9)
    assert below.notes == ()


def test_joints_that_leave_their_places_are_told(bvh):
    path = bvh()
    head, motion, tail = path.read_text().partition("MOTION")
    spine = head.index("CHANNELS 3")
    head = head[:spine] + head[spine:].replace("CHANNELS 3", "CHANNELS 4 Xposition", 1)
    first, second, *frames = tail.strip().splitlines()
    rows = [row.split() for row in frames]
    moved = [" ".join([*row[:6], str(3.0 * t), *row[6:]]) for t, row in enumerate(rows)]
    path.write_text("\n".join([head + motion, first, second, *moved]))
    assert read_bvh(path).notes == ("clip: bones keep their lengths; the positions of Spine are not followed.",)


def test_a_byte_order_mark_is_skipped(bvh):
    path = bvh()
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_bvh(path).poses) == 4


def test_name_prefix_is_ignored(bvh):
    with_prefix, without = read_bvh(bvh(prefix="mixamorig1:")), read_bvh(bvh(prefix=""))
    assert with_prefix.skeleton.names == without.skeleton.names


def test_skeleton_that_stands_along_z_is_turned_upright(bvh):
    path = bvh()
    lines = []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["OFFSET"]:
            x, y, z = map(float, words[1:])
            line = f"OFFSET {x} {-z} {y}"
        lines.append(line)
    path.write_text("\n".join(lines))
    joints = read_bvh(path).skeleton
    head, foot = (joints.joints[joints.index(name)] for name in ("Head", "LeftFoot"))
    assert head[1] - foot[1] > 100.0
    assert joints.joints[joints.index("LeftToeBase"), 2] > foot[2] + 10.0


def test_rate_comes_from_the_frame_time(bvh, woman):
    motion = load_motion(bvh(frames=11, frame_time="0.05"))
    assert motion.duration == pytest.approx(0.5)
    poses = motion.poses(woman, 40.0, motion.available_frames(40.0))
    assert len(poses) == 21
    # 2 units a frame of 0.05 s, evenly: resampled positions lie on the line.
    steps = np.diff(poses.root_positions[:, 2])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)


def test_unknown_joints_are_refused_with_the_nearest_skeleton(bvh):
    with pytest.raises(InputError, match=r"Mixamo.* LeftArm, RightArm"):
        load_motion(bvh(renamed={"LeftArm": "Flipper", "RightArm": "Fin"}))


def test_cut_short_in_the_frames_is_refused(bvh):
    path = bvh(frames=6)
    path.write_text(path.read_text()[:-200])
    with pytest.raises(InputError, match=r"6 frames .*ends in frame"):
        load_motion(path)


@pytest.mark.parametrize("keep", ["HIERARCHY\n", "MOTION", "JOINT"])
def test_cut_short_in_the_hierarchy_is_refused(bvh, keep):
    path = bvh()
    text = path.read_text()
    path.write_text(text[: text.rindex(keep) + len(keep)])
    with pytest.raises(InputError, match=r"cut short|no HIERARCHY|no MOTION"):
        load_motion(path)


def test_missing_brace_is_refused(bvh):
    path = bvh()
    head, _, tail = path.read_text().partition("MOTION")
    path.write_text(head.rstrip().removesuffix("}") + "MOTION" + tail)
    with pytest.raises(InputError, match="cut short in its HIERARCHY"):
        load_motion(path)


def test_no_frames_are_refused(bvh):
    with pytest.raises(InputError, match="no frames"):
        load_motion(bvh(frames=0))


@pytest.mark.parametrize("frame_time", ["0", "-0.01", "nan"])
def test_frame_time_that_is_not_positive_is_refused(bvh, frame_time):
    with pytest.raises(InputError, match=r"frame time is|Frame Time should be"):
        load_motion(bvh(frame_time=frame_time))


def test_more_frames_than_are_told_are_read(bvh):
    # Rokoko's header counts one frame less than there are.
    assert len(read_bvh(bvh(frames=4, count=3)).poses) == 4


def test_a_part_of_a_frame_too_much_is_refused(bvh):
    path = bvh(frames=4)
    path.write_text(path.read_text().rstrip() + "\n1.0 2.0\n")
    with pytest.raises(InputError, match="not the 4 frames"):
        read_bvh(path)


def test_decimal_commas_and_small_letters_of_channels_are_read(bvh):
    path = bvh()
    wanted = read_bvh(path).poses
    path.write_text(path.read_text().replace(".", ",").replace("rotation", "ROTATION").replace("Xpos", "xPos"))
    np.testing.assert_allclose(read_bvh(path).poses.root_positions, wanted.root_positions)
    np.testing.assert_allclose(read_bvh(path).poses.rotations, wanted.rotations)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_values_that_are_not_finite_are_refused(bvh, value):
    with pytest.raises(InputError, match=r"frame 3 .*not finite"):
        load_motion(bvh(frames=4, value=value))


def test_other_text_is_refused(tmp_path):
    path = tmp_path / "a.bvh"
    path.write_text("not a recording")
    with pytest.raises(InputError, match="no HIERARCHY"):
        load_motion(path)


def test_channels_that_are_given_twice_are_refused(bvh):
    path = bvh()
    text = path.read_text()
    line = next(line for line in text.splitlines() if "CHANNELS 3" in line)
    path.write_text(text.replace(line, f"{line}\n{line}", 1))
    with pytest.raises(InputError, match="has its CHANNELS twice"):
        load_motion(path)


def test_an_offset_may_follow_the_channels(bvh):
    path = bvh()
    whole = read_bvh(path)
    lines = path.read_text().splitlines()
    for number, line in enumerate(lines):
        if "CHANNELS" in line:
            lines[number - 1], lines[number] = line, lines[number - 1]
    path.write_text("\n".join(lines))
    turned = read_bvh(path)
    np.testing.assert_array_equal(turned.poses.rotations, whole.poses.rotations)
    np.testing.assert_array_equal(turned.skeleton.joints, whole.skeleton.joints)


@pytest.mark.parametrize(
    ("frame_time", "fps"), [("0.0333333", 30.0), ("0.033333", 30.0), ("0.041667", 24.0), ("0.0083333", 120.0)]
)
def test_a_rounded_frame_time_loses_no_frame(bvh, frame_time, fps):
    assert load_motion(bvh(frames=300, frame_time=frame_time)).available_frames(fps) == 300


def test_a_rate_of_television_stays(bvh):
    assert load_motion(bvh(frames=4, frame_time="0.0333667")).duration == pytest.approx(3 / 29.97, rel=1e-5)
