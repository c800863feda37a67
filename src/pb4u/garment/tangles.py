"""Where garments cross themselves and each other, as sentences; and a start from which nothing crosses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pb4u.collision.crossings import self_crossings
from pb4u.errors import InputError
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.layering import joined_faces, layered, mobility_of
from pb4u.garment.untangling import untangle


@dataclass(frozen=True)
class Tangle:
    """Triangles of one garment, or of two, that cross.

    Args:
        garments: names of the two, inner first; the same twice where a garment crosses itself.
        pairs: number of pairs of triangles that cross, pairs that share a vertex included.
        place: (x, y, z) of a triangle in the middle of them [m].
    """

    garments: tuple[str, str]
    pairs: int
    place: tuple[float, float, float]

    def __str__(self) -> str:
        one, other = self.garments
        who = f"{one} crosses itself" if one == other else f"{one} and {other} cross"
        where = ", ".join(f"{value:.2f}" for value in self.place)
        return f"{who} in {self.pairs} pair{'s' if self.pairs > 1 else ''} of triangles around ({where}) m"

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary for a JSON report."""
        return {"garments": list(self.garments), "pairs": self.pairs, "place": list(self.place)}


def tangles(
    names: Sequence[str], vertex_garment: np.ndarray, vertices: np.ndarray, faces: np.ndarray, pairs: np.ndarray
) -> tuple[Tangle, ...]:
    """Crossing triangles by the garments they belong to, most first.

    Args:
        names: of the garments; of those with one name, the second and later ones are numbered.
        vertex_garment: (vertices,) int64 garment of each vertex.
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        pairs: (pairs, 2) int64 faces that cross.
    """
    titles = [
        name if name not in names[:k] else f"{name} ({names[:k].count(name) + 1})" for k, name in enumerate(names)
    ]
    owners = np.sort(vertex_garment[faces[pairs, 0]], axis=1)
    centres = vertices[faces[pairs[:, 0]]].mean(axis=1)
    entangled = []
    for one, other in np.unique(owners, axis=0).tolist():
        there = centres[(owners == [one, other]).all(axis=1)]
        place = there[np.linalg.norm(there - np.median(there, axis=0), axis=1).argmin()]
        entangled.append(Tangle((titles[one], titles[other]), len(there), tuple(np.round(place, 4).tolist())))
    return tuple(sorted(entangled, key=lambda tangle: -tangle.pairs))


@dataclass(frozen=True)
class OutfitCrossings:
    """Crossings of several garments, before and after layering.

    Args:
        as_made: crossings at the positions in which the garments were made.
        as_worn: crossings left after layering.
    """

    as_made: tuple[Tangle, ...]
    as_worn: tuple[Tangle, ...]

    @staticmethod
    def of(garments: Sequence[Garment], body: RestBody) -> OutfitCrossings:
        """Crossings of `garments`, inner first, on the resting body.

        Args:
            garments: inner first.
            body: the body that wears them.
        """
        return OutfitCrossings(
            _found(garments, [garment.vertices for garment in garments]), _found(garments, layered(garments, body))
        )


def _found(garments: Sequence[Garment], places: Sequence[np.ndarray]) -> tuple[Tangle, ...]:
    vertices, faces, owner = np.concatenate(places), *joined_faces(garments)
    pairs = self_crossings(vertices.astype(np.float32), faces, sharing=True)
    return tangles([garment.name for garment in garments], owner, vertices, faces, pairs)


def untangled_start(garments: Sequence[Garment], positions: np.ndarray) -> np.ndarray:
    """Positions near the given ones from which a simulation may begin: no two triangles of cloth cross.

    Pinned vertices stay; of two garments the outer one moves. Parts that share no vertex keep
    `collision_free.SMALLEST_GAP` where pins let them. Positions without crossings are returned rounded to float32.

    Args:
        garments: the garments of one world, inner first.
        positions: (vertices, 3) of all garments, concatenated [m].

    Returns:
        (vertices, 3) float64 [m], exactly representable in float32.

    Raises:
        InputError: some crossings cannot be removed.
    """
    faces, owner = joined_faces(garments)
    pinned = np.concatenate([garment.pinned for garment in garments])
    mobility = np.where(pinned, 0.0, mobility_of(owner, len(garments)))
    start = untangle(positions, faces, mobility)
    if start.is_free:
        return start.vertices
    remaining = tangles([garment.name for garment in garments], owner, start.vertices, faces, start.crossings)
    text = "; ".join(map(str, remaining[:3])) + (f"; and {len(remaining) - 3} more" if len(remaining) > 3 else "")
    mend = (
        "repair it in the program it comes from"
        if all(tangle.garments[0] == tangle.garments[1] for tangle in remaining)
        else "give the garments in another order"
    )
    raise InputError(f"The starting position cannot be untangled: {text}; {mend}, or simulate with --self-contact off.")
