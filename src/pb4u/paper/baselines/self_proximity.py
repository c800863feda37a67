"""Vertices of a surface close over or under its own faces, and which of them have passed through (reference 6.1, 6.2).

The tree is built once and its boxes are fitted to each frame, as that of `surface_tree`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.collision.box_tree import Boxes, BoxTree, boxes_of, still_boxes, with_room
from pb4u.collision.jit import compiled
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.paper.baselines.enclosures import CutOff, Enclosures
from pb4u.paper.baselines.intersection_contours import ContourFinder

_ROUNDING = 1e-9
"""What boxes are wider by [m], so that rounding leaves nothing out."""

_MOST = 40_000_000
"""Faces looked at for all vertices beyond which cloth has collapsed; so many pairs (24 bytes) would fill the memory."""

_DEEPEST = 128
"""Entries of the stack of a search: a median split halves, so that 2^60 faces would not fill it."""


@dataclass(frozen=True, eq=False)
class FacingPairs:
    """Vertices whose projection lies in a face that does not have them as a corner.

    Args:
        vertices: (pairs,) int64.
        faces: (pairs,) int64.
        heights: (pairs,) over the face's plane [m], positive outside.
        passed: (pairs,) bool, whether the vertex has passed through the face.
    """

    vertices: np.ndarray
    faces: np.ndarray
    heights: np.ndarray
    passed: np.ndarray


def facing_pairs(vertices: np.ndarray, tree: SurfaceTree, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex, face and height [m], (pairs,) each, of all pairs whose projection is in the face; by vertex, then by
    face.

    Faces that have the vertex as a corner are left out, and so are faces of another world or with positions that are
    not finite. The result is empty if some 40 million pairs would have to be tested: such a cloth has collapsed.

    Args:
        vertices: (vertices, 3) [m].
        tree: of the surface.
        radius: largest height on either side [m].
    """
    points, own_boxes = still_boxes(vertices, tree.faces, 0.0)
    forms = _forms(points, tree.faces)
    # What stands over a face is in its prism, which along the face is no wider than the face.
    offsets = radius * np.nan_to_num(forms[:, None, :3])
    corners = points[tree.faces]
    ends = np.concatenate([corners - offsets, corners + offsets], axis=1).reshape(-1, 3)
    prisms = boxes_of(ends, np.zeros_like(ends), np.arange(len(ends)).reshape(-1, 6), _ROUNDING)
    lost = own_boxes[:, 0] > own_boxes[:, 3]
    prisms[lost] = own_boxes[lost]
    world = np.where(np.isfinite(vertices).all(axis=1), tree.vertex_world, -1)
    face_world = tree.vertex_world[tree.faces[:, 0]]
    elements, boxes = (points, world, face_world, tree.faces, forms), tree.boxes.fitted(prisms)
    pairs, heights = _facing(elements, boxes, tree.boxes, radius, _MOST)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return pairs[order, 0], pairs[order, 1], heights[order, 0]


def nearest_corners(
    positions: np.ndarray, faces: np.ndarray, pair_vertices: np.ndarray, pair_faces: np.ndarray
) -> np.ndarray:
    """Corner (pairs,) int64 of the face of each pair that is nearest to its vertex.

    Args:
        positions: (vertices, 3) [m].
        faces: (faces, 3) int64.
        pair_vertices: (pairs,) int64.
        pair_faces: (pairs,) int64.
    """
    corners = faces[pair_faces]
    away = np.linalg.norm(positions[corners] - positions[pair_vertices][:, None], axis=2)
    return np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]


class SelfProximity:
    """Finds parts of a surface that are close to each other; data that depend only on its faces are prepared once.

    Args:
        tree: of the surface.
        cut_off: rule for parts that have passed through.
    """

    def __init__(self, tree: SurfaceTree, cut_off: CutOff) -> None:
        self.tree = tree
        self.contours = ContourFinder(tree)
        self._cut_off = cut_off

    def find(self, vertices: np.ndarray, radius: float) -> FacingPairs:
        """The pairs that are close at one instant; for a vertex that has passed through a surface, the pairs with that
        surface.

        Args:
            vertices: (vertices, 3) [m].
            radius: largest height on either side of a face [m].
        """
        vertex, face, height = facing_pairs(vertices, self.tree, radius)
        free, passed = self.enclosures(vertices).told(vertex, face)
        return FacingPairs(vertex[free], face[free], height[free], passed[free])

    def enclosures(self, vertices: np.ndarray) -> Enclosures:
        """Vertices that have passed through the cloth, at positions `vertices` (vertices, 3) [m].

        Args:
            vertices: (vertices, 3) [m].
        """
        return self._cut_off(self.contours.find(vertices), self.contours.topology)


@compiled
def _forms(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Affine forms (faces, 12) of faces: four numbers r each, with the value r[:3] . x + r[3] at a point x.

    Height over the plane [m]; barycentric coordinates of the foot with respect to corner 1 and corner 2. Not numbers,
    so that no foot lies in it, of a face without area.
    """
    forms = np.empty((len(faces), 12))
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        double = nx * nx + ny * ny + nz * nz
        length = np.sqrt(double)
        form = forms[f]
        form[0], form[1], form[2] = nx / length, ny / length, nz / length
        form[4], form[5] = (vy * nz - vz * ny) / double, (vz * nx - vx * nz) / double
        form[6] = (vx * ny - vy * nx) / double
        form[8], form[9] = (ny * uz - nz * uy) / double, (nz * ux - nx * uz) / double
        form[10] = (nx * uy - ny * ux) / double
        for k in range(0, 12, 4):
            form[k + 3] = -(form[k] * a[0] + form[k + 1] * a[1] + form[k + 2] * a[2])
    return forms


@compiled
def _facing(elements: tuple, boxes: Boxes, tree: BoxTree, radius: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertex and face (pairs, 2), and height (pairs, 1) [m], of all pairs whose foot is in the face.

    Each vertex is searched among the faces of its world, those of world -1 not at all. Nothing is found where over
    `most` faces have to be looked at.
    """
    points, world, face_world, faces, forms = elements
    node_boxes, prisms = boxes
    order, children, ranges, roots = tree
    pairs, heights = np.empty((1024, 2), dtype=np.int64), np.empty((1024, 1))
    stack = np.empty(_DEEPEST, dtype=np.int64)
    count, looked = 0, 0
    for root in roots:
        own = face_world[order[ranges[root, 0]]]
        for v in range(len(points)):
            if world[v] != own:
                continue
            x, y, z = points[v]
            stack[0] = root
            depth = 1
            while depth > 0:
                depth -= 1
                node = stack[depth]
                if not _holds(node_boxes[node], x, y, z):
                    continue
                if children[node, 0] >= 0:
                    stack[depth], stack[depth + 1] = children[node, 0], children[node, 1]
                    depth += 2
                    continue
                for place in range(ranges[node, 0], ranges[node, 1]):
                    f = order[place]
                    looked += 1
                    if not _holds(prisms[f], x, y, z) or v == faces[f, 0] or v == faces[f, 1] or v == faces[f, 2]:
                        continue
                    second, third = _value(forms[f, 4:8], x, y, z), _value(forms[f, 8:12], x, y, z)
                    height = _value(forms[f, 0:4], x, y, z)
                    if second >= 0.0 and third >= 0.0 and second + third <= 1.0 and abs(height) <= radius:
                        pairs, heights = with_room(pairs, count), with_room(heights, count)
                        pairs[count, 0], pairs[count, 1], heights[count, 0] = v, f, height
                        count += 1
            if looked > most:
                return pairs[:0], heights[:0]
    return pairs[:count], heights[:count]


@compiled
def _holds(box: np.ndarray, x: float, y: float, z: float) -> bool:
    """Whether a point is in a box (12,) that does not move."""
    return box[0] <= x <= box[3] and box[1] <= y <= box[4] and box[2] <= z <= box[5]


@compiled
def _value(form: np.ndarray, x: float, y: float, z: float) -> float:
    """Value of an affine form (4,) at a point."""
    return form[3] + form[0] * x + form[1] * y + form[2] * z
