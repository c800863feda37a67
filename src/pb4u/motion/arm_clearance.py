"""Arms swung out of the body, where a recording puts them into it.

A body that is broader than who was recorded presses its forearms into hips and belly: on an average woman most CMU
recordings by 2 to 7 cm, walks in most of their frames. No sleeve can be where skin is inside skin.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from pb4u.body.skeleton import PoseSequence, joint_positions
from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface
from pb4u.geometry.rotation import from_axis_angle, multiply, rotate
from pb4u.motion.humanoid import Humanoid

SIDES = ("L", "R")
# Room [m] between the skins, for cloth on both of them.
_ROOM = 0.008
# Nothing is turned farther: an arm that would have to be lies behind the body or under it.
_FARTHEST = np.deg2rad(30.0)
# Turns in search of the room, each for the deepest point; none for a point nearly in line with the push [m].
_ROUNDS = 6
_LEAST_LEVER = 0.05
# An arm begins to swing off so long [s] before it has to, twice over: found and blended.
_LEAD = 0.1


class ArmClearance:
    """Where the arms of a body may be.

    Args:
        humanoid: the body.

    Attributes:
        humanoid: the body.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        self.humanoid = humanoid
        body = humanoid.body
        shares = np.array([humanoid.arm_shares(side) for side in SIDES])
        weights = body.weights
        of_arm = (shares[:, weights.bones] * weights.weights).sum(axis=-1)
        self._body = TriangleSurface(body.faces, len(body.vertices), of_arm.max(axis=0) < 0.5)
        self._shoulders = [body.skeleton.index(humanoid.bone_of(f"upper_arm.{side}")) for side in SIDES]
        self._points = [self._lower_arm(side) for side in SIDES]

    def _lower_arm(self, side: str) -> np.ndarray:
        """Vertices of an arm from halfway down to the elbow, with those of the hand that cloth meets."""
        humanoid, body = self.humanoid, self.humanoid.body
        arm = humanoid.arm_shares(side) == 1.0
        shoulder, elbow = humanoid.joint(f"upper_arm.{side}"), humanoid.joint(f"forearm.{side}")
        far = np.linalg.norm(body.vertices - shoulder, axis=1) > 0.5 * np.linalg.norm(elbow - shoulder)
        return np.flatnonzero((body.weights.share_of(arm) > 0.9) & far & body.contact)

    def turns(self, poses: PoseSequence) -> np.ndarray:
        """The least turns of both arms about their shoulders that leave room between them and the body.

        Args:
            poses: poses of the body, of consecutive frames.

        Returns:
            (2, frames, 3) rotation vectors in the world [rad], left and right.
        """
        posed = self.humanoid.body.posed(poses)
        shoulders = joint_positions(self.humanoid.body.skeleton, poses)[:, self._shoulders]
        turns = np.zeros((len(SIDES), len(poses), 3))
        for t in range(len(poses)):
            vertices = posed.positions(t, t + 1)[0].double()
            surface = self._body.at(vertices)
            for k, points in enumerate(self._points):
                if len(points):
                    turns[k, t] = _least_turn(surface, vertices.numpy()[points], shoulders[t, k])
        return turns


def reach(fps: float) -> int:
    """Number of frames before and after a frame on which `eased` depends.

    Args:
        fps: frames per second.
    """
    return 2 * max(1, round(_LEAD * fps))


def eased(turns: np.ndarray, fps: float) -> np.ndarray:
    """Turns that smoothly begin before and end after the required ones.

    Args:
        turns: (frames, 3) rotation vectors [rad].
        fps: frames per second.
    """
    half = reach(fps) // 2
    angle = np.linalg.norm(turns, axis=1)
    frames = np.arange(len(turns))
    window = np.clip(frames[:, None] + np.arange(-half, half + 1), 0, len(turns) - 1)
    largest = turns[window[frames, angle[window].argmax(axis=1)]]
    weight = 1.0 - np.abs(np.arange(-half, half + 1)) / (half + 1)
    return np.einsum("w,fwi->fi", weight / weight.sum(), largest[window])


def _least_turn(surface: PosedSurface, points: np.ndarray, shoulder: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] about the shoulder (3,) that takes the points (points, 3) off the surface."""
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(_ROUNDS):
        arm = rotate(turn, points - shoulder)
        near = surface.nearest(torch.from_numpy(shoulder + arm))
        gap = torch.where(near.beyond_border, torch.inf, near.signed_distance).numpy()
        deepest = int(gap.argmin())
        missing = _ROOM - gap[deepest]
        axis = np.cross(arm[deepest], near.normals[deepest].numpy())
        lever = np.linalg.norm(axis)
        if missing <= 0.0 or lever < _LEAST_LEVER:
            break
        turn = multiply(from_axis_angle(axis / lever * min(missing / lever, _FARTHEST)), turn)
    axis = turn[1:] * np.sign(turn[0])
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return axis
    return axis / length * min(2.0 * math.asin(min(length, 1.0)), _FARTHEST)


def held_off(humanoid: Humanoid, poses: PoseSequence, turns: np.ndarray) -> PoseSequence:
    """The poses with both arms turned.

    Args:
        humanoid: the body.
        poses: its poses.
        turns: (2, frames, 3) rotation vectors in the world [rad], left and right.
    """
    for side, turn in zip(SIDES, turns, strict=True):
        poses = humanoid.arm_turned(poses, side, from_axis_angle(turn))
    return poses
