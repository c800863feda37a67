"""A rigged character: a surface skinned to the nodes of a scene, with clips of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pb4u.body.animated_body import FLOOR_PERCENTILE
from pb4u.body.body_model import PosedBody, ShapedBody
from pb4u.body.node_animation import Clip, NodePoses, NodeTree

# The ground of a clip that is nearer [m] to y = 0 is taken as that.
_FLOOR_NEAR = 0.02


@dataclass(frozen=True, eq=False)
class Morph:
    """Targets that a mesh is morphed to before it is skinned.

    Args:
        node: the node whose weights control the morph.
        vertices: (moved,) int64, the vertices that it moves.
        offsets: (targets, moved, 3) at rest [m].
        rest: (targets,) weights that the rest pose has [1].
    """

    node: int
    vertices: np.ndarray
    offsets: np.ndarray
    rest: np.ndarray


@dataclass(frozen=True, eq=False)
class Rig:
    """The bones, nodes and morph targets that move a character.

    Args:
        tree: the nodes of its file.
        bone_nodes: (bones,) int64, node of each bone.
        binds: (bones, 4, 4) transform of each bone to the world at rest [m].
        morphs: morph targets applied before skinning.
    """

    tree: NodeTree
    bone_nodes: np.ndarray
    binds: np.ndarray
    morphs: tuple[Morph, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Character(ShapedBody):
    """A rigged character in its bind pose, the pose that garments are fitted to.

    The bones of a human skeleton get the names of SMPL's joints, so that garments can be cut for it and any motion
    retargeted to it; its own clips move it exactly as the file says.

    Args:
        rig: the bones, nodes and morph targets that move it.
        clip: the clip that it performs; None if its file has no clip.
        clip_names: names of all clips of its file.
        notes: plain sentences on omitted parts and repairs.
        source_vertices: (file's vertices,) int64, the vertex here of each vertex in the file's meshes.
    """

    rig: Rig
    source_vertices: np.ndarray
    clip: Clip | None = None
    clip_names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def is_human(self) -> bool:
        """Whether its bones are known, so that it can perform motions."""
        return "pelvis" in self.skeleton.names

    def available_frames(self, fps: float) -> int:
        """Number of frames of its clip at `fps` frames per second.

        Args:
            fps: frames per second.
        """
        return 1 if self.clip is None else int(self.clip.duration * fps + 1e-6) + 1

    def clip_poses(self, fps: float, frames: int) -> NodePoses:
        """Poses of its clip from the first on, on the ground; the last one is held.

        Args:
            fps: frames per second.
            frames: number of frames.
        """
        poses = self.rig.tree.posed(self.clip, np.arange(frames) / fps)
        lowest = PosedCharacter(self, poses, fps).positions(0, frames)[..., 1].amin(dim=1).numpy()
        floor = float(np.percentile(lowest, FLOOR_PERCENTILE))
        rise = 0.0 if abs(floor) < _FLOOR_NEAR else -floor
        return NodePoses(poses.translations, poses.rotations, poses.scales, poses.weights, rise)


class PosedCharacter(PosedBody):
    """A character moved by poses of its nodes.

    Args:
        body: the character at rest.
        poses: of its nodes.
        fps: frames per second.
    """

    def __init__(self, body: Character, poses: NodePoses, fps: float) -> None:
        super().__init__(body, fps)
        self.character = body
        self.node_poses = poses

    @property
    def frame_count(self) -> int:
        return len(self.node_poses)

    @cached_property
    def transforms(self) -> Tensor:
        rig = self.character.rig
        posed = rig.tree.globals(self.node_poses)[:, rig.bone_nodes]
        return torch.from_numpy((posed @ np.linalg.inv(rig.binds))[:, :, :3]).float()

    @cached_property
    def joints(self) -> np.ndarray:
        transforms = self.transforms.double().numpy()
        rest = self.body.skeleton.joints
        return np.einsum("fbij,bj->fbi", transforms[..., :3], rest) + transforms[..., 3]

    def positions(self, start: int, stop: int) -> Tensor:
        result = self._surface.positions(self.transforms[start:stop])
        chunk = self._surface.CHUNK
        for first in range(start, stop if self.character.rig.morphs else start, chunk):
            last = min(first + chunk, stop)
            offsets = torch.zeros(last - first, *self.rest_vertices.shape)
            for morph in self.character.rig.morphs:
                weights = self.node_poses.weights[morph.node][first:last] - morph.rest
                shift = torch.from_numpy(np.einsum("fk,kvc->fvc", weights, morph.offsets)).float()
                offsets[:, morph.vertices] += shift
            if offsets.any():
                result[first - start : last - start] += self._surface.turned(offsets, self.transforms[first:last])
        return result
