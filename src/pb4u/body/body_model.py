"""The stages of a skinned body: model -> shaped -> posed -> mesh."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.skeleton import PoseSequence, Skeleton, joint_positions
from pb4u.body.skinning import SkinnedSurface, SkinningWeights, bone_transforms
from pb4u.errors import InputError

Kept = TypeVar("Kept")


def complete_parameters(
    body: str, ranges: Mapping[str, tuple[float, float, float]], values: Mapping[str, float]
) -> dict[str, float]:
    """Value of every shape parameter by name, in the order of `ranges`.

    Args:
        body: name of the body, for messages.
        ranges: name -> (lowest, default, highest).
        values: the parameters that differ from the default.

    Raises:
        InputError: a name is unknown or a value out of range.
    """
    offered = ", ".join(f"{key} ({low:g} to {high:g})" for key, (low, _, high) in list(ranges.items())[:12])
    for key, value in values.items():
        if key not in ranges:
            offers = f"its shape parameters are {offered}" if offered else "it has no shape parameters"
            raise InputError(f'The body "{body}" has no shape parameter "{key}": {offers}.')
        low, _, high = ranges[key]
        if not low <= value <= high:
            raise InputError(f'Shape parameter "{key}" of body "{body}" is {value:g}; give {low:g} to {high:g}.')
    return {key: float(values.get(key, default)) for key, (_, default, _) in ranges.items()}


_FARTHEST = 1e4
"""Distance [m] from the origin in which a body at rest lies; one beyond comes of damaged numbers."""


class BodyModel(ABC):
    """A body model; `shaped` gives the body of some shape parameters.

    Attributes:
        name: as given by the user.
        family: which bone names it has: "anny", "smpl", "smplh" or "smplx".
        faces: (faces, 3) int64, counter-clockwise seen from outside.
        bone_names: names of the bones, parents before children.
        bone_parents: (bones,) int64, -1 for the root.
        weights: skinning weights of the vertices.
        contact: (vertices,) bool, see `ShapedBody`.
        pose_offsets: see `ShapedBody`.
    """

    name: str
    family: str
    faces: np.ndarray
    bone_names: tuple[str, ...]
    bone_parents: np.ndarray
    weights: SkinningWeights
    contact: np.ndarray
    pose_offsets: np.ndarray | None = None

    @property
    @abstractmethod
    def shape_parameters(self) -> Mapping[str, tuple[float, float, float]]:
        """Name -> (lowest, default, highest) of each shape parameter."""

    @abstractmethod
    def rest(self, parameters: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """The body at rest in the world's axes, at the height that the model gives it.

        Args:
            parameters: every shape parameter by name.

        Returns:
            Vertices (vertices, 3) and joints (bones, 3), float64 [m].
        """

    def shaped(self, **parameters: float) -> ShapedBody:
        """The body of some shape parameters, standing on the ground.

        Args:
            **parameters: shape parameters by name; the others have their default.

        Raises:
            InputError: a name is unknown or a value out of range.
        """
        self._refuse_metres(parameters)
        complete = complete_parameters(self.name, self.shape_parameters, parameters)
        vertices, joints = self.rest(complete)
        if not all((np.abs(places) <= _FARTHEST).all() for places in (vertices, joints)):
            raise InputError(f"{self.name}: the body has vertices or joints over {_FARTHEST:g} m away; load it again.")
        lift = np.array([0.0, -vertices[:, 1].min(), 0.0])
        return ShapedBody(
            name=self.name,
            family=self.family,
            vertices=vertices + lift,
            faces=self.faces,
            skeleton=Skeleton(self.bone_names, self.bone_parents, joints + lift),
            weights=self.weights,
            contact=self.contact,
            shape=complete,
            own_shape={name: v for name, v in complete.items() if v != self.shape_parameters[name][1]},
            pose_offsets=self.pose_offsets,
            lift=float(lift[1]),
        )

    def _refuse_metres(self, values: Mapping[str, float]) -> None:
        """Refuse a height in metres or centimetres where it is a share, and say which share that is."""
        shares, height = self.shape_parameters.get("height"), values.get("height", 0.0)
        metres = 0.01 * height if height > 100.0 else height
        if shares is None or metres <= shares[2] or metres > 3.0:
            return
        heights = [self.shaped(**{**values, "height": share}).height for share in shares]
        remedy = f"it is {heights[0]:.2f} to {heights[-1]:.2f} m tall"
        if heights[0] <= metres <= heights[-1]:
            remedy = f"{metres:.2f} m is height={np.interp(metres, heights, shares):.2f}"
        raise InputError(
            f'Shape parameter "height" of body "{self.name}" is a number from 0 to 1, not a length; {remedy}.'
        )


@dataclass(frozen=True, eq=False)
class ShapedBody:
    """One body at rest, in the pose that garments are fitted to: feet on y = 0, facing +Z.

    That pose is the A-pose of Anny and the T-pose of the SMPL family.

    Args:
        name: as given by the user.
        family: which bone names it has: "anny", "smpl", "smplh" or "smplx".
        vertices: (vertices, 3) float64 rest positions [m].
        faces: (faces, 3) int64.
        skeleton: bones at rest.
        weights: skinning weights of the vertices.
        contact: (vertices,) bool, False for hands or fingers and skin inside other skin at rest.
        shape: the shape parameters it was made with.
        pose_offsets: optional (vertices, 3, pose features) correctives added before skinning, driven by the local
            rotation matrices minus identity of all bones but the root (SMPL family).
        lift: height [m] by which the model's own origin was raised so that the feet stand on y = 0.
        own_shape: the shape parameters that are not at their default.
    """

    name: str
    family: str
    vertices: np.ndarray
    faces: np.ndarray
    skeleton: Skeleton
    weights: SkinningWeights
    contact: np.ndarray
    shape: Mapping[str, float] = field(default_factory=dict)
    pose_offsets: np.ndarray | None = None
    lift: float = 0.0
    own_shape: Mapping[str, float] = field(default_factory=dict)
    _kept: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def kept(self, name: str, make: Callable[[ShapedBody], Kept]) -> Kept:
        """Result of `make` on this body, computed once and cached with the body.

        Args:
            name: of the result in the cache.
            make: called with the body.
        """
        if name not in self._kept:
            self._kept[name] = make(self)
        return cast(Kept, self._kept[name])

    def posed(self, poses: PoseSequence) -> PosedBody:
        """The body moving through `poses`.

        Args:
            poses: world rotations and root positions, frame by frame.
        """
        return _PosedSkeleton(self, poses)

    def with_contact(self, contact: np.ndarray) -> ShapedBody:
        """The same body with other vertices left out of contact: `contact` (vertices,) bool is False there.

        Args:
            contact: (vertices,) bool, False where a vertex is left out of contact.
        """
        return replace(self, contact=contact)

    @property
    def height(self) -> float:
        """Height at rest [m]."""
        return float(np.ptp(self.vertices[:, 1]))


class PosedBody(AnimatedBody):
    """A shaped body moved by its bones; vertices are computed on demand.

    Args:
        body: the body at rest.
        fps: frames per second.
    """

    def __init__(self, body: ShapedBody, fps: float) -> None:
        self.body = body
        self.faces = body.faces
        self.contact = body.contact
        self.rest_vertices = body.vertices
        self.fps = fps
        self.name = body.name
        self._worn: tuple[np.ndarray, SkinningWeights, SkinnedSurface] | None = None

    @property
    @abstractmethod
    def transforms(self) -> Tensor:
        """Transforms (frames, bones, 3, 4) float32 of the bones from rest to world; their last column is in [m]."""

    @property
    @abstractmethod
    def joints(self) -> np.ndarray:
        """Positions (frames, bones, 3) of the joints [m]."""

    def skin(self, rest_vertices: np.ndarray, weights: SkinningWeights, start: int, stop: int) -> Tensor:
        """Any other surface moved by the bones of this body.

        Args:
            rest_vertices: (vertices, 3) its positions on the body at rest [m].
            weights: the bones of each vertex.
            start: first frame.
            stop: frame after the last.

        Returns:
            (stop - start, vertices, 3) float32 [m].
        """
        if self._worn is None or self._worn[0] is not rest_vertices or self._worn[1] is not weights:
            surface = SkinnedSurface(rest_vertices, weights, self.body.skeleton.bone_count)
            self._worn = (rest_vertices, weights, surface)
        return self._worn[2].positions(self.transforms[start:stop])

    @cached_property
    def _surface(self) -> SkinnedSurface:
        return SkinnedSurface(self.body.vertices, self.body.weights, self.body.skeleton.bone_count)

    def corrected(self, surface: SkinnedSurface, pose_offsets: np.ndarray, start: int, stop: int) -> Tensor:
        """A surface moved by the bones of this body, with pose-dependent corrections of its rest shape.

        Args:
            surface: skinned to the bones.
            pose_offsets: (vertices, 3, pose features) [m], see `ShapedBody`.
            start: first frame.
            stop: frame after the last.

        Returns:
            (stop - start, vertices, 3) float32 [m].
        """
        # Some frames at a time, to bound memory.
        flat = pose_offsets.reshape(-1, pose_offsets.shape[-1]).astype(np.float32, copy=False)
        directions = torch.from_numpy(flat).T
        parents = torch.from_numpy(self.body.skeleton.parents[1:])
        result = surface.positions(self.transforms[start:stop])
        for first in range(0, len(result), SkinnedSurface.CHUNK):
            transforms = self.transforms[start:stop][first : first + SkinnedSurface.CHUNK]
            rotations = transforms[..., :3]
            local = rotations[:, parents].transpose(-1, -2) @ rotations[:, 1:]
            features = (local - torch.eye(3)).flatten(1)
            offsets = (features @ directions).view(len(transforms), -1, 3)
            result[first : first + SkinnedSurface.CHUNK] += surface.turned(offsets, transforms)
        return result


class _PosedSkeleton(PosedBody):
    """A shaped body moving through a pose sequence.

    Args:
        body: the body at rest.
        poses: its poses over time.
    """

    def __init__(self, body: ShapedBody, poses: PoseSequence) -> None:
        super().__init__(body, poses.fps)
        self.poses = poses

    @property
    def frame_count(self) -> int:
        return len(self.poses)

    @cached_property
    def transforms(self) -> Tensor:
        return bone_transforms(self.body.skeleton, self.poses)

    @cached_property
    def joints(self) -> np.ndarray:
        return joint_positions(self.body.skeleton, self.poses)

    def positions(self, start: int, stop: int) -> Tensor:
        if self.body.pose_offsets is not None:
            return self.corrected(self._surface, self.body.pose_offsets, start, stop)
        return self._surface.positions(self.transforms[start:stop])
