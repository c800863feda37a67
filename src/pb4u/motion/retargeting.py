"""A recording performed by a body with another skeleton."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache, partial

import numpy as np

from pb4u.body.animated_body import FLOOR_PERCENTILE
from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence, joint_positions
from pb4u.body.skinning import SkinnedSurface, SkinningWeights, bone_transforms
from pb4u.errors import InputError
from pb4u.geometry.rotation import about_axis, conjugate, multiply, rotate
from pb4u.motion.arm_clearance import ArmClearance, eased, held_off, reach
from pb4u.motion.bone_axes import unit
from pb4u.motion.correspondences import SEGMENTS
from pb4u.motion.ground import stances
from pb4u.motion.humanoid import humanoid_of
from pb4u.motion.motion import Motion, Performed
from pb4u.motion.recording import Recording
from pb4u.motion.reference_pose import ReferencePose

# Frames of which the lowest point is looked at for the floor, at most.
_FLOOR_SAMPLES = 240
# Where feet stand, that is the lowest of the levels they stand on: no more than this [m] above the lowest frames, which
# holds the toes that dip as a foot rolls off, and no stair.
_LEVEL = 0.06
# Frames that are compared with the recording, and how far [deg] a limb may point from there; a trunk, whose rest
# differs from body to body, may farther.
_LIKENESS_SAMPLES, _UNLIKE, _UNLIKE_TRUNK = 12, 20.0, 30.0
# What is turned by less [deg] is not worth a word.
_LEAST_TOLD = 1.0


class Retargeting:
    """Puts one recording on one body: rotations by role, hips matched, travel scaled by leg length, feet on the floor.

    A recording of the body's own family keeps its rotations and its travel unchanged. Either way the performance
    starts above the origin and faces +Z in its first frame.

    Args:
        recording: the performance.
        body: the body that repeats it.

    Raises:
        InputError: its bones play no known roles, or the body would not follow the recording.
    """

    def __init__(self, recording: Recording, body: ShapedBody) -> None:
        self.recording = recording
        self.humanoid = humanoid_of(body)
        self.direct = body.family in recording.source.same_as
        self.scale = 1.0 if self.direct else self.humanoid.leg_length / recording.leg_length
        self.reference = ReferencePose.of_joints(recording.joint, recording.source.elbow_flexion)
        self.turn = np.array([1.0, 0.0, 0.0, 0.0])
        self.origin = np.zeros(3)
        first = self.poses(np.zeros(1))
        self.turn = conjugate(heading(first.rotations[0, 0]))
        self.origin = rotate(self.turn, first.root_positions[0]) * np.array([1.0, 0.0, 1.0])
        self.origin[1] = self._floor()
        if not self.direct:
            self._require_likeness()

    def poses(self, times: np.ndarray) -> PoseSequence:
        """Poses of the body at `times` (frames,) [s] of the recording.

        Args:
            times: (frames,) [s].
        """
        recorded = self.recording.sampled(times)
        if self.direct:
            rotations = multiply(self.turn, self._own_bones(recorded))
            roots = rotate(self.turn, recorded.root_positions) - self.origin
            return PoseSequence(rotations, roots, recorded.fps)
        roles = self.humanoid.aligned(self.recording.role_rotations(recorded), self.reference)
        rotations = multiply(self.turn, self.humanoid.bone_rotations(roles))
        hips = rotate(self.turn, self.scale * self.recording.hip_midpoints(recorded)) - self.origin
        return PoseSequence(rotations, self.humanoid.root_positions(rotations, hips), recorded.fps)

    @cached_property
    def arm_clearance(self) -> ArmClearance:
        """Where the arms of the body may be."""
        return ArmClearance(self.humanoid)

    def _require_likeness(self) -> None:
        """Refuse a recording of which limbs or trunk of the body point elsewhere than its own joints do.

        Raises:
            InputError: they do by more than proportions of a body explain.
        """
        recording, skeleton = self.recording, self.humanoid.body.skeleton
        times = np.unique(np.linspace(0.0, recording.duration, _LIKENESS_SAMPLES))
        bone_places = rotate(self.turn, joint_positions(recording.skeleton, recording.sampled(times)))
        body = joint_positions(skeleton, self.poses(times))
        places = {
            role: np.stack([bone_places[:, recording.joint_index(role)], body[:, skeleton.index(bone)]])
            for role, bone in self.humanoid.target.joints.items()
        }
        places |= {role: 0.5 * (places[f"{role}.L"] + places[f"{role}.R"]) for role in ("upper_arm", "thigh")}
        for first, second in (*SEGMENTS.items(), ("thigh", "upper_arm")):
            theirs, ours = unit(places[second] - places[first])
            apart = np.rad2deg(np.arccos(np.clip(np.median(np.sum(ours * theirs, axis=1)), -1.0, 1.0)))
            plain = first[:-2].replace("_", " ") if "." in first else "trunk"
            if apart > (_UNLIKE if "." in first else _UNLIKE_TRUNK):
                raise InputError(
                    f"{recording.name}: on {self.humanoid.body.name} the {plain} points "
                    f"{apart:.0f} degrees away from its direction in the recording: the rest pose of the recording is "
                    "not a standing person; export it again from a T-pose."
                )

    def _floor(self) -> float:
        """Height [m] of the floor under the body: under the feet that stand, or under its lowest moments."""
        recording = self.recording
        standing = np.zeros(len(recording.poses), dtype=bool)
        for stance in stances(recording):
            standing[stance.first : stance.stop] = True
        frames = np.flatnonzero(standing) if standing.any() else np.arange(len(standing))
        chosen = frames[np.linspace(0, len(frames) - 1, min(len(frames), _FLOOR_SAMPLES)).round().astype(int)]
        lowest = lowest_heights(self.humanoid.body, self.poses(chosen / recording.poses.fps))
        low = np.percentile(lowest, FLOOR_PERCENTILE)
        return float(np.median(lowest[lowest < low + _LEVEL]) if standing.any() else low)

    def _own_bones(self, recorded: PoseSequence) -> np.ndarray:
        """World rotations (frames, bones, 4) by bone name; bones that were not recorded go with their parents."""
        skeleton, names = self.humanoid.body.skeleton, self.recording.skeleton.names
        result = np.empty((len(recorded), skeleton.bone_count, 4))
        for i, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
            result[:, i] = recorded.rotations[:, names.index(name)] if name in names else result[:, parent]
        return result


def heading(rotation: np.ndarray) -> np.ndarray:
    """Turn about Y in the rotation of a pelvis; the identity where its front points up or down.

    Args:
        rotation: (..., 4) unit quaternions wxyz.

    Returns:
        (..., 4) unit quaternions wxyz.
    """
    front = rotate(rotation, np.array([0.0, 0.0, 1.0]))
    level = np.hypot(front[..., 0], front[..., 2])
    return about_axis("y", np.where(level > 0.2, np.arctan2(front[..., 0], front[..., 2]), 0.0))


def lowest_heights(body: ShapedBody, poses: PoseSequence) -> np.ndarray:
    """Heights of the lowest point of a posed body, by the outermost vertices of each bone.

    Args:
        body: the body.
        poses: poses of its skeleton.

    Returns:
        (frames,) y [m].
    """
    transforms = bone_transforms(body.skeleton, poses)
    return (
        body.kept("outermost surface", _outermost_surface)
        .positions(transforms)[..., 1]
        .min(dim=1)
        .values.double()
        .numpy()
    )


def _outermost_surface(body: ShapedBody) -> SkinnedSurface:
    """The vertices that lie farthest out in some direction among those that one bone moves most."""
    directions = np.stack(np.meshgrid(*[[-1.0, -0.4, 0.0, 0.4, 1.0]] * 3), -1).reshape(-1, 3)
    directions = directions[np.abs(directions).max(1) == 1.0]
    bones, weights = body.weights.bones, body.weights.weights
    owner = bones[np.arange(len(bones)), weights.argmax(1)]
    chosen: set[int] = set()
    for bone in np.unique(owner):
        rows = np.flatnonzero(owner == bone)
        chosen.update(rows[np.argmax(body.vertices[rows] @ directions.T, axis=0)].tolist())
    outer = np.array(sorted(chosen), dtype=np.int64)
    return SkinnedSurface(body.vertices[outer], SkinningWeights(bones[outer], weights[outer]), body.skeleton.bone_count)


class RecordedMotion(Motion):
    """A recording performed by any body; it ends where the recording does.

    Args:
        recording: the performance.
        arms_away_degrees: see `Motion`.
    """

    def __init__(self, recording: Recording, arms_away_degrees: float | None = None) -> None:
        super().__init__(recording.name, recording.duration, recording.notes, arms_away_degrees)
        self.recording = recording
        self._retargeting = lru_cache(maxsize=4)(partial(Retargeting, recording))

    def _perform(self, body: ShapedBody, fps: float, frames: np.ndarray) -> Performed:
        retargeting = self._retargeting(body)
        arms = self.arm_clearance(body)
        if arms is None:
            return Performed(replace(retargeting.poses(frames / fps), fps=fps))
        # With some frames around them, so that a frame does not depend on which others are computed.
        end = self.available_frames(fps) or int(frames[-1]) + 1
        around = np.arange(max(frames[0] - reach(fps), 0), min(frames[-1] + 1 + reach(fps), end))
        return self._held_off(arms, replace(retargeting.poses(around / fps), fps=fps), frames - around[0])

    def arm_clearance(self, body: ShapedBody) -> ArmClearance | None:
        retargeting = self._retargeting(body)
        as_measured = retargeting.direct and not self.recording.from_video
        return None if as_measured or self.arms_away_degrees is not None else retargeting.arm_clearance

    def _held_off(self, arms: ArmClearance, poses: PoseSequence, mask: np.ndarray) -> Performed:
        """Some frames of the poses with the arms swung out of the body."""
        turns = arms.turns(poses)
        turns = np.stack([eased(turn, poses.fps)[mask] for turn in turns])
        poses = replace(poses, rotations=poses.rotations[mask], root_positions=poses.root_positions[mask])
        angles = np.rad2deg(np.linalg.norm(turns, axis=-1))
        if angles.max() < _LEAST_TOLD:
            return Performed(held_off(arms.humanoid, poses, turns))
        frames = int((angles >= _LEAST_TOLD).any(axis=0).sum())
        note = (
            f"{self.name}: arms are swung out by up to {angles.max():.0f} degrees in {frames} of {len(mask)} frames, "
            "where they would go into the body; --arms-away 0 leaves them as recorded."
        )
        return Performed(held_off(arms.humanoid, poses, turns), (note,))
