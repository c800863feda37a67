"""A BVH moves a body by where its joints are in its frames, whatever pose it rests in."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.rest_poses import OFFSETS, RESTS, write_rested

from pb4u.errors import InputError
from pb4u.geometry.rotation import rotate
from pb4u.motion.bvh import read_bvh
from pb4u.motion.library import load_motion
from pb4u.motion.retargeting import Retargeting


def surface(path: Path, body, frames: int = 30) -> np.ndarray:
    """The body in all frames, (frames, vertices, 3) [m]."""
    return body.posed(load_motion(path).poses(body, 30.0, frames)).positions(0, frames).numpy()


@pytest.fixture(scope="module")
def from_t_pose(tmp_path_factory, woman) -> np.ndarray:
    return surface(write_rested(tmp_path_factory.mktemp("t") / "clip.bvh", {}), woman)


@pytest.mark.parametrize("rest", list(RESTS))
def test_the_rest_pose_is_no_matter(tmp_path, woman, from_t_pose, rest):
    found = surface(write_rested(tmp_path / "clip.bvh", RESTS[rest]), woman)
    assert np.linalg.norm(found - from_t_pose, axis=-1).max() < 0.01


@pytest.mark.parametrize("name", ["r_supine", "r_line"])
def test_files_of_strangers_move_as_from_their_t_pose(test_data, woman, name):
    folder = test_data / "strangers"
    apart = surface(folder / f"{name}.bvh", woman, 40) - surface(folder / "r_tpose.bvh", woman, 40)
    assert np.linalg.norm(apart, axis=-1).max() < 0.01


@pytest.mark.parametrize("rest", ["on the back", "bones along X"])
def test_who_lies_in_the_frames_lies(tmp_path, woman, rest):
    def lying(time: float) -> dict[str, Rotation]:
        down = Rotation.from_euler("xy", [-90.0, 90.0], degrees=True)
        return {"Hips": down, "LeftLeg": Rotation.from_rotvec([np.sin(time), 0.0, 0.0])}

    path = write_rested(tmp_path / "clip.bvh", RESTS[rest], lying)
    text = path.read_text().replace("\n0.000000 100.000000 ", "\n0.000000 20.000000 ")
    path.write_text(text)
    assert surface(path, woman, 1)[..., 1].max() < 0.8


@pytest.mark.parametrize("rest", ["legs reversed", "turned away", "bones along X"])
@pytest.mark.parametrize("heading", [0.0, 90.0, 180.0])
def test_who_sits_with_the_hips_at_the_origin_stays_upright(tmp_path, rest, heading):
    def seated(time: float) -> dict[str, Rotation]:
        legs = {f"{side}UpLeg": Rotation.from_rotvec([-1.5, 0.0, 0.0]) for side in ("Left", "Right")}
        return {"Hips": Rotation.from_euler("y", heading, degrees=True), **legs}

    path = write_rested(tmp_path / "clip.bvh", RESTS[rest], seated, frames=3)
    path.write_text(re.sub(r"\n0\.000000 100\.000000 \S+ ", "\n0 0 0 ", path.read_text()))
    up = rotate(read_bvh(path).poses.rotations[:, 0], np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(up, np.broadcast_to([0.0, 1.0, 0.0], up.shape), atol=1e-5)


def test_rotations_of_another_rest_pose_are_refused(tmp_path):
    offsets = {**OFFSETS, **{f"{side}{part}": -OFFSETS[f"{side}{part}"] for side in ("Left", "Right") for part in
               ("Leg", "Foot")}}  # fmt: skip
    with pytest.raises(InputError, match="thighs point into the trunk, so its rest pose"):
        load_motion(write_rested(tmp_path / "clip.bvh", {}, offsets=offsets))


def test_bones_without_a_length_are_refused(tmp_path):
    offsets = {**OFFSETS, "LeftForeArm": np.zeros(3)}
    with pytest.raises(InputError, match="LeftArm and LeftForeArm are at the same point in its rest pose"):
        load_motion(write_rested(tmp_path / "clip.bvh", {}, offsets=offsets))


def test_a_trunk_that_would_point_elsewhere_is_refused(acclaim, woman):
    # The rest pose of an .asf is known to be that of the database.
    path = acclaim()
    asf = path.with_name("07.asf")
    text = asf.read_text()
    for bone in ("lowerback", "upperback", "thorax"):
        text = text.replace(f"name {bone}\n    direction 0.0 1.0 0.0", f"name {bone}\n    direction 0.0 0.0 1.0")
    asf.write_text(text)
    with pytest.raises(InputError, match=r"the trunk points \d+ degrees away .* the rest pose"):
        Retargeting(load_motion(path).recording, woman)
