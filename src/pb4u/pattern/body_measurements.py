"""Measures of a body that GarmentCode makes patterns from, by the names of its body files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.garment.body_form import Limb, directions, form_of

_SLICE = 0.012
"""Half thickness [m] of a slice of skin that a tape lies around, across a limb."""

_NECK_ROOM = 0.01
"""Distance [m] beside the neck at which the shoulder begins."""

_LOW_WAIST = 0.25
"""How far below the waist jeans are worn, as a share of the way to the hips."""

_UNDER_BUST = 0.045
"""Height of the fold under the bust below its fullest level, as a share of the body's height."""


def body_measurements(body: ShapedBody) -> dict[str, float]:
    """GarmentCode's measures of a resting body [cm, degrees], by the names of its body files.

    Girths are those of a tape, which lies along the convex hull of a slice; heights are between its levels.

    Args:
        body: the resting body.

    Raises:
        InputError: its skeleton lacks the joints of shoulders, arms, hips or legs.
    """
    tape = _Tape(body)
    lengths, angles = tape.lengths(), tape.angles()
    return {**{name: round(100.0 * value, 2) for name, value in lengths.items()}, **angles}


def measurements_yaml(measures: Mapping[str, float]) -> str:
    """Those measures as the YAML text of a GarmentCode body file.

    Args:
        measures: by name [cm, degrees].
    """
    rows = [f"  {name}: {value:g}" for name, value in sorted(measures.items())]
    return "\n".join(["body:", *rows, ""])


def tailors_measures(body: ShapedBody) -> dict[str, float]:
    """Measures that the built-in patterns are drafted from [m; angles rad], by name.

    Measures named `_height` are above the floor; `_width` is the straight width; the others are tape measures.

    Args:
        body: the resting body.

    Raises:
        InputError: its skeleton lacks the joints of shoulders, arms, hips or legs.
    """
    tape = _Tape(body)
    form, arm, leg = tape.form, tape.form.arms[0], tape.form.legs[0]
    lengths, low_waist = tape.lengths(), tape.waist - _LOW_WAIST * (tape.waist - tape.hips)
    return {name: float(lengths[name]) for name in ("bust", "waist", "hips", "wrist", "arm_length")} | {
        "neck_height": float(tape.shoulder[1]),
        "neck_width": 2.0 * float(tape.shoulder[0]),
        "shoulder_height": float(tape.shoulder_end[1]),
        "shoulder_width": 2.0 * float(tape.shoulder_end[0]),
        "armpit_height": form.armpit,
        "upper_arm": tape.limb_girth(arm, 0.3),
        "arm_angle": float(np.radians(tape.angles()["arm_pose_angle"])),
        "bust_height": tape.bust,
        "bust_points": lengths["bust_points"],
        "front_length": lengths["waist_over_bust_line"],
        "waist_height": tape.waist,
        "low_waist_height": low_waist,
        "low_waist": tape.girth(low_waist),
        "hip_height": tape.hips,
        "crotch_height": form.crotch,
        "thigh": lengths["leg_circ"],
        "knee_height": form.knee_height,
        "knee": tape.limb_girth(leg, 1.0),
        "calf": max(tape.limb_girth(leg, at) for at in (1.2, 1.3, 1.4)),
        "ankle_height": form.ankle_height,
    }


def shoulder_height(body: ShapedBody, x: float) -> float:
    """Height [m] of the shoulder of a resting body at a distance `x` [m] from its middle.

    Args:
        body: the resting body.
        x: distance from the middle [m], to either side.
    """
    return float(_Tape(body).top(x)[1])


def trunk_girths(body: ShapedBody, **levels: float) -> dict[str, tuple[float, float]]:
    """Heights and girths [m] of a resting body's trunk, by name: bust, waist, hips and others.

    Args:
        body: the resting body. **levels: heights of further girths [m].
    """
    tape = _Tape(body)
    heights = {name: getattr(tape, name) for name in ("bust", "waist", "hips")} | levels
    return {name: (level, tape.girth(level)) for name, level in heights.items()}


class _Tape:
    """A tape around a body.

    Args:
        body: the resting body.
    """

    def __init__(self, body: ShapedBody) -> None:
        self.body, self.form = body, form_of(body)
        points, _, owner = self.form.samples
        self.trunk = points[~self.form.arm_skin[owner] & ~self.form.head[owner]]
        self.heights = self.form.torso.heights
        self.girths = 2.0 * np.pi * np.nan_to_num(self.form.torso.support).mean(axis=1)

    def lengths(self) -> dict[str, float]:
        """Lengths [m] by name."""
        form, arm, shoulder = self.form, self.form.arms[0], self.shoulder
        return {
            "height": self.body.height,
            "head_l": self.body.height - shoulder[1],
            "neck_w": 2.0 * float(shoulder[0]),
            "shoulder_w": 2.0 * self.shoulder_end[0],
            "armscye_depth": float(self.shoulder_end[1] - form.armpit),
            "arm_length": float(np.linalg.norm(np.diff(arm.joints, axis=0), axis=1).sum()),
            "wrist": self.limb_girth(arm, 1.97),
            "bust": self.girth(self.bust),
            "underbust": self.girth(self.bust - _UNDER_BUST * self.body.height),
            "waist": self.girth(self.waist),
            "hips": self.girth(self.hips),
            "back_width": self.back_width(self.bust),
            "waist_back_width": self.back_width(self.waist),
            "hip_back_width": self.back_width(self.hips),
            "bust_line": float(np.linalg.norm(self.front(self.bust) - shoulder)),
            "vert_bust_line": float(shoulder[1] - self.bust),
            "waist_line": float(form.neck[1] - self.waist),
            "waist_over_bust_line": float(
                np.linalg.norm(np.diff([shoulder, self.front(self.bust), self.front(self.waist)], axis=0), axis=1).sum()
            ),
            "hips_line": self.waist - self.hips,
            "crotch_hip_diff": self.hips - form.crotch,
            "leg_circ": self.limb_girth(self.form.legs[0], 0.12),
            "bust_points": 2.0 * abs(self.front(self.bust)[0]),
            "bum_points": 2.0 * abs(self.back(self.hips)[0]),
        }

    def angles(self) -> dict[str, float]:
        """Angles [degrees] by name."""
        way = self.form.arms[0].direction(0.5)
        drop = self.shoulder - self.shoulder_end
        side = [self.side(level) for level in (self.waist, self.hips)]
        hip = np.degrees(np.arctan2(side[1] - side[0], self.waist - self.hips))
        return {
            "arm_pose_angle": round(float(np.degrees(np.arctan2(-way[1], abs(way[0])))), 2),
            "shoulder_incl": round(float(np.degrees(np.arctan2(drop[1], -drop[0]))), 2),
            "hip_inclination": round(float(hip), 2),
        }

    @cached_property
    def shoulder(self) -> np.ndarray:
        """Point (3,) [m] where the left shoulder begins, beside the neck."""
        return self.top(self.form.neck_half_width + _NECK_ROOM * self.form.scale)

    @cached_property
    def shoulder_end(self) -> np.ndarray:
        """Point (3,) [m] on top of the left shoulder joint."""
        points, _, owner = self.form.samples
        skin = points[~self.form.head[owner]]
        return self._highest(skin, self.form.shoulder_half_width)

    @cached_property
    def waist(self) -> float:
        """Height [m] of the smallest girth between hips and armpits."""
        middle = 0.5 * (self.form.hip_height + self.form.armpit)
        return self._level(self.form.hip_height + 0.05, middle + 0.03, np.argmin)

    @cached_property
    def hips(self) -> float:
        """Height [m] of the largest girth between crotch and waist."""
        return self._level(0.85 * self.form.crotch + 0.15 * self.waist, self.waist - 0.05, np.argmax)

    @cached_property
    def bust(self) -> float:
        """Height [m] at which the trunk reaches farthest forward between waist and armpits."""
        levels = np.arange(self.waist + 0.05, self.form.armpit, 0.005)
        return float(levels[np.argmax([self.front(level)[2] for level in levels])])

    def top(self, x: float) -> np.ndarray:
        """Highest point (3,) [m] of the trunk at a distance `x` [m] to the left."""
        return self._highest(self.trunk, x)

    def front(self, level: float) -> np.ndarray:
        """Foremost point (3,) [m] of the trunk at a height, on the left."""
        near = self._near(level)
        return near[near[:, 2].argmax()]

    def back(self, level: float) -> np.ndarray:
        """Hindmost point (3,) [m] of the trunk at a height, on the left."""
        near = self._near(level)
        return near[near[:, 2].argmin()]

    def side(self, level: float) -> float:
        """Reach [m] of the trunk to the left at a height."""
        return float(self._near(level)[:, 0].max())

    def girth(self, level: float) -> float:
        """Girth [m] of the trunk at a height."""
        return float(np.interp(level, self.heights, self.girths))

    def back_width(self, level: float) -> float:
        """Length [m] of a tape across the back at a height, from side to side."""
        support = self.form.torso.support[self.form.torso.level(level)]
        turn = 2.0 * np.pi / len(support)
        across = np.gradient(np.concatenate([support[-2:], support, support[:2]]), turn)[2:-2]
        units = directions()
        hull = support[:, None] * units + across[:, None] * np.column_stack([units[:, 1], -units[:, 0]])
        # Directions run from the front to the left and on around the back to the right.
        quarter = len(support) // 4
        return float(np.linalg.norm(np.diff(hull[quarter : 3 * quarter + 1], axis=0), axis=1).sum())

    def limb_girth(self, limb: Limb, at: float) -> float:
        """Girth [m] of a limb at a place along it: 0 its first joint, 2 its last."""
        from scipy.spatial import ConvexHull

        points, _, owner = self.form.samples
        axis, side = limb.direction(at), np.sign(limb.side) * points[:, 0] > 0.0
        offset = points[limb.belongs[owner] & side] - limb.along(at)
        ring = offset[np.abs(offset @ axis) < _SLICE * self.form.scale]
        first = np.linalg.svd(axis[None])[2][1:]
        return float(ConvexHull(ring @ first.T).area)

    def _near(self, level: float) -> np.ndarray:
        trunk = self.trunk
        return trunk[(np.abs(trunk[:, 1] - level) < _SLICE * self.form.scale) & (trunk[:, 0] >= 0.0)]

    def _highest(self, skin: np.ndarray, x: float) -> np.ndarray:
        near = skin[np.abs(skin[:, 0] - x) < 0.5 * _SLICE * self.form.scale]
        return np.array([x, *near[near[:, 1].argmax(), 1:]])

    def _level(self, low: float, high: float, best: Callable[[np.ndarray], Any]) -> float:
        rows = np.flatnonzero((self.heights >= low) & (self.heights <= high))
        return float(self.heights[rows[best(self.girths[rows])]])
