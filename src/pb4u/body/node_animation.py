"""Nodes of a glTF scene over time: clips of key frames, and the transforms that they give the nodes.

Source: Khronos, glTF 2.0 specification, 3.5 (transformations), 3.11 (animations) and appendix C (interpolation).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.geometry.rotation import from_xyzw, slerp, to_xyzw


@dataclass(frozen=True, eq=False)
class Channel:
    """Key frames of one property of a node.

    Args:
        node: index of the node.
        path: "translation", "rotation" (quaternions wxyz), "scale" or "weights" (of morph targets).
        times: (keys,) rising [s].
        values: (keys, numbers), of a cubic spline (keys, 3, numbers): tangent before, value, tangent after.
        interpolation: "LINEAR", "STEP" or "CUBICSPLINE".
    """

    node: int
    path: str
    times: np.ndarray
    values: np.ndarray
    interpolation: str = "LINEAR"

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values (frames, numbers) at `times` (frames,) [s], constant before the first and after the last key.

        Args:
            times: (frames,) [s].
        """
        keys = self.times
        after = np.clip(np.searchsorted(keys, times, side="right"), 1, max(len(keys) - 1, 1))
        before, after = after - 1, np.minimum(after, len(keys) - 1)
        span = keys[after] - keys[before]
        share = np.clip((times - keys[before]) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)
        if self.interpolation == "STEP":
            return self.values[np.where(share >= 1.0, after, before)]
        if self.interpolation == "CUBICSPLINE":
            s, step = share[:, None], span[:, None]
            first, second = self.values[before], self.values[after]
            mixed = (2 * s**3 - 3 * s**2 + 1) * first[:, 1] + step * (s**3 - 2 * s**2 + s) * first[:, 2]
            mixed = mixed + (3 * s**2 - 2 * s**3) * second[:, 1] + step * (s**3 - s**2) * second[:, 0]
            return mixed / np.linalg.norm(mixed, axis=1, keepdims=True) if self.path == "rotation" else mixed
        if self.path == "rotation":
            return slerp(self.values[before], self.values[after], share)
        return self.values[before] + share[:, None] * (self.values[after] - self.values[before])


@dataclass(frozen=True, eq=False)
class Clip:
    """One animation of a file.

    Args:
        name: as the file has it.
        channels: what moves.
    """

    name: str
    channels: tuple[Channel, ...]

    @property
    def start(self) -> float:
        """Time of the first key [s]."""
        return min((float(channel.times[0]) for channel in self.channels), default=0.0)

    @property
    def duration(self) -> float:
        """Time from the first key to the last [s]."""
        return max((float(channel.times[-1]) for channel in self.channels), default=0.0) - self.start


@dataclass(frozen=True, eq=False)
class NodePoses:
    """Transforms of the nodes from their parents over time.

    Args:
        translations: (frames, nodes, 3), in the unit of the file.
        rotations: (frames, nodes, 4) unit quaternions wxyz.
        scales: (frames, nodes, 3) [1].
        weights: node -> weights (frames, targets) of the morph targets of its mesh [1].
        rise: height [m] by which the whole is raised.
    """

    translations: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    weights: Mapping[int, np.ndarray] = field(default_factory=dict)
    rise: float = 0.0

    def __len__(self) -> int:
        return len(self.translations)

    def matrices(self, node: int) -> np.ndarray:
        """Transforms (frames, 4, 4) float64 from a node to its parent, translations in the file's unit.

        Args:
            node: index of the node.
        """
        result = np.zeros((len(self), 4, 4))
        turns = Rotation.from_quat(to_xyzw(self.rotations[:, node])).as_matrix()
        result[:, :3, :3] = turns * self.scales[:, node][:, None, :]
        result[:, :3, 3] = self.translations[:, node]
        result[:, 3, 3] = 1.0
        return result

    def joined(self, following: NodePoses) -> NodePoses:
        """These poses and then others.

        Args:
            following: poses of the same nodes, which come after these.
        """
        weights = {node: np.concatenate([self.weights[node], w]) for node, w in following.weights.items()}
        return NodePoses(
            np.concatenate([self.translations, following.translations]),
            np.concatenate([self.rotations, following.rotations]),
            np.concatenate([self.scales, following.scales]),
            weights,
            following.rise,
        )


@dataclass(frozen=True, eq=False)
class NodeTree:
    """The nodes of a scene.

    Args:
        names: of the nodes.
        parents: (nodes,) int64, -1 of a root.
        order: indices of the nodes, parents before children.
        poses: the one pose that the file gives them, with the weights of the morph targets.
        world: (4, 4) transform of the scene to the world [m].
    """

    names: tuple[str, ...]
    parents: np.ndarray
    order: tuple[int, ...]
    poses: NodePoses
    world: np.ndarray

    def posed(self, clip: Clip | None, times: np.ndarray) -> NodePoses:
        """Poses of a clip; without one, the poses that the file gives the nodes.

        Args:
            clip: what moves.
            times: (frames,) from its first key [s].
        """
        frames, still = len(times), self.poses
        parts = {
            path: np.repeat(getattr(still, path), frames, axis=0) for path in ("translations", "rotations", "scales")
        }
        weights = {node: np.repeat(values, frames, axis=0) for node, values in still.weights.items()}
        for channel in clip.channels if clip else ():
            values = channel.at(np.asarray(times, dtype=np.float64) + (clip.start if clip else 0.0))
            if channel.path != "weights":
                parts[channel.path + "s"][:, channel.node] = values
            elif channel.node in weights:
                weights[channel.node] = values
        return NodePoses(parts["translations"], parts["rotations"], parts["scales"], weights)

    def globals(self, poses: NodePoses) -> np.ndarray:
        """Transforms (frames, nodes, 4, 4) of the nodes to the world [m].

        Args:
            poses: local poses of the nodes.
        """
        result = np.zeros((len(poses), len(self.parents), 4, 4))
        world = self.world.copy()
        world[1, 3] += poses.rise
        for node in self.order:
            parent = int(self.parents[node])
            result[:, node] = (world if parent < 0 else result[:, parent]) @ poses.matrices(node)
        return result


def parted(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation (3,), rotation (4,) as quaternion wxyz and scale (3,) of a transform (4, 4) without shear.

    Args:
        matrix: (4, 4), translation [m].

    Raises:
        ValueError: it is sheared, or flat.
    """
    linear = np.asarray(matrix, dtype=np.float64)[:3, :3]
    scale = np.linalg.norm(linear, axis=0)
    if not np.isfinite(matrix).all() or (scale < 1e-12).any():
        raise ValueError("a node is flattened")
    if np.linalg.det(linear) < 0.0:
        scale = scale * np.array([-1.0, 1.0, 1.0])
    turn = linear / scale
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3:
        raise ValueError("a node is sheared")
    return np.array(matrix[:3, 3]), from_xyzw(Rotation.from_matrix(turn).as_quat()), scale
