"""A body that cloth is sewn around: first thin, with arms along the sleeves, and at the end in its own shape."""

from __future__ import annotations

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence, branch
from pb4u.garment.body_form import Limb, form_of
from pb4u.geometry.rotation import between

_END = 0.95
"""Share of a sleeve's points that are nearer to the shoulder than its end."""


class SewingBody:
    """A resting body that grows: first thin, with straight arms, and at the end in its own shape.

    Args:
        body: the resting body.
        sleeves: (n, 3) points of the left arm's sleeve, in the frontal plane [m]; none where there are no sleeves.

    Raises:
        InputError: the skeleton lacks the joints of arms.
    """

    def __init__(self, body: ShapedBody, sleeves: np.ndarray) -> None:
        self.rest = body.vertices
        straight = body.posed(_straight_arms(body, sleeves))
        lines = bone_lines(body)
        self._straight, self._lines = (
            straight.skin(places, body.weights, 0, 1)[0].numpy().astype(np.float64) for places in (self.rest, lines)
        )

    def thin(self, share: float) -> np.ndarray:
        """Vertices (vertices, 3) [m] with arms stretched, at a `share` of the girth around the bones.

        Args:
            share: of the girth, 0 to 1.
        """
        return self._lines + share * (self._straight - self._lines)

    def between(self, share: float, blend: float) -> np.ndarray:
        """Vertices (vertices, 3) [m] interpolated by `blend` from `thin` at a `share` (0) to the body at rest (1).

        Args:
            share: of the girth, 0 to 1.
            blend: interpolation parameter, 0 to 1.
        """
        return (1.0 - blend) * self.thin(share) + blend * self.rest


def _straight_arms(body: ShapedBody, sleeves: np.ndarray) -> PoseSequence:
    """The pose, one frame long, in which each arm and its hand are a straight line in the frontal plane."""
    skeleton = body.skeleton
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (skeleton.bone_count, 1))
    for arm in form_of(body).arms:
        shoulder, direction = arm.joints[0], (arm.joints[2] - arm.joints[0])[:2]
        if len(sleeves):
            # Through the middle of the sleeve's end.
            ways = sleeves[:, :2] * (arm.side, 1.0) - shoulder[:2]
            lengths = np.hypot(*ways.T)
            direction = ways[lengths >= np.quantile(lengths, _END)].mean(axis=0)
        direction = np.append(direction / np.hypot(*direction), 0.0)
        # From the shoulder on; what comes later in the chain overrides.
        for joint, way in _parts(body, arm):
            first = int(np.linalg.norm(skeleton.joints - joint, axis=1).argmin())
            rotations[branch(skeleton.parents, (first,))] = between(way / np.linalg.norm(way), direction)
    return PoseSequence(rotations[None], skeleton.joints[None, 0], 30.0)


def _parts(body: ShapedBody, arm: Limb) -> list[tuple[np.ndarray, np.ndarray]]:
    """Head (3,) and direction (3,) [m] of upper arm, forearm and hand."""
    shoulder, elbow, wrist = arm.joints
    hand = body.vertices[arm.tip].mean(axis=0)
    return [(shoulder, elbow - shoulder), (elbow, wrist - elbow), (wrist, hand - wrist)]


def bone_lines(body: ShapedBody) -> np.ndarray:
    """Nearest points (vertices, 3) [m] on the bones to each vertex of a resting body, averaged by skinning weight.

    Args:
        body: the resting body.
    """
    skeleton, mixed = body.skeleton, np.zeros_like(body.vertices)
    for bone in range(skeleton.bone_count):
        share = np.where(body.weights.bones == bone, body.weights.weights, 0.0).sum(axis=1)
        skin = np.flatnonzero(share > 0.0)
        if not len(skin):
            continue
        points, start = body.vertices[skin], skeleton.joints[bone]
        nearest = np.broadcast_to(start, points.shape).copy()
        for child in np.flatnonzero(skeleton.parents == bone):
            way = skeleton.joints[child] - start
            along = np.clip((points - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
            on_bone = start + along[:, None] * way
            closer = np.linalg.norm(points - on_bone, axis=1) < np.linalg.norm(points - nearest, axis=1)
            nearest[closer] = on_bone[closer]
        mixed[skin] += share[skin, None] * nearest
    return mixed
