"""A moving surface as linear blend skinning: few rigid bones, and four weights a vertex.

Source: Le and Deng, Smooth Skinning Decomposition with Rigid Bones (SIGGRAPH Asia 2012). Weights and bones are solved
in turn, the other fixed; the start is a clustering of the vertices by their paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import nnls

from pb4u.progress import Progress, no_progress

MOST_BONES = 48
"""What engines for phones and browsers take in one mesh."""
_INFLUENCES = 4
_CANDIDATES = 10
"""Bones of which the four of a vertex are chosen: those that follow it best alone."""
_ROUNDS = 12
_VERTICES_AT_ONCE = 512


@dataclass(frozen=True, eq=False)
class BakedBones:
    """Bones and weights that follow a moving surface.

    Args:
        joints: (vertices, 4) int64 bones of each vertex.
        weights: (vertices, 4) float64 their shares, rows sum to 1.
        centres: (bones, 3) float64 where each bone is at rest, unturned [m].
        rotations: (frames, bones, 3, 3) float64 of each bone.
        translations: (frames, bones, 3) float64 where each bone is [m].
        rms_error: root mean square distance of the vertices over all frames [m].
        largest_error: largest such distance [m].
    """

    joints: np.ndarray
    weights: np.ndarray
    centres: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    rms_error: float
    largest_error: float


def bake_bones(positions: np.ndarray, bones: int, progress: Progress = no_progress) -> BakedBones:
    """Bones that follow a surface; its first frame is the rest shape.

    Args:
        positions: (frames, vertices, 3) [m], finite.
        bones: number of bones; fewer if there are fewer vertices.
        progress: called after each round.
    """
    paths = np.asarray(positions, dtype=np.float64)
    rest = paths[0]
    bones = min(bones, len(rest))
    moments = np.unique(np.linspace(0, len(paths) - 1, 12).round().astype(int))
    flat = paths[moments].transpose(1, 0, 2).reshape(len(rest), -1)
    cluster = kmeans2(flat, bones, minit="++", seed=np.random.default_rng(0))[1]
    weights = np.zeros((len(rest), bones))
    weights[np.arange(len(rest)), cluster] = 1.0
    rotations = np.tile(np.eye(3), (len(paths), bones, 1, 1))
    shifts = np.zeros((len(paths), bones, 3))
    for rounds in range(_ROUNDS):
        _fit_bones(paths, weights, rotations, shifts)
        weights = _fit_weights(paths, rotations, shifts)
        progress(rounds + 1, _ROUNDS)
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :_INFLUENCES]
    shares = np.take_along_axis(weights, joints, axis=1)
    unused = (0, 0), (0, _INFLUENCES - joints.shape[1])
    joints, shares = np.pad(joints, unused), np.pad(shares, unused)
    mass = weights.sum(axis=0)
    centres = weights.T @ rest / np.maximum(mass, 1e-9)[:, None]
    squares = np.stack(
        [((_skinned(rest, weights, rotations[t], shifts[t]) - paths[t]) ** 2).sum(1) for t in range(len(paths))]
    )
    return BakedBones(
        joints, shares, centres, rotations, np.einsum("tbij,bj->tbi", rotations, centres) + shifts,
        float(np.sqrt(squares.mean())), float(np.sqrt(squares.max())),
    )  # fmt: skip


def _skinned(rest: np.ndarray, weights: np.ndarray, rotations: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Vertices (vertices, 3) [m] at one frame."""
    turned = np.einsum("vb,bij->vij", weights, rotations)
    return np.einsum("vij,vj->vi", turned, rest) + weights @ shifts


def _fit_bones(paths: np.ndarray, weights: np.ndarray, rotations: np.ndarray, shifts: np.ndarray) -> None:
    """Move each bone, in place, to where it leaves the least error beside the others (section 4.2 of the source)."""
    rest = paths[0]
    error = np.stack([path - _skinned(rest, weights, *at) for path, *at in zip(paths, rotations, shifts, strict=True)])
    for bone, weight in enumerate(weights.T):
        rows = np.flatnonzero(weight > 0.0)
        if not len(rows):
            continue
        w, p = weight[rows], rest[rows]
        skinned = np.einsum("tij,vj->tvi", rotations[:, bone], p) + shifts[:, bone, None]
        target = error[:, rows] + w[:, None] * skinned
        total = (w**2).sum()
        middle = (w**2) @ p / total
        goal = np.einsum("v,tvi->ti", w, target) / total
        spread = np.einsum("vi,tvj->tij", w[:, None] * (p - middle), target - w[:, None] * goal[:, None])
        u, _, vt = np.linalg.svd(spread)
        sign = np.linalg.det(np.einsum("tij,tjk->tik", u, vt))
        u[:, :, 2] *= sign[:, None]
        rotations[:, bone] = np.einsum("tij,tjk->tki", u, vt)
        shifts[:, bone] = goal - rotations[:, bone] @ middle
        error[:, rows] = target - w[:, None] * (np.einsum("tij,vj->tvi", rotations[:, bone], p) + shifts[:, bone, None])


def _fit_weights(paths: np.ndarray, rotations: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """The best weights (vertices, bones) of at most four bones a vertex: not negative, summing to 1."""
    vertices, bones = paths.shape[1], rotations.shape[1]
    weights = np.zeros((vertices, bones))
    for first in range(0, vertices, _VERTICES_AT_ONCE):
        rest = paths[0, first : first + _VERTICES_AT_ONCE]
        off = np.einsum("tbij,vj->vtib", rotations, rest) + shifts.transpose(0, 2, 1)
        off -= paths[:, first : first + _VERTICES_AT_ONCE].transpose(1, 0, 2)[..., None]
        for k, one in enumerate(off.reshape(len(rest), -1, bones)):
            near = np.argsort((one**2).sum(axis=0))[:_CANDIDATES]
            share = _simplex(one[:, near])
            strongest = np.argsort(-share)[:_INFLUENCES]
            weights[first + k, near[strongest]] = _simplex(one[:, near[strongest]])
    return weights


def _simplex(off: np.ndarray) -> np.ndarray:
    """Shares (bones,) of no negative that sum to 1 and leave least of `off` (rows, bones)."""
    # |off w|^2 + (1 - sum w)^2 is least along the same ray, whatever the second term weighs.
    size = np.sqrt((off**2).mean()) + 1e-12
    root = np.linalg.qr(off / size, mode="r")
    share = nnls(np.vstack([root, np.ones(off.shape[1])]), np.r_[np.zeros(len(root)), 1.0])[0]
    return share / share.sum()
