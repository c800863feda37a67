"""Motion from videos, as GVHMR, WHAM and TRAM write it, against the recordings that the files are made of."""

from __future__ import annotations

import pickle
import re
import zipfile
from pathlib import Path

import joblib
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tests.motion.video_files import (
    TRIALS,
    rotation_vectors,
    trial,
    wham_people,
    write_gvhmr,
    write_tram,
)

from pb4u.body.skeleton import PoseSequence, joint_positions, world_rotations
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_axis_angle, multiply
from pb4u.motion.library import load_motion, read_recording
from pb4u.motion.steadying import steadied


class Code:
    """What a pickle runs when it is loaded."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('code of the file was run')",))


def swinging(body, frames=40) -> PoseSequence:
    """A body that shifts its weight and swings an arm, in one place."""
    local = np.zeros((frames, body.skeleton.bone_count, 3))
    local[:, body.skeleton.index("left_shoulder"), 2] = -1.2 + 0.2 * np.sin(np.arange(frames) / 6)
    local[:, body.skeleton.index("right_shoulder"), 2] = 1.2
    rotations = world_rotations(from_axis_angle(local), body.skeleton.parents)
    return PoseSequence(rotations, np.tile([0.3, 0.95, -0.2], (frames, 1)), 30.0)


def farthest(body, poses, others) -> float:
    """Largest distance [m] between joints of two sequences of poses."""
    apart = joint_positions(body.skeleton, poses) - joint_positions(body.skeleton, others)
    return float(np.linalg.norm(apart, axis=-1).max())


@pytest.mark.parametrize("name", TRIALS)
def test_gvhmr_has_the_joints_of_the_trial(tmp_path, test_data, smpl_body, name):
    body = smpl_body("smplx")
    poses = trial(test_data, name, body)
    path = write_gvhmr(tmp_path / "hmr4d_results.pt", poses, body)
    recording = read_recording(path)
    assert recording.poses.fps == 30.0
    assert farthest(body, recording.poses, poses) < 1e-5
    assert "--body-shape beta0=0.5" in recording.notes[0]
    # Performed by a body it begins at the origin, facing +Z, and on the ground, as the trial does.
    played = load_motion(path, raw=True, arms_away_degrees=0.0).poses(body, 30.0, len(poses))
    moved = PoseSequence(played.rotations, played.root_positions - [0.0, _height(played, poses), 0.0], 30.0)
    assert farthest(body, moved, poses) < 1e-5
    assert abs(_height(played, poses)) < 1e-3


def _height(played, poses) -> float:
    """By how much the floor was found elsewhere [m]: the trial has four times as many frames to find it from."""
    return float((played.root_positions - poses.root_positions)[:, 1].mean())


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.0, 2.1, 0.0)])
def test_start_and_floor_may_be_anywhere(tmp_path, smpl_body, turn):
    body = smpl_body("smplx")
    poses = swinging(body)
    turned = Rotation.from_rotvec(turn).as_quat()[[3, 0, 1, 2]]
    elsewhere = PoseSequence(multiply(turned, poses.rotations), poses.root_positions + [4.0, -7.0, 1.0], 30.0)
    played = load_motion(write_gvhmr(tmp_path / "a.pt", elsewhere, body)).poses(body, 30.0, len(poses))
    lowest = body.posed(played).positions(0, len(poses))[..., 1].min()
    assert abs(float(lowest)) < 5e-3
    np.testing.assert_allclose(played.root_positions[0, [0, 2]], 0.0, atol=1e-6)


def test_wham_has_the_joints_of_its_people(tmp_path, test_data, smpl_body):
    body = smpl_body("smpl")
    performed = {0: trial(test_data, TRIALS[0], body), 3: trial(test_data, TRIALS[1], body)}
    seen = np.delete(np.arange(len(performed[3])), slice(40, 52))
    path = tmp_path / "wham_output.pkl"
    joblib.dump(wham_people(performed, body, {3: seen}), path)
    first = read_recording(path, "0")
    assert farthest(body, first.poses, performed[0]) < 1e-5
    second = read_recording(path, "3")
    assert len(second.poses) == len(performed[3])
    joints, wanted = (joint_positions(body.skeleton, poses) for poses in (second.poses, performed[3]))
    assert np.abs(joints - wanted)[seen].max() < 1e-5
    # Walking a third of a second between two frames that are known, no joint strays by more than a stride.
    assert np.linalg.norm(joints - wanted, axis=-1).max() < 0.4
    assert any("12 frame(s) in which the person was not seen are interpolated (40 to 51)" in n for n in second.notes)


@pytest.mark.parametrize("compressed", [0, 3])
def test_wham_of_one_person_needs_no_choice(tmp_path, smpl_body, compressed):
    body = smpl_body("smpl")
    poses = swinging(body)
    path = tmp_path / "wham_output.pkl"
    joblib.dump(wham_people({4: poses}, body), path, compress=compressed)
    if compressed:
        with pytest.raises(InputError, match="not a complete pickle"):
            read_recording(path)
        return
    assert farthest(body, read_recording(path).poses, poses) < 1e-5
    assert load_motion(f"{path}:4", raw=True).duration == pytest.approx(39 / 30)


def test_wham_by_an_older_joblib_or_plain_pickle(tmp_path, smpl_body):
    body = smpl_body("smpl")
    poses = swinging(body)
    people = wham_people({0: poses}, body)
    joblib.dump(people, tmp_path / "a.pkl", protocol=3)
    (tmp_path / "b.pkl").write_bytes(pickle.dumps(people))
    for name in "ab":
        assert farthest(body, read_recording(tmp_path / f"{name}.pkl").poses, poses) < 1e-5


def test_people_are_named_in_the_refusal(tmp_path, smpl_body):
    body = smpl_body("smpl")
    path = tmp_path / "wham_output.pkl"
    joblib.dump(wham_people({0: swinging(body), 3: swinging(body, 20)}, body), path)
    with pytest.raises(InputError, match=r"2 people, 0 \(40 frames\), 3 \(20 frames\).*pkl:0"):
        load_motion(path)
    with pytest.raises(InputError, match=r"has no person 9; it has 0"):
        load_motion(f"{path}:9")


def test_tram_is_brought_from_its_camera_into_the_world(tmp_path, test_data, smpl_body):
    body = smpl_body("smpl")
    poses = trial(test_data, TRIALS[0], body)
    path = write_tram(tmp_path, poses, body, tilt=np.array([0.15, 0.0, 0.05]))
    # The joints are the trial's, in another frame of reference.
    ours, theirs = (joint_positions(body.skeleton, each) for each in (read_recording(path).poses, poses))
    ours, theirs = ((each - each.mean(axis=(0, 1))).reshape(-1, 3) for each in (ours, theirs))
    turn, _ = Rotation.align_vectors(theirs, ours)
    assert np.linalg.norm(turn.apply(ours) - theirs, axis=1).max() < 1e-5
    played = load_motion(path, raw=True, arms_away_degrees=0.0).poses(body, 30.0, len(poses))
    # Up is where the person stands up to and where the feet stand: within a degree of the trial's.
    assert farthest(body, played, poses) < 0.02


def test_smplx_joint_by_joint_in_an_npz(tmp_path, smpl_body):
    body = smpl_body("smplx")
    poses = swinging(body)
    vectors = rotation_vectors(poses, body)
    path = tmp_path / "fitted.npz"
    parts = {"global_orient": vectors[:, :1], "body_pose": vectors[:, 1:22], "transl": poses.root_positions}
    np.savez(path, **parts, fps=25.0, left_hand_pose=np.zeros((40, 6)))
    recording = read_recording(path)
    assert recording.poses.fps == 25.0
    assert farthest(body, recording.poses, poses) < 1e-5


def test_the_rate_of_the_video_can_be_told(tmp_path, smpl_body):
    path = write_gvhmr(tmp_path / "a.pt", swinging(smpl_body("smplx")), smpl_body("smplx"))
    assert load_motion(path).duration == pytest.approx(39 / 30)
    assert load_motion(path, recorded_fps=60.0).duration == pytest.approx(39 / 60)


def trembling(body, poses: PoseSequence) -> PoseSequence:
    """Poses as from a video: every joint trembles by 1.5 degrees, the body by 8 mm, and it slides at 15 cm/s."""
    rng = np.random.default_rng(1)
    vectors = rotation_vectors(poses, body)
    local = multiply(from_axis_angle(vectors), from_axis_angle(np.deg2rad(1.5) * rng.normal(size=vectors.shape)))
    slide = np.outer(np.arange(len(poses)) / 30.0, [0.15, 0.0, 0.0])
    roots = poses.root_positions + 0.008 * rng.normal(size=(len(poses), 3)) + slide
    return PoseSequence(world_rotations(local, body.skeleton.parents), roots, 30.0)


def accelerations(body, poses) -> float:
    """Mean acceleration of the joints [m/s^2]."""
    return float(900.0 * np.linalg.norm(np.diff(joint_positions(body.skeleton, poses), 2, axis=0), axis=-1).mean())


@pytest.mark.parametrize("name", TRIALS)
def test_trembling_and_sliding_are_taken_out(tmp_path, test_data, smpl_body, name):
    body = smpl_body("smplx")
    poses = trial(test_data, name, body)
    path = write_gvhmr(tmp_path / "a.pt", trembling(body, poses), body)
    raw, steady = (
        load_motion(path, raw=raw, arms_away_degrees=0.0).poses(body, 30.0, len(poses)) for raw in (True, False)
    )
    clean = accelerations(body, poses)
    assert accelerations(body, raw) > 8.0 * clean
    assert accelerations(body, steady) < 3.5 * clean
    own = [joint_positions(body.skeleton, each) for each in (raw, steady, poses)]
    away = [np.linalg.norm((each - each[:, :1]) - (own[2] - own[2][:, :1]), axis=-1).mean() for each in own[:2]]
    assert away[1] < 0.7 * away[0]
    note = load_motion(path).notes[-1]
    before, after = (float(note.split(word)[1].split()[0].rstrip(";")) for word in ("slid at ", "now at "))
    assert before > 50.0
    assert after < 10.0


def test_feet_that_stand_still_stay_where_they_are(smpl_body, tmp_path):
    body = smpl_body("smplx")
    recording = read_recording(write_gvhmr(tmp_path / "a.pt", swinging(body), body))
    assert farthest(body, steadied(recording).poses, recording.poses) < 2e-3


def test_arms_are_held_off_on_its_own_family_too(tmp_path, smpl_body):
    # What was measured keeps its arms on SMPL; what was estimated from a picture may have them in the body.
    body = smpl_body("smplx")
    path = write_gvhmr(tmp_path / "a.pt", swinging(body), body)
    motion = load_motion(path)
    assert motion.recording.from_video
    assert len(motion.poses(body, 30.0, 10)) == 10


def test_leaps_are_told(tmp_path, smpl_body):
    body = smpl_body("smplx")
    poses = swinging(body)
    roots = poses.root_positions.copy()
    roots[20:] += [2.0, 0.0, 0.0]
    path = write_gvhmr(tmp_path / "a.pt", PoseSequence(poses.rotations, roots, 30.0), body)
    told = " ".join(load_motion(path).notes)
    assert re.search(r"the body leaps 1 time\(s\), farthest by 2\.\d m from frame 19 to 20", told)


# What is no such file, or is damaged.


def gvhmr(path: Path, **changes) -> Path:
    frames = 5
    parameters = {
        "body_pose": torch.zeros(frames, 63),
        "betas": torch.zeros(frames, 10),
        "global_orient": torch.zeros(frames, 3),
        "transl": torch.zeros(frames, 3),
        **changes,
    }
    torch.save({"smpl_params_global": {k: v for k, v in parameters.items() if v is not None}}, path)
    return path


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"body_pose": torch.full((5, 63), torch.nan)}, "frame 0 holds values that are not finite"),
        ({"transl": torch.tensor([[0.0, 0, 0]] * 4 + [[torch.nan, 0, 0]])}, "frame 4 holds values that are not finite"),
        ({"transl": None}, "has no transl; it holds betas, body_pose, global_orient"),
        ({"body_pose": torch.zeros(5, 72)}, "body_pose has 72 numbers a frame; SMPL-X has 63 and SMPL 69"),
        ({"global_orient": torch.zeros(4, 3)}, r"global_orient has the shape \(4, 3\), not \(5, 3\)"),
        (
            {"body_pose": torch.zeros(0, 63), "global_orient": torch.zeros(0, 3), "transl": torch.zeros(0, 3)},
            "no frames",
        ),
        ({"body_pose": torch.zeros(5, 63, dtype=torch.complex64)}, '"body_pose" is not an array of numbers'),
    ],
)
def test_parts_of_gvhmr_that_do_not_fit_are_refused(tmp_path, changes, sentence):
    with pytest.raises(InputError, match=sentence):
        load_motion(gvhmr(tmp_path / "a.pt", **changes))


def test_code_in_a_result_of_gvhmr_is_not_run(tmp_path):
    torch.save({"smpl_params_global": Code()}, tmp_path / "a.pt")
    with pytest.raises(InputError, match="exec"):
        load_motion(tmp_path / "a.pt")


def test_weights_are_no_motion(tmp_path):
    torch.save({"state_dict": {"a": torch.zeros(2)}}, tmp_path / "a.pt")
    with pytest.raises(InputError, match=r"smpl_params_global .*state_dict"):
        load_motion(tmp_path / "a.pt")


def test_a_torch_file_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.pt").write_bytes(b"solid nothing")
    with pytest.raises(InputError, match=r"not a complete file of torch\.save"):
        load_motion(tmp_path / "a.pt")
    whole = gvhmr(tmp_path / "b.pt").read_bytes()
    (tmp_path / "c.pt").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"not a complete file of torch\.save"):
        load_motion(tmp_path / "c.pt")


def test_a_packed_torch_file_is_refused(tmp_path):
    gvhmr(tmp_path / "a.pt")
    with (
        zipfile.ZipFile(tmp_path / "a.pt") as old,
        zipfile.ZipFile(tmp_path / "b.pt", "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            new.writestr(name, old.read(name))
    with pytest.raises(InputError, match="its members are compressed"):
        load_motion(tmp_path / "b.pt")


def test_one_person_needs_no_name(tmp_path):
    with pytest.raises(InputError, match=r'one person.*":1"'):
        load_motion(f"{gvhmr(tmp_path / 'a.pt')}:1")


@pytest.mark.parametrize(
    ("people", "sentence"),
    [
        ({}, "holds nobody"),
        ({0: {}}, "person 0 has no pose_world and trans_world"),
        ({0: {"pose_world": np.zeros((4, 71)), "trans_world": np.zeros((4, 3))}}, r"poses have the shape \(4, 71\)"),
        ({0: {"pose_world": np.full((4, 72), np.nan), "trans_world": np.zeros((4, 3))}}, "frame 0 holds values"),
        (
            {
                0: {
                    "pose_world": np.zeros((4, 72)),
                    "trans_world": np.zeros((4, 3)),
                    "frame_ids": np.array([3, 2, 4, 5]),
                }
            },
            "not numbered in rising order",
        ),
        (
            {0: {"pose_world": np.zeros((2, 72)), "trans_world": np.zeros((2, 3)), "frame_ids": np.array([3, 900])}},
            "only 2 of 898 frames exist",
        ),
        ({0: Code()}, 'asks for "builtins.exec".*nothing in the file was run'),
        ({0: {"pose_world": np.array([Code()], dtype=object)}}, "an array of objects"),
    ],
)
def test_wham_files_that_do_not_fit_are_refused(tmp_path, people, sentence):
    joblib.dump(people, tmp_path / "wham_output.pkl")
    with pytest.raises(InputError, match=sentence):
        load_motion(tmp_path / "wham_output.pkl")


def test_a_wham_file_cut_short_is_refused(tmp_path, smpl_body):
    joblib.dump(wham_people({0: swinging(smpl_body("smpl"))}, smpl_body("smpl")), tmp_path / "a.pkl")
    whole = (tmp_path / "a.pkl").read_bytes()
    for share in (0.3, 0.6, 0.95):
        (tmp_path / "b.pkl").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"b\.pkl"):
            load_motion(tmp_path / "b.pkl")


def test_tram_files_that_do_not_fit_are_refused(tmp_path, smpl_body):
    body = smpl_body("smpl")
    path = write_tram(tmp_path, swinging(body), body, tilt=np.zeros(3))
    camera = (tmp_path / "camera.npy").read_bytes()
    (tmp_path / "camera.npy").unlink()
    with pytest.raises(InputError, match=r"needs the camera\.npy"):
        load_motion(path)
    np.save(tmp_path / "camera.npy", {"pred_cam_R": np.eye(3)[None], "pred_cam_T": np.zeros((1, 3))})
    with pytest.raises(InputError, match="the two come from different videos"):
        load_motion(path)
    (tmp_path / "camera.npy").write_bytes(camera)
    np.save(path, {"pred_rotmat": Code()}, allow_pickle=True)
    with pytest.raises(InputError, match=r'asks for "builtins\.exec"'):
        load_motion(path)
    np.save(path, np.zeros(3))
    with pytest.raises(InputError, match="not a dictionary"):
        load_motion(path)
