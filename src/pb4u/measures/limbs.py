"""Limbs that have gone through cloth: bones that cross its faces.

Skin that is a little above or beside cloth may be a fold or a coarse mesh; a bone that crosses a face cannot be. A
sleeve or a trouser leg is around its bone, and a hem or a collar lets it through an opening. Where a bone is outside of
its own skin, as that of a shoulder is by some millimetres under a raised arm, what it crosses says nothing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pb4u.body.body_model import PosedBody
from pb4u.collision.crossings import segments_through_faces
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory

_TOES = re.compile(r"^toe[\d-]+")
_ARM = re.compile("arm|elbow|wrist")
"""In the names of an arm's bones, as Anny and the SMPL family have them; a shoulder's bone is held off by nothing."""


@dataclass(frozen=True, eq=False)
class Bones:
    """Bones that cloth has to stay around, over time; those of hands, which are left out of contact, are none of them.

    Args:
        names: name of each bone.
        ends: (frames, bones, 2, 3) its joint and the next [m].
    """

    names: tuple[str, ...]
    ends: np.ndarray

    @staticmethod
    def of(scene: Scene, trajectory: Trajectory) -> Bones:
        """The bones of a scene's bodies at the frames of a trajectory; none of a body without a skeleton.

        Args:
            scene: what was simulated.
            trajectory: the result.
        """
        frames = trajectory.frame_count
        at = scene.lead_in + np.arange(frames) * (scene.fps / trajectory.fps)
        names: list[str] = []
        ends = [np.zeros((frames, 0, 2, 3))]
        for body in scene.colliders:
            if isinstance(body, PosedBody):
                bones, segments = _touchable_bones(body)
                joints = body.joints
                now = np.minimum(at.astype(int), len(joints) - 1)
                share = (at - now)[:, None, None]
                between = (1.0 - share) * joints[now] + share * joints[np.minimum(now + 1, len(joints) - 1)]
                names += bones
                ends.append(between[:, segments])
        return Bones(tuple(names), np.concatenate(ends, axis=1))

    def through_cloth(self, trajectory: Trajectory) -> np.ndarray:
        """Which bones (frames, bones) bool cross a face of the garments inside the body.

        Args:
            trajectory: the frames that the bones were taken at.
        """
        crossed = np.zeros(self.ends.shape[:2], dtype=bool)
        if not self.names:
            return crossed
        skin = TriangleSurface(np.array(trajectory.header.body_faces), trajectory.body_positions.shape[1])
        for t, ends in enumerate(self.ends):
            cloth = np.asarray(trajectory.positions[t], dtype=np.float64)
            if not np.isfinite(cloth).all():
                continue
            pairs, places = segments_through_faces(ends[:, 0], ends[:, 1], cloth, trajectory.faces)
            if len(pairs):
                body = torch.from_numpy(np.array(trajectory.body_positions[t], dtype=np.float64))
                inside = skin.at(body).nearest(torch.from_numpy(places)).signed_distance.numpy() < 0.0
                crossed[t, pairs[inside, 0]] = True
        return crossed


def _touchable_bones(body: PosedBody) -> tuple[list[str], np.ndarray]:
    """Names of a body's bones whose skin is mostly touchable, and the two joints (bones, 2) int64 of each.

    The toes of a foot have one name.
    """
    skeleton, weights = body.body.skeleton, body.body.weights
    nearest = weights.bones[np.arange(len(weights.bones)), weights.weights.argmax(axis=1)]
    skin = np.bincount(nearest, minlength=skeleton.bone_count)
    touched = np.bincount(nearest, body.contact, skeleton.bone_count)
    segments = [
        (parent, bone)
        for bone, parent in enumerate(skeleton.parents.tolist())
        if parent >= 0 and skin[parent] and 2 * touched[parent] > skin[parent]
    ]
    return [_TOES.sub("toes", skeleton.names[parent]) for parent, _ in segments], np.array(
        segments, dtype=np.int64
    ).reshape(-1, 2)


def limbs_through_cloth(names: Sequence[str], crossed: np.ndarray) -> list[dict[str, Any]]:
    """What has gone through cloth, the longest first: name of the `bone`, `first_frame` and number of `frames`.

    Args:
        names: names of the bones.
        crossed: (frames, bones) bool as `Bones.through_cloth`.
    """
    # A joint with several children is the head of several bones of one name.
    by_name = {name: crossed[:, [k for k, other in enumerate(names) if other == name]].any(axis=1) for name in names}
    found = [
        {"bone": name, "first_frame": int(rows.argmax()), "frames": int(rows.sum())}
        for name, rows in by_name.items()
        if rows.any()
    ]
    return sorted(found, key=lambda each: -each["frames"])


def limbs_sentence(found: Sequence[dict[str, Any]], frames: int) -> str | None:
    """What has gone through cloth in one sentence; None for nothing.

    Args:
        found: as `limbs_through_cloth`.
        frames: number of frames of the trajectory.
    """
    if not found:
        return None
    first = min(each["first_frame"] for each in found)
    told = ", ".join(f"{each['bone']} ({each['frames']})" for each in found[:4])
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    arms = "; --arms-away 8 holds arms off the body" if any(_ARM.search(each["bone"]) for each in found) else ""
    return (
        f"Limbs have gone through the cloth from frame {first} on; bones that cross it, with the number of frames of "
        f"{frames}: {told}{more}{arms}."
    )
