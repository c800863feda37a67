"""CMU Acclaim files: the arithmetic on a small skeleton, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.geometry.rotation import rotate
from pb4u.motion.asf_amc import find_asf, read_amc, read_asf
from pb4u.motion.library import load_motion


def test_knee_turns_about_its_own_axis(acclaim):
    amc = acclaim(pose={"ltibia": [90.0]})
    recording = read_amc(amc)
    shin = recording.poses.rotations[0, recording.skeleton.index("ltibia")]
    # A flexed knee carries the shin backwards: it hung down before.
    np.testing.assert_allclose(rotate(shin, np.array([0.0, -1.0, 0.0])), [0.0, 0.0, -1.0], atol=1e-3)


def test_rest_pose_has_vertical_legs_and_no_rotation(acclaim):
    amc = acclaim()
    recording = read_amc(amc)
    joints = recording.skeleton.joints
    leg = joints[recording.skeleton.index("lfoot")] - joints[recording.skeleton.index("lfemur")]
    assert abs(leg[0]) < 1e-9
    assert leg[1] < -7.9
    # In the file the legs are spread: from legs together that is 20 degrees.
    femur = recording.poses.rotations[0, recording.skeleton.index("lfemur")]
    assert np.rad2deg(2 * np.arccos(femur[0])) == pytest.approx(20.0, abs=0.1)


def test_radians_and_degrees_agree(acclaim):
    amc = acclaim(pose={"ltibia": [90.0]})
    degrees = read_amc(amc).poses.rotations
    text = amc.read_text().replace(":DEGREES", ":RADIANS").replace("90.0", str(np.pi / 2))
    amc.write_text(text)
    np.testing.assert_allclose(read_amc(amc).poses.rotations, degrees, atol=1e-9)


def test_trial_finds_the_only_skeleton_of_its_folder(acclaim):
    amc = acclaim()
    amc.with_name("07.asf").rename(amc.with_name("someone.asf"))
    assert find_asf(amc).name == "someone.asf"


def test_missing_skeleton_is_refused(acclaim):
    amc = acclaim()
    amc.with_name("07.asf").unlink()
    with pytest.raises(InputError, match=r"07\.asf"):
        load_motion(amc)


def test_several_skeletons_without_a_match_are_refused(acclaim):
    amc = acclaim()
    asf = amc.with_name("07.asf")
    amc.with_name("a.asf").write_text(asf.read_text())
    asf.rename(amc.with_name("b.asf"))
    with pytest.raises(InputError, match=r"2 \.asf skeletons"):
        load_motion(amc)


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_recording_cut_between_lines_is_refused(acclaim, cut):
    amc = acclaim(frames=5)
    amc.write_text("\n".join(amc.read_text().splitlines()[:-cut]))
    with pytest.raises(InputError, match="cut short: frame 5"):
        load_motion(amc)


def test_recording_cut_within_a_line_is_refused(acclaim):
    amc = acclaim(frames=5, pose={"rhumerus": [1.0, 2.0, 3.0]})
    text = amc.read_text()
    amc.write_text(text[: text.rindex("rhumerus") + len("rhumerus 1.0 2.0")])
    with pytest.raises(InputError, match=r'frame 5 .*"rhumerus 1.0 2.0".* 3'):
        load_motion(amc)


def test_recording_without_frames_is_refused(acclaim):
    with pytest.raises(InputError, match="no frames"):
        load_motion(acclaim(frames=0))


def test_unknown_bone_is_refused(acclaim):
    amc = acclaim()
    amc.write_text(amc.read_text().replace("ltoes", "tail"))
    with pytest.raises(InputError, match=r'"tail".*07\.asf'):
        load_motion(amc)


def test_skeleton_with_other_names_is_refused(acclaim):
    amc = acclaim()
    for path in (amc, amc.with_name("07.asf")):
        path.write_text(path.read_text().replace("ltibia", "fin"))
    with pytest.raises(InputError, match=r"CMU ASF, of which ltibia is missing"):
        load_motion(amc)


def test_nan_is_refused(acclaim):
    amc = acclaim(frames=3)
    head, _, tail = amc.read_text().rpartition("lhumerus 0.0")
    amc.write_text(f"{head}lhumerus nan{tail}")
    with pytest.raises(InputError, match=r"frame 2 .*not finite"):
        load_motion(amc)


def test_word_instead_of_a_number_is_refused(acclaim):
    amc = acclaim(frames=3)
    amc.write_text(amc.read_text().replace("lradius 0.0", "lradius zero"))
    with pytest.raises(InputError, match="zero"):
        load_motion(amc)


@pytest.mark.parametrize("section", [":bonedata", ":hierarchy", ":root"])
def test_skeleton_cut_short_is_refused(acclaim, section):
    asf = acclaim().with_name("07.asf")
    asf.write_text(asf.read_text().split(section)[0])
    with pytest.raises(InputError, match="cut short or is not an ASF"):
        read_asf(asf)


def test_skeleton_cut_inside_a_bone_is_refused(acclaim):
    asf = acclaim().with_name("07.asf")
    text = asf.read_text()
    bones, hierarchy = text.split(":hierarchy")
    asf.write_text(bones[: bones.rindex("length")] + "\n:hierarchy" + hierarchy)
    with pytest.raises(InputError, match="ends inside bone"):
        read_asf(asf)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("XYZ", "XYW", "axis order"),
        ("length ", "length 0 ", "no length"),
        ("direction ", "direction 0 0 0 ", "no direction"),
    ],
)
def test_a_skeleton_that_cannot_be_posed_is_refused(acclaim, old, new, says):
    asf = acclaim().with_name("07.asf")
    text = asf.read_text()
    assert old in text
    head, _, bones = text.partition(":bonedata")
    asf.write_text(head + ":bonedata" + bones.replace(old, new, 1))
    with pytest.raises(InputError, match=says):
        read_asf(asf)


def test_bones_that_form_a_circle_are_refused(acclaim):
    asf = acclaim().with_name("07.asf")
    text = asf.read_text()
    head, _, tail = text.partition(":hierarchy")
    first = next(line for line in tail.splitlines() if line.strip().startswith("root"))
    child = first.split()[1]
    asf.write_text(head + ":hierarchy" + tail.replace("end", f"{child} root\nend"))
    with pytest.raises(InputError, match="second parent"):
        read_asf(asf)
