"""Garments laid over each other in the order they are worn, on the resting body, from where each was made."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface
from pb4u.errors import InputError
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.untangling import untangle
from pb4u.geometry.topology import joined_indices, neighbour_mean, offsets
from pb4u.geometry.triangle_mesh import area_weighted_normals

LAYER_GAP = 3e-3
"""Distance [m] between layers where they are laid: more than the 2 mm at which cloth begins to feel cloth."""

_SKIN_CLEARANCE = 4e-3
"""Distance [m] from the skin that inner cloth is laid down to: garments are cut with 7 mm where they rest on it."""
_REACH_UNDER = 0.07
"""Height [m] over an outer garment from which inner cloth is laid under it: as loose cloth stands off the body.
Of a T-shirt in a tank top it draws in the cloth beneath the arm; 12 cm would draw in the sleeve."""
_REACH_OVER = 0.04
"""Depth [m] beneath inner cloth from which outer cloth is brought out: what is deeper belongs elsewhere, as the inside
of a trouser leg within a wide skirt does."""
_FACETING = 6e-3
"""Height [m] of a vertex over a face of the other garment that is due to the faces being flat: less than a third of
the edges of 2,500 triangles on a limb."""
_SMOOTHING_PASSES, _PROJECTION_PASSES = 20, 20
_BELOW_TOP = 0.15
"""How far [m] under its own upper edge a garment is held that is tucked in: straps and necklines differ by less."""
INNERMOST_MOBILITY = 0.2
"""Mobility of the innermost garment where cloth is parted; outwards it rises to 1."""


def layered(garments: Sequence[Garment], body: RestBody) -> tuple[np.ndarray, ...]:
    """Positions of garments with each one over those before it; their rest shapes do not change.

    Parts of an inner garment outside an outer one are moved towards the body, as far as there is room; outer cloth that
    is still beneath it, or closer over it than `LAYER_GAP`, is moved to its outer side. The cloth around follows
    smoothly, and remaining crossings are untangled. Cloth that cannot be untangled keeps its position.

    Args:
        garments: inner first, each in its position on the resting body; faces counter-clockwise from outside.
        body: the body that wears them.

    Returns:
        (vertices, 3) float64 [m] of each garment; of a single one its own.
    """
    places = [garment.vertices for garment in garments]
    if len(garments) < 2:
        return tuple(places)
    for outer in range(1, len(garments)):
        for inner in range(outer):
            places[inner] = _laid_under(garments[inner], places[inner], garments[outer], places[outer], body)
    for outer in range(1, len(garments)):
        places[outer] = _laid_over(garments[outer], places[outer], garments[:outer], places[:outer])
    faces, owner = joined_faces(garments)
    # Distances are the start's to widen, which knows what the pins hold in place.
    parted = untangle(np.concatenate(places), faces, mobility_of(owner, len(garments)), gap=0.0)
    return tuple(np.split(parted.vertices, offsets(places)[1:-1])) if parted.is_free else tuple(places)


def worn_order(garments: Sequence[Garment], tucked: Sequence[bool]) -> list[int]:
    """Indices of garments, inner first, with tucked garments placed beneath those worn from the waist.

    A garment is tucked into the innermost one whose upper edge lies between its own upper and lower edges, at least
    0.15 m under the upper; otherwise the given order is kept.

    Args:
        garments: in the given order, each in its position on the resting body.
        tucked: (garments,) whether each is to be tucked in.

    Raises:
        InputError: no garment has its upper edge there.
    """
    heights = [(float(g.vertices[:, 1].min()), float(g.vertices[:, 1].max())) for g in garments]
    order = list(range(len(garments)))
    for which in (k for k, is_tucked in enumerate(tucked) if is_tucked):
        low, high = heights[which]
        holders = [k for k in order if k != which and low < heights[k][1] < high - _BELOW_TOP]
        if not holders:
            raise InputError(
                f"{garments[which].name} cannot be tucked in: no other garment has its upper edge at its waist, as "
                "trousers or a skirt have."
            )
        if order.index(holders[0]) < order.index(which):
            order.remove(which)
            order.insert(order.index(holders[0]), which)
    return order


def joined_faces(garments: Sequence[Garment]) -> tuple[np.ndarray, np.ndarray]:
    """Faces (faces, 3) int64 of garments with concatenated vertices, and the garment (vertices,) of each vertex.

    Args:
        garments: in the order of their vertices.
    """
    places = [garment.vertices for garment in garments]
    owner = np.repeat(np.arange(len(garments)), [len(vertices) for vertices in places])
    return joined_indices([garment.faces for garment in garments], offsets(places)), owner


def mobility_of(vertex_garment: np.ndarray, count: int) -> np.ndarray:
    """Mobility (vertices,) of cloth during untangling: outer garments move, inner ones less.

    Args:
        vertex_garment: (vertices,) int64 index of each vertex's garment in the order they are worn, inner first.
        count: number of garments.
    """
    rise = (1.0 - INNERMOST_MOBILITY) / max(count - 1, 1)
    return 1.0 - rise * (count - 1 - vertex_garment)


def _laid_under(
    inner: Garment, places: np.ndarray, outer: Garment, outer_places: np.ndarray, body: RestBody
) -> np.ndarray:
    """Positions (vertices, 3) [m] of a garment with the parts that reach beyond another moved towards the body."""
    surface = TriangleSurface(outer.faces, len(outer_places)).at(outer_places)

    def push_at(vertices: np.ndarray) -> np.ndarray:
        near = surface.nearest(vertices)
        distance, normals = near.signed_distance.numpy() + LAYER_GAP, near.normals.numpy()
        alike = np.einsum("ij,ij->i", normals, area_weighted_normals(vertices, inner.faces)) > 0.0
        out = (distance > 1e-6) & (distance < _REACH_UNDER) & alike & ~near.beyond_border.numpy()
        push = np.zeros_like(vertices)
        chosen = np.flatnonzero(out)
        if len(chosen):
            room = np.maximum(body.signed_distances(vertices[chosen]) - _SKIN_CLEARANCE, 0.0)
            push[chosen] = -np.minimum(distance[chosen], room)[:, None] * normals[chosen]
        return push

    return _pushed(inner, places, push_at, _REACH_UNDER)


def _laid_over(
    outer: Garment, places: np.ndarray, inner: Sequence[Garment], inner_places: Sequence[np.ndarray]
) -> np.ndarray:
    """Positions (vertices, 3) [m] of a garment, what lies beneath others brought over them."""
    layers = [_Layer(garment, vertices) for garment, vertices in zip(inner, inner_places, strict=True)]

    def push_at(vertices: np.ndarray) -> np.ndarray:
        push = np.zeros_like(vertices)
        for layer in layers:
            for more in (layer.over(vertices), layer.let_under(vertices, outer)):
                larger = np.einsum("ij,ij->i", more, more) > np.einsum("ij,ij->i", push, push)
                push[larger] = more[larger]
        return push

    return _pushed(outer, places, push_at, _REACH_OVER)


def _pushed(
    garment: Garment, start: np.ndarray, push_at: Callable[[np.ndarray], np.ndarray], reach: float
) -> np.ndarray:
    """Positions (vertices, 3) [m] after displacements, which `push_at` gives at each state, in several passes.

    First the cloth around moves along, so that it does not crease; then what this undid is pushed alone.
    """
    spread, vertices = neighbour_mean(garment.topology), start
    for passes in range(_SMOOTHING_PASSES + _PROJECTION_PASSES):
        push = push_at(vertices)
        if not (np.abs(push) > 1e-6).any():
            break
        displacement = vertices + push - start
        if passes < _SMOOTHING_PASSES:
            displacement = 0.5 * (displacement + spread @ displacement)
        far = np.linalg.norm(displacement, axis=1, keepdims=True)
        vertices = start + displacement * np.minimum(1.0, reach / np.maximum(far, 1e-12))
    return vertices


class _Layer:
    """An inner garment where it lies."""

    def __init__(self, garment: Garment, vertices: np.ndarray) -> None:
        self.vertices = vertices
        self.normals = area_weighted_normals(vertices, garment.faces)
        self.surface = TriangleSurface(garment.faces, len(vertices)).at(vertices)

    def over(self, outer: np.ndarray) -> np.ndarray:
        """Displacements (outer vertices, 3) [m] of cloth at `outer` to at least `LAYER_GAP` over this layer."""
        near = self.surface.nearest(outer)
        distance = near.signed_distance.numpy()
        near_enough = (distance < LAYER_GAP - 1e-6) & (distance > -_REACH_OVER) & ~near.beyond_border.numpy()
        return np.where(near_enough, LAYER_GAP - distance, 0.0)[:, None] * near.normals.numpy()

    def let_under(self, outer: np.ndarray, garment: Garment) -> np.ndarray:
        """Displacements (outer vertices, 3) [m] of faces of `garment`, at `outer`, that vertices here stick out of."""
        surface: PosedSurface = TriangleSurface(garment.faces, len(outer)).at(outer)
        near = surface.nearest(self.vertices)
        distance, normals = near.signed_distance.numpy(), near.normals.numpy()
        # The sleeve of the outer garment faces the side of the inner one, and is not to be moved through it.
        alike = (np.einsum("ij,ij->i", normals, self.normals) > 0.0) & ~near.beyond_border.numpy()
        rows = np.flatnonzero((distance > 1e-6 - LAYER_GAP) & (distance < _FACETING) & alike)
        shares = near.barycentric.numpy()[rows]
        corners = garment.faces[near.triangle.numpy()[rows]].reshape(-1)
        push = ((distance[rows] + LAYER_GAP) / (shares**2).sum(axis=1))[:, None, None] * shares[:, :, None]
        push = (push * normals[rows][:, None, :]).reshape(-1, 3)
        largest = np.zeros_like(outer)
        order = np.argsort(np.einsum("ij,ij->i", push, push))  # of several, the largest is written last
        largest[corners[order]] = push[order]
        return largest
