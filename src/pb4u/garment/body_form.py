"""A tailor's measures of a resting body: joints, limbs, cross sections, all taken from its surface and skeleton."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.joint_names import LIMB_BONES, NECK_BONES, SIDES
from pb4u.body.skeleton import branch
from pb4u.errors import InputError
from pb4u.geometry.triangle_mesh import face_cross_products

_ARM, _LEG = ("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot")

#: Number of support directions around the torso or a leg.
DIRECTIONS = 72
# Heights [m] above the base of the neck at which it is measured, for an adult of 1.75 m: the first, or where the neck
# is narrowest, as strong shoulders rise beside its base.
_NECK_LEVELS = (0.03, 0.04, 0.05, 0.06, 0.07)
# Half a width [m] that is no neck's: those of drawn bodies are 0.047 to 0.066, with strong shoulders 0.085 to 0.119.
_WIDE_NECK = 0.07
# Where straps begin and end at most, as shares of the way to the shoulder joint.
_STRAP_SHARES = (0.55, 0.86)
# Distance [m] between levels of the sections: finer detail of the skin does not show in the cloth.
_STEP = 0.01


@dataclass(frozen=True, eq=False)
class Limb:
    """A chain of three joints on one side, +1 for the body's left (+X), and their descendants.

    Args:
        side: +1 or -1.
        joints: (3, 3) shoulder, elbow, wrist or hip, knee, ankle [m].
        belongs: (vertices,) bool, skin moved mostly by this limb, hand or foot included.
        tip: (vertices,) bool, skin of the hand or foot.
    """

    side: int
    joints: np.ndarray
    belongs: np.ndarray
    tip: np.ndarray

    def along(self, fraction: float) -> np.ndarray:
        """Point (3,) [m] along the limb: 0 first joint, 1 second, 2 third.

        Args:
            fraction: 0 to 2.
        """
        first = int(np.clip(np.floor(fraction), 0, 1))
        return self.joints[first] + (fraction - first) * (self.joints[first + 1] - self.joints[first])

    def direction(self, fraction: float) -> np.ndarray:
        """Unit direction (3,) towards the hand or foot.

        Args:
            fraction: 0 to 2, as in `along`.
        """
        first = int(np.clip(np.floor(fraction), 0, 1))
        way = self.joints[first + 1] - self.joints[first]
        return way / np.linalg.norm(way)


@dataclass(frozen=True, eq=False)
class Sections:
    """Convex hulls of horizontal slices of some skin, as support functions.

    Args:
        heights: (levels,) increasing [m].
        centres: (levels, 2) x and z that the support is measured from [m].
        support: (levels, directions) reach of the hull from the centre [m]; NaN where there is no skin.
    """

    heights: np.ndarray
    centres: np.ndarray
    support: np.ndarray

    def reach(self, bottom: float, top: float) -> np.ndarray:
        """Half extents, about the origin, of the part between two heights.

        Args:
            bottom: lower height [m].
            top: upper height [m].

        Returns:
            (2,) in x and z [m].
        """
        part = slice(self.level(bottom), self.level(top) + 1)
        widest = float(np.nanmax(self.support[part]))
        return widest + np.abs(self.centres[part]).max(axis=0)

    def level(self, y: float) -> int:
        """Index of the level nearest to height y [m].

        Args:
            y: height [m].
        """
        return int(np.clip(round((y - self.heights[0]) / _STEP), 0, len(self.heights) - 1))


def directions() -> np.ndarray:
    """Unit vectors (directions, 2) in the x-z plane, from +Z towards +X."""
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return np.column_stack([np.sin(angle), np.cos(angle)])


class BodyForm:
    """Measures of one resting body.

    Args:
        body: the body.

    Raises:
        InputError: the skeleton lacks the joints of shoulders, arms, hips or legs, or does not stand.

    Attributes:
        neck: (3,) base of the neck [m].
        head: (vertices,) bool, skin of the head; so `arm_skin` (hands too), `hand_skin` and `foot_skin`.
        arms: left and right.
        legs: left and right.
        scale: lengths that are not measured grow with it, 1 for an adult of 1.75 m.
        shoulder_height: mean height of the joints on both sides [m]; so `hip_height`, `knee_height`, `ankle_height`.
        waist: height of the natural waist [m].
        shoulder_half_width: how far the nearer shoulder joint is from the middle [m].
    """

    def __init__(self, body: ShapedBody) -> None:
        self.body = body
        names, sides = _bone_names(body)
        skeleton = body.skeleton
        self.neck: np.ndarray = skeleton.joints[skeleton.index(names["neck"])]
        self.head: np.ndarray = _share_of_bone(body, names["head"]) > 0.5
        self.arms = tuple(self._limb([names[k].format(side) for k in _ARM]) for side in sides)
        self.legs = tuple(self._limb([names[k].format(side) for k in _LEG]) for side in sides)
        self._arm_share = sum(
            (_share_of_bone(body, names["upper_arm"].format(side)) for side in sides), np.zeros(len(body.vertices))
        )
        shoulders, hips = (np.mean([limb.joints[0] for limb in limbs], axis=0) for limbs in (self.arms, self.legs))
        trunk = shoulders - hips
        if trunk[1] < 0.7 * np.linalg.norm(trunk):
            raise InputError(
                f'The built-in garments are cut for a standing body, and "{body.name}" lies or bends in its rest '
                "pose; turn "
                "its file so that Y is up, or give a garment file instead."
            )
        self.scale = body.height / 1.75
        self.arm_skin: np.ndarray = self.arms[0].belongs | self.arms[1].belongs
        self.hand_skin: np.ndarray = self.arms[0].tip | self.arms[1].tip
        self.foot_skin: np.ndarray = self.legs[0].tip | self.legs[1].tip
        self.shoulder_height = float(np.mean([arm.joints[0, 1] for arm in self.arms]))
        self.shoulder_half_width = min(abs(float(arm.joints[0, 0])) for arm in self.arms)
        self.hip_height, self.knee_height, self.ankle_height = (
            float(np.mean([leg.joints[k, 1] for leg in self.legs])) for k in range(3)
        )
        self.waist = self.hip_height + 0.38 * (self.shoulder_height - self.hip_height)

    def _limb(self, bones: list[str]) -> Limb:
        skeleton = self.body.skeleton
        joints = np.array([skeleton.joints[skeleton.index(bone)] for bone in bones])
        side = 1 if joints[:, 0].sum() > 0 else -1
        return Limb(side, joints, _share_of_bone(self.body, bones[0]) > 0.5, _share_of_bone(self.body, bones[2]) > 0.5)

    @cached_property
    def samples(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points spread over the skin.

        Returns:
            Points (n, 3) [m], their outward unit normals (n, 3) and the body vertex (n,) int64 that each belongs to.
        """
        vertices, faces = self.body.vertices, self.body.faces
        a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
        cross = face_cross_products(vertices, faces)
        normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
        longest = np.linalg.norm(np.stack([b - a, c - b, a - c]), axis=2).max(axis=0)
        points, owner, normal = [], [], []
        for parts in range(1, 7):
            chosen = (np.clip(np.ceil(longest / 0.008), 1, 6) == parts).nonzero()[0]
            if not len(chosen):
                continue
            grid = np.array([(i, j) for i in range(parts) for j in range(parts - i)])
            weights = (3 * grid + 1) / (3 * parts)
            weights = np.column_stack([1 - weights.sum(axis=1), weights])
            points.append(np.einsum("sk,fkd->fsd", weights, vertices[faces[chosen]]).reshape(-1, 3))
            owner.append(faces[chosen][:, np.argmax(weights, axis=1)].reshape(-1))
            normal.append(np.repeat(normals[chosen], len(weights), axis=0))
        vertex_normal = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(vertex_normal, faces[:, k], cross)
        vertex_normal /= np.maximum(np.linalg.norm(vertex_normal, axis=1, keepdims=True), 1e-300)
        points.append(vertices)
        owner.append(np.arange(len(vertices)))
        normal.append(vertex_normal)
        return np.concatenate(points), np.concatenate(normal), np.concatenate(owner)

    def sections(self, skin: np.ndarray, centre_x: float | None = 0.0) -> Sections:
        """Hulls of the horizontal slices of some skin; each level includes its neighbouring slices.

        Args:
            skin: (vertices,) bool.
            centre_x: x [m] that the support is measured from; None for the middle of each slice.
        """
        points, _, owner = self.samples
        points = points[skin[owner]]
        top = int(np.ceil(self.body.vertices[:, 1].max() / _STEP)) + 1
        heights = _STEP * np.arange(top + 1)
        level = np.clip(np.rint(points[:, 1] / _STEP).astype(int), 0, top)
        units = directions()
        reach = np.full((top + 1, DIRECTIONS), -np.inf)
        for k, (ux, uz) in enumerate(units):
            np.maximum.at(reach[:, k], level, points[:, 0] * ux + points[:, 2] * uz)
        below, above = reach.copy(), reach.copy()
        below[:-1], above[1:] = reach[1:], reach[:-1]
        reach = np.maximum(reach, np.maximum(below, above))
        empty = ~np.isfinite(reach[:, 0])
        reach[empty] = np.nan
        quarter = DIRECTIONS // 4
        front, back, left, right = (reach[:, k] for k in (0, 2 * quarter, quarter, 3 * quarter))
        centre_z = _smooth_filled(0.5 * (front - back), 8.0)
        middle_x = _smooth_filled(0.5 * (left - right), 4.0) if centre_x is None else np.full(top + 1, centre_x)
        centres = np.column_stack([middle_x, centre_z])
        return Sections(heights, centres, reach - centres @ units.T)

    @cached_property
    def torso(self) -> Sections:
        """Sections of everything but head, arms and hands: both legs within one hull."""
        return self.sections(~(self.head | self.arm_skin))

    @cached_property
    def crotch(self) -> float:
        """Height [m] where the legs part."""
        points, _, owner = self.samples
        knee = max(limb.joints[1, 1] for limb in self.legs)
        hip = max(limb.joints[0, 1] for limb in self.legs)
        hand = self.arm_skin[owner]
        middle = (np.abs(points[:, 0]) < 0.012 * self.scale) & (points[:, 1] > knee) & ~hand
        return float(min(points[middle, 1].min(), hip)) if middle.any() else 0.9 * float(hip)

    @cached_property
    def armpit(self) -> float:
        """Height [m] of the underarm fold, the lower of the two sides."""
        points, _, owner = self.samples
        blend = self._arm_share[owner]
        fold = (blend > 0.35) & (blend < 0.65)
        return float(points[fold, 1].min()) if fold.any() else float(self.shoulder_height - 0.1 * self.scale)

    @cached_property
    def neck_half_width(self) -> float:
        """Half the width [m] of the neck at its base, or higher up where strong shoulders rise beside it."""
        points, _, owner = self.samples
        inner = points[(np.abs(points[:, 0]) < 0.12 * self.scale) & ~self.arm_skin[owner]]

        def half_width(level: float) -> float:
            near = np.abs(inner[:, 1] - self.neck[1] - level * self.scale) < 0.012
            return float(np.abs(inner[near, 0]).max()) if near.any() else 0.06 * self.scale

        base = half_width(_NECK_LEVELS[0])
        return base if base < _WIDE_NECK * self.scale else min(half_width(level) for level in _NECK_LEVELS)

    @cached_property
    def shoulder_slope(self) -> float:
        """Angle [rad] by which the tops of the shoulders slope under straps, from halfway to the joint onwards."""
        points, _, owner = self.samples
        width = self.shoulder_half_width
        skin = points[~self.head[owner] & (points[:, 1] > self.armpit)]
        heights = []
        for share in _STRAP_SHARES:
            near = np.abs(np.abs(skin[:, 0]) - share * width) < 0.004 * self.scale
            heights.append(skin[near, 1].max() if near.any() else self.shoulder_height)
        far = (_STRAP_SHARES[1] - _STRAP_SHARES[0]) * width
        return float(np.arctan2(heights[0] - heights[1], far))

    def midline(self, y: float, front: bool) -> np.ndarray:
        """Point of the skin in the symmetry plane, on the chest side or on the back.

        Args:
            y: height [m].
            front: whether the point is on the chest side.

        Returns:
            (3,) [m].
        """
        points, _, owner = self.samples
        arm = self.arm_skin[owner]
        near = (np.abs(points[:, 0]) < 0.02 * self.scale) & (np.abs(points[:, 1] - y) < 0.008) & ~arm
        if not near.any():
            return np.array([0.0, y, self.neck[2]])
        z = points[near, 2]
        return np.array([0.0, y, float(z.max() if front else z.min())])


def form_of(body: ShapedBody) -> BodyForm:
    """The form of a body, computed once and stored with it.

    Args:
        body: the resting body.

    Raises:
        InputError: its skeleton lacks the joints of shoulders, arms, hips or legs, or does not stand.
    """
    return body.kept("form", BodyForm)


def _smooth_filled(values: np.ndarray, sigma: float) -> np.ndarray:
    """Fills NaN from the nearest values and smooths along the levels."""
    from scipy.ndimage import gaussian_filter1d

    finite = np.isfinite(values)
    filled = np.interp(np.arange(len(values)), np.flatnonzero(finite), values[finite]) if finite.any() else 0.0 * values
    return gaussian_filter1d(np.nan_to_num(filled), sigma, mode="nearest")


def _bone_names(body: ShapedBody) -> tuple[dict[str, str], tuple[str, str]]:
    """Bone names of the joints, with a place for the side, and the names of the sides."""
    for family, sides in SIDES.items():
        names = {**NECK_BONES[family], **{part: LIMB_BONES[family][part] for part in _ARM + _LEG}}
        if {name.format(side) for name in names.values() for side in sides} <= set(body.skeleton.names):
            return names, sides
    raise InputError(
        f'The built-in garments cannot be fitted to body "{body.name}" (family "{body.family}"): its skeleton lacks '
        "the named shoulder, elbow, wrist, hip, knee, ankle and neck joints; give a garment file instead."
    )


def _share_of_bone(body: ShapedBody, name: str) -> np.ndarray:
    """(vertices,) share of each vertex's skinning that the bone `name` and the bones below it hold."""
    return body.weights.share_of(branch(body.skeleton.parents, (body.skeleton.index(name),)))
