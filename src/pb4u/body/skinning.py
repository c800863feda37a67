"""Linear blend skinning with a few bones per vertex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.body.skeleton import PoseSequence, Skeleton, joint_positions
from pb4u.geometry.rotation import matrix_from_quaternion


@dataclass(frozen=True, eq=False)
class SkinningWeights:
    """Bones that move each vertex.

    Args:
        bones: (vertices, influences) int64 bone indices.
        weights: (vertices, influences) float32, rows sum to 1; unused entries are 0.
    """

    bones: np.ndarray
    weights: np.ndarray

    def dense(self, bone_count: int) -> np.ndarray:
        """Weights (vertices, bones) float64 of every bone.

        Args:
            bone_count: bones of the body.
        """
        dense = np.zeros((len(self.bones), bone_count))
        np.add.at(dense, (np.arange(len(dense))[:, None], self.bones), self.weights)
        return dense

    def share_of(self, bones: np.ndarray) -> np.ndarray:
        """Share of each vertex's motion that some bones have.

        Args:
            bones: (bones,) bool, the bones counted.

        Returns:
            (vertices,) in [0, 1].
        """
        return (self.weights * bones[self.bones]).sum(axis=1)

    def at(self, corners: np.ndarray, barycentric: np.ndarray, bone_count: int) -> SkinningWeights:
        """Weights of other vertices, each interpolated from the corners of a triangle.

        Args:
            corners: (vertices, 3) int64, corners of the triangle that each lies on.
            barycentric: (vertices, 3) its coordinates there, rows sum to 1.
            bone_count: bones of the body.
        """
        mixed = np.maximum(np.einsum("vc,vcb->vb", barycentric, self.dense(bone_count)[corners]), 0.0)
        return strongest_influences(np.broadcast_to(np.arange(bone_count), mixed.shape), mixed, bone_count)


def strongest_influences(bones: np.ndarray, weights: np.ndarray, count: int) -> SkinningWeights:
    """The `count` largest weights of each vertex, scaled to sum to 1.

    Args:
        bones: (vertices, influences) bone indices.
        weights: (vertices, influences) weights [1], in any order.
        count: influences to keep at most.
    """
    count = min(count, int((weights > 0).sum(axis=1).max()))
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    shares = np.take_along_axis(weights, order, axis=1).astype(np.float64)
    shares /= shares.sum(axis=1, keepdims=True)
    chosen = np.where(shares > 0, np.take_along_axis(bones, order, axis=1), 0)
    return SkinningWeights(chosen.astype(np.int64), shares.astype(np.float32))


def bone_transforms(skeleton: Skeleton, poses: PoseSequence) -> Tensor:
    """Transforms x -> A x + b of rest positions to world positions.

    Args:
        skeleton: the bones at rest.
        poses: how they move.

    Returns:
        (frames, bones, 3, 4) float32: A and, in the last column, b [m].
    """
    rotation = matrix_from_quaternion(torch.from_numpy(poses.rotations))
    joints = torch.from_numpy(joint_positions(skeleton, poses))
    rest = torch.from_numpy(np.ascontiguousarray(skeleton.joints, dtype=np.float64))
    translation = joints - (rotation @ rest[..., None])[..., 0]
    return torch.cat([rotation, translation[..., None]], dim=-1).to(torch.float32)


def skin(rest_vertices: Tensor, bones: Tensor, weights: Tensor, transforms: Tensor) -> Tensor:
    """Positions of a surface moved by blended bone transforms; `SkinnedSurface` is faster.

    Args:
        rest_vertices: (vertices, 3) [m].
        bones: (vertices, influences) int64.
        weights: (vertices, influences), rows sum to 1.
        transforms: (frames, bones, 3, 4), see `bone_transforms`.

    Returns:
        (frames, vertices, 3) [m].
    """
    frames = transforms.shape[0]
    flat = transforms.reshape(frames, -1, 12)
    blended = torch.zeros(frames, rest_vertices.shape[0], 12, dtype=transforms.dtype, device=transforms.device)
    for k in range(bones.shape[1]):
        blended.addcmul_(flat.index_select(1, bones[:, k]), weights[:, k, None].to(transforms.dtype))
    blended = blended.view(frames, -1, 3, 4)
    return (blended[..., :3] @ rest_vertices.to(transforms.dtype)[..., None])[..., 0] + blended[..., 3]


class SkinnedSurface:
    """A surface skinned to bones: linear blend skinning as one sparse product.

    sum_b w_b (A_b x + t_b) is linear in the bone transforms, so a matrix (vertices, 4 bones) with the entries
    w_b (x, 1) maps the stacked transforms of any number of frames to positions, without a blended transform for
    each vertex and frame in between.

    Args:
        rest_vertices: (vertices, 3) [m].
        weights: bones of each vertex.
        bone_count: bones of the skeleton.
    """

    # Frames at a time: the intermediate copy stays in the processor cache, which halves the time.
    CHUNK = 16

    def __init__(self, rest_vertices: np.ndarray, weights: SkinningWeights, bone_count: int) -> None:
        from scipy.sparse import csr_matrix

        vertex, influence = np.nonzero(weights.weights)
        bone, weight = weights.bones[vertex, influence], weights.weights[vertex, influence]
        starts = np.searchsorted(vertex, np.arange(len(rest_vertices) + 1))
        self._weights = csr_matrix((weight, bone, starts), shape=(len(rest_vertices), bone_count))
        homogeneous = np.append(rest_vertices[vertex], np.ones((len(vertex), 1)), axis=1)
        values = (weight[:, None] * homogeneous).astype(np.float32)
        columns = 4 * bone[:, None] + np.arange(4)
        self._matrix = csr_matrix(
            (values.reshape(-1), columns.reshape(-1), 4 * starts), shape=(len(rest_vertices), 4 * bone_count)
        )

    def positions(self, transforms: Tensor) -> Tensor:
        """Vertices (frames, vertices, 3) float32 [m] under `transforms` (frames, bones, 3, 4).

        Args:
            transforms: (frames, bones, 3, 4), see `bone_transforms`.
        """
        stacked = transforms.to(torch.float32).numpy().transpose(1, 3, 0, 2)
        result = np.empty((len(transforms), self._matrix.shape[0], 3), dtype=np.float32)
        for start in range(0, len(result), self.CHUNK):
            chunk = stacked[:, :, start : start + self.CHUNK]
            block = self._matrix @ chunk.reshape(self._matrix.shape[1], -1)
            result[start : start + self.CHUNK] = block.reshape(len(block), -1, 3).transpose(1, 0, 2)
        return torch.from_numpy(result)

    def turned(self, offsets: Tensor, transforms: Tensor) -> Tensor:
        """Offsets from the rest surface, rotated by the blended rotations of the bones.

        Args:
            offsets: (frames, vertices, 3) at rest [m].
            transforms: (frames, bones, 3, 4), see `bone_transforms`.

        Returns:
            (frames, vertices, 3) [m].
        """
        rotations = transforms[..., :3].to(torch.float32).numpy().transpose(1, 0, 2, 3)
        blended = self._weights @ rotations.reshape(self._weights.shape[1], -1)
        turns = torch.from_numpy(blended).view(-1, len(transforms), 3, 3)
        return (turns @ offsets.transpose(0, 1)[..., None])[..., 0].transpose(0, 1)
