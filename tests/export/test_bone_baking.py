"""A clip as linear blend skinning, and the glTF that plays it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.export.readers import Glb

from pb4u.errors import InputError
from pb4u.export.bone_baking import bake_bones
from pb4u.export.registry import export
from pb4u.scene.trajectory import Trajectory


def test_two_stiff_halves_need_two_bones() -> None:
    rest = np.random.default_rng(0).random((60, 3)) - [0.5, 0.0, 0.5]
    half = rest[:, 1] > 0.5
    rest[half] += [0, 0.5, 0]
    angles = np.linspace(0.0, 1.2, 15)
    turned = np.stack([Rotation.from_rotvec([a, 0, 0.5 * a]).apply(rest) + [0, a, 0] for a in angles])
    baked = bake_bones(np.where(half[:, None], turned, rest), 2)
    assert baked.largest_error < 1e-6
    np.testing.assert_allclose(baked.weights.sum(axis=1), 1.0)
    assert len({*baked.joints[half, 0].tolist()}) == 1


def test_more_bones_are_nearer_and_the_error_is_that_of_what_is_skinned(trajectory: Trajectory) -> None:
    errors = []
    for bones in (2, 8, 24):
        baked = bake_bones(trajectory.positions, bones)
        assert baked.weights.min() >= 0.0
        local = trajectory.positions[0][:, None] - baked.centres[baked.joints]
        turned = np.einsum("tvkij,vkj->tvki", baked.rotations[:, baked.joints], local)
        posed = np.einsum("vk,tvki->tvi", baked.weights, turned + baked.translations[:, baked.joints])
        off = np.linalg.norm(posed - trajectory.positions, axis=2)
        assert baked.largest_error == pytest.approx(off.max(), rel=1e-6)
        assert baked.rms_error == pytest.approx(np.sqrt((off**2).mean()), rel=1e-6)
        errors.append(baked.rms_error)
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_the_file_plays_to_the_error_that_is_said(trajectory: Trajectory, tmp_path: Path) -> None:
    said: list[str] = []
    file = export(trajectory, tmp_path / "bones.glb", say=said.append, bones=12)
    posed = skinned(Glb(file), 0, trajectory.frame_count)
    off = np.linalg.norm(posed[:, : trajectory.positions.shape[1]] - trajectory.positions, axis=2)
    extras = Glb(file).json["meshes"][0]["extras"]
    assert off.max() == pytest.approx(extras["largest_error"], rel=1e-3)
    assert said == [
        f"bones.glb has 12 bones, which leave the garment {1000 * extras['rms_error']:.1f} mm off (root mean square) "
        f"and {1000 * off.max():.1f} mm at most."
    ]
    assert "targets" not in Glb(file).json["meshes"][0]["primitives"][0]


def test_bones_are_refused_where_there_are_none(
    trajectory: Trajectory, tmp_path: Path, convert: Callable[..., tuple[int, str]]
) -> None:
    with pytest.raises(InputError, match="from 1 to 48, not 49"):
        export(trajectory, tmp_path / "walk.glb", bones=49)
    saved = trajectory.save(tmp_path / "run.npz")
    code, said = convert(saved, tmp_path / "walk.obj", "--bones", 4)
    assert code != 0
    assert ".obj has no bones; --bones is for .glb." in said


def skinned(glb: Glb, node: int, frames: int) -> np.ndarray:
    """(frames, vertices, 3) of a node as its specification skins it, at the keys of its animation."""
    entry = glb.json["nodes"][node]
    skin = glb.json["skins"][entry["skin"]]
    attributes = glb.json["meshes"][entry["mesh"]]["primitives"][0]["attributes"]
    points, joints, weights = (glb.array(attributes[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
    inverse = glb.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    animation = glb.json["animations"][0]
    world = np.tile(np.eye(4), (frames, len(skin["joints"]), 1, 1))
    for channel in animation["channels"]:
        if channel["target"]["node"] in skin["joints"]:
            bone = skin["joints"].index(channel["target"]["node"])
            values = glb.array(animation["samplers"][channel["sampler"]]["output"])
            if channel["target"]["path"] == "rotation":
                assert ((values[1:] * values[:-1]).sum(axis=1) >= 0.0).all()
                world[:, bone, :3, :3] = Rotation.from_quat(values).as_matrix()
            else:
                world[:, bone, :3, 3] = values
    matrices = np.einsum("vk,tvkij->tvij", weights, (world @ inverse)[:, joints])
    homogeneous = np.column_stack([points, np.ones(len(points))])
    return np.einsum("tvij,vj->tvi", matrices, homogeneous)[..., :3]
