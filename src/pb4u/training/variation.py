"""Garments as they vary in the world: other cuts, and meshes of uneven edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.errors import InputError
from pb4u.garment.clearance import clear_of_body
from pb4u.garment.cuts import CUTS, Cut, Neckline
from pb4u.garment.garment import Garment
from pb4u.garment.library import FEWEST_TRIANGLES, build_garment, cut_garment
from pb4u.geometry.edge_operations import split_edges

CAPE = "cape"
"""Name of what is worn in training alone, besides the built-in garments."""

_DRAWS = 3
"""Cuts drawn for a body before the standard one is taken: few of them come out in another number of pieces."""

_NO_FRONT = 4.0
"""Width [m] of an opening in front that leaves the back alone of any garment."""

_PINNED_DEPTH = 0.04
"""Depth [m] below its highest points on which a cape is pinned on each shoulder."""

_OPEN_FRONTS = 0.15
"""Share of sleeved tops that are cut open in front."""


def varied_garment(name: str, body: ShapedBody, triangles: int, rng: np.random.Generator) -> Garment:
    """A built-in garment with a random cut; the standard cut if no draw can be worn.

    Args:
        name: built-in garment.
        body: body that it is cut for.
        triangles: wanted number of triangles.
        rng: source of the draws, which it advances.
    """
    for _ in range(_DRAWS):
        cut = varied_cut(CUTS[name], rng)
        try:
            garment = cut_garment(name, cut, body, triangles)
        except InputError:
            continue
        mesh = garment.topology
        if mesh.piece_of_vertex.max() == 0 and len(mesh.boundary_loops) == _borders(cut):
            return garment
    return build_garment(name, body, triangles, "moulded")


def _borders(cut: Cut) -> int:
    """Number of borders of a garment in one piece: an open front joins neck and hem."""
    if cut.top == "waist":
        return 3 if cut.legs else 2
    return 3 if cut.front_gap > 0.0 else 4


def varied_cut(cut: Cut, rng: np.random.Generator) -> Cut:
    """A cut of the same kind: another length, ease, neckline, sleeve and front.

    Args:
        cut: to vary.
        rng: source of the draws, which it advances.
    """

    def factor(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    # How far [m] hems rise at most: short trousers end above the knee, tops at the waist.
    shorter = 0.4 if cut.legs else 0.22 if cut.loose else 0.09
    longer = 0.12 if cut.hem in ("crotch", "knee") else 0.0
    chest, waist, hip, end = cut.ease
    wider = factor(0.8, 1.8)
    if cut.top == "waist":
        # Pinned there, it has to fit.
        ease = (chest, waist, hip * wider, end * wider * factor(0.8, 1.5))
    else:
        ease = (chest * wider, waist * wider, hip * wider, end * wider)
    above, below = cut.taper
    flare = float(rng.uniform(-0.2, 0.05)) if cut.loose else 0.0
    line = cut.neckline
    neckline = Neckline(line.front * factor(0.8, 1.6), line.back + float(rng.uniform(0.0, 0.02)), line.spread)
    sleeve = 0.0
    if cut.sleeve > 0.0:
        sleeve = float(rng.uniform(0.4, 0.95) if cut.sleeve < 1.0 else rng.uniform(1.2, 1.95))
    shoulder, cuff = cut.sleeve_ease
    front = cut.front_gap * factor(0.5, 1.6)
    if front == 0.0 and sleeve > 0.0 and rng.random() < _OPEN_FRONTS:
        front = float(rng.uniform(0.04, 0.12))
    return replace(
        cut,
        hem_offset=cut.hem_offset + float(rng.uniform(-longer, shorter)),
        ease=ease,
        taper=(above, below + flare),
        neckline=neckline,
        sleeve=sleeve,
        sleeve_ease=(shoulder * factor(0.9, 1.5), cuff * factor(0.8, 2.0)),
        armhole_depth=cut.armhole_depth * factor(0.7, 1.4),
        strap=cut.strap * factor(0.7, 1.3),
        front_gap=front,
    )


def cape(body: ShapedBody, triangles: int, rng: np.random.Generator) -> Garment:
    """A cape down the back, pinned on both shoulders: the back of a wide dress, where news has far to travel.

    Args:
        body: body that it is cut for.
        triangles: wanted number of triangles.
        rng: source of the draws, which it advances.
    """
    cut = replace(
        CUTS["dress"],
        hem_offset=float(rng.uniform(0.0, 0.4)),
        ease=(0.03, 0.05, 0.07, 0.09),
        taper=(-0.1, float(rng.uniform(-0.6, -0.2))),
        front_gap=_NO_FRONT,
    )
    garment = cut_garment(CAPE, cut, body, triangles)
    height, is_left = garment.vertices[:, 1], garment.vertices[:, 0] > 0.0
    tops = [side & (height > height[side].max() - _PINNED_DEPTH) for side in (is_left, ~is_left)]
    return garment.with_pins(tops[0] | tops[1])


def uneven(garment: Garment, body: ShapedBody, rng: np.random.Generator) -> Garment:
    """The garment with half the edge length in a random region, as artists refine for detail.

    Args:
        garment: worn by the body at rest.
        body: that nothing of the garment may sink into.
        rng: source of the draws, which it advances.
    """
    centre = garment.vertices[int(rng.integers(len(garment.vertices)))]
    distance = np.linalg.norm(garment.vertices - centre, axis=1)
    chosen = distance < np.quantile(distance, float(rng.uniform(0.15, 0.4)))
    mesh = garment.topology
    marked = chosen[mesh.edges].all(axis=1)
    vertices, faces, _ = split_edges(garment.vertices, garment.faces, mesh, marked, garment.pinned)
    pinned = np.concatenate([garment.pinned, garment.pinned[mesh.edges[marked]].all(axis=1)])
    vertices = np.where(pinned[:, None], vertices, clear_of_body(vertices, faces, body))
    return Garment(garment.name, vertices, faces, garment.material, pinned, loose=garment.loose)


def before_refining(triangles: int) -> int:
    """Number of triangles of a garment that `uneven` then brings to about `triangles`.

    Args:
        triangles: wanted number after refinement.
    """
    # A quarter of the surface in four times as many triangles.
    return max(FEWEST_TRIANGLES, round(triangles / 1.8))
