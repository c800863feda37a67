"""People who lie, crawl or stand on their hands stay so, whichever way they face, in every kind of SMPL file."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.rest_poses import write_rested
from tests.motion.video_files import rotation_vectors, wham_people, write_gvhmr, write_tram

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence, joint_positions, world_rotations
from pb4u.geometry.rotation import about_axis, from_axis_angle, multiply, rotate
from pb4u.motion.bvh import read_bvh
from pb4u.motion.library import load_motion, read_recording

Y_TO_Z = about_axis("x", np.pi / 2)
HEADINGS = range(0, 360, 45)


def leaning(degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    """A pelvis that leans forward by so much, in every frame."""
    return lambda time: np.full_like(time, degrees)


# What the pelvis does [deg] over a second, and joints that are bent [deg] by axis.
ACTIVITIES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], dict[str, tuple[float, float, float]]]] = {
    "lying on the back": (leaning(-90.0), {"left_shoulder": (0, 0, -60), "right_shoulder": (0, 0, 60)}),
    "lying on the front": (leaning(90.0), {"left_shoulder": (0, 0, 60), "right_shoulder": (0, 0, -60)}),
    "crawling": (
        leaning(80.0),
        {
            "left_shoulder": (0, -90, 0), "right_shoulder": (0, 90, 0), "left_hip": (-75, 0, 0),
            "right_hip": (-85, 0, 0), "left_knee": (90, 0, 0), "right_knee": (90, 0, 0),
        },
    ),
    "dog of yoga": (
        leaning(130.0),
        {
            "left_shoulder": (0, 0, 80), "right_shoulder": (0, 0, -80), "left_hip": (-90, 0, 0),
            "right_hip": (-90, 0, 0),
        },
    ),
    "standing on the hands": (leaning(180.0), {"left_shoulder": (0, 0, 85), "right_shoulder": (0, 0, -85)}),
    "turning a cartwheel": (lambda time: 360.0 * time, {"left_shoulder": (0, 0, 40), "right_shoulder": (0, 0, -40)}),
    "standing": (leaning(0.0), {"left_shoulder": (0, 0, -70), "right_shoulder": (0, 0, 70)}),
}  # fmt: skip


def performed(body: ShapedBody, activity: str, heading: float, frames: int = 16) -> PoseSequence:
    """An activity with its lowest joint on the floor, at a heading [deg], moving on by 30 cm a second."""
    lean, bends = ACTIVITIES[activity]
    skeleton, time = body.skeleton, np.linspace(0.0, 1.0, frames)
    local = np.zeros((frames, skeleton.bone_count, 3))
    for joint, angles in bends.items():
        local[:, skeleton.index(joint)] = np.deg2rad(angles)
    q = from_axis_angle(local)
    axis = "z" if "cartwheel" in activity else "x"
    yaw = np.full(frames, np.deg2rad(heading))
    q[:, 0] = multiply(about_axis("y", yaw), about_axis(axis, np.deg2rad(lean(time))))
    way = np.array([np.sin(np.deg2rad(heading)), 0.0, np.cos(np.deg2rad(heading))])
    poses = PoseSequence(world_rotations(q, skeleton.parents), np.outer(0.3 * time, way), 30.0)
    low = joint_positions(skeleton, poses)[..., 1].min(axis=1)
    return PoseSequence(poses.rotations, poses.root_positions + np.outer(0.05 - low, [0.0, 1.0, 0.0]), 30.0)


def z_up(poses: PoseSequence) -> PoseSequence:
    return PoseSequence(multiply(Y_TO_Z, poses.rotations), rotate(Y_TO_Z, poses.root_positions), 30.0)


def amass(folder: Path, poses: PoseSequence, body: ShapedBody, **more: object) -> Path:
    vectors = rotation_vectors(z_up(poses), body).reshape(len(poses), -1)
    members = {"poses": vectors, "trans": z_up(poses).root_positions, "betas": np.zeros(16), **more}
    np.savez(folder / "clip.npz", **({"mocap_framerate": 30.0} if not more else {}), **members)  # type: ignore[arg-type]
    return folder / "clip.npz"


def stageii(folder: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    vectors = rotation_vectors(z_up(poses), body).reshape(len(poses), -1)
    keys = {"root_orient": vectors[:, :3], "pose_body": vectors[:, 3:66], "pose_hand": vectors[:, 75:]}
    return amass(folder, poses, body, mocap_frame_rate=30.0, surface_model_type="smplx", **keys)


def joint_by_joint(folder: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    vectors = rotation_vectors(poses, body)
    parts = {"global_orient": vectors[:, 0], "body_pose": vectors[:, 1:22], "transl": poses.root_positions}
    np.savez(folder / "clip.npz", **parts)
    return folder / "clip.npz"


def hood(folder: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    vectors = rotation_vectors(poses, body).reshape(len(poses), 72)
    held = {"body_pose": vectors[:, 3:], "global_orient": vectors[:, :3], "transl": poses.root_positions}
    (folder / "clip.pkl").write_bytes(pickle.dumps({**held, "betas": np.zeros(10)}))
    return folder / "clip.pkl"


def gvhmr(folder: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    return write_gvhmr(folder / "clip.pt", poses, body)


def wham(folder: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    joblib.dump(wham_people({0: poses}, body), folder / "clip.pkl")
    return folder / "clip.pkl"


def tram(folder: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    return write_tram(folder, poses, body, tilt=np.array([0.1, 0.0, 0.05]))


KINDS = {
    "smplh": (amass,), "smplx": (stageii, joint_by_joint, gvhmr), "smpl": (hood, wham, tram),
}  # fmt: skip


ROOTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "over the floor": lambda places: places,
    "at the origin": np.zeros_like,
    "from the origin": lambda places: places - places[0],
}


@pytest.mark.parametrize("root", list(ROOTS))
@pytest.mark.parametrize("activity", list(ACTIVITIES))
@pytest.mark.parametrize(("family", "write"), [(f, w) for f, kinds in KINDS.items() for w in kinds])
def test_nobody_is_stood_up_or_laid_down(tmp_path, smpl_body, activity, family, write, root):
    body = smpl_body(family)
    for heading in HEADINGS:
        poses = performed(body, activity, heading)
        poses = replace(poses, root_positions=ROOTS[root](poses.root_positions))
        folder = tmp_path / str(heading)
        folder.mkdir()
        recording = read_recording(write(folder, poses, body))
        # Where the pelvis' own axes point up and down, but for a camera that is held a little askew.
        for axis in np.eye(3):
            found, wanted = (rotate(each.rotations[:, 0], axis)[:, 1] for each in (recording.poses, poses))
            assert np.abs(found - wanted).max() < (0.2 if write is tram else 1e-3), heading
        assert not [note for note in recording.notes if "up, which is where" in note or "turned by 180" in note]


@pytest.mark.parametrize("heading", HEADINGS)
def test_who_lies_on_the_floor_is_low(tmp_path, smpl_body, woman, heading):
    path = amass(tmp_path, performed(smpl_body("smplh"), "lying on the back", heading), smpl_body("smplh"))
    poses = load_motion(path).poses(woman, 30.0, 1)
    assert woman.posed(poses).positions(0, 1)[..., 1].max() < 0.7


@pytest.mark.parametrize("turned", ["Y in AMASS", "Z in HOOD"])
def test_who_stands_along_another_axis_over_a_floor_there_is_believed(tmp_path, smpl_body, turned):
    body = smpl_body("smplh" if turned == "Y in AMASS" else "smpl")
    poses = performed(body, "standing", 30.0)
    if turned == "Y in AMASS":
        vectors = rotation_vectors(poses, body).reshape(len(poses), -1)
        np.savez(tmp_path / "clip.npz", poses=vectors, trans=poses.root_positions, mocap_framerate=30.0)
        recording = read_recording(tmp_path / "clip.npz")
    else:
        recording = read_recording(hood(tmp_path, z_up(poses), body))
    assert f"taken as {turned[0]} up" in recording.notes[0]
    np.testing.assert_allclose(rotate(recording.poses.rotations[:, 0], np.array([0.0, 1.0, 0.0]))[:, 1], 1.0, atol=1e-3)


@pytest.mark.parametrize("rest", ["standing", "bones along X"])
@pytest.mark.parametrize("axis", ["Y", "Z"])
@pytest.mark.parametrize("activity", list(ACTIVITIES))
def test_a_bvh_is_upright_by_its_floor(tmp_path, smpl_body, activity, axis, rest):
    # Away from the planes at 0 that are no floor: who happens to touch one may be taken to stand on it.
    skeleton, turn = smpl_body("smpl").skeleton, Y_TO_Z if axis == "Z" else np.array([1.0, 0.0, 0.0, 0.0])
    parents = {n: skeleton.names[p] if p >= 0 else "" for n, p in zip(skeleton.names, skeleton.parents, strict=True)}
    offsets = {n: 100.0 * rotate(turn, skeleton.joints[b] - skeleton.joints[p]) for b, (n, p) in enumerate(
        zip(skeleton.names, skeleton.parents, strict=True))}  # fmt: skip
    ends = {parent: name for name, parent in reversed(parents.items())}
    along = {name: offsets[ends.get(name, name)] for name in parents}
    own = {name: Rotation.align_vectors([v / np.linalg.norm(v)], [[1.0, 0.0, 0.0]])[0] for name, v in along.items()}
    for heading in HEADINGS:
        poses = performed(smpl_body("smpl"), activity, heading)
        vectors = rotate(turn, rotation_vectors(poses, smpl_body("smpl")))
        roots = 100.0 * rotate(turn, poses.root_positions + np.array([2.5, 0.0, 1.7]))

        def turned(time: float, vectors=vectors) -> dict[str, Rotation]:
            frame = vectors[round(30.0 * time)]
            return {name: Rotation.from_rotvec(v) for name, v in zip(parents, frame, strict=True)}

        path = write_rested(
            tmp_path / f"{heading}.bvh", own if rest != "standing" else {}, turned, frames=len(poses), offsets=offsets,
            parents=parents, places=lambda frame, roots=roots: roots[frame],
        )  # fmt: skip
        found = read_bvh(path)
        heights = 0.01 * joint_positions(found.skeleton, found.poses)[..., 1]
        wanted = joint_positions(skeleton, poses)[..., 1]
        order = [found.skeleton.index(name) for name in skeleton.names]
        assert np.abs((heights - heights[:, :1])[:, order] - (wanted - wanted[:, :1])).max() < 0.15, heading
