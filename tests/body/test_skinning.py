import numpy as np
import torch

from pb4u.body.skeleton import PoseSequence, Skeleton, joint_positions
from pb4u.body.skinning import (
    SkinnedSurface,
    SkinningWeights,
    bone_transforms,
    skin,
    strongest_influences,
)
from pb4u.geometry.rotation import from_axis_angle, rotate

SKELETON = Skeleton(("hip", "knee", "ankle"), np.array([-1, 0, 1]), np.array([[0, 1.0, 0], [0, 0.5, 0.1], [0, 0, 0]]))


def poses(frames: int) -> PoseSequence:
    rng = np.random.default_rng(1)
    return PoseSequence(from_axis_angle(rng.normal(size=(frames, 3, 3))), rng.normal(size=(frames, 3)), 30.0)


def surface(vertices: int) -> tuple[np.ndarray, SkinningWeights]:
    rng = np.random.default_rng(2)
    weights = rng.random((vertices, 2)).astype(np.float32)
    weights[::3, 1] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    bones = np.stack([rng.integers(0, 3, vertices), rng.integers(0, 3, vertices)], axis=1)
    return rng.normal(size=(vertices, 3)), SkinningWeights(bones, weights)


def test_skinned_surface_agrees_with_a_sum_over_bones_written_out() -> None:
    vertices, weights = surface(40)
    sequence = poses(35)
    joints = joint_positions(SKELETON, sequence)
    expected = np.zeros((35, 40, 3))
    for k in range(2):
        bone = weights.bones[:, k]
        moved = rotate(sequence.rotations[:, bone], (vertices - SKELETON.joints[bone])[None]) + joints[:, bone]
        expected += weights.weights[:, k, None] * moved
    transforms = bone_transforms(SKELETON, sequence)
    np.testing.assert_allclose(SkinnedSurface(vertices, weights, 3).positions(transforms), expected, atol=2e-6)
    reference = skin(
        torch.from_numpy(vertices.astype(np.float32)),
        torch.from_numpy(weights.bones),
        torch.from_numpy(weights.weights),
        transforms,
    )
    np.testing.assert_allclose(reference, expected, atol=2e-6)


def test_rest_pose_leaves_the_surface_in_place() -> None:
    vertices, weights = surface(20)
    rest = PoseSequence(np.tile([1.0, 0, 0, 0], (2, 3, 1)), np.repeat(SKELETON.joints[:1], 2, axis=0), 30.0)
    moved = SkinnedSurface(vertices, weights, 3).positions(bone_transforms(SKELETON, rest))
    np.testing.assert_allclose(moved, np.stack([vertices, vertices]), atol=1e-6)


def test_strongest_influences_keep_the_largest_and_sum_to_one() -> None:
    bones = np.array([[4, 2, 7], [1, 0, 3]])
    weights = np.array([[0.1, 0.6, 0.3], [0.0, 1.0, 0.0]])
    kept = strongest_influences(bones, weights, 2)
    np.testing.assert_array_equal(kept.bones, [[2, 7], [0, 0]])
    np.testing.assert_allclose(kept.weights, [[2 / 3, 1 / 3], [1.0, 0.0]], atol=1e-7)
    assert strongest_influences(bones[1:], weights[1:], 2).bones.shape == (1, 1), "unused places are left out"
