"""AMASS and VTO / HOOD files on bodies of the SMPL family and on the default body."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from pb4u.body.sequence_files import write_vertex_sequence
from pb4u.body.skeleton import joint_positions
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between, from_axis_angle, rotate
from pb4u.motion.library import load_motion, read_recording
from pb4u.motion.smpl_recording import nominal_skeleton, read_amass, smpl_recording

FAMILY = {72: "smpl", 156: "smplh", 165: "smplx"}


def swinging(frames: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses with arms hanging, a bent left elbow and a left leg swinging; Y up, walking along +Z."""
    names = nominal_skeleton(FAMILY[width]).names
    poses = np.zeros((frames, width // 3, 3))
    poses[:, names.index("left_shoulder"), 2] = -np.pi / 2
    poses[:, names.index("right_shoulder"), 2] = np.pi / 2
    poses[:, names.index("left_elbow"), 1] = -np.pi / 2
    poses[:, names.index("left_hip"), 0] = -0.4 * np.sin(np.linspace(0, 3, frames))
    translations = np.stack([np.zeros(frames), np.full(frames, 0.9), 0.03 * np.arange(frames)], axis=1)
    return poses.reshape(frames, width), translations


def z_up(poses: np.ndarray, translations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same, with Z up: the root turned by a quarter about X; only right where the root was unrotated."""
    poses = poses.copy()
    poses[:, 0] = np.pi / 2
    x, y, z = translations.T
    return poses, np.stack([x, -z, y], axis=1)


def write_amass(path, width=156, **changes):
    poses, translations = z_up(*swinging(20, width))
    members = {"poses": poses, "trans": translations, "mocap_framerate": 60.0, "betas": np.zeros(16), **changes}
    np.savez(path, **{key: value for key, value in members.items() if value is not None})
    return path


@pytest.mark.parametrize("width", [156, 165])
def test_amass_on_its_own_family_is_taken_as_it_is(tmp_path, smpl_body, width):
    motion = load_motion(write_amass(tmp_path / "a.npz", width))
    body = smpl_body(FAMILY[width])
    poses = motion.poses(body, 60.0, 20)
    given, translations = swinging(20, width)
    local = from_axis_angle(given.reshape(20, -1, 3))
    hip = body.skeleton.index("left_hip")
    assert angle_between(poses.rotations[:, hip], local[:, hip]).max() < 1e-6
    # Travel is neither scaled nor turned; the floor may move it up or down.
    np.testing.assert_allclose(poses.root_positions[:, 2], translations[:, 2], atol=1e-6)
    np.testing.assert_allclose(np.diff(poses.root_positions[:, 1]), 0.0, atol=1e-6)


def test_both_names_of_the_frame_rate_are_read(tmp_path):
    for key in ("mocap_framerate", "mocap_frame_rate"):
        path = write_amass(tmp_path / f"{key}.npz", **{"mocap_framerate": None, key: np.array(120.0)})
        assert load_motion(path).duration == pytest.approx(19 / 120)


def test_body_with_fewer_joints_takes_what_it_has(tmp_path, smpl_body):
    motion = load_motion(write_amass(tmp_path / "a.npz", 165))
    poses = motion.poses(smpl_body("smpl"), 60.0, 5)
    skeleton = smpl_body("smpl").skeleton
    wrist, hand = skeleton.index("left_wrist"), skeleton.index("left_hand")
    np.testing.assert_array_equal(poses.rotations[:, hand], poses.rotations[:, wrist])


def test_amass_on_the_default_body_hangs_arms_and_folds_the_elbow_forward(tmp_path, woman):
    motion = load_motion(write_amass(tmp_path / "a.npz"))
    joints = joint_positions(woman.skeleton, motion.poses(woman, 60.0, 20))
    shoulder, elbow, wrist = (joints[0, woman.skeleton.index(n)] for n in ("upperarm01.L", "lowerarm01.L", "wrist.L"))
    upper, fore = elbow - shoulder, wrist - elbow
    assert upper[1] / np.linalg.norm(upper) < -0.99
    assert fore[2] / np.linalg.norm(fore) > 0.99
    # The thigh swings forward, and Y is up.
    knee = joints[:, woman.skeleton.index("lowerleg01.L")] - joints[:, woman.skeleton.index("upperleg01.L")]
    assert (knee[10] - knee[0])[2] > 0.1
    assert joints[0, woman.skeleton.index("head"), 1] > 1.5


def test_recorded_clips_play_on_smpl_bodies(test_data, smpl_body):
    body = smpl_body("smplx")
    poses = load_motion(test_data / "motions/cmu_asfamc/07/07_02.amc").poses(body, 30.0, 60)
    joints = joint_positions(body.skeleton, poses)
    head, foot = (joints[:, body.skeleton.index(name), 1] for name in ("head", "left_ankle"))
    assert (head - foot).min() > 1.1
    assert np.ptp(joints[:, 0, 2]) > 2.0
    elbow = joints[:, body.skeleton.index("left_elbow")] - joints[:, body.skeleton.index("left_shoulder")]
    assert (elbow[:, 1] < 0).all()


def write_vto(path, **changes):
    poses, translations = swinging(20, 72)
    content = {"poses": poses, "trans": translations, "betas": np.zeros(10), **changes}
    path.write_bytes(pickle.dumps({key: value for key, value in content.items() if value is not None}))
    return path


def test_vto_is_y_up_at_thirty_frames(tmp_path, smpl_body):
    motion = load_motion(write_vto(tmp_path / "a.pkl"))
    assert motion.duration == pytest.approx(19 / 30)
    poses = motion.poses(smpl_body("smpl"), 30.0, 20)
    np.testing.assert_allclose(poses.root_positions[:, 2], 0.03 * np.arange(20), atol=1e-9)
    np.testing.assert_allclose(rotate(poses.rotations[0, 0], np.array([0.0, 1.0, 0.0])), [0.0, 1.0, 0.0], atol=1e-9)


def test_hood_sequence_with_separate_root_is_read(tmp_path):
    poses, _ = swinging(20, 72)
    path = write_vto(tmp_path / "a.pkl", poses=None, body_pose=poses[:, 3:], global_orient=poses[:, :3])
    np.testing.assert_allclose(
        load_motion(path).recording.poses.rotations,
        load_motion(write_vto(tmp_path / "b.pkl")).recording.poses.rotations,
    )


def test_axis_other_than_usual_is_noticed_and_told(tmp_path):
    poses, translations = z_up(*swinging(20, 72))
    motion = load_motion(write_vto(tmp_path / "a.pkl", poses=poses, trans=translations))
    assert "Z up" in motion.notes[0]
    up = rotate(motion.recording.poses.rotations[:, 0], np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(up[:, 1], 1.0, atol=1e-6)


@pytest.mark.parametrize("kind", ["amass", "joint by joint"])
def test_a_recording_in_the_axes_of_a_camera_is_turned_upright(tmp_path, kind):
    poses, translations = swinging(20, 72)
    seen = poses.copy()
    seen[:, :3] = [np.pi, 0.0, 0.0]
    path, moved = tmp_path / "clip.npz", translations * [1, -1, -1]
    if kind == "amass":
        np.savez(path, poses=seen, trans=moved, mocap_framerate=30.0)
    else:
        np.savez(path, global_orient=seen[:, :3], body_pose=seen[:, 3:], transl=moved)
    recording = read_recording(path)
    assert "turned by 180 degrees" in recording.notes[0]
    upright = smpl_recording(path, poses, translations, 30.0)
    assert upright.notes == ()
    np.testing.assert_allclose(recording.poses.root_positions, upright.poses.root_positions)
    up = np.array([0.1, 1.0, 0.2])
    np.testing.assert_allclose(rotate(recording.poses.rotations, up), rotate(upright.poses.rotations, up), atol=1e-9)


def test_the_shape_that_was_recorded_is_told(tmp_path):
    betas = np.array([0.5312, -1.2, 0.004, -0.001, 0.9, 0.3])
    path = write_amass(tmp_path / "a.npz", betas=betas, gender=np.array(b"female"))
    assert load_motion(path, crop=(2, 9)).notes == (
        "a.npz: the shape of the recorded body is not taken over; on an SMPL-family body (female) it is --body-shape "
        "beta0=0.53,beta1=-1.2,beta2=0,beta3=0 (the first 4 of 6).",
    )
    (note,) = load_motion(write_amass(tmp_path / "a.npz", betas=betas[:2])).notes
    assert note.endswith("on an SMPL-family body it is --body-shape beta0=0.53,beta1=-1.2.")


@pytest.mark.parametrize(
    "betas",
    [
        None, np.full(16, 0.05), np.zeros(0), np.full(10, np.nan), np.array(["tall"]),
        np.array([{"a": 1}], dtype=object),
    ],
)  # fmt: skip
def test_no_shape_worth_telling_is_no_note_and_no_fault(tmp_path, betas):
    path = write_amass(tmp_path / "a.npz", betas=betas, gender=np.array(["male"], dtype=object))
    assert load_motion(path).notes == ()


def test_a_moving_body_is_no_recording(tmp_path):
    path = tmp_path / "walk.npz"
    write_vertex_sequence(path, np.zeros((2, 3, 3)), np.array([[0, 1, 2]]), 30.0)
    with pytest.raises(InputError, match=r"--body .*walk\.npz"):
        load_motion(path)


def test_a_rate_that_amass_does_not_tell_can_be_given(tmp_path):
    path = write_amass(tmp_path / "a.npz", mocap_framerate=None)
    with pytest.raises(InputError, match="--recorded-fps"):
        load_motion(path)
    assert load_motion(path, recorded_fps=120.0).duration == pytest.approx(19 / 120)


@pytest.mark.parametrize("key", ["poses", "trans"])
def test_amass_without_a_key_is_refused(tmp_path, key):
    with pytest.raises(InputError, match=f"has no {key}"):
        load_motion(write_amass(tmp_path / "a.npz", **{key: None}))


@pytest.mark.parametrize("value", [[[10**400, 0, 0]] * 3, [[1.0], [1.0, 2.0]], 1j, "far"])
def test_vto_of_no_numbers_is_refused(tmp_path, value):
    path = tmp_path / "clip.pkl"
    path.write_bytes(pickle.dumps({"poses": np.zeros((3, 72)), "trans": value}))
    with pytest.raises(InputError, match='"trans"'):
        load_motion(path)


@pytest.mark.parametrize("key", ["poses", "trans"])
def test_vto_without_a_key_is_refused(tmp_path, key):
    with pytest.raises(InputError, match=f"has no {key}"):
        load_motion(write_vto(tmp_path / "a.pkl", **{key: None}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"poses": np.zeros((20, 100))}, r"shape \(20, 100\)"),
        ({"poses": np.zeros(156)}, r"shape \(156,\)"),
        ({"trans": np.zeros((19, 3))}, r"shape \(19, 3\)"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "no frames"),
        ({"mocap_framerate": 0.0}, "frame rate is 0"),
        ({"mocap_framerate": np.array([30.0, 60.0])}, "single"),
        ({"poses": np.array([["a"] * 156] * 20)}, "should be numbers"),
    ],
)
def test_amass_of_wrong_shape_is_refused(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        load_motion(write_amass(tmp_path / "a.npz", **changes))


def test_amass_with_nan_is_refused(tmp_path):
    poses, _ = z_up(*swinging(20, 156))
    poses[7, 30] = np.nan
    with pytest.raises(InputError, match=r"frame 7 .*not finite"):
        load_motion(write_amass(tmp_path / "a.npz", poses=poses))


def test_amass_of_pickled_objects_is_refused(tmp_path):
    with pytest.raises(InputError, match="plain arrays"):
        load_motion(write_amass(tmp_path / "a.npz", poses=np.array([{"a": 1}], dtype=object)))


def test_file_that_is_no_npz_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(InputError, match="not a readable"):
        load_motion(path)


class _Touches:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_pickle_that_asks_for_code_is_refused_and_does_not_run(tmp_path):
    proof = tmp_path / "ran"
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"poses": _Touches(proof), "trans": np.zeros((1, 3))}))
    with pytest.raises(InputError, match="nothing in the file was run"):
        load_motion(path)
    assert not proof.exists()


def test_pickle_that_is_no_dictionary_is_refused(tmp_path):
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps([1, 2, 3]))
    with pytest.raises(InputError, match="not the dictionary"):
        load_motion(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"poses": np.full((3, 72), 1e300)}, "beyond 1e+07"),
        ({"poses": np.zeros((3, 72), dtype=complex)}, "should be numbers"),
        ({"mocap_framerate": 1e-9}, "the frame rate is 1e-09"),
        ({"mocap_framerate": 1e9}, "the frame rate is 1e+09"),
    ],
)
def test_numbers_that_nobody_recorded_are_refused(tmp_path, change, says):
    members = {"poses": np.zeros((3, 72)), "trans": np.zeros((3, 3)), "mocap_framerate": 30.0, **change}
    np.savez(tmp_path / "odd.npz", **members)
    with pytest.raises(InputError) as refusal:
        load_motion(tmp_path / "odd.npz")
    assert says in str(refusal.value)


def test_labels_of_bedlam_and_near_names_are_told(tmp_path):
    labels = {key: np.zeros(1) for key in ("imgname", "pose_world", "trans_world", "pose_cam", "betas")}
    np.savez(tmp_path / "labels.npz", **labels)
    with pytest.raises(InputError, match="labels images of BEDLAM: each row of its pose_world and trans_world"):
        read_amass(tmp_path / "labels.npz")
    np.savez(tmp_path / "clip.npz", **{f"a{k}": np.zeros(1) for k in range(12)}, root_trans=np.zeros((2, 3)))
    with pytest.raises(InputError, match="has no poses and no trans; it holds root_trans, a0"):
        read_amass(tmp_path / "clip.npz")


def test_aist_is_read_in_its_own_unit_and_rate(tmp_path):
    poses, translations = swinging(20, 72)
    held = {"smpl_poses": poses, "smpl_trans": 93.0 * translations, "smpl_scaling": np.array([93.0]), "smpl_loss": 0.1}
    (tmp_path / "dance.pkl").write_bytes(pickle.dumps(held))
    recording = read_recording(tmp_path / "dance.pkl")
    assert recording.poses.fps == 60.0
    np.testing.assert_allclose(recording.poses.root_positions, translations)
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps({**held, "smpl_scaling": np.zeros(1)}))
    with pytest.raises(InputError, match=r"bad\.pkl: smpl_scaling should be a single number above 0"):
        read_recording(tmp_path / "bad.pkl")


@pytest.mark.parametrize(
    ("pose", "translation"), [("pose", "transl"), ("poses", "transl"), ("smpl_poses", "smpl_trans")]
)
def test_other_usual_names_are_known(tmp_path, pose, translation):
    poses, translations = swinging(20, 72)
    np.savez(tmp_path / "clip.npz", **{pose: poses, translation: translations, "fps": 25.0})
    recording = read_recording(tmp_path / "clip.npz")
    assert recording.poses.fps == 25.0
    up = rotate(recording.poses.rotations[:, 0], np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(up[:, 1], 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "held", "sentence"),
    [
        ("joints.npy", np.zeros((20, 22, 3)), "not a dictionary. .*as of HumanML3D and MDM, are not read: export BVH"),
        ("results.npy", {"motion": np.zeros(3)}, "has no pred_rotmat; it holds motion. .*export BVH"),
        (
            "vibe.pkl",
            {1: {"pose": np.zeros((3, 72))}},
            "relative to a camera, as VIBE and PHALP write it, is not read: give",
        ),
    ],
)
def test_what_others_find_in_videos_is_refused_with_a_way_out(tmp_path, name, held, sentence):
    path = tmp_path / name
    if path.suffix == ".npy":
        np.save(path, held)
    else:
        path.write_bytes(pickle.dumps(held))
    with pytest.raises(InputError, match=sentence):
        read_recording(path)
