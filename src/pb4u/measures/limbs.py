"""Limbs that have gone through cloth: bones that cross its faces, and skin that comes out of it.

A sleeve or a trouser leg is around its bone, and a hem or a collar lets it through an opening: a bone that crosses a
face is through. Where it is outside of its own skin, as that of a shoulder is by some millimetres under a raised arm,
what it crosses says nothing. Skin is through where some square centimetres of a limb lie over cloth that they cross,
and not where the body is inside itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch

from pb4u.body.body_model import PosedBody
from pb4u.body.joint_names import ARM, plain_name, plain_names
from pb4u.body.limb_bones import limb_bones
from pb4u.collision.crossings import crossings, segments_through_faces
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.garment.coarseness import Coarseness
from pb4u.garment.fit import RestBody
from pb4u.geometry.triangle_mesh import area_weighted_normals, face_areas, vertex_areas
from pb4u.measures.overlaps import overlapping_faces
from pb4u.physics.contact.skin_cover import SkinCover
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory, TrajectoryHeader

_BARE, _OUT = 1e-3, 3e-3
"""Skin [m^2] of a limb that lies so far [m] over cloth which it crosses from which on it has come through: 3 cm
square. Cloth that sags between its vertices lies less deep."""

_IN_TWO = 1.5
"""Winding number from which on a point is inside two parts of a body."""

_SPANNED = math.radians(22.0)
"""Angle round a limb that an edge spans where cloth holds it, bent or stretched: sixteen edges. At seven to twelve,
elbows and knees come through sleeves and tights that are worn without fault at rest."""

_MOST_FINER = 8.0
"""Times as many triangles that are named at most: a loose skirt needs fewer than go round it."""


@dataclass(frozen=True, eq=False)
class Bones:
    """Bones that cloth must stay around, over time, without those of hands or fingers left out of contact.

    Args:
        names: name of each bone.
        ends: (frames, bones, 2, 3) its joint and the next [m].
        skin: (body vertices,) int64 the bone that moves each most; -1 if it is another bone.
        scene: the scene with these bodies, if known.
    """

    names: tuple[str, ...]
    ends: np.ndarray
    skin: np.ndarray
    scene: Scene | None = None

    @staticmethod
    def of(scene: Scene, frames: int, fps: float) -> Bones:
        """The bones of a scene's bodies at the frames that are written; none of a body without a skeleton.

        Args:
            scene: the simulated one.
            frames: number of frames.
            fps: their rate [1/s].
        """
        at = scene.lead_in + np.arange(frames) * (scene.fps / fps)
        names: list[str] = []
        ends, skin = [np.zeros((frames, 0, 2, 3))], [np.zeros(0, dtype=np.int64)]
        for body in scene.colliders:
            if not isinstance(body, PosedBody):
                skin.append(np.full(len(body.contact), -1))
                continue
            bones, segments, nearest = limb_bones(body.body)
            joints = body.joints
            now = np.minimum(at.astype(int), len(joints) - 1)
            share = (at - now)[:, None, None]
            between = (1.0 - share) * joints[now] + share * joints[np.minimum(now + 1, len(joints) - 1)]
            skin.append(np.where(nearest < 0, -1, nearest + len(names)))
            names += bones
            ends.append(between[:, segments])
        return Bones(tuple(names), np.concatenate(ends, axis=1), np.concatenate(skin), scene)

    @cached_property
    def asked_at_rest(self) -> dict[str, int]:
        """Name of a garment -> recommended triangles, for garments that are coarse for a body at rest."""
        triangles: dict[str, int] = {}
        if self.scene is None:
            return triangles
        bodies = [RestBody.of(collider.body) for collider in self.scene.colliders if isinstance(collider, PosedBody)]
        for garment in (dressed.garment for dressed in self.scene.garments):
            for body in bodies:
                coarse = Coarseness.of(garment.vertices, garment.faces, body)
                if coarse.is_few:
                    triangles[garment.name] = max(coarse.enough, triangles.get(garment.name, 0))
        return triangles


class LimbWatch:
    """Finds limbs that have come through cloth, frame by frame.

    Args:
        bones: of the bodies.
        header: of the trajectory.

    Attributes:
        needs: name of each bone found -> the garment that it passes through, and the number of triangles that would
            prevent this; None if the garment already has as many.
    """

    def __init__(self, bones: Bones, header: TrajectoryHeader) -> None:
        self.bones, self.header = bones, header
        self.needs: dict[str, tuple[str, int | None]] = {}
        self._faces = np.array(header.body_faces)
        self._touched = self._faces[np.array(header.body_contact)[self._faces].all(axis=1)]

    @cached_property
    def _vertices(self) -> np.ndarray:
        return np.unique(self._touched)

    @cached_property
    def _skin(self) -> TriangleSurface:
        return TriangleSurface(self._faces, len(self.bones.skin))

    def through(self, t: int, cloth: np.ndarray, body: np.ndarray) -> np.ndarray:
        """Which bones (bones,) bool are through cloth.

        Args:
            t: number of the frame.
            cloth: (vertices, 3) of all garments [m].
            body: (body vertices, 3) [m].
        """
        import igl

        is_through = np.zeros(len(self.bones.names), dtype=bool)
        cloth, body = np.asarray(cloth, dtype=np.float64), np.array(body, dtype=np.float64)
        if not self.bones.names or not len(self._touched) or not np.isfinite(cloth).all():
            return is_through
        faces, ends = self.header.faces, self.bones.ends[t]
        pairs, places = segments_through_faces(ends[:, 0], ends[:, 1], cloth, faces)
        if len(pairs):
            skin = self._skin.at(torch.from_numpy(body))
            inside = skin.nearest(torch.from_numpy(places)).signed_distance.numpy() < 0.0
            # Between two parts that are in each other, cloth is in both.
            pairs = pairs[inside][igl.winding_number(body, self._faces, places[inside]) < _IN_TWO]
            is_through[pairs[:, 0]] = True
        crossing = crossings(cloth, faces, body, self._touched)
        if len(crossing):
            limb = self.bones.skin[self._touched[crossing[:, 1], 0]]
            bare = self._bare(cloth, body, np.unique(limb[limb >= 0]))
            is_through |= bare
            pairs = np.concatenate([pairs, np.column_stack([limb, crossing[:, 0]])[bare[limb] & (limb >= 0)]])
        for bone in np.flatnonzero(is_through).tolist():
            if self.bones.names[bone] not in self.needs:
                self.needs[self.bones.names[bone]] = self._needed(bone, ends, body, pairs[pairs[:, 0] == bone, 1])
        return is_through

    def _bare(self, cloth: np.ndarray, body: np.ndarray, limbs: np.ndarray) -> np.ndarray:
        """Which bones (bones,) bool, of some `limbs`, have skin over the cloth."""
        bones = len(self.bones.names)
        vertices = self._vertices[np.isin(self.bones.skin[self._vertices], limbs)]
        normals = area_weighted_normals(body, self._touched)[vertices]
        cover = SkinCover.at(body[vertices], normals, TriangleSurface(self.header.faces, len(cloth)).at(cloth))
        areas, shown = vertex_areas(body, self._touched), vertices[cover.shown & (cover.heights < -_OUT)]
        over = np.bincount(self.bones.skin[shown], areas[shown], bones) > _BARE
        if not over.any():
            return over
        pinched = np.zeros(len(body), dtype=bool)
        pinched[self._faces[overlapping_faces(body, self._faces)]] = True
        shown = shown[~pinched[shown]]
        return np.bincount(self.bones.skin[shown], areas[shown], bones) > _BARE

    def _needed(self, bone: int, ends: np.ndarray, body: np.ndarray, faces: np.ndarray) -> tuple[str, int | None]:
        """Garment that a limb came through, and triangles at which its edges are short enough to go round the limb."""
        start, way = ends[bone, 0], ends[bone, 1] - ends[bone, 0]
        # Bones that begin at one joint share its skin, which counts as that of the first.
        first = (ends[:, 0] == start).all(axis=1).argmax()
        offsets = body[self.bones.skin == first] - start
        along = np.clip(offsets @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        radius = float(np.quantile(np.linalg.norm(offsets - along[:, None] * way, axis=1), 0.25))
        # An equilateral triangle of the same area has edges of this length.
        rest = np.asarray(self.header.rest_positions, dtype=np.float64)
        area = float(face_areas(rest, self.header.faces[faces]).mean())
        edge, holds = math.sqrt(4.0 * area / math.sqrt(3.0)), 2.0 * radius * math.sin(0.5 * _SPANNED)
        garment = next(g for g in self.header.garments if g["triangles"][0] <= faces[0] < g["triangles"][1])
        count = garment["triangles"][1] - garment["triangles"][0]
        enough = 100 * math.ceil(count * min((edge / holds) ** 2, _MOST_FINER) / 100)
        enough = max(enough, self.bones.asked_at_rest.get(garment["name"], 0))
        return garment["name"], enough if enough > count else None

    def sentences(self, bones: Sequence[str], frame: int, counts: dict[str, int]) -> list[str]:
        """Warnings of limbs that have newly passed through cloth, one a garment; none for skinning, which has no
        physics.

        Args:
            bones: their names, of `needs`.
            frame: number of the frame.
            counts: name of a garment -> triangles recommended before; new recommendations are added.
        """
        if not has_physics(self.header):
            return []
        sentences, contact = list[str](), self.header.metadata.get("contact", True)
        for garment in dict.fromkeys(self.needs[bone][0] for bone in bones):
            group = [bone for bone in bones if self.needs[bone][0] == garment]
            advice = (
                self._advice(group, garment, counts)
                if contact
                else "nothing keeps it off the body: leave out --contact off"
            )
            verb = "are" if len({plain_name(bone) for bone in group}) > 1 else "is"
            through = f"Frame {frame}: {plain_names(group)} {verb} through the {garment}"
            sentences.append(f"{through}{': ' if advice else ''}{advice}.")
        return sentences

    def _advice(self, bones: Sequence[str], garment: str, counts: dict[str, int]) -> str:
        """What would hold limbs inside a garment; nothing where that was said."""
        enough = max(self.needs[bone][1] or 0 for bone in bones)
        arms = " or --arms-away 8" if any(map(ARM.search, bones)) else ""
        if garment in counts and enough <= counts[garment]:
            return ""
        counts[garment] = enough
        if enough:
            return f"try {_triangles_flag({garment: enough}, len(self.header.garments))}{arms}"
        is_solver = self.header.metadata.get("model") == "solver"
        way = "a slower motion or more --fps" if is_solver else "--model solver"
        return f"its triangles are small enough, so try {way}{arms}"


def has_physics(header: TrajectoryHeader) -> bool:
    """Whether a solver or a network moved the cloth, not only skinning.

    Args:
        header: of the trajectory.
    """
    return bool(header.metadata.get("model") != "skinning")


def _triangles_flag(enough: Mapping[str, int], garments: int) -> str:
    """The flags that ask for triangles of garments by name; the only one of a scene needs no name."""
    return " ".join(f"--triangles {f'{name}=' if garments > 1 else ''}{count}" for name, count in enough.items())


def watched(bones: Bones, trajectory: Trajectory) -> tuple[np.ndarray, LimbWatch]:
    """Which bones (frames, bones) bool are through cloth, and the triangle counts that would prevent it.

    Args:
        bones: at the frames of the trajectory.
        trajectory: the simulated one.
    """
    watch = LimbWatch(bones, trajectory.header)
    frames = zip(trajectory.positions, trajectory.body_positions, strict=True)
    return np.array([watch.through(t, *frame) for t, frame in enumerate(frames)], dtype=bool), watch


def limbs_through_cloth(crossed: np.ndarray, watch: LimbWatch) -> list[dict[str, Any]]:
    """Limbs that passed through cloth, the longest first: name of the `bone`, `first_frame`, number of `frames`, the
    `garment`, and the number of `triangles` that would prevent it, or None if the garment has as many.

    Args:
        crossed: (frames, bones) bool as `watched` gives it.
        watch: the watch that found them.
    """
    names = watch.bones.names
    # A joint with several children is the head of several bones of one name.
    by_name = {name: crossed[:, [k for k, other in enumerate(names) if other == name]].any(axis=1) for name in names}
    limbs = [
        {
            "bone": name,
            "first_frame": int(rows.argmax()),
            "frames": int(rows.sum()),
            **dict(zip(("garment", "triangles"), watch.needs.get(name, (None, None)), strict=True)),
        }
        for name, rows in by_name.items()
        if rows.any()
    ]
    return sorted(limbs, key=lambda limb: -limb["frames"])


def limbs_sentence(limbs: Sequence[dict[str, Any]], trajectory: Trajectory) -> str | None:
    """One sentence on limbs that passed through cloth; None for none.

    Args:
        limbs: as `limbs_through_cloth`.
        trajectory: in which they were found.
    """
    if not limbs:
        return None
    first, frames = min(limb["first_frame"] for limb in limbs), trajectory.frame_count
    longest: dict[str, int] = {}
    for limb in limbs:
        longest.setdefault(plain_name(limb["bone"]), limb["frames"])
    names = ", ".join(f"the {name} ({count})" for name, count in list(longest.items())[:4])
    more = f" and {len(longest) - 4} more" if len(longest) > 4 else ""
    through = (
        f"Limbs have passed through the cloth from frame {first} on, each with its number of frames of "
        f"{frames}: {names}{more}"
    )
    if not has_physics(trajectory.header):
        return f"{through}; skinning has no physics, --model quick-solver has."
    if not trajectory.header.metadata.get("contact", True):
        return f"{through}; nothing keeps the cloth off the body: leave out --contact off."
    enough: dict[str, int] = {}
    for limb in limbs:
        if limb["triangles"]:
            enough[limb["garment"]] = max(enough.get(limb["garment"], 0), limb["triangles"])
    flag = _triangles_flag(enough, len(trajectory.header.garments))
    finer = f"; {flag} makes the cloth fine enough for these limbs" if enough else ""
    arms = "; --arms-away 8 swings arms away from the body" if any(ARM.search(limb["bone"]) for limb in limbs) else ""
    return f"{through}{finer}{arms}."
