"""A recording performed by a body with another skeleton."""

from __future__ import annotations

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.geometry.rotation import conjugate, multiply, rotate
from pb4u.motion.ground import lowest_heights
from pb4u.motion.humanoid import humanoid_of
from pb4u.motion.recording import Recording
from pb4u.motion.reference_pose import ReferencePose

# The floor is where the lowest point of the body is in all but the lowest frames, told from at most so many of them.
_FLOOR_PERCENTILE = 5.0
_FLOOR_SAMPLES = 240


class Retargeting:
    """Puts one recording on one body: rotations by role, hips matched, travel scaled by leg length, feet on the floor.

    A recording of the body's own family keeps its rotations and its travel as they are. Either way the performance
    starts above the origin and faces +Z in its first frame.
    """

    def __init__(self, recording: Recording, body: ShapedBody) -> None:
        self.recording = recording
        self.humanoid = humanoid_of(body)
        self.direct = body.family in recording.source.same_as
        self.scale = 1.0 if self.direct else self.humanoid.leg_length / recording.leg_length
        self.reference = ReferencePose.of_joints(
            lambda role: recording.skeleton.joints[recording.joint_index(role)], recording.source.elbow_flexion
        )
        self.turn = np.array([1.0, 0.0, 0.0, 0.0])
        self.origin = np.zeros(3)
        first = self.poses(np.zeros(1))
        self.turn = conjugate(heading(first.rotations[0, 0]))
        self.origin = rotate(self.turn, first.root_positions[0]) * np.array([1.0, 0.0, 1.0])
        samples = min(len(recording.poses), _FLOOR_SAMPLES)
        lowest = lowest_heights(body, self.poses(np.linspace(0.0, recording.duration, samples)))
        self.origin[1] = np.percentile(lowest, _FLOOR_PERCENTILE)

    def poses(self, times: np.ndarray) -> PoseSequence:
        """Poses of the body at `times` (frames,) [s] of the recording."""
        recorded = self.recording.sampled(times)
        if self.direct:
            rotations = multiply(self.turn, self._own_bones(recorded))
            roots = rotate(self.turn, recorded.root_positions) - self.origin
            return PoseSequence(rotations, roots, recorded.fps)
        roles = self.humanoid.aligned(self.recording.role_rotations(recorded), self.reference)
        rotations = multiply(self.turn, self.humanoid.bone_rotations(roles))
        hips = rotate(self.turn, self.scale * self.recording.hip_midpoints(recorded)) - self.origin
        return PoseSequence(rotations, self.humanoid.root_positions(rotations, hips), recorded.fps)

    def _own_bones(self, recorded: PoseSequence) -> np.ndarray:
        """World rotations (frames, bones, 4) by bone name; bones that were not recorded go with their parents."""
        skeleton, names = self.humanoid.body.skeleton, self.recording.skeleton.names
        result = np.empty((len(recorded), skeleton.bone_count, 4))
        for i, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
            result[:, i] = recorded.rotations[:, names.index(name)] if name in names else result[:, parent]
        return result


def heading(rotation: np.ndarray) -> np.ndarray:
    """The turn about Y (..., 4) in a pelvis rotation (..., 4); the identity where the front points up or down."""
    front = rotate(rotation, np.array([0.0, 0.0, 1.0]))
    level = np.hypot(front[..., 0], front[..., 2])
    half = 0.5 * np.where(level > 0.2, np.arctan2(front[..., 0], front[..., 2]), 0.0)
    return np.stack([np.cos(half), np.zeros_like(half), np.sin(half), np.zeros_like(half)], axis=-1)
