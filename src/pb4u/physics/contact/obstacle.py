"""The bodies as surfaces that cloth does not pass through: what moves and contact pairs know of them over a step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.crossing_search import CrossingSearch
from pb4u.collision.jit import as_float64, compiled
from pb4u.collision.lengths import length
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import vertex_areas
from pb4u.physics.contact.contact_set import MOTION_REACH, ContactPlanes, nearest_planes
from pb4u.scene.colliders import ColliderFrame, ColliderPose
from pb4u.scene.packed import PackedGarments

_SPARE = 1e-3
"""Dip [m] of the cloth between vertices that leaves it clear of the body: they come to rest at nearly twice as much."""

_MOST = 4e-3
"""Most [m] that a vertex is raised for the cloth beside it."""

_STRETCHED = 1.5
"""Length over the length at rest up to which the way between the places beneath an edge's ends is one over the skin."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The bodies moving during a step; their vertices are numbered after those of the cloth.

    Args:
        tree: search among cloth and bodies.
        areas: (body vertices,) [m^2].
        before: (body vertices, 3) [m] at the start of the step.
        after: (body vertices, 3) [m] where they end.
        passed: (vertices + body vertices,) bool, elements whose contact is ignored because the body has already passed
            through the cloth, or leaves it no room.
    """

    tree: SurfaceTree
    areas: np.ndarray
    before: np.ndarray
    after: np.ndarray
    passed: np.ndarray

    @staticmethod
    def over(garments: PackedGarments, bodies: ColliderFrame | None, x: Tensor) -> Obstacle | None:
        """The bodies moving during a step, ignoring contacts already violated at its start; None without a body.

        Args:
            garments: static quantities.
            bodies: around the step.
            x: (vertices, 3) [m] at its start.
        """
        start = None if bodies is None else Obstacle.at(garments, bodies.now, x)
        return None if start is None or bodies is None else replace(start, after=bodies.following.touched)

    @staticmethod
    def at(garments: PackedGarments, pose: ColliderPose, x: Tensor) -> Obstacle | None:
        """The bodies at rest, ignoring contacts already violated; None if no part of them may be touched.

        Args:
            garments: static quantities.
            pose: of the bodies.
            x: (vertices, 3) [m].
        """
        if all(surface is None for surface in pose.colliders.surfaces):
            return None
        tree, areas = _surface(garments, pose)
        body = pose.touched
        known = pose.passed.get(garments.whole)
        if known is not None and torch.equal(known[0], x):
            return Obstacle(tree, areas, body, body, known[1])
        return Obstacle(tree, areas, body, body, _noted(garments, pose, x, tree, body))

    def reached(self, garments: PackedGarments, pose: ColliderPose, x: Tensor) -> None:
        """Note at the pose through what of the cloth, moved there past them, the bodies are: less than they may be.

        Args:
            garments: static quantities.
            pose: of the bodies where they end.
            x: (vertices, 3) [m].
        """
        if self.passed.any():
            _noted(garments, pose, x, self.tree, self.after, self.passed)
        else:
            pose.passed[garments.whole] = x, self.passed

    @property
    def moves(self) -> np.ndarray:
        """Displacements (body vertices, 3) [m]."""
        return self.after - self.before

    def standing(self, passed: np.ndarray) -> Obstacle:
        """The bodies at the end of the step, ignoring contacts with `passed` (vertices + body vertices,).

        Args:
            passed: (vertices + body vertices,) bool.
        """
        return replace(self, before=self.after, passed=passed)


def _noted(
    garments: PackedGarments,
    pose: ColliderPose,
    x: Tensor,
    tree: SurfaceTree,
    body: np.ndarray,
    among: np.ndarray | None = None,
) -> np.ndarray:
    """Vertices (vertices + body vertices,) of the cloth at `x` that bodies are through; kept at the pose."""
    passed = CrossingSearch(tree).crossed(np.concatenate([as_float64(x), body]), among)
    planes = nearest_planes(pose, garments, x, within=MOTION_REACH)
    inside = (planes.touchable & (planes.distance < 0.0)).numpy()
    passed[: len(x)] |= inside if among is None else inside & among[: len(x)]
    pose.passed[garments.whole] = x, passed
    return passed


def sags(garments: PackedGarments, planes: ContactPlanes) -> Tensor:
    """Additional heights (vertices,) [m] over the body, so that the cloth between vertices clears it.

    A chord of length L between two points of a round body whose normals differ by an angle t dips by L t / 8 below it,
    the middle of a face by L t / 6.

    Args:
        garments: static quantities.
        planes: of the bodies at the step's start.
    """
    near = planes.touchable & (planes.distance < MOTION_REACH)
    points, normals = as_float64(planes.points), as_float64(planes.normals)
    longest = _STRETCHED * as_float64(garments.edge_lengths)
    heights = _edge_sags(points, normals, near.numpy(), garments.edges.numpy(), longest)
    return torch.from_numpy(heights).to(planes.distance)


@compiled
def _edge_sags(
    points: np.ndarray, normals: np.ndarray, near: np.ndarray, edges: np.ndarray, longest: np.ndarray
) -> np.ndarray:
    """Heights (vertices,) [m] of `sags`, from what is nearest to each vertex.

    Points (vertices, 3) [m], normals (vertices, 3) and whether it is `near` (vertices,); chords over the `edges`
    (edges, 2) are up to `longest` (edges,) [m].
    """
    heights = np.zeros(len(points))
    for edge in range(len(edges)):
        a, b = edges[edge, 0], edges[edge, 1]
        if not (near[a] and near[b]):
            continue
        x, y, z = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        bend = (normals[b, 0] - normals[a, 0]) * x + (normals[b, 1] - normals[a, 1]) * y
        bend += (normals[b, 2] - normals[a, 2]) * z
        if length(x, y, z) < longest[edge]:
            dip = min(max(bend / 6.0 - _SPARE, 0.0), _MOST)
            heights[a], heights[b] = max(heights[a], dip), max(heights[b], dip)
    return heights


def _surface(garments: PackedGarments, pose: ColliderPose) -> tuple[SurfaceTree, np.ndarray]:
    """Search among garments and bodies, and areas (body vertices,) [m^2]; made once, from the first pose."""
    colliders, garments = pose.colliders, garments.whole
    if (known := colliders.trees.get(garments)) is not None:
        return known
    vertices, faces = colliders.touched
    body, first = pose.touched, garments.vertex_count
    rest, own, edges, part = (
        values.cpu().numpy()
        for values in (garments.rest_positions, garments.faces, garments.edges, garments.vertex_garment)
    )
    # All that is of one world lies together.
    worlds = colliders.vertex_world.cpu().numpy()[vertices]
    _, bodies = np.unique(worlds, return_inverse=True)
    sides = Topology(faces, len(vertices)).edges
    tree = SurfaceTree(
        np.concatenate([rest.astype(np.float64), body]),
        np.concatenate([own, faces + first]),
        np.concatenate([edges, sides + first]),
        np.concatenate([part, bodies + garments.garment_count]),
        [*garments.worlds, *np.unique(worlds).tolist()],
        len(body),
    )
    colliders.trees[garments] = made = tree, vertex_areas(body, faces)
    return made
