"""A recorded performance of some skeleton, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pb4u.body.skeleton import PoseSequence, Skeleton, branch, joint_positions
from pb4u.errors import InputError
from pb4u.geometry.rotation import about_axis, between, conjugate, multiply, rotate, slerp, spline
from pb4u.motion.correspondences import ROLES, Blend, SkeletonRoles
from pb4u.motion.reference_pose import leg_length


@dataclass(frozen=True, eq=False)
class Recording:
    """World rotations of a recorded skeleton from its own reference pose; lengths in any unit, Y up.

    Args:
        name: as given by the user.
        source: how its bones play the roles.
        skeleton: the reference pose, facing +Z.
        poses: the performance.
        notes: plain sentences on what was repaired or ignored.
        from_video: whether it was estimated from a video, whose feet slide and whose joints tremble.
        askew: slope [deg] up to which its floor may be level in truth.
    """

    name: str
    source: SkeletonRoles
    skeleton: Skeleton
    poses: PoseSequence
    notes: tuple[str, ...] = ()
    from_video: bool = False
    askew: float = 3.0

    @property
    def duration(self) -> float:
        """Time from the first frame to the last [s]."""
        return (len(self.poses) - 1) / self.poses.fps

    def cropped(self, start: int, stop: int) -> Recording:
        """A part of the recording.

        Args:
            start: first frame, counted at the recording's own rate.
            stop: frame after the last.

        Raises:
            InputError: the part is not inside the recording.
        """
        frames = len(self.poses)
        if not 0 <= start < stop <= frames:
            raise InputError(
                f"{self.name}: the crop {start}:{stop} is not inside the recording, which has frames 0:{frames}."
            )
        poses = PoseSequence(self.poses.rotations[start:stop], self.poses.root_positions[start:stop], self.poses.fps)
        return replace(self, poses=poses)

    def sampled(self, times: np.ndarray) -> PoseSequence:
        """Poses at `times` (frames,) [s] within the recording, interpolated through its frames with continuous
        velocities.

        Args:
            times: (frames,) [s].
        """
        from scipy.interpolate import PchipInterpolator

        place = np.clip(np.asarray(times) * self.poses.fps, 0.0, len(self.poses) - 1)
        # Times that differ from a recorded frame only by rounding take that frame as it is.
        place = np.where(np.abs(place - np.rint(place)) < 1e-6, np.rint(place), place)
        roots, rotations = self.poses.root_positions, self.poses.rotations
        fps = 1.0 / float(times[1] - times[0]) if len(times) > 1 else self.poses.fps
        if (place == np.rint(place)).all():
            frames = place.astype(np.int64)
            return PoseSequence(rotations[frames], roots[frames], fps)
        return PoseSequence(spline(rotations, place), PchipInterpolator(np.arange(len(roots)), roots)(place), fps)

    def stood_up(self, up: np.ndarray) -> Recording:
        """The same performance turned so that `up` (3,), of length 1, is up along Y.

        Args:
            up: (3,) unit vector.
        """
        turn, poses = between(up, np.array([0.0, 1.0, 0.0])), self.poses
        roots = rotate(turn, poses.root_positions)
        return replace(self, poses=replace(poses, rotations=multiply(turn, poses.rotations), root_positions=roots))

    @property
    def metres(self) -> float:
        """Length [m] of the recording's unit, for the leg of an average adult."""
        return _LEG / max(self.leg_length, 1e-9)

    def with_vertical_legs(self) -> Recording:
        """The same performance, relative to a reference pose whose legs hang straight down in the frontal plane.

        The rest poses of motion capture skeletons often spread the legs, feet and all; a body at rest does not.
        """
        joints = self.skeleton.joints.copy()
        rotations = self.poses.rotations.copy()
        for side in "LR":
            hip, ankle = (self.joint_index(f"{role}.{side}") for role in ("thigh", "foot"))
            leg = joints[ankle] - joints[hip]
            turn = about_axis("z", -np.arctan2(leg[0], -leg[1]))
            below = np.flatnonzero(branch(self.skeleton.parents, (hip,)))
            joints[below] = joints[hip] + rotate(turn, joints[below] - joints[hip])
            rotations[:, below] = multiply(rotations[:, below], conjugate(turn))
        return replace(
            self,
            skeleton=replace(self.skeleton, joints=joints),
            poses=replace(self.poses, rotations=rotations),
        )

    def joint_index(self, role: str) -> int:
        """Index of the bone whose head marks the upper end of a limb role.

        Args:
            role: a limb role.
        """
        part = self.source.roles[role]
        return self.skeleton.index(part.first if isinstance(part, Blend) else part)

    def joint(self, role: str) -> np.ndarray:
        """Position (3,) of the upper joint of a limb role in the reference pose, in the unit of the recording.

        Args:
            role: a limb role.
        """
        return self.skeleton.joints[self.joint_index(role)]

    def role_rotations(self, poses: PoseSequence) -> np.ndarray:
        """World rotations (frames, roles, 4), unit quaternions wxyz, of every role from the reference pose.

        Args:
            poses: poses of this recording's skeleton.
        """
        result = np.empty((len(poses), len(ROLES), 4))
        for i, role in enumerate(ROLES):
            part = self.source.roles[role]
            if isinstance(part, Blend):
                first, second = (poses.rotations[:, self.skeleton.index(b)] for b in (part.first, part.second))
                result[:, i] = slerp(first, second, np.full(len(poses), part.amount))
            else:
                result[:, i] = poses.rotations[:, self.skeleton.index(part)]
        return result

    def hip_midpoints(self, poses: PoseSequence) -> np.ndarray:
        """World positions (frames, 3) halfway between the hip joints, in the unit of the recording.

        Args:
            poses: poses of this recording's skeleton.
        """
        joints = joint_positions(self.skeleton, poses)
        return 0.5 * (joints[:, self.joint_index("thigh.L")] + joints[:, self.joint_index("thigh.R")])

    @property
    def leg_length(self) -> float:
        """Length of hip to knee to ankle in the reference pose, mean of both legs, in the unit of the recording."""
        return leg_length(self.joint)


_LEG = 0.85
"""Length of hip to knee to ankle of an average adult [m]; files have units of their own."""
_LARGEST = 1e7
"""Numbers of a recording beyond which they are damaged: ten kilometres in millimetres."""
_RATES = (0.1, 1e5)
"""Frames per second that a recording, or a body in motion, may have."""


def require_rate(fps: float, path: Path) -> None:
    """Refuse an impossible frame rate.

    Args:
        fps: frames per second.
        path: the file that contains it, for the message.

    Raises:
        InputError: it is out of range.
    """
    if not _RATES[0] <= fps <= _RATES[1]:
        raise InputError(
            f"{path}: the frame rate is {fps:g}; it should be a positive number of frames per second, from "
            f"{_RATES[0]:g} to {_RATES[1]:g}."
        )


def finite_frames(values: np.ndarray, path: Path) -> np.ndarray:
    """The values unchanged, where all are finite.

    Args:
        values: (frames, numbers), in any unit.
        path: their file, for the message.

    Returns:
        (frames, numbers), the argument itself.

    Raises:
        InputError: a value is NaN or infinite, or too large for an angle or a position; names its frame.
    """
    bad = ~(np.abs(values) <= _LARGEST).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: frame {int(np.argmax(bad))} holds values that are not finite, or beyond {_LARGEST:g} "
            f"({int(bad.sum())} such frame(s)); "
            f"leave them out or repair the file."
        )
    return values
