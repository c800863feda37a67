"""A skeleton at rest, sequences of poses of it, and forward kinematics."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from pb4u.body.joint_names import LIMB_BONES, SIDES
from pb4u.geometry.rotation import conjugate, multiply, rotate

_WRISTS = {LIMB_BONES[family]["hand"].format(side) for family, sides in SIDES.items() for side in sides}


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones of a body in its rest pose.

    Every pose is written as world rotations *from rest*: the identity is the rest pose whatever frames a file used,
    so no local bone axes are needed anywhere downstream of a loader.

    Args:
        names: bone names, parents before children; the root is first.
        parents: (bones,) int64 index of each parent, -1 for the root.
        joints: (bones, 3) float64 rest position of each bone's head [m], world axes (Y up, facing +Z).
    """

    names: tuple[str, ...]
    parents: np.ndarray
    joints: np.ndarray

    def index(self, name: str) -> int:
        """Index of the bone called `name`.

        Args:
            name: of the bone.

        Raises:
            ValueError: there is no such entry.
        """
        return self.names.index(name)

    @property
    def bone_count(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """Poses of one skeleton over time.

    Args:
        rotations: (frames, bones, 4) float64 unit quaternions wxyz: world rotation of each bone from rest.
        root_positions: (frames, 3) float64 world position of the root joint [m].
        fps: frames per second.
    """

    rotations: np.ndarray
    root_positions: np.ndarray
    fps: float

    def __len__(self) -> int:
        return len(self.rotations)


def branch(parents: Sequence[int] | np.ndarray, tops: Collection[int]) -> np.ndarray:
    """Mask (bones,) bool of some bones and all their descendants.

    Args:
        parents: (bones,) index of each bone's parent, always lower than the bone's own; -1 for a root.
        tops: indices of the topmost bones.
    """
    below = np.zeros(len(parents), dtype=bool)
    for bone, parent in enumerate(parents):
        below[bone] = bone in tops or (parent >= 0 and below[parent])
    return below


def hand_bones(names: Sequence[str], parents: Sequence[int] | np.ndarray) -> np.ndarray:
    """Mask (bones,) bool of the hands: both wrists, as Anny and the SMPL family name them, and all their descendants.

    Args:
        names: (bones,) name of each.
        parents: (bones,) index of each bone's parent, always lower than the bone's own; -1 for a root.
    """
    return branch(parents, [bone for bone, name in enumerate(names) if name in _WRISTS])


def world_rotations(local: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """World rotations of bones whose rotations are given relative to their parents.

    Args:
        local: (frames, bones, 4) unit quaternions wxyz.
        parents: (bones,) index of each parent, before the bone itself; -1 for the root.

    Returns:
        (frames, bones, 4) unit quaternions wxyz.
    """
    world = np.empty_like(local)
    for bone, parent in enumerate(parents.tolist()):
        world[:, bone] = local[:, bone] if parent < 0 else multiply(world[:, parent], local[:, bone])
    return world


def local_rotations(world: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Rotations of bones from their parents, the inverse of `world_rotations`.

    Args:
        world: (frames, bones, 4) unit quaternions wxyz.
        parents: (bones,) index of each parent; -1 for the root.

    Returns:
        (frames, bones, 4) unit quaternions wxyz.
    """
    local = world.copy()
    for bone, parent in enumerate(parents.tolist()):
        if parent >= 0:
            local[:, bone] = multiply(conjugate(world[:, parent]), world[:, bone])
    return local


def joint_positions(skeleton: Skeleton, poses: PoseSequence) -> np.ndarray:
    """World positions of the joints, by forward kinematics.

    Args:
        skeleton: the bones at rest.
        poses: how they move.

    Returns:
        (frames, bones, 3) [m].
    """
    positions = np.empty((len(poses), skeleton.bone_count, 3))
    positions[:, 0] = poses.root_positions
    for bone, parent in enumerate(skeleton.parents.tolist()):
        if parent >= 0:
            offset = skeleton.joints[bone] - skeleton.joints[parent]
            positions[:, bone] = positions[:, parent] + rotate(poses.rotations[:, parent], offset)
    return positions
